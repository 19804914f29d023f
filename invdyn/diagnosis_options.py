"""Options of `diagnose`: more recordings, logs of robots, what the search may do, what its answer is checked on."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from .console import say
from .options import MOST_WORKERS, Seed
from .recording_options import Recorded


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
    free: Annotated[
        str,
        typer.Option(
            help="Numbers of the body's file to learn too, such as damping,armature.elbow=0.5: relative standard "
            "deviations, 0.3 unless said."
        ),
    ] = ""
    most: Annotated[int, typer.Option(min=1, help="Most effects in one cause; more take longer.")] = 4
    budget: Annotated[
        float | None,
        typer.Option(
            help="Seconds after which no more candidate is begun; the one at work is finished. The program's start, "
            "the fit without any and the report come on top, 10 s or more. Default: counted work, the same result on "
            "every machine."
        ),
    ] = None
    tolerance: Annotated[
        float,
        typer.Option(
            min=0, max=1, help="A gap, or a rest of one, under this share of a typical torque does not matter."
        ),
    ] = 0.005
    mapping: Annotated[
        str | None,
        typer.Option("--map", metavar="FILE", help="For a robot's log: which track is which joint's, .toml."),
    ] = None
    beside: Annotated[
        str | None, typer.Option(help="Keypoints of a camera that filmed what a robot's log has: the two are joined.")
    ] = None
    clock: Annotated[
        float | None,
        typer.Option(help="How far that camera's clock is ahead of the log's, s; default: found from the motion."),
    ] = None
    episodes: Annotated[
        str, typer.Option(help="Which episodes of a log to diagnose together, such as 0,1; default: the first.")
    ] = "0"
    force: Annotated[
        bool, typer.Option("--force", help="Go on where the recording has a mistake that is sure; it is printed.")
    ] = False
    seed: Seed = 0
    workers: Annotated[
        int,
        typer.Option(
            min=1, max=MOST_WORKERS, help="Processes side by side, with the same result (on Linux; one elsewhere)."
        ),
    ] = 2

    def check(self) -> None:
        """Raise InputError for what does not go together, an unknown effect, and a recording that is given twice."""
        from invdyn.models.effects import EFFECTS
        from invdyn.recordings import InputError, resolved

        for name in self.struck:
            if name not in EFFECTS:
                raise InputError(f"unknown effect {name!r}: known are {', '.join(EFFECTS)}")
        if self.calibration:
            if len(self.recordings) < 2:
                raise InputError("--calibration is of several cameras: give the tracks of two or more, in pixels")
            beside = {"--also": self.also, "--held-out": self.held_out, "--map": self.mapping, "--beside": self.beside}
            if surplus := [option for option, value in beside.items() if value]:
                raise InputError(
                    f"{surplus[0]} takes recordings in metres: `invdyn triangulate` makes them of several cameras"
                )
        if self.of_logs and (surplus := [option for option, value in self.of_keypoints.items() if value]):
            raise InputError(
                f"{surplus[0]}: a robot's log carries its own times, names and units: leave {surplus[0]} out"
            )
        if self.passive and self.hide_torque:
            raise InputError("--passive says that torques are zero, --hide-torque that they are unknown: choose one")
        if self.clock is not None and self.beside is None:
            raise InputError("--clock is of a camera beside a log: name its keypoints with --beside")
        if self.beside is not None and len(self.numbers) > 1:
            raise InputError("--beside takes one episode of a log, which the camera filmed: --episodes 0")
        given: set[Path] = set()
        first = () if self.calibration else (self.recording,)
        for name in (*first, *self.others, *(each for each in (self.held_out, self.beside) if each)):
            if resolved(name) in given:
                option = {self.held_out: "--held-out", self.beside: "--beside"}.get(name, "--also")
                raise InputError(f"{name}: expected another recording of the same arm for {option}, got one twice")
            given.add(resolved(name))

    @property
    def of_logs(self) -> bool:
        """Whether all that is read is robots' own logs."""
        from .inputs import is_log

        names = (*self.recordings, *self.others, *((self.held_out,) if self.held_out else ()))
        return not (self.calibration or self.beside) and all(is_log(name, self.mapping) for name in names)

    @property
    def struck(self) -> tuple[str, ...]:
        """Names of `without`."""
        return tuple(name.strip() for name in self.without.split(",") if name.strip())

    @property
    def files(self) -> list[Path]:
        """What is read, and must not be written over."""
        names = (*self.tracked, *self.others, self.body, self.held_out, self.beside, *(self.calibration or ()))
        return [Path(name) for name in names if name is not None]

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
        body = freed(self.read_body(filmed=not self.of_logs), self.free)
        if self.calibration:
            return self.arguments(self.triangulated(), [], body, None)
        recording, *more = self.episodes_of(self.recording, body, self.numbers, self.frames)
        more += [each for name in self.others for each in self.episodes_of(name, body)]
        if self.beside is not None:
            recording = self.joined(recording, self.read(self.beside, body, as_filmed=True), body)
        held_out = None if self.held_out is None else self.episodes_of(self.held_out, body)[0]
        return self.arguments(recording, more, body, held_out)

    def episodes_of(self, name: str, body: Any, numbers: Sequence[int] = (0,), frames: str = ":") -> list:
        """A robot's log, an episode each, or the one recording of another file, each of what it says it is."""
        from dataclasses import replace

        from invdyn.diagnosis.check.before import check_before
        from invdyn.recordings import parse_units
        from invdyn.recordings.reading import Reading

        from .inputs import is_log, read_logs

        if is_log(name, self.mapping):
            readings = read_logs(name, body, self.mapping, numbers, frames, self.units)
        else:
            recording = self.read(name, body, as_filmed=True, frames=frames)
            readings = [Reading(recording, parse_units(self.units))]
        for reading in readings:
            check_before(reading, body, self.passive or self.hide_torque, self.force)
        found = [reading.recording for reading in readings]
        if not self.hide_torque:
            return found
        return [
            replace(each, torques=None, joint_names=each.joint_names if each.angles is not None else ())
            for each in found
        ]

    def triangulated(self) -> Any:
        """Points in space of several cameras' tracks."""
        from .inputs_of_cameras import load_from_cameras

        options = {"fps": self.fps, "format": self.format, "individual": self.individual}
        found, _ = load_from_cameras(
            self.recordings, self.calibration or (), self.body, self.frames, (), self.not_of_cameras, **options
        )
        return found.points

    def arguments(self, recording: Any, more: list, body: Any, held_out: Any) -> dict[str, Any]:
        """Arguments of `diagnosis.diagnose`."""
        return {
            "recording": [recording, *more] if more else recording,
            "body": body,
            "held_out": held_out,
            "passive": self.passive,
            "without": self.struck,
            "most": self.most,
            "budget": self.budget,
            "tolerance": self.tolerance,
            "checked": not self.calibration,
            "force": self.force,
            "seed": self.seed,
            "workers": self.workers,
        }

    def joined(self, log: Any, film: Any, body: Any) -> Any:
        """A log with the film of it, on the log's clock; says by how much the film's was found to be ahead."""
        from invdyn.diagnosis.problem.clocks import camera_clock
        from invdyn.recordings.beside import beside

        if self.clock is not None:
            return beside(log, film, self.clock)
        found = camera_clock(log, film, body)
        say(f"clock      {film.name} is ahead of {log.name} by {found.seconds:.4f} ± {found.sd:.4f} s")
        return beside(log, film, found.seconds)


FREE = 0.3
"""Relative standard deviation of what is only said to be free."""


def freed(body: Any, free: str) -> Any:
    """The body with numbers of its file uncertain, "damping,armature.elbow=0.5".

    Raises InputError for what is no such list, or no joint of the body has; BodyError for an unknown number.
    """
    from dataclasses import replace

    from invdyn.models.bodies.joint_parts import NOTHING, PARTS
    from invdyn.recordings import InputError

    stated = {}
    for word in filter(None, map(str.strip, free.split(","))):
        name, _, sd = word.partition("=")
        try:
            stated[name] = float(sd) if sd else FREE
        except ValueError:
            raise InputError(f"--free: expected a number behind {name}=, such as {name}=0.5, got {sd!r:.60}") from None
        part, _, joint = name.partition(".")
        having = [j for j, p in zip(body.joint_names, body.joint_parts, strict=True) if getattr(p or NOTHING, part, 0)]
        if part in PARTS and not (joint in having if joint in body.joint_names else having):
            where = joint or "any joint"
            raise InputError(
                f"--free: {body.name!r} has no {part} at {where} that could be learned: an effect is looked for there"
            )
    return replace(body, uncertainty={**body.uncertainty, **stated}) if stated else body
