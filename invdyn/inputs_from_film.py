"""`invdyn infer film.mp4` and `diagnose`: a film is tracked into a table of pixels, a recording like any other."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Generic, TypeVar

import arviz as az

from invdyn.models import Body
from invdyn.recordings import InputError, read_keypoint_csv
from invdyn.recordings.tracking.film import Film, is_film

from .film_commands import tracks_of
from .inputs import load_planar
from .recording_options import Recorded

if TYPE_CHECKING:
    from .overlay import Overlay

Given = TypeVar("Given", bound=Recorded)


@dataclass(frozen=True)
class TrackedFilm(Generic[Given]):
    """A film in a recording's place, who tracks it, and where the tracks go."""

    given: Given
    network: Path | None
    arm: str | None
    person: str | None
    tracks: Path

    @classmethod
    def of(
        cls, given: Given, network: Path | None, arm: str | None, person: str | None, tracks: Path
    ) -> "TrackedFilm[Given] | None":
        """None for a recording that is no film.

        Raises InputError for options of a film without one, and what a film does not go with; OSError for no body.
        """
        if len(given.recordings) > 1 or not is_film(given.recording):
            for option, value in (("--network", network), ("--arm", arm), ("--person", person)):
                if value is not None:
                    raise InputError(f"{given.recordings[0]}: {option} tracks a film, and this is none")
            return None
        for option, told in (("--units", given.units), ("--fps", given.fps), ("--format", given.format)):
            if told is not None:
                raise InputError(f"{given.recording}: a film has pixels and its own times: leave {option} out")
        if given.scale is None and not given.body_lengths:
            raise InputError(
                f"{given.recording}: a film has pixels, the body has metres: pass --scale (metres a pixel) or "
                "--body-lengths"
            )
        load_planar(given.body, "a film of one camera")
        return cls(given, network, arm, person, tracks)

    @property
    def files(self) -> list[Path]:
        """What is read beside the recording's own."""
        return [] if self.network is None else [self.network]

    @property
    def body(self) -> Body:
        """Whom it shows."""
        return load_planar(self.given.body, "a film of one camera")

    @property
    def base(self) -> str:
        """Name of the keypoint at the first joint."""
        return self.given.base or self.body.base_keypoint

    def track(self, checkpoint: Path | None, progress: Callable[[int, int, str], None]) -> Given:
        """Track the film; what is given then. Raises as `film_commands.tracks_of`."""
        wanted = (self.base, *self.body.keypoint_names)
        kept = None if checkpoint is None else checkpoint.with_name(f"{checkpoint.name}.tracking")
        film = Path(self.given.recording)
        if (aspect := Film(film).aspect) != 1:
            warnings.warn(
                f"{film}: its pixels are {aspect:.3g} times as wide as high, so no one scale fits both directions: "
                "make them square first, with ffmpeg's filter scale=iw*sar:ih,setsar=1",
                stacklevel=2,
            )
        tracks_of(film, self.tracks, self.network, self.arm, self.person, kept, progress, wanted)
        return replace(self.given, recordings=[str(self.tracks)], units="px")

    def overlay(self, idata: az.InferenceData) -> "Overlay":
        """What the posterior's film is laid over."""
        from .overlay import Overlay

        return Overlay(Film(self.given.recording), read_keypoint_csv(self.tracks), self.base, idata)
