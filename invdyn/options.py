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
    str, typer.Option("--body", metavar="FILE", help="Body: .toml, .xml (MJCF), .urdf, or the name of one of ours.")
]
LARGEST_SEED = 2**63 - 1  # what torch and netCDF take alike
MOST_WORKERS = 1024
Seed = Annotated[int, typer.Option(min=0, max=LARGEST_SEED, help="Same seed, same result.")]
FORCES = (
    *("torque", "passive", "hide_torque", "workers", "scheduler", "device", "filters_per_task"),
    *("calibration", "learn_cameras"),
)
"""Options that a kinematic model takes none of: of forces, and of cameras, which it does not know."""
TruthFile = Annotated[str | None, typer.Option(help="Torques to compare with: .csv, or a known recording's name.")]


@dataclass(frozen=True)
class Recorded:
    """What every command on a recording is given: the recording, how to read it, and a body."""

    recordings: Annotated[
        list[str],
        typer.Argument(
            metavar="RECORDING…",
            help="File of keypoints, or the name of a known recording; with --calibration one file of pixels a camera.",
        ),
    ]
    body: BodyFile
    calibration: Annotated[
        list[Path] | None,
        typer.Option(help="Of several cameras, in metres: .toml, .qca.txt, .yml or .json (OpenCV; repeatable)."),
    ] = None
    units: Annotated[
        str | None, typer.Option(help="Units of the file: px, mm, cm, m; deg, rad; s, ms, us …, frames.")
    ] = None
    fps: Annotated[float | None, typer.Option(help="Frames a second, if the file does not say.")] = None
    format: Annotated[str | None, typer.Option(help="Format of the file, if its name does not tell.")] = None
    scale: Annotated[float | None, typer.Option(help="Metres a pixel.")] = None
    body_lengths: Annotated[
        bool, typer.Option("--body-lengths", help="No scale known: take it from the body's own length.")
    ] = False
    base: Annotated[
        str | None,
        typer.Option(
            help="Keypoint that becomes the origin; default: the first joint's (in `diagnose` none, for metres)."
        ),
    ] = None
    individual: Annotated[str | None, typer.Option(help="Which animal, in a file of several.")] = None
    plane: Annotated[
        str | None,
        typer.Option(
            help="The axes that point right and up, of a file with three: xy, xz …; default: the two that change."
        ),
    ] = None
    frames: Annotated[str, typer.Option(help="Which rows to use, of the first recording, such as 50:250.")] = ":"
    passive: Annotated[bool, typer.Option("--passive", help="No torque acts: the body moves freely.")] = False
    hide_torque: Annotated[bool, typer.Option("--hide-torque", help="Ignore the recording's commands.")] = False

    @property
    def recording(self) -> str:
        """The one that is given. Raises InputError for several, which only cameras are."""
        from invdyn.recordings import InputError

        if len(self.recordings) > 1:
            raise InputError(
                f"expected one recording, got {len(self.recordings)}: tracks of several cameras need --calibration"
            )
        return self.recordings[0]

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
    offset: Annotated[
        list[str] | None, typer.Option(help="By how much a camera's times run ahead: cam2=0.02, s; repeatable.")
    ] = None
    learn_cameras: Annotated[
        str, typer.Option(help="What is not known of cameras but the first: offset (of clocks), pose, or both.")
    ] = ""
    learn_lengths: Annotated[bool, typer.Option("--learn-lengths", help="Learn the links' lengths.")] = False
    torque: Annotated[
        str,
        typer.Option(help="Torque process: ornstein_uhlenbeck, random_walk, matern32, matern52, recurrent."),
    ] = "ornstein_uhlenbeck"
    noise: Annotated[
        str | None,
        typer.Option(help="Observation noise: gaussian or student_t; default: gaussian, of pixels student_t."),
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
    device: Annotated[str, typer.Option(help="Of the particle filters: cpu or cuda.")] = "cpu"

    def check(self, *methods: str) -> None:
        """Raise InputError for a name that is not known."""
        from invdyn.inference import METHODS
        from invdyn.models import FAMILIES, TORQUE_PROCESSES
        from invdyn.recordings import InputError

        named: list[tuple[str, str, Collection[str]]] = [("method", method, METHODS) for method in methods]
        named += [("torque process", self.torque, TORQUE_PROCESSES), ("noise", self.family, FAMILIES)]
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
        given = (name.rpartition("=")[2] if self.calibration else name for name in self.recordings)
        named = [Path(name) for name in (*given, self.body, self.truth) if name is not None]
        return [*named, *(self.calibration or [])]

    @property
    def family(self) -> str:
        """Of the noise: a tracker's pixels stray."""
        return self.noise or ("student_t" if self.calibration else "gaussian")

    def load(self) -> dict[str, Any]:
        """Read all of it: keyword arguments of `inference.infer` and `inference.compare`. Raises as readers do."""
        from invdyn.models import TORQUE_PROCESSES

        from .filmed import film_of
        from .inputs import load_body, load_known

        recording: Any
        body: Any
        if self.calibration:
            recording, body = film_of(
                self.recordings,
                self.calibration,
                self.body,
                self.frames,
                self.offset or (),
                {
                    "--units": self.units,
                    "--scale": self.scale,
                    "--base": self.base,
                    "--plane": self.plane,
                    "--body-lengths": self.body_lengths,
                    "--learn-lengths": self.learn_lengths,
                },
                fps=self.fps,
                format=self.format,
                individual=self.individual,
            )
        else:
            self._check_no_cameras()
            body = load_body(self.body)
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
            "torque": TORQUE_PROCESSES[self.torque](),
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
            raise InputError(f"{option} is of several cameras: give their --calibration, and one file of pixels each")

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
    mapping: Annotated[
        str | None,
        typer.Option("--map", metavar="FILE", help="For a robot's log: which track is which joint's, .toml."),
    ] = None
    episodes: Annotated[
        str, typer.Option(help="Of a log of several: which to diagnose together, such as 0,1; default: the first.")
    ] = "0"
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
        if self.calibration:
            raise InputError(
                "a diagnosis takes one recording in metres, so far: `invdyn triangulate` makes it of several cameras"
            )
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
    def numbers(self) -> list[int]:
        """Numbers of `episodes`. Raises InputError for what is none."""
        from invdyn.recordings import InputError

        try:
            return [int(number) for number in self.episodes.split(",")]
        except ValueError:
            raise InputError(f"--episodes is a list of numbers, such as 0,1, got {self.episodes!r}") from None

    @property
    def others(self) -> tuple[str, ...]:
        """Names of `also`."""
        return tuple(name.strip() for name in (self.also or "").split(",") if name.strip())

    def load(self) -> dict[str, Any]:
        """Read all of it: keyword arguments of `diagnosis.diagnose`. Raises as readers do."""
        from dataclasses import replace

        from .inputs import is_log, load_log, load_logs, load_planar

        body = load_planar(self.body, "a diagnosis")

        def read(name: str, frames: str = ":") -> Any:
            if self.mapping is not None or is_log(name):
                recording = load_log(name, body, None, frames, self.mapping)
            else:
                recording = self.read(name, body, as_filmed=True, frames=frames)
            if self.hide_torque and recording.torques is not None:
                joints = recording.joint_names if recording.angles is not None else ()
                recording = replace(recording, torques=None, joint_names=joints)
            return recording

        recording = read(self.recording, self.frames)
        more = [*map(read, self.others)]
        if self.mapping is not None or is_log(self.recording):
            recording, *rest = load_logs(self.recording, body, self.mapping, self.numbers, self.frames)
            more = [*rest, *more]
        return {
            "recording": [recording, *more] if more else recording,
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
