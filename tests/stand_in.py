"""A recording to stand in for the paper's human arm where the real one is not at hand.

The same file in the same layout (DeepLabCut, pixels, 30 frames/s, 444 frames), but simulated: a rigid arm of 41 and
40 pixels turns about a shoulder that hardly moves, and each mark is off by half a pixel.
"""

from pathlib import Path

import numpy as np
import pandas as pd

from invdyn.recordings.catalogue import CATALOGUE

FRAMES, FPS = 444, 30
LINKS = (41.0, 40.0)  # px


def human_arm(folder: Path) -> Path:
    """Write the file below a folder that can be INVDYN_DATA; returns the folder."""
    file = folder / CATALOGUE["human-arm"].sources[0].file
    file.parent.mkdir(parents=True)
    deeplabcut(file)
    return folder


def deeplabcut(file: Path, links: tuple[float, float] = LINKS, frames: int = FRAMES) -> None:
    """Write a table of shoulder, elbow and wrist, px, of an arm with links so long."""
    time, rng = np.arange(frames) / FPS, np.random.default_rng(0)
    upper = 1.0 + 0.5 * np.sin(1.7 * time) + 0.2 * np.sin(4.1 * time)
    fore = upper + 0.9 + 0.6 * np.sin(2.3 * time + 1)
    shoulder = np.tile([75.0, 135.0], (frames, 1))
    elbow = shoulder + links[0] * np.stack([np.cos(upper), -np.sin(upper)], -1)  # a picture's y points down
    wrist = elbow + links[1] * np.stack([np.cos(fore), -np.sin(fore)], -1)
    marks = np.stack([shoulder, elbow, wrist], 1)
    marks[:, 1:] += 0.5 * rng.standard_normal(marks[:, 1:].shape)
    table = np.concatenate([marks, np.ones((frames, 3, 1))], -1).reshape(frames, -1)
    columns = pd.MultiIndex.from_product(
        [["network"], ["shoulder", "elbow", "wrist"], ["x", "y", "likelihood"]], names=["scorer", "bodyparts", "coords"]
    )
    pd.DataFrame(table, columns=columns).to_csv(file)
