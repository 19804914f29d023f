"""Options of `infer` and `compare`: the model that joins recording and body, sampler sizes, where it runs."""

from collections.abc import Collection
from contextlib import AbstractContextManager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any

import typer

from .options import MOST_WORKERS, Seed
from .recording_options import Recorded

TruthFile = Annotated[str | None, typer.Option(help="Torques to compare with: .csv, or a known recording's name.")]
FORCES = (
    *("torque", "passive", "hide_torque", "workers", "scheduler", "device", "filters_per_task"),
    *("calibration", "learn_cameras"),
)
"""Options that a kinematic model takes none of: of forces, and of cameras, which it does not know."""


@dataclass(frozen=True)
class Inference(Recorded):
    """What `infer` and `compare` are given: a recording, a body, the model that joins them, sampler sizes."""

    truth: TruthFile = None
    offset: Annotated[
        list[str] | None, typer.Option(help="How far a camera's clock is ahead, s: cam2=0.02; repeatable.")
    ] = None
    learn_cameras: Annotated[
        str, typer.Option(help="What is not known of cameras: offset (of clocks), pose, or turn about their places.")
    ] = ""
    learn_lengths: Annotated[bool, typer.Option("--learn-lengths", help="Learn the links' lengths.")] = False
    torque: Annotated[
        str,
        typer.Option(
            help="Torque process: ornstein_uhlenbeck, random_walk, matern32, matern52, recurrent, smooth_and_rough; "
            "or auto, which fits the first and the last and keeps the one with more evidence."
        ),
    ] = "ornstein_uhlenbeck"
    noise: Annotated[
        str | None,
        typer.Option(
            help="Observation noise: gaussian, student_t of each number, or multivariate_t of each keypoint; default: "
            "gaussian, and student_t for pixels."
        ),
    ] = None
    filters: Annotated[int, typer.Option(min=1, help="Independent filters.")] = 64
    particles: Annotated[int, typer.Option(min=1, help="Particles of each.")] = 100
    draws: Annotated[int, typer.Option(min=1, help="Trajectories drawn from each.")] = 4
    seed: Seed = 0
    workers: Annotated[int | None, typer.Option(min=1, max=MOST_WORKERS, help="Processes that share the filters.")] = (
        None
    )
    scheduler: Annotated[
        str | None, typer.Option(help="Where the filters run: a Dask scheduler (tcp://host:8786), or mpi.")
    ] = None
    filters_per_task: Annotated[
        int | None, typer.Option(min=1, help="Filters that a worker takes at a time; default: 32.")
    ] = None
    device: Annotated[str, typer.Option(help="Where particle filters compute: cpu or cuda.")] = "cpu"

    def check(self, *methods: str) -> None:
        """Raise InputError for a name that is not known."""
        from invdyn.inference import METHODS
        from invdyn.models import FAMILIES, TORQUE_PROCESSES
        from invdyn.recordings import InputError

        named: list[tuple[str, str, Collection[str]]] = [("method", method, METHODS) for method in methods]
        named += [("torque process", self.torque, (*TORQUE_PROCESSES, "auto")), ("noise", self.family, FAMILIES)]
        for what, given, known in named:
            if given not in known:
                raise InputError(f"unknown {what} {given!r}: known are {', '.join(known)}")

    def check_kinematic(self, **others: Path | None) -> None:
        """Raise InputError for options, of this group and `others`, that a motion without forces has no use for."""
        from invdyn.recordings import InputError

        own = {field.name: field.default for field in fields(self) if field.name in FORCES}
        given = [name for name, default in own.items() if getattr(self, name) != default]
        given += [name for name, value in others.items() if value is not None]
        if given:
            raise InputError(f"--{given[0].replace('_', '-')}: has no part in --kinematic; leave one of them out")

    @staticmethod
    def kinematic(arguments: dict[str, Any]) -> dict[str, Any]:
        """Of what `load` returns that which `inference.infer_kinematics` takes."""
        return {name: value for name, value in arguments.items() if name not in FORCES}

    @property
    def files(self) -> list[Path]:
        """What is read, and must not be written over."""
        named = [Path(name) for name in (*self.tracked, self.body, self.truth) if name is not None]
        return [*named, *(self.calibration or [])]

    @property
    def guessed(self) -> bool:
        """Whether lengths are learned."""
        return self.learn_lengths

    @property
    def family(self) -> str:
        """Of the noise: a tracker's pixels stray."""
        return self.noise or ("student_t" if self.calibration else "gaussian")

    def load(self) -> dict[str, Any]:
        """Read all of it: keyword arguments of `inference.infer` and `inference.compare`. Raises as readers do."""
        from invdyn.models import SMOOTHNESS, TORQUE_PROCESSES

        from .inputs import load_known
        from .inputs_of_cameras import load_from_cameras

        recording: Any
        body: Any
        if self.calibration:
            recording, body = load_from_cameras(
                self.recordings,
                self.calibration,
                self.body,
                self.frames,
                self.offset or (),
                self.not_of_cameras | {"--learn-lengths": self.learn_lengths},
                fps=self.fps,
                format=self.format,
                individual=self.individual,
            )
        else:
            self._check_no_cameras()
            body = self.read_body()
            recording = self.read(self.recording, body, frames=self.frames)
        return {
            "recording": recording,
            "body": body,
            "truth": None if self.truth is None else load_known(self.truth, body),
            "num_filters": self.filters,
            "num_particles": self.particles,
            "num_draws": self.draws,
            "seed": self.seed,
            "learn_lengths": self.learn_lengths,
            "torque": [TORQUE_PROCESSES[name]() for name in (SMOOTHNESS if self.torque == "auto" else [self.torque])],
            "family": self.family,
            "learn_cameras": tuple(word.strip() for word in self.learn_cameras.split(",") if word.strip()),
            "passive": self.passive,
            "hide_torque": self.hide_torque,
            "device": self.device,
            "filters_per_task": self.filters_per_task,
        }

    def _check_no_cameras(self) -> None:
        from invdyn.recordings import InputError

        if self.offset or self.learn_cameras:
            option = "--offset" if self.offset else "--learn-cameras"
            raise InputError(
                f"{option} needs several cameras: pass --calibration, and one file of pixels for each camera"
            )

    def executor(self) -> AbstractContextManager:
        """Executor asked for, or None, for the time of a block. Raises InputError when there is none to be had."""
        from invdyn.inference.execution.executors import open_executor

        return open_executor(self.workers, self.scheduler)
