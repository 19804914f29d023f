"""Calibrate cameras from films or folders of pictures of one board: first each lens, then where they all stand."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from ..errors import InputError, about
from .boards import Board
from .camera import Calibration
from .intrinsics import Intrinsics, fit_intrinsics
from .pictures import grey_pictures
from .rig import fit_rig


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
