"""Calibrate cameras from films or folders of pictures of one board: first each lens, then where they all stand.

Grey pictures of a film are decoded by ffmpeg (extra `cameras`); those of a folder are taken in order.
"""

import subprocess
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np

from ..errors import InputError, about, first_line
from ..paths import check_readable
from .boards import Board
from .camera import Calibration
from .intrinsics import Intrinsics, fit_intrinsics
from .rig import fit_rig

IMAGES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")


def grey_pictures(path: str | Path, every: int = 1) -> Iterator[tuple[int, np.ndarray]]:
    """Number and picture (H, W) uint8 of every n-th frame of a film, or image of a folder.

    Raises:
        InputError: a folder without images, an image or film that cannot be decoded, pictures of different sizes, or
            the package that decodes films is missing.
        OSError: a path that is not there, or no ordinary file.
    """
    path = Path(path)
    source = _images(path, every) if path.is_dir() else _film(path, every)
    size = None
    for number, picture in source:
        if size not in (None, picture.shape):
            raise InputError(
                f"{path}: picture {number} has {picture.shape[1]} × {picture.shape[0]} px, those before "
                f"{size[1]} × {size[0]}: expected pictures of one camera in one setting"
            )
        size = picture.shape
        yield number, picture
    if size is None:
        raise InputError(f"{path}: no picture in it")


def _images(folder: Path, every: int) -> Iterator[tuple[int, np.ndarray]]:
    from PIL import Image

    files = sorted(file for file in folder.iterdir() if file.suffix.lower() in IMAGES)
    if not files:
        raise InputError(f"{folder}: no images in this folder; expected {', '.join(IMAGES)}")
    for number, file in list(enumerate(files))[::every]:
        check_readable(file)
        try:
            with Image.open(file) as image:
                picture = np.asarray(image.convert("L"))
        except (OSError, SyntaxError, Image.DecompressionBombError) as error:
            raise InputError(f"{file}: not an image that can be read ({first_line(error)})") from None
        yield number, picture


def _film(path: Path, every: int) -> Iterator[tuple[int, np.ndarray]]:
    check_readable(path)
    try:
        import imageio_ffmpeg
    except ImportError:
        raise InputError(f"{path}: decoding a film needs one more package: pip install 'invdyn[cameras]'") from None
    # YUV4MPEG2: a line with the size, then each frame behind a line of its own; every frame once, as it is stored.
    form = ["-f", "yuv4mpegpipe", "-strict", "-1", "-pix_fmt", "gray", "-fps_mode", "passthrough", "-"]
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-nostdin", "-i", str(path), "-map", "0:v:0", *form]
    with tempfile.TemporaryFile() as complaints:
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=complaints) as decoder:
            try:
                assert decoder.stdout is not None
                yield from _frames(decoder.stdout, every)
            finally:
                decoder.kill()  # the caller may stop early
        complaints.seek(0)
        lines = complaints.read().decode(errors="replace").strip().splitlines()
    if lines and decoder.returncode > 0:
        raise InputError(f"{path}: not a film that ffmpeg can decode ({lines[-1][:200]})")


def _frames(stream: IO[bytes], every: int) -> Iterator[tuple[int, np.ndarray]]:
    words = stream.readline().decode("ascii", errors="replace").split()
    side = {word[0]: int(word[1:]) for word in words if word[0] in "WH"}
    number = 0
    while stream.readline():
        frame = stream.read(side["W"] * side["H"])
        if len(frame) == side["W"] * side["H"] and number % every == 0:
            yield number, np.frombuffer(frame, np.uint8).reshape(side["H"], side["W"])
        number += 1


def calibrate(
    sources: Mapping[str, Path],
    board: Board,
    every: int = 10,
    progress: Callable[[int, int, str], None] | None = None,
) -> tuple[Calibration, dict[str, Intrinsics]]:
    """Calibrate, metric by the board's squares, in the first camera's frame.

    Args:
        sources: camera → film or folder; of several, pictures of the same number were taken at the same moment.
        board: what was shown.
        every: which frames of a film to search; of a folder of images all are.
        progress: called as (done, total, what).

    Returns:
        The cameras, and the lens that was fitted to each one's pictures.

    Raises:
        InputError: as `grey_pictures`, `fit_intrinsics` and `fit_rig`.
        OSError: a path that is not there.
    """
    if not sources:
        raise InputError("expected films of one camera or more, got none")
    found: dict[str, dict[Any, Any]] = {}
    lenses: dict[str, Any] = {}
    for done, (name, path) in enumerate(sources.items()):
        if progress:
            progress(done, len(sources), "boards")
        found[name] = {}
        for number, picture in grey_pictures(path, 1 if Path(path).is_dir() else every):
            if (pixels := board.find(picture)) is not None:
                found[name][number] = pixels
            size = (picture.shape[1], picture.shape[0])
        with about(path):
            lenses[name] = fit_intrinsics(name, board, found[name], size)
    if progress:
        progress(len(sources), len(sources), "boards")
    return fit_rig(board, lenses, found), lenses
