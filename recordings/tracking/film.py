"""A film's pictures with their own times, decoded by PyAV (extra `tracking`).

Times are those that the file gives each picture, from the first one on: a telephone drops frames in the dark, and a
constant frame rate would shift all that follow. An upright telephone stores its pictures on their side, with the angle
by which to rotate them; here they come as one sees them. Pixels: u right, v down, (0, 0) is the centre of the
first; they are the stored ones, without a player's aspect ratio. A file's edit list says which of its pictures are
shown; a damaged time scale leaves few of them, or one.
"""

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from ..errors import InputError
from ..paths import check_readable

CONTAINERS = (
    *("mov", "matroska", "avi", "mpegts", "mpeg", "asf", "flv", "ogg", "mxf", "dv", "gif", "apng", "nut", "ivf"),
    *("mpegvideo", "m4v", "h264", "hevc", "mjpeg", "yuv4mpegpipe"),
)
"""What FFmpeg may take a file for, by its names: kinds that hold their pictures. A playlist (hls, concat, dash, sdp …)
names other files and hosts, and would make it read them.
"""


@dataclass(frozen=True)
class Picture:
    """Number in the film, time s since its first picture, and RGB (H, W, 3) uint8."""

    number: int
    time: float
    rgb: np.ndarray


class Film:
    """A film that can be read, again and again, from its start.

    Attributes:
        path: the file.
        width, height: of its pictures as one sees them, px.
        expected: number of pictures, as the file announces it; it need not be true, and may be 0.
        aspect: width of a stored pixel over its height, as a player shows it; 1 where the file does not state it.

    Raises:
        InputError: a file that is no film, that this ffmpeg cannot decode, or whose times show less than half of its
            pictures; or PyAV is missing.
        OSError: a path that is not there, or no ordinary file.
    """

    def __init__(self, path: str | Path):
        self.path = check_readable(path)
        first = next(self.pictures(), None)
        if first is None:
            raise InputError(f"{path}: not one picture of this film can be decoded; is the file whole?")
        self.height, self.width = first.rgb.shape[:2]
        with self._open() as container:
            stream = container.streams.video[0]
            seconds, rate = float(container.duration or 0) / 1e6, float(stream.average_rate or 0)
            self.expected = int(stream.frames or round(seconds * rate))
            self.aspect = float(stream.sample_aspect_ratio or 1)
            if stream.frames:  # 0 where a file does not state it
                self._check_shown(
                    stream.frames, sum(each.size > 0 and not each.is_discard for each in container.demux(stream))
                )

    def _check_shown(self, stored: int, shown: int) -> None:
        """Raise InputError, or warn, where pictures that the file holds lie outside the times that it shows."""
        if shown >= stored:
            return
        left_out = f"{self.path}: the file holds {stored} pictures, but its times show {shown}"
        if shown < stored / 2:
            raise InputError(
                f"{left_out}: its time scale or edit list is damaged, or most of it was cut; convert it first, ffmpeg "
                "-ignore_editlist 1 -i FILM COPY"
            )
        warnings.warn(f"{left_out}: an edit list leaves the others out", stacklevel=3)

    def pictures(self, size: tuple[int, int] | None = None, start: int = 0) -> Iterator[Picture]:
        """All pictures from number `start` on; `size` (height, width) has them scaled by averaging over areas.

        Raises InputError for a film that ends in the middle of a picture, or changes its size.
        """
        av = import_av(self.path)
        start_time, last, shape, number = None, -np.inf, None, 0
        with self._open() as container:
            try:
                for number, frame in enumerate(container.decode(video=0)):
                    if frame.time is None:
                        raise InputError(f"{self.path}: picture {number} has no time: convert the film to mp4 first")
                    start_time = frame.time if start_time is None else start_time
                    time = float(frame.time - start_time)
                    if time <= last:
                        raise InputError(f"{self.path}: time stands still at picture {number}: convert the film to mp4")
                    last = time
                    if shape not in (None, (frame.height, frame.width)):
                        raise InputError(f"{self.path}: the size of its pictures changes at picture {number}")
                    shape = (frame.height, frame.width)
                    if number >= start:
                        yield Picture(number, time, _upright(frame, size))
            except av.error.FFmpegError as error:
                raise InputError(
                    f"{self.path}: the film cannot be decoded after picture {number} ({error.strerror}): "
                    "is the file whole?"
                ) from None

    def _open(self) -> Any:
        av = import_av(self.path)
        try:
            container = av.open(str(self.path), container_options={"format_whitelist": ",".join(CONTAINERS)})
        except av.error.FFmpegError as error:
            raise InputError(f"{self.path}: not a film that can be decoded ({error.strerror})") from None
        if not container.streams.video:
            container.close()
            raise InputError(f"{self.path}: there are no pictures in this file, only sound or text")
        return container


def read_pictures(film: Film, numbers: Sequence[int], size: tuple[int, int] | None = None) -> Iterator[np.ndarray]:
    """The pictures (H, W, 3) of those numbers, which must rise. Raises InputError where the film is shorter."""
    pictures = film.pictures(size, numbers[0] if len(numbers) else 0)
    for number in numbers:
        picture = next((each for each in pictures if each.number == number), None)
        if picture is None:
            raise InputError(f"{film.path}: there is no picture {number} in this film: are the labels another film's?")
        yield picture.rgb


def import_av(path: str | Path | None = None) -> ModuleType:
    """PyAV. Raises InputError when it is not installed."""
    try:
        import av
    except ImportError:
        where = "" if path is None else f"{path}: "
        raise InputError(f"{where}reading a film needs more packages: pip install 'invdyn[tracking]'") from None
    return av


def _upright(frame: Any, size: tuple[int, int] | None) -> np.ndarray:
    """RGB of a decoded frame, scaled, then rotated as the file states."""
    quarters = round(frame.rotation / 90) % 4  # counter-clockwise
    if size is None:
        rgb = frame.to_ndarray(format="rgb24")
    else:
        height, width = size if quarters % 2 == 0 else size[::-1]
        rgb = frame.to_ndarray(format="rgb24", width=width, height=height, interpolation="AREA")
    return np.ascontiguousarray(np.rot90(rgb, quarters)) if quarters else rgb
