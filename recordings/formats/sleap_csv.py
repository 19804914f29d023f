"""SLEAP's analysis csv: one row an animal and frame.

    track, frame_idx, instance.score, <node>.x, <node>.y, <node>.score …

Frames in which an animal was not found have no row, and a point that was not found has empty cells. Numbers stay as in
the file: pixels, y down. https://docs.sleap.ai (export analysis csv)
"""

from pathlib import Path

import numpy as np

from ..errors import InputError, about
from ..naming import choose_individual
from ..recording import Recording
from ..tables import read_numbers, read_rows

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
