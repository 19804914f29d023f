"""Options of every command on a recording: which files, how to read them, and a body."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from .options import (
    Calibration,
    Checkpoint,
    FileFormat,
    FrameRate,
    Frames,
    HideTorque,
    Individual,
    Mapping,
    Offset,
    Person,
    Tracker,
    Units,
    ZeroTorque,
)
from .settings import Setting

READING = (
    *("units", "fps", "format", "base", "individual", "plane", "calibration", "offset", "tracker", "person"),
    "mapping",
)
"""Options of how to read files, under the names that readers have."""


@dataclass(frozen=True)
class Recorded:
    """What every command on a recording is given: the recording, how to read it, and a body."""

    recordings: Annotated[
        list[str],
        typer.Argument(
            metavar="RECORDING…",
            help="Keypoints, a film, a robot's log, or the name of a known recording; "
            "with --calibration one file of pixels for each camera.",
        ),
    ]
    body: Annotated[
        str | None,
        typer.Option(
            "--body",
            metavar="FILE",
            help="Body: .toml, .xml (MJCF), .urdf, .osim, or the name of one of ours. Of a person, "
            "--height, --mass and --sex instead.",
        ),
    ] = None
    height: Annotated[float | None, typer.Option(help="Of a person, m; with --mass and --sex, in place of --body.")] = (
        None
    )
    mass: Annotated[float | None, typer.Option(help="Of a person, kg.")] = None
    sex: Annotated[str | None, typer.Option(help="Of a person: f or m.")] = None
    units: Units = None
    fps: FrameRate = None
    scale: Annotated[
        str | None, typer.Option(help="Metres a pixel; 'body' if unknown: the tracks are scaled to the body's length.")
    ] = None
    base: Annotated[
        str | None,
        Setting("keypoint that becomes the origin; default: the first joint's (`diagnose` of metres: none)"),
    ] = None
    frames: Frames = ":"
    calibration: Calibration = None
    offset: Offset = None
    tracker: Tracker = None
    mapping: Mapping = None
    zero_torque: ZeroTorque = False
    hide_torque: HideTorque = False
    checkpoint: Checkpoint = None
    episodes: Annotated[str, Setting("which episodes of a log, such as 0,1; default: the first")] = "0"
    format: FileFormat = None
    individual: Individual = None
    person: Person = None
    limb: Annotated[str, Setting("limb of a person: arm, arm_and_hand or leg; default: arm")] = "arm"
    keypoints: Annotated[str, Setting("a person's keypoints in the file, from the elbow on, as RELB,RWRA")] = ""
    payload: Annotated[float, Setting("what a person's limb carries, kg", float, least=0)] = 0.0
    plane: Annotated[
        str | None, Setting("axes of a file in space that point right and up, such as xz; default: the two that change")
    ] = None
    tracks: Annotated[Path | None, Setting("where a film's tracks go: .csv; default: next to the output")] = None

    def check_exist(self) -> None:
        """Raise FileNotFoundError for a file that is nowhere, before anything large is imported.

        Raises InputError unless there is a body file, or all numbers that a person needs, for an unknown unit, and for
        a table of keypoints whose format asks for more than is given.
        """
        from invdyn.recordings import InputError
        from invdyn.recordings.loader import stated_format
        from invdyn.recordings.logs.read import kind_of
        from invdyn.recordings.paths import is_film
        from invdyn.recordings.units import parse_units

        from .input_names import check_exist

        said = {f"--{name}": getattr(self, name) is not None for name in ("height", "mass", "sex")}
        if self.body is not None and any(said.values()):
            raise InputError(f"--body and {next(name for name in said if said[name])}: leave one of them out")
        if self.body is not None and (self.payload or self.limb != "arm" or self.keypoints):
            raise InputError("--set payload, limb and keypoints are a person's: a body's file states its own")
        if self.body is None and not all(said.values()):
            missing = ", ".join(name for name in said if not said[name])
            raise InputError(
                f"expected --body, or a person's --height, --mass and --sex; missing: --body, or {missing}"
            )
        check_exist(*self.tracked, *(() if self.calibration else self.other_recordings), body=self.body)
        parse_units(self.units)
        path = Path(self.recording)
        table = path.is_file() and not is_film(path) and kind_of(path) in (None, "csv")
        if table and not self.calibration and self.mapping is None:
            stated_format(path, self.units, self.fps, self.format, self.individual)

    @property
    def recording(self) -> str:
        """The first one."""
        return self.recordings[0]

    @property
    def first(self) -> list[str]:
        """Files of the first one: all that are given, as of several cameras, where a command takes one recording."""
        return self.recordings

    @property
    def tracked(self) -> list[str]:
        """Files of the recordings; with a calibration a name may say the camera, "cam1=tracks.csv"."""
        return [name.rpartition("=")[2] if self.calibration else name for name in self.recordings]

    @property
    def other_recordings(self) -> list[str]:
        """Files, or names of known recordings, that are read in addition."""
        return []

    @property
    def files(self) -> list[Path]:
        """What is read, and must not be written over."""
        network = [] if self.tracker in (None, "left", "right") else [str(self.tracker)]
        named = (
            *self.tracked,
            *([self.body] if self.body else ()),
            *network,
            *(self.calibration or ()),
            *([self.mapping] if self.mapping else ()),
        )
        return [Path(name) for name in named]

    @property
    def metres_a_pixel(self) -> float | str | None:
        """The scale, or "body". Raises InputError for what is neither."""
        from invdyn.recordings import InputError

        if self.scale in (None, "body"):
            return self.scale
        try:
            return float(self.scale)
        except ValueError:
            raise InputError(f"--scale: expected metres a pixel, or body, got {self.scale!r}") from None

    @property
    def reading(self) -> dict[str, Any]:
        """Options of how to read files, by the names that readers have."""
        episodes = None if self.episodes == "0" else self.episodes
        own = {name: getattr(self, name) for name in READING}
        return own | {"scale": self.metres_a_pixel, "episodes": episodes}

    def read_body(self, *, filmed: bool) -> Any:
        """The body, of as many dimensions as the recording shows of a robot's file; see `inputs.load_body`."""
        from .inputs import TABLE, load_body, source_of

        if self.height is not None and self.mass is not None and self.sex is not None:
            from invdyn.models import person

            called = [name.strip() for name in self.keypoints.split(",")] if self.keypoints else ()
            return person(self.height, self.mass, self.sex, self.limb, self.payload, keypoints=called)
        names = ("units", "fps", "format", "individual")
        options = {name: getattr(self, name) for name in names}
        if isinstance(self.metres_a_pixel, float):
            options["scale"] = self.metres_a_pixel
        table = filmed and not self.plane and source_of(self.first, self.calibration, self.mapping) is TABLE
        return load_body(self.body, filmed=filmed, recording=self.recording if table else None, **options)

    def tracks_file(self, default: Path) -> Path | None:
        """Where tracks go: the default unless it is said; None where the recording is no film."""
        from invdyn.recordings.paths import is_film

        filmed = not self.calibration and is_film(self.recording)
        return (self.tracks or default) if filmed else None
