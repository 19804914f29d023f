"""Options that commands share: a dataclass whose fields are options, spread into a command by a decorator."""

import inspect
from collections.abc import Callable, Collection
from contextlib import AbstractContextManager
from dataclasses import MISSING, dataclass, fields
from functools import update_wrapper
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer

BodyFile = Annotated[
    str, typer.Option("--body", metavar="FILE", help="Body: .toml, .xml (MJCF), .urdf, or one that comes with us.")
]
LARGEST_SEED = 2**63 - 1  # what torch and netCDF take alike
MOST_WORKERS = 1024
Seed = Annotated[int, typer.Option(min=0, max=LARGEST_SEED, help="Same seed, same result.")]
TruthFile = Annotated[str | None, typer.Option(help="Torques to compare with: .csv, or a known recording's name.")]


@dataclass(frozen=True)
class Recorded:
    """What every command on a recording is given: the recording, how to read it, and a body."""

    recording: Annotated[str, typer.Argument(help="File of keypoints, or the name of a known recording.")]
    body: BodyFile
    units: Annotated[str | None, typer.Option(help="Of the file: px, mm, cm, m; deg, rad; s, ms, us …, frames.")] = None
    fps: Annotated[float | None, typer.Option(help="Frames a second, if the file does not say.")] = None
    format: Annotated[str | None, typer.Option(help="Of the file, if it is not plain from it.")] = None
    scale: Annotated[float | None, typer.Option(help="Metres a pixel.")] = None
    body_lengths: Annotated[
        bool, typer.Option("--body-lengths", help="No scale known: take it from the body's own length.")
    ] = False
    base: Annotated[
        str | None, typer.Option(help="Keypoint to subtract; default: the first joint's (`diagnose`: none in metres).")
    ] = None
    individual: Annotated[str | None, typer.Option(help="Which animal, in a file of several.")] = None
    plane: Annotated[
        str | None,
        typer.Option(help="Of a file's three axes, right and up: xy, xz …; default: without a constant one."),
    ] = None
    frames: Annotated[str, typer.Option(help="Which rows to use, of the first recording, such as 50:250.")] = ":"
    passive: Annotated[bool, typer.Option("--passive", help="No torque acts: the body moves freely.")] = False
    hide_torque: Annotated[bool, typer.Option("--hide-torque", help="Ignore the recording's commands.")] = False

    def read(self, name: str, body: Any, as_filmed: bool = False, frames: str = ":") -> Any:
        """A recording of `body`, read as the options say; see `inputs.load_recording`. Raises as readers do."""
        from .inputs import load_recording

        return load_recording(
            name,
            body,
            self.base,
            self.body_lengths,
            as_filmed,
            frames,
            units=self.units,
            fps=self.fps,
            format=self.format,
            scale=self.scale,
            individual=self.individual,
            plane=self.plane,
        )


@dataclass(frozen=True)
class Inference(Recorded):
    """What `infer` and `compare` are given: a recording, a body, the model that joins them, sampler sizes."""

    truth: TruthFile = None
    learn_lengths: Annotated[bool, typer.Option("--learn-lengths", help="Learn the links' lengths.")] = False
    torque: Annotated[
        str,
        typer.Option(help="Torque process: ornstein_uhlenbeck, random_walk, matern32, matern52, recurrent."),
    ] = "ornstein_uhlenbeck"
    noise: Annotated[str, typer.Option(help="Observation noise: gaussian or student_t.")] = "gaussian"
    filters: Annotated[int, typer.Option(min=1, help="Independent filters.")] = 64
    particles: Annotated[int, typer.Option(min=1, help="Particles of each.")] = 100
    draws: Annotated[int, typer.Option(min=1, help="Trajectories drawn from each.")] = 4
    seed: Seed = 0
    workers: Annotated[int | None, typer.Option(min=1, max=MOST_WORKERS, help="Processes that share the filters.")] = (
        None
    )
    scheduler: Annotated[
        str | None, typer.Option(help="Whose workers share the filters: Dask's (tcp://host:8786), or mpi.")
    ] = None
    filters_per_task: Annotated[
        int | None, typer.Option(min=1, help="Filters that a worker takes at a time; default: 32.")
    ] = None
    device: Annotated[str, typer.Option(help="Of the particle filters: cpu or cuda.")] = "cpu"

    def check(self, *methods: str) -> None:
        """Raise InputError for a name that is not known."""
        from invdyn.inference import METHODS
        from invdyn.models import FAMILIES, TORQUE_PROCESSES
        from invdyn.recordings import InputError

        named: list[tuple[str, str, Collection[str]]] = [("method", method, METHODS) for method in methods]
        named += [("torque process", self.torque, TORQUE_PROCESSES), ("noise", self.noise, FAMILIES)]
        for what, given, known in named:
            if given not in known:
                raise InputError(f"unknown {what} {given!r}: known are {', '.join(known)}")

    @property
    def files(self) -> list[Path]:
        """What is read, and must not be written over."""
        return [Path(name) for name in (self.recording, self.body, self.truth) if name is not None]

    def load(self) -> dict[str, Any]:
        """Read all of it: keyword arguments of `inference.infer` and `inference.compare`. Raises as readers do."""
        from invdyn.models import TORQUE_PROCESSES

        from .inputs import load_body, load_known

        body = load_body(self.body)
        return {
            "recording": self.read(self.recording, body, frames=self.frames),
            "body": body,
            "truth": None if self.truth is None else load_known(self.truth, body),
            "num_filters": self.filters,
            "num_particles": self.particles,
            "num_draws": self.draws,
            "seed": self.seed,
            "learn_lengths": self.learn_lengths,
            "torque": TORQUE_PROCESSES[self.torque](),
            "family": self.noise,
            "passive": self.passive,
            "hide_torque": self.hide_torque,
            "device": self.device,
            "filters_per_task": self.filters_per_task,
        }

    def executor(self) -> AbstractContextManager:
        """Executor asked for, or None, for the time of a block. Raises InputError when there is none to be had."""
        from invdyn.inference.execution.executors import open_executor

        return open_executor(self.workers, self.scheduler)


@dataclass(frozen=True)
class Diagnosed(Recorded):
    """What `diagnose` is given: a recording, the body whose simulation is questioned, what to check the answer on."""

    also: Annotated[
        str | None, typer.Option(help="More recordings of the same arm to diagnose together with it, comma-separated.")
    ] = None
    held_out: Annotated[
        str | None,
        typer.Option(help="Another recording of the same arm, to check the answer on; default: this one's last third."),
    ] = None
    without: Annotated[str, typer.Option(help="Effects to strike from the catalogue, such as payload,armature.")] = ""
    most: Annotated[int, typer.Option(min=1, help="Effects at once, at most; with many it takes long.")] = 4
    budget: Annotated[
        float | None,
        typer.Option(help="Seconds the search may take; default: counted work, the same result on every machine."),
    ] = None
    tolerance: Annotated[
        float,
        typer.Option(
            min=0, max=1, help="Share of a typical torque under which a gap, or what is left, does not matter."
        ),
    ] = 0.005
    seed: Seed = 0
    workers: Annotated[
        int,
        typer.Option(
            min=1, max=MOST_WORKERS, help="Processes side by side, with the same result (on Linux; one elsewhere)."
        ),
    ] = 2

    def check(self) -> None:
        """Raise InputError for an unknown effect, torques both 0 and hidden, and a recording that is given twice."""
        from invdyn.models.effects import EFFECTS
        from invdyn.recordings import InputError, resolved

        for name in self.struck:
            if name not in EFFECTS:
                raise InputError(f"unknown effect {name!r}: known are {', '.join(EFFECTS)}")
        if self.passive and self.hide_torque:
            raise InputError("--passive says that torques are zero, --hide-torque that they are unknown: choose one")
        given: set[Path] = set()
        for name in (self.recording, *self.others, *([] if self.held_out is None else [self.held_out])):
            if resolved(name) in given:
                option = "--held-out" if name == self.held_out else "--also"
                raise InputError(f"{name}: expected another recording of the same arm for {option}, got one twice")
            given.add(resolved(name))

    @property
    def struck(self) -> tuple[str, ...]:
        """Names of `without`."""
        return tuple(name.strip() for name in self.without.split(",") if name.strip())

    @property
    def files(self) -> list[Path]:
        """What is read, and must not be written over."""
        return [Path(name) for name in (self.recording, *self.others, self.body, self.held_out) if name is not None]

    @property
    def others(self) -> tuple[str, ...]:
        """Names of `also`."""
        return tuple(name.strip() for name in (self.also or "").split(",") if name.strip())

    def load(self) -> dict[str, Any]:
        """Read all of it: keyword arguments of `diagnosis.diagnose`. Raises as readers do."""
        from dataclasses import replace

        from .inputs import load_body

        body = load_body(self.body)

        def read(name: str, frames: str = ":") -> Any:
            recording = self.read(name, body, as_filmed=True, frames=frames)
            if self.hide_torque and recording.torques is not None:
                joints = recording.joint_names if recording.angles is not None else ()
                recording = replace(recording, torques=None, joint_names=joints)
            return recording

        recording = read(self.recording, self.frames)
        return {
            "recording": [recording, *map(read, self.others)] if self.others else recording,
            "body": body,
            "held_out": None if self.held_out is None else read(self.held_out),
            "passive": self.passive,
            "without": self.struck,
            "most": self.most,
            "budget": self.budget,
            "tolerance": self.tolerance,
            "seed": self.seed,
            "workers": self.workers,
        }


def with_option_groups(command: Callable[..., None]) -> Callable[..., None]:
    """Let typer see the fields of a command's first parameter, a dataclass, as options: the required ones before the
    command's own options, the others after them.
    """
    (first, *own) = inspect.signature(command).parameters.values()
    hints = get_type_hints(command, include_extras=True)
    group = hints.pop(first.name)
    kinds = get_type_hints(group, include_extras=True)

    def parameter(name: str, default: Any, kind: Any) -> inspect.Parameter:
        empty = inspect.Parameter.empty if default is MISSING else default
        return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=empty, annotation=kind)

    shared = [parameter(field.name, field.default, kinds[field.name]) for field in fields(group)]
    required = [one for one in shared if one.default is inspect.Parameter.empty]
    rest = [one for one in shared if one not in required]
    parameters = [*required, *(one.replace(kind=inspect.Parameter.KEYWORD_ONLY) for one in own), *rest]

    def spread_command(**options: Any) -> None:
        given = group(**{name: options.pop(name) for name in kinds})
        command(given, **options)

    update_wrapper(spread_command, command)
    vars(spread_command)["__signature__"] = inspect.Signature(parameters)
    spread_command.__annotations__ = {one.name: hints.get(one.name, one.annotation) for one in parameters}
    del vars(spread_command)["__wrapped__"]
    return spread_command
