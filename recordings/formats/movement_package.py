"""The other trackers' files, read through the package `movement` (extra `tracks`).

SLEAP (.slp, .h5), Lightning Pose (.csv) and Anipose (.csv, 3-D, with keypoints in alphabetical order). None of these is
read through pickles (`movement` reads DeepLabCut's .h5 by PyTables, which executes pickles, so that
:mod:`.deeplabcut` does it instead). Numbers stay as in the file. https://movement.neuroinformatics.dev
"""

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError, about, readable
from ..hdf5_size import check_hdf5
from ..naming import choose_individual
from ..recording import Recording

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
