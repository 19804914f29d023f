"""Options of `infer` and `compare`: the model that joins recording and body, sizes of samplers, where it runs."""

import inspect
import re
from collections.abc import Callable, Collection
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .options import MAX_WORKERS, Device, Filters, Particles, Seed, Workers
from .recording_options import Recorded
from .settings import Setting, spelled, yes

if TYPE_CHECKING:
    from invdyn.recordings.reading import TrackedFilm

AUTO = "auto"
"""The torque by default, whose process is not known."""
NONE = "none"
"""No torque: a kinematic model, of motion and lengths alone."""
LENGTHS = "lengths"
CAMERAS = ("offset", "pose", "turn")
"""What `--learn` may name: of links, and of cameras."""


@dataclass(frozen=True)
class Inference(Recorded):
    """What `infer` and `compare` are given: a recording, a body, the model that joins them, sizes of samplers."""

    truth: Annotated[str | None, Setting("torques to compare with: .csv, or a known recording's name")] = None
    learn: Annotated[
        list[str] | None,
        typer.Option(
            help="What to learn too: lengths of links; of cameras offset (of clocks), pose, or turn "
            "about their places. Repeatable."
        ),
    ] = None
    torque: Annotated[
        str,
        typer.Option(
            help="Torque process: auto, whose parameters are uncertain; or ornstein_uhlenbeck, random_walk, matern32, "
            "matern52, recurrent, smooth_and_rough, at fitted parameters; none: motion and lengths alone, "
            "without forces, by smc or laplace (`infer`)."
        ),
    ] = AUTO
    noise: Annotated[
        str | None,
        Setting(
            "of an observation: gaussian, student_t of each number, or multivariate_t of each keypoint; "
            "default: gaussian, and student_t for pixels"
        ),
    ] = None
    forces: Annotated[
        Path | None, Setting("known forces on keypoints, N: .csv of time, <keypoint>_fx, <keypoint>_fy", Path)
    ] = None
    filters: Filters = 64
    particles: Particles = 100
    draws: Annotated[int, Setting("trajectories drawn from each filter; default: 4", int, least=1)] = 4
    seed: Seed = 0
    workers: Workers = None
    device: Device = "cpu"
    filters_per_task: Annotated[
        int | None, Setting("filters that a worker takes at a time; default: 32", int, least=1)
    ] = None
    exact_body: Annotated[bool, Setting("yes: the numbers of a robot's file are exact; default: no", yes)] = False

    def check(self, *methods: str, without_torque: bool = False) -> None:
        """Raise InputError for a name that is not known; a torque "none" is one only ``without_torque``."""
        from invdyn.inference import METHODS
        from invdyn.models import FAMILIES, TORQUE_PROCESSES
        from invdyn.recordings import InputError

        named: list[tuple[str, str, Collection[str]]] = [("method", method, METHODS) for method in methods]
        named += [
            ("torque process", self.torque, (*TORQUE_PROCESSES, AUTO, *[NONE] * without_torque)),
            ("noise", self.family, FAMILIES),
        ]
        named += [("word of --learn", word, (LENGTHS, *CAMERAS)) for word in self.learned]
        for what, given, known in named:
            if given not in known:
                raise InputError(f"unknown {what} {given!r}: known are {', '.join(known)}")

    @property
    def other_recordings(self) -> list[str]:
        """The truth, and forces."""
        return [str(each) for each in (self.truth, self.forces) if each is not None]

    @property
    def learned(self) -> list[str]:
        """Words of `learn`."""
        return [word.strip() for text in self.learn or () for word in text.split(",") if word.strip()]

    @property
    def family(self) -> str:
        """Of the noise: a tracker's pixels have outliers."""
        return self.noise or ("student_t" if self.calibration else "gaussian")

    @property
    def arguments(self) -> dict[str, Any]:
        """Arguments of `inference.infer` and `inference.compare`, but for what is read."""
        from invdyn.models import TORQUE_PROCESSES

        named: dict[str, Callable[[], Any]] = {**TORQUE_PROCESSES, AUTO: lambda: None, NONE: lambda: None}
        return {
            "num_filters": self.filters,
            "num_particles": self.particles,
            "num_draws": self.draws,
            "seed": self.seed,
            "learn_lengths": LENGTHS in self.learned,
            "torque": named[self.torque](),
            "family": self.family,
            "learn_cameras": tuple(word for word in self.learned if word in CAMERAS),
            "passive": self.zero_torque,
            "hide_torque": self.hide_torque,
            "device": self.device,
            "filters_per_task": self.filters_per_task,
            "checkpoint": self.checkpoint,
        }

    def load(self, **more: Any) -> tuple[dict[str, Any], "TrackedFilm | None"]:
        """Read recording, body and truth; and the film that was tracked, if any.

        ``more`` are options of readers. Raises as readers do.
        """
        from invdyn.recordings import InputError, read_forces

        from .inputs import LOG, check_options, load_known, read_recordings, source_of

        source = source_of(self.recordings, self.calibration, self.mapping)
        check_options(self.recording, [source], self.reading, type(self))
        if not self.calibration and (cameras := [word for word in self.learned if word in CAMERAS]):
            raise InputError(f"--learn {cameras[0]} needs several cameras: pass --calibration, and a file for each one")
        body = self.read_body(filmed=source is not LOG)
        body = replace(body, exact=True) if self.exact_body else body
        more |= {"frames": self.frames, "guessed": LENGTHS in self.learned, "hide_torque": self.hide_torque}
        readings = read_recordings(self.recordings, body, **self.reading, **more)
        if len(readings) > 1:
            raise InputError(f"expected one recording, got {len(readings)} episodes: --set episodes=0 chooses one")
        truth = None if self.truth is None else load_known(self.truth, body)
        read: dict[str, Any] = {"recording": readings[0].recording, "body": body, "truth": truth}
        if self.forces is not None:
            read["forces"] = read_forces(self.forces)
        return read, readings[0].film


def kinematic_arguments(arguments: dict[str, Any]) -> dict[str, Any]:
    """Those that `inference.infer_kinematics` takes. Raises InputError for any other that is not its default."""
    from invdyn.inference import infer
    from invdyn.inference.kinematics import infer_kinematics
    from invdyn.recordings import InputError

    usual, taken = inspect.signature(infer).parameters, inspect.signature(infer_kinematics).parameters
    for name, value in arguments.items():
        if name not in taken and value not in (None, usual[name].default):
            field = {"passive": "zero_torque", "executor": "workers", "learn_cameras": "learn"}.get(name, name)
            raise InputError(f"{spelled(Inference, field)}: has no part in --torque none; leave one of them out")
    return {name: value for name, value in arguments.items() if name in taken}


def open_workers(workers: str | None) -> AbstractContextManager:
    """The executor of `--workers`, or None, for the time of a block. Raises InputError where it cannot be had."""
    from invdyn.inference.execution.executors import open_executor
    from invdyn.recordings import InputError

    if workers is None or not re.fullmatch("-?[0-9]+", workers):
        return open_executor(None, workers)
    if len(workers) > len(str(MAX_WORKERS)) or not 1 <= int(workers) <= MAX_WORKERS:
        raise InputError(f"--workers: expected 1 to {MAX_WORKERS} processes, or a scheduler, got {workers:.60}")
    return open_executor(int(workers))
