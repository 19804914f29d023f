"""Options of every command on a recording: which file, how to read it, and a body."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from .options import BodyFile


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
        typer.Option(help="The cameras' calibration, in metres: .toml, .qca.txt, .yml or .json (OpenCV; repeatable)."),
    ] = None
    units: Annotated[
        str | None, typer.Option(help="Units of the file: px, mm, cm, m; deg, rad; s, ms, us …, frames.")
    ] = None
    fps: Annotated[float | None, typer.Option(help="Frames a second, if the file has no times.")] = None
    format: Annotated[str | None, typer.Option(help="Format of the file, if its name does not tell.")] = None
    scale: Annotated[float | None, typer.Option(help="Metres a pixel.")] = None
    body_lengths: Annotated[
        bool, typer.Option("--body-lengths", help="The scale is unknown: scale the tracks to the body's length.")
    ] = False
    base: Annotated[
        str | None,
        typer.Option(
            help="Keypoint that becomes the origin; default: the first joint's; `diagnose` of metres moves none."
        ),
    ] = None
    individual: Annotated[str | None, typer.Option(help="Which animal, in a file of several.")] = None
    plane: Annotated[
        str | None,
        typer.Option(help="Axes of a file in space that point right and up, such as xz; default: the two that change."),
    ] = None
    frames: Annotated[str, typer.Option(help="Which rows to use, of the first recording, such as 50:250.")] = ":"
    passive: Annotated[bool, typer.Option("--passive", help="No torque acts: the body moves freely.")] = False
    hide_torque: Annotated[bool, typer.Option("--hide-torque", help="Ignore the recording's commands.")] = False

    def __post_init__(self) -> None:
        """Raise InputError for a scale that is given and said to be unknown."""
        from invdyn.recordings import InputError

        if self.scale is not None and self.body_lengths:
            raise InputError(
                "--scale says how long a pixel is, --body-lengths that this is not known: leave one of them out"
            )

    def check_exist(self) -> None:
        """Raise FileNotFoundError for a body or a recording that is nowhere, before anything large is imported.

        Films, and what goes with several cameras, have checks of their own.
        """
        from invdyn.recordings.tracking.film import is_film

        from .named_files import body_file, check_recording

        if self.calibration or len(self.recordings) != 1 or is_film(self.recordings[0]):
            return
        with body_file(self.body):
            check_recording(self.recordings[0])

    @property
    def recording(self) -> str:
        """The one that is given. Raises InputError for several, which only cameras are."""
        from invdyn.recordings import InputError

        if len(self.recordings) > 1:
            raise InputError(
                f"expected one recording, got {len(self.recordings)}: tracks of several cameras need --calibration"
            )
        return self.recordings[0]

    @property
    def guessed(self) -> bool:
        """Whether the body's lengths are guessed, and will be learned."""
        return False

    @property
    def tracked(self) -> list[str]:
        """Files of what was tracked; with a calibration a name may say the camera, "cam1=tracks.csv"."""
        return [name.rpartition("=")[2] if self.calibration else name for name in self.recordings]

    @property
    def not_of_cameras(self) -> dict[str, Any]:
        """Options that tracks of several cameras do not take, with their values."""
        return {
            "--units": self.units,
            "--scale": self.scale,
            "--base": self.base,
            "--plane": self.plane,
            "--body-lengths": self.body_lengths,
        }

    @property
    def of_keypoints(self) -> dict[str, Any]:
        """Options that a robot's own log does not take, with their values."""
        return {
            "--fps": self.fps,
            "--format": self.format,
            "--scale": self.scale,
            "--body-lengths": self.body_lengths,
            "--base": self.base,
            "--individual": self.individual,
            "--plane": self.plane,
        }

    def read_body(self, *, filmed: bool = True) -> Any:
        """The body, of as many dimensions as the recording shows of a robot's file; see `inputs.load_body`."""
        from .inputs import is_log, load_body

        recording = None if self.plane or self.calibration or is_log(self.recording) else self.recording
        options = {name: getattr(self, name) for name in ("units", "fps", "format", "scale", "individual")}
        return load_body(self.body, filmed=filmed, recording=recording if filmed else None, **options)

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
            self.guessed,
            units=self.units,
            fps=self.fps,
            format=self.format,
            scale=self.scale,
            individual=self.individual,
            plane=self.plane,
        )
