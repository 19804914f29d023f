"""Options of `diagnose`: more recordings, what the search may do, what its answer is checked on."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .console import say
from .options import Processes, Seed
from .recording_options import Recorded
from .settings import Setting

if TYPE_CHECKING:
    from invdyn.recordings import Recording
    from invdyn.recordings.reading import TrackedFilm


@dataclass(frozen=True)
class Diagnosed(Recorded):
    """What `diagnose` is given: a recording, the body whose simulation is questioned, what to check the answer on."""

    others: Annotated[
        str | None,
        typer.Option("--with", help="More recordings of the same arm to diagnose together, comma-separated."),
    ] = None
    held_out: Annotated[
        str | None,
        typer.Option(help="Another recording of the same arm, to check the answer on; default: this one's last third."),
    ] = None
    camera: Annotated[
        str | None, typer.Option(help="Keypoints of a camera that filmed the robot of a log: the two are joined.")
    ] = None
    exclude: Annotated[str, typer.Option(help="Effects to leave out of the catalogue, such as payload,armature.")] = ""
    estimate: Annotated[
        str,
        typer.Option(
            help="Numbers of the body's file to learn too, such as damping,armature.elbow=0.5, with their relative "
            "standard deviations; default: 0.3."
        ),
    ] = ""
    max_effects: Annotated[
        int, typer.Option(min=1, help="Most effects in one cause of a search, not of the regression.")
    ] = 4
    budget: Annotated[
        float | None,
        typer.Option(
            help="Seconds after which no new candidate starts; start, first fit and report take 10 s or more "
            "in addition. Default: counted work, the same result on every machine."
        ),
    ] = None
    force: Annotated[
        bool, typer.Option("--force", help="Go on where the recording has a certain mistake; it is printed.")
    ] = False
    workers: Processes = 2
    seed: Seed = 0
    clock: Annotated[
        float | None,
        Setting("how far the clock of --camera is ahead of the log's, s; default: found from the motion", float),
    ] = None
    tolerance: Annotated[
        float | None,
        Setting(
            "a gap below this share of a typical torque does not matter; default: by source, .03 of a robot's, .005 of "
            "a simulation's",
            float,
            least=0,
        ),
    ] = None
    source: Annotated[
        str | None,
        Setting(
            "what made the recording, robot or simulation; default: robot for a log that a map is of, else simulation",
            str,
        ),
    ] = None

    def check(self) -> None:
        """Raise InputError for what does not go together, an unknown effect, and a recording that is given twice."""
        from invdyn.diagnosis.catalogue.engine_effects import EFFECTS as OF_ENGINE
        from invdyn.models.effects import EFFECTS
        from invdyn.recordings import InputError, resolved

        for name in self.excluded:
            if name not in EFFECTS and name not in {effect.name for effect in OF_ENGINE}:
                raise InputError(f"unknown effect {name!r}: known are {', '.join(EFFECTS)}")
        more = {"--with": self.others, "--held-out": self.held_out, "--camera": self.camera}
        if self.source not in (None, *SOURCES):
            raise InputError(f"expected a source among {', '.join(SOURCES)}, got {self.source!r:.60}")
        if self.calibration:
            if len(self.recordings) < 2:
                raise InputError("--calibration is of several cameras: give the tracks of two or more, in pixels")
            if surplus := [option for option, value in more.items() if value]:
                raise InputError(
                    f"{surplus[0]} takes recordings in metres: `invdyn triangulate` makes them of several cameras"
                )
        if self.zero_torque and self.hide_torque:
            raise InputError(
                "--zero-torque says that torques are zero, --set hide_torque=yes that they are unknown: choose one"
            )
        if self.clock is not None and self.camera is None:
            raise InputError("clock is of a camera that filmed a log's robot: name its keypoints with --camera")
        if self.camera is not None and "," in self.episodes:
            raise InputError("--camera takes one episode of a log, which the camera filmed: --set episodes=0")
        given: set[Path] = set()
        first = () if self.calibration else (self.recording,)
        for name in (*first, *self.other_recordings):
            if resolved(name) in given:
                option = {self.held_out: "--held-out", self.camera: "--camera"}.get(name, "--with")
                raise InputError(f"{name}: expected another recording of the same arm for {option}, got one twice")
            given.add(resolved(name))

    @property
    def robot(self) -> bool:
        """Whether the recording is a real robot's."""
        return self.mapping is not None if self.source is None else self.source == SOURCES[0]

    @property
    def excluded(self) -> tuple[str, ...]:
        """Names of `exclude`."""
        return tuple(name.strip() for name in self.exclude.split(",") if name.strip())

    @property
    def first(self) -> list[str]:
        """Files of the first one: tables may be of several cameras, and each log that a map is of is a recording."""
        return self.recordings if self.mapping is None or self.calibration else self.recordings[:1]

    @property
    def more(self) -> tuple[str, ...]:
        """Recordings after the first, and names of `others`."""
        named = (name.strip() for name in (self.others or "").split(",") if name.strip())
        return (*self.recordings[len(self.first) :], *named)

    @property
    def other_recordings(self) -> list[str]:
        """Those that are diagnosed together, the one that is held out, and the camera's."""
        return [name for name in (*self.more, self.held_out, self.camera) if name is not None]

    def load(self, **more: Any) -> tuple[dict[str, Any], "TrackedFilm | None"]:
        """Read all of it: arguments of `diagnosis.diagnose`, and the film that was tracked, if any.

        ``more`` are options of readers, for the first recording. Raises as readers do.
        """
        from .inputs import LOG, TABLE, check_options, read_recordings, source_of

        later = [*self.more, *([self.held_out] if self.held_out else [])]
        sources = [source_of(self.first, self.calibration, self.mapping)]
        sources += [source_of([name], None, self.mapping) for name in later]
        sources += [TABLE] * (self.camera is not None)
        check_options(self.recording, sources, self.reading, type(self))
        filmed = any(source is not LOG for source in sources)
        body = with_estimated(self.read_body(filmed=filmed), self.estimate)

        refused: list[str] = []

        def recordings(files: list[str], **options: Any) -> Iterator[tuple["Recording", "TrackedFilm | None"]]:
            options = {**self.reading, "hide_torque": self.hide_torque, "as_filmed": True, **options}
            for reading in read_recordings(files, body, **options):
                recording, said = self._checked(reading, body)
                refused.extend(said)
                yield recording, reading.film

        first, *others = recordings(self.first, frames=self.frames, **more)
        recording, film = first
        together = [each for each, _ in others]
        together += [each for name in self.more for each, _ in recordings([name], episodes="0")]
        if self.camera is not None:
            options = self.reading | {"mapping": None, "as_filmed": True}
            (seen,) = read_recordings([self.camera], body, **options)
            recording = self._joined(recording, seen.recording, body)
        held_out = None
        if self.held_out is not None:
            held_out, _ = next(recordings([self.held_out], episodes="0"))
        arguments = {
            "recording": [recording, *together] if together else recording,
            "body": body,
            "held_out": held_out,
            "passive": self.zero_torque,
            "without": self.excluded,
            "most": self.max_effects,
            "budget": self.budget,
            "tolerance": self.tolerance,
            "robot": self.robot,
            "checked": True,
            "force": self.force,
            "refused": tuple(refused),
            "seed": self.seed,
            "workers": self.workers,
        }
        return arguments, film

    def _checked(self, reading: Any, body: Any) -> tuple["Recording", tuple[str, ...]]:
        """The recording, without its torques if they are to be hidden, and what was refused and gone past by force."""
        from invdyn.diagnosis.check.before import check_before

        recording: Recording = reading.recording.points
        hidden = self.zero_torque or self.hide_torque
        refused = check_before(replace(reading, recording=recording), body, hidden, self.force)
        if not self.hide_torque:
            return recording, refused
        names = recording.joint_names if recording.angles is not None else ()
        return replace(recording, torques=None, joint_names=names), refused

    def _joined(self, log: Any, film: Any, body: Any) -> Any:
        """A log with the film of it, on the log's clock; says by how much the film's was found to be ahead."""
        from invdyn.diagnosis.problem.clocks import camera_clock
        from invdyn.recordings.joined import merge_log_and_camera

        if self.clock is not None:
            return merge_log_and_camera(log, film, self.clock)
        found = camera_clock(log, film, body)
        say(f"clock      {film.name} is ahead of {log.name} by {found.seconds:.4f} ± {found.sd:.4f} s")
        return merge_log_and_camera(log, film, found.seconds)


SOURCES = ("robot", "simulation")
ESTIMATED = 0.3
"""Relative standard deviation of a number that is to be estimated, where none is given."""


def with_estimated(body: Any, numbers: str) -> Any:
    """The body with numbers of its file uncertain, "damping,armature.elbow=0.5".

    Raises InputError for what is no such list, or no joint of the body has; BodyError for an unknown number.
    """
    from invdyn.models.bodies.joint_parts import PARTS
    from invdyn.recordings import InputError

    stated = {}
    for word in filter(None, map(str.strip, numbers.split(","))):
        name, _, sd = word.partition("=")
        try:
            stated[name] = float(sd) if sd else ESTIMATED
        except ValueError:
            raise InputError(
                f"--estimate: expected a number behind {name}=, such as {name}=0.5, got {sd!r:.60}"
            ) from None
        part, _, joint = name.partition(".")
        having = [j for j, p in zip(body.joint_names, body.joint_parts, strict=True) if getattr(p, part, 0)]
        if part in PARTS and not (joint in having if joint in body.joint_names else having):
            where = joint or "any joint"
            raise InputError(
                f"--estimate: {body.name!r} has no {part} at {where} that could be learned: "
                "an effect is searched for there"
            )
    return replace(body, uncertainty={**body.uncertainty, **stated}) if stated else body
