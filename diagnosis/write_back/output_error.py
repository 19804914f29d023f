"""The numbers of a robot's file by output error: MuJoCo replays the logs, and what it is off by is made small.

    ẑ = argmin over z   Σ over windows w, joints j   n log(1 + mean e²(w, j)/s²(j))   +   Σ ((z − m)/sd)²
    e = q_sim(z) − q                                        s = noise and `refine_floor` of the joint's motion

(Ljung 1999, System Identification, §7.2, with the variance of each window and joint unknown: its likelihood is a
Student t's. What no number explains, such as a servo that slews, then counts little next to what one does.) A window
begins at the smoothed state (:mod:`.engine_replays`); n is its length in correlation times. Gauss–Newton with damped
steps; slopes are differences of replays, all of a window in one batch.

Every third window is held out. There the fit is compared with the file and with what the regression alone writes, and
the likelihood is tempered, H/c² + prior, until an ensemble's bands hold `ensemble_coverage` of the rows: what the
simulation lacks is then in its width, and a number of which the logs say nothing stays as wide as its prior.

Shapes: N numbers (:mod:`.file_numbers`), B models, W windows, R rows of one, K joints. Units: rad, s.
"""

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from invdyn.diagnosis.assessment.result import Diagnosis
from invdyn.diagnosis.rules import FIXED
from invdyn.diagnosis.write_back.changes import Z_90, FileChange, correction
from invdyn.diagnosis.write_back.engine_replays import Replays, Window, seconds, windows
from invdyn.diagnosis.write_back.file_numbers import FileNumbers
from invdyn.diagnosis.write_back.xml_text import is_mjcf
from invdyn.models import ArticulatedBody
from invdyn.models.bodies.body_mjcf import compiled
from invdyn.models.bodies.body_xml import MOST_BYTES
from invdyn.models.bodies.joint_parts_mjcf import joint_names
from invdyn.models.bodies.whole_file import read_whole
from invdyn.recordings import Recording


@dataclass(frozen=True)
class OutputError:
    """A file's numbers after the fit.

    `changes` have 90 % ranges of `draws` (D, N), which are of the ensemble's own scatter. `rms` is of held-out windows,
    rad, by "file", "regression" and "refined", each by joint; `coverage` what the ensemble's band holds there.
    """

    numbers: FileNumbers
    changes: tuple[FileChange, ...]
    draws: np.ndarray
    rms: dict[str, dict[str, float]]
    coverage: float
    windows: int

    @property
    def is_better(self) -> bool:
        """Whether it is less far off than the file and than the regression's, in the mean of joints' logarithms."""
        size = {who: float(np.mean(np.log(list(each.values())))) for who, each in self.rms.items()}
        return size["refined"] < min(size["file"], size["regression"])

    def to_json(self) -> dict[str, Any]:
        """What a diagnosis.json has of it."""
        return {
            "window_s": seconds(self.numbers.body),
            "windows": self.windows,
            "held_out_rms_rad": self.rms,
            "ensemble_coverage": self.coverage,
        }

    def member(self, place: int) -> tuple[FileChange, ...]:
        """The changes at one of the draws."""
        z = self.draws[place % len(self.draws)]
        return self.numbers.changes(z, z[None])


def refine(
    diagnosis: Diagnosis,
    source: Any,
    body: ArticulatedBody,
    recordings: Sequence[Recording],
    *,
    members: int = 0,
    workers: int = 1,
    progress: Callable[[int, int, str], None] | None = None,
) -> OutputError | None:
    """The regression's answer to a robot's logs, refined in MuJoCo; an ensemble has so many ``members``.

    ``source`` is the robot's file, or a ``mujoco.MjSpec`` or ``MjModel``.

    None where the file is no MJCF, the answer is not the regression's, or the fit replays held-out windows no better.
    """
    if diagnosis.regressed is None:
        return None
    if isinstance(source, str | Path) and not is_mjcf(read_whole(source, MOST_BYTES)):
        return None
    found = correction(diagnosis.regressed, body).changes
    draws = max(members, FIXED.refine_draws)
    result = refined(recordings, source, body, found, draws, diagnosis.seed, workers, progress)
    return result if result is not None and result.is_better else None


def refined(
    recordings: Sequence[Recording],
    robot: Any,
    body: ArticulatedBody,
    found: Sequence[FileChange],
    draws: int,
    seed: int,
    workers: int = 1,
    progress: Callable[[int, int, str], None] | None = None,
) -> OutputError | None:
    """The numbers of a robot that replay the recordings best; ``found`` is what a regression changes.

    None where no joint has a motor of its own, or no recording is as long as three windows.
    """
    model = compiled(robot)
    if set(body.joint_names) - set(joint_names(model)):
        return None  # MuJoCo counts a ball otherwise
    numbers = FileNumbers(model, body, found)
    every = [window for each in recordings for window in windows(numbers, each)]
    if not any(each.quantity.endswith("gain") for each in numbers.numbers) or len(every) < 3:
        return None
    fitted, held_out = split(every)
    replay = Replays(numbers, workers)
    some = fitted[:: FIXED.refine_first]
    report = partial(_report, progress)
    found_by_regression = numbers.mean
    numbers = replay.numbers = _started(replay, some)
    z, _ = _fitted(replay, some, numbers.mean, partial(report, "first replays"))
    z, information = _fitted(replay, fitted, z, partial(report, "all replays"))
    unit = np.random.default_rng(seed).standard_normal((draws, len(z)))
    for scale in FIXED.ensemble_scales:
        root = np.linalg.cholesky(information / scale**2 + np.diag(1 / numbers.sd**2))
        members = z + np.linalg.solve(root.T, unit.T).T
        coverage = _coverage(replay, members, held_out, _floor(fitted))
        if coverage >= FIXED.ensemble_coverage:
            break
    models = [copy.copy(numbers.filed), numbers.model(found_by_regression), numbers.model(z)]
    off = np.concatenate([replay.off(models, each) for each in held_out], 1)
    by_joint = np.sqrt((off**2).mean(1)).tolist()
    rms = {
        who: dict(zip(body.joint_names, each, strict=True))
        for who, each in zip(("file", "regression", "refined"), by_joint, strict=True)
    }
    return OutputError(numbers, numbers.changes(z, members), members, rms, coverage, len(fitted) + len(held_out))


def split(every: Sequence[Window]) -> tuple[list[Window], list[Window]]:
    """Windows to fit, and every third one, which is held out; of many, `max_refine_windows` that lie evenly."""
    order = np.linspace(0, len(every) - 1, min(len(every), FIXED.max_refine_windows)).round().astype(int)
    return [every[n] for m, n in enumerate(order) if m % 3 != 2], [every[n] for n in order[2::3]]


def _started(replay: Replays, replayed: Sequence[Window]) -> FileNumbers:
    """The numbers with priors about better starts: of each joint, the one of several that replays it best.

    They are the regression's, and the file's with gains of a ladder, whose damping goes with the gain's root. One
    joint's numbers hardly move another.
    """
    starts = replay.numbers.starts()
    error = sum(np.log((replay.errors(starts, each) ** 2).mean(1) + FIXED.min_replay_noise**2) for each in replayed)
    best = dict(zip(replay.numbers.body.joint_names, np.asarray(error).argmin(0), strict=True))
    return replay.numbers.about([starts[best.get(each.place, 0)][n] for n, each in enumerate(replay.numbers.numbers)])


def _fitted(
    replay: Replays, replayed: Sequence[Window], z: np.ndarray, report: Callable[[int], None]
) -> tuple[np.ndarray, np.ndarray]:
    """ẑ (N,) from a start, and the likelihood's precision H (N, N)."""
    mean, sd = replay.numbers.mean, replay.numbers.sd
    floor = _floor(replayed)
    count = max(1.0, seconds(replay.numbers.body) / FIXED.refine_memory)
    step = FIXED.refine_slope * np.minimum(sd, 1.0)

    def cost(z: np.ndarray, off: list[np.ndarray]) -> np.ndarray:
        """Of models (B, N) with errors (B, R, K) in each window."""
        own = sum(np.log1p((each**2).mean(-2) / floor**2).sum(-1) for each in off)
        return np.asarray(count * own + (((z - mean) / sd) ** 2).sum(-1))

    def run(z: np.ndarray) -> list[np.ndarray]:
        return [replay.errors(z, each) for each in replayed]

    now, information = float(cost(z[None], run(z[None]))[0]), np.zeros((len(z), len(z)))
    for done in range(FIXED.refine_rounds):
        report(done)
        moved = [replay.errors(np.concatenate([z[None], z + np.diag(step)]), each) for each in replayed]
        information, pull = np.zeros((len(z), len(z))), (mean - z) / sd**2
        for each in moved:
            here = each[0]
            weight = np.sqrt(count / len(here) / ((here**2).mean(0) + floor**2))
            slope = (weight * (each[1:] - here) / step[:, None, None]).reshape(len(z), -1)
            information = information + slope @ slope.T
            pull = pull - slope @ (weight * here).ravel()
        precision = information + np.diag(1 / sd**2)
        tried = np.array(
            [z + np.linalg.solve(precision + d * np.diag(np.diag(precision)), pull) for d in FIXED.refine_steps]
        )
        costs = cost(tried, run(tried))
        best = int(np.argmin(costs))
        if costs[best] > now - FIXED.refine_gain:
            break
        z, now = tried[best], float(costs[best])
    return z, information


def _report(progress: Callable[[int, int, str], None] | None, what: str, done: int) -> None:
    if progress is not None:
        progress(done, FIXED.refine_rounds, f"refine; {what}")


def _floor(replayed: Sequence[Window]) -> np.ndarray:
    """Errors s (K,) below which less does not count, rad."""
    moved = np.concatenate([window.angle - window.angle.mean(0) for window in replayed])
    return np.maximum(FIXED.refine_floor * np.sqrt((moved**2).mean(0)), FIXED.min_replay_noise)


def _coverage(replay: Replays, members: np.ndarray, replayed: Sequence[Window], floor: np.ndarray) -> float:
    """Share of rows and joints that members' central 90 % holds, as wide as 90 % of the floor's normal at least."""
    inside: list[Any] = []
    for window in replayed:
        low, high = np.quantile(replay.errors(members, window), [0.05, 0.95], axis=0)
        middle, half = (low + high) / 2, np.maximum((high - low) / 2, Z_90 * floor)
        inside.append(np.abs(middle) <= half)
    return float(np.mean([each.mean() for each in inside]))
