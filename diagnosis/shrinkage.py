"""How far the gap closes on data that the cause's parameters have not seen.

Another recording of the same arm where there is one; else the last third of this one, the cause refitted on the first
two; but what was searched (:mod:`.noise`), and what the first two cannot show, such as a push that comes later, keeps
the parameters that all rows gave it. In nats of one-step prediction, with the simulation as it is, with the cause, and
the floor that a simulation without a gap would reach:

    closed = Σ (with − without) / Σ (floor − without)

Its interval comes from a moving-block bootstrap of the rows (Künsch 1989), as neighbouring errors are alike.
"""

from dataclasses import dataclass

import numpy as np
import torch

from invdyn.diagnosis.cause import Refined
from invdyn.diagnosis.paths import led
from invdyn.diagnosis.predict import Scores, best_size, scores
from invdyn.diagnosis.refine import refine
from invdyn.diagnosis.setting import Setting
from invdyn.inference.gauss_newton import gauss_newton

BLOCK = 0.4
"""s, length of the bootstrap's blocks."""
DRAWS = 1000
LATER = 4.0
"""Factor by which a parameter's standard deviation grows where the rows that show it are missing; by 1.2 elsewhere."""
SHARE = 2 / 3
"""Of the rows, to fit on, where the rest is held out."""


@dataclass(frozen=True)
class Closed:
    """Result: ``share`` and its central 90 % interval (None where there was no gap to close), and nats per frame."""

    share: float | None
    interval: tuple[float, float] | None
    per_frame: dict[str, float]


def split(setting: Setting) -> tuple[Setting, np.ndarray]:
    """The setting before its last rows, and which rows (T,) those are."""
    seen = np.flatnonzero((~torch.isnan(setting.observations)).any(-1).numpy())
    first = int(seen[int(SHARE * len(seen))])
    return setting.until(first), np.arange(len(setting.observations)) >= first


def held_out_scores(
    setting: Setting, none: Refined, cause: Refined, other: Setting | None = None
) -> tuple[Scores, Scores, np.ndarray]:
    """Scores without and with the cause, and the rows (T,) that count."""
    if other is not None:
        pair = []
        for each in (none, cause):
            model = each.carried_to(other)
            start = gauss_newton(other.with_residual(other.loose, model), other.observations).path
            path = led(other, model, start, best_size(setting, each))
            pair.append(scores(other, each.moved_to(model, path)))
        return *pair, np.ones(len(other.observations), bool)
    train, rows = split(setting)
    pair = []
    for each in (none, cause):
        values = dict(zip(each.names, each.mean.tolist(), strict=True)) | each.noise
        try:
            begun, size = each.path[: len(train.observations)], best_size(setting, each)
            fitted = refine(train, each.effects, values, begun, size, rounds=2, **each.searched)
        except (ValueError, np.linalg.LinAlgError, torch.linalg.LinAlgError):
            fitted = each  # the first rows by themselves lead nowhere
        if _shown_later(each, fitted):
            fitted = each
        # Linearised along a path that knows the held-out rows; the predictions themselves do not.
        pair.append(scores(setting, fitted.moved_to(fitted.model, each.path)))
    return *pair, rows


def _shown_later(cause: Refined, fitted: Refined) -> bool:
    """Whether the rows that a cause is ``fitted`` on say next to nothing of some parameter of its effects."""
    mine = np.array([not name.startswith("body.") for name in cause.names], dtype=bool)
    return bool((fitted.sd[mine] > LATER * cause.sd[mine]).any())


def closed(without: Scores, with_cause: Scores, rows: np.ndarray, time: np.ndarray, seed: int) -> Closed:
    """Share of the gap that is closed on ``rows`` (T,)."""
    use = rows & np.isfinite(without.score) & np.isfinite(with_cause.score)
    gain, gap = (with_cause.score - without.score)[use], (with_cause.floor - without.score)[use]
    per_frame = {
        "nominal": float(without.score[use].mean()),
        "corrected": float(with_cause.score[use].mean()),
        "noise_floor": float(with_cause.floor[use].mean()),
    }
    if gap.sum() <= 0:
        return Closed(None, None, per_frame)
    length = max(1, round(BLOCK / np.median(np.diff(time[use]))))
    count = max(1, int(np.ceil(len(gain) / length)))
    starts = np.random.default_rng(seed).integers(max(len(gain) - length, 0) + 1, size=(DRAWS, count))
    index = np.minimum((starts[..., None] + np.arange(length)).reshape(DRAWS, -1), len(gain) - 1)
    total = gap[index].sum(1)
    shares = gain[index].sum(1)[total > 0] / total[total > 0]
    low, high = np.quantile(np.minimum(shares, 1.0), [0.05, 0.95]) if len(shares) else (np.nan, np.nan)
    return Closed(float(min(gain.sum() / gap.sum(), 1.0)), (float(low), float(high)), per_frame)
