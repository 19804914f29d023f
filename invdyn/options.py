"""Options that commands share: a dataclass whose fields are options, spread into a command by a decorator."""

import inspect
from collections.abc import Callable
from dataclasses import MISSING, dataclass, fields
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer

BodyFile = Annotated[str, typer.Option("--body", metavar="TOML", help="Body file, or a body that comes with us.")]
Seed = Annotated[int, typer.Option(min=0, help="Same seed, same result.")]
TruthFile = Annotated[str | None, typer.Option(help="Torques to compare with: .csv, or a known recording's name.")]


@dataclass(frozen=True)
class Inference:
    """What `infer` and `compare` are given: a recording, a body, the model that joins them, sampler sizes."""

    recording: Annotated[str, typer.Argument(help="File of keypoints, or the name of a known recording.")]
    body: BodyFile
    truth: TruthFile = None
    units: Annotated[str | None, typer.Option(help="Of the file's numbers: px, mm, cm, m; deg, rad.")] = None
    fps: Annotated[float | None, typer.Option(help="Frames a second, if the file does not say.")] = None
    format: Annotated[str | None, typer.Option(help="Of the file, if it is not plain from it.")] = None
    scale: Annotated[float | None, typer.Option(help="Metres a pixel.")] = None
    body_lengths: Annotated[
        bool, typer.Option("--body-lengths", help="No scale known: divide by the body's own length.")
    ] = False
    base: Annotated[
        str | None, typer.Option(help="Keypoint to subtract; default: the first joint's, where tracked.")
    ] = None
    frames: Annotated[str, typer.Option(help="Which frames to use, such as 50:250.")] = ":"
    learn_lengths: Annotated[bool, typer.Option("--learn-lengths", help="Learn the links' lengths.")] = False
    torque: Annotated[
        str,
        typer.Option(help="Torque process: ornstein_uhlenbeck, random_walk, matern32, matern52, recurrent."),
    ] = "ornstein_uhlenbeck"
    noise: Annotated[str, typer.Option(help="Observation noise: gaussian or student_t.")] = "gaussian"
    passive: Annotated[bool, typer.Option("--passive", help="No torque acts: the body moves freely.")] = False
    hide_torque: Annotated[bool, typer.Option("--hide-torque", help="Ignore the recording's commands.")] = False
    filters: Annotated[int, typer.Option(min=1, help="Independent filters.")] = 64
    particles: Annotated[int, typer.Option(min=1, help="Particles of each.")] = 100
    draws: Annotated[int, typer.Option(min=1, help="Trajectories drawn from each.")] = 4
    seed: Seed = 0

    def check(self, *methods: str) -> None:
        """Raise InputError for a name that is not known."""
        from invdyn.inference import METHODS
        from invdyn.models import FAMILIES, TORQUE_PROCESSES
        from invdyn.recordings import InputError

        named = [("method", method, METHODS) for method in methods]
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

        from .inputs import frame_range, load_body, load_known, load_recording

        body = load_body(self.body)
        recording = load_recording(
            self.recording,
            body,
            self.base,
            self.body_lengths,
            units=self.units,
            fps=self.fps,
            format=self.format,
            scale=self.scale,
        )
        return {
            "recording": recording.select(*frame_range(self.frames)),
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
        }


def spread(command: Callable[..., None]) -> Callable[..., None]:
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

    @wraps(command)
    def spread_command(**options: Any) -> None:
        given = group(**{name: options.pop(name) for name in kinds})
        command(given, **options)

    spread_command.__signature__ = inspect.Signature(parameters)
    spread_command.__annotations__ = {one.name: hints.get(one.name, one.annotation) for one in parameters}
    del spread_command.__wrapped__
    return spread_command
