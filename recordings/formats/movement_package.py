"""The other trackers' files: through the package `movement` (extra `tracks`), and SLEAP's analysis csv.

SLEAP (.slp, .h5), Lightning Pose (.csv) and Anipose (.csv, 3-D, with keypoints in alphabetical order). None of these is
read through pickles (`movement` reads DeepLabCut's .h5 by PyTables, which executes pickles, so that
:mod:`.deeplabcut` does it instead). Numbers stay as in the file. https://movement.neuroinformatics.dev

SLEAP's analysis csv has one row an animal and frame:

    track, frame_idx, instance.score, <node>.x, <node>.y, <node>.score …

Frames in which an animal was not found have no row, and a point that was not found has empty cells. Pixels, y down.
https://docs.sleap.ai (export analysis csv)
"""

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ..budget import check_hdf5
from ..errors import InputError, about, readable
from ..naming import choose_individual
from ..recording import Recording
from ..tables import read_numbers, read_rows

SOFTWARE = {  # our name of a format: movement's
    "sleap": "SLEAP",
    "lightningpose": "LightningPose",
    "anipose": "Anipose",
}


def read_with_movement(path: str | Path, software: str, fps: float, individual: str | None = None) -> Recording:
    """Read tracks by `movement`; `software` is one of `SOFTWARE`'s keys.

    Raises:
        InputError: `movement` is not installed or cannot read the file, it is beyond its budget, or an animal has to
            be chosen.
        OSError: a file that cannot be opened.
    """
    with open(path, "rb"):  # raises the system's own error for a path that cannot be opened
        pass
    load_dataset = _import_movement(path)
    if Path(path).suffix.lower() != ".csv":
        check_hdf5(path)
    with readable(path, f"a {SOFTWARE[software]} file"), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the library itself
        dataset = load_dataset(Path(path), source_software=SOFTWARE[software], fps=fps)
        position = dataset.position.transpose("time", "individuals", "keypoints", "space")
        confidence = dataset.confidence.transpose("time", "individuals", "keypoints").to_numpy()
        animals, points = position.individuals.to_numpy().tolist(), position.keypoints.to_numpy().tolist()
        time, tracks = position.time.to_numpy().astype(float), position.to_numpy()
    with about(path):
        i = animals.index(choose_individual(animals, individual))
        return Recording(
            time=time,
            keypoints=tracks[:, i],
            keypoint_names=tuple(points),
            confidence=confidence[:, i] if np.isfinite(confidence[:, i]).any() else None,
            name=Path(path).stem,
            length_unit="px" if tracks.shape[-1] == 2 else "m",
        )


def _import_movement(path: str | Path) -> Callable[..., Any]:
    show = warnings.showwarning
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            from loguru import logger
            from movement.io import load_dataset
    except ImportError:
        raise InputError(f"{path}: reading this format needs one more package: pip install 'invdyn[tracks]'") from None
    finally:
        warnings.showwarning = show  # importing movement sends all warnings to its own log
    logger.disable("movement")  # it logs what it raises; the user gets one line, from us
    return load_dataset


FIRST = ("track", "frame_idx", "instance.score")


def read_sleap_csv(path: str | Path, fps: float, individual: str | None = None) -> Recording:
    """Read one; `individual` is a track's name, needed where there are several.

    Raises:
        InputError: another header, cells that are no numbers, two rows of one animal and frame, a track not chosen.
        OSError: a file that cannot be opened.
    """
    (_, header), *rows = read_rows(path)
    with about(path):
        nodes = tuple(dict.fromkeys(name.rpartition(".")[0] for name in header[len(FIRST) :]))
        columns = [*FIRST, *(f"{node}.{part}" for node in nodes for part in ("x", "y", "score"))]
        if not nodes or header != columns:
            raise InputError(
                f"not a SLEAP analysis csv: its header is {', '.join(FIRST)}, then <node>.x, .y and .score of each node"
            )
        tracks = list(dict.fromkeys(cells[0] for _, cells in rows))
        track = choose_individual(tracks, individual if any(tracks) else "") if tracks else ""
        own = [(line, cells[1:]) for line, cells in rows if cells[0] == track]
        numbers, where = read_numbers(own, columns[1:])
        order = np.argsort(numbers[:, 0], kind="stable")
        frames, values = numbers[order, 0], numbers[order, 2:].reshape(len(own), len(nodes), 3)
        if (twice := np.flatnonzero(np.diff(frames) == 0)).size:
            raise InputError(
                f"{where(int(order[twice[0] + 1]))}: frame {frames[twice[0]]:g} comes twice for track {track!r}: "
                "track the animals first, so that each has a name of its own"
            )
        return Recording(
            time=frames / fps,
            keypoints=values[..., :2],
            keypoint_names=nodes,
            confidence=values[..., 2] if np.isfinite(values[..., 2]).any() else None,
            name=Path(path).stem,
            length_unit="px",
        )
