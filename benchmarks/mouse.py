"""The mouse of Biderman et al. (2020): the motion of its paw in space, and the lengths of its bones, without forces.

The session is the paper's: shoulder, elbow and wrist by two cameras and bundle adjustment, 5,110 frames at 30 a second
(github.com/danbider/aesmc; not ours to give: `INVDYN_DATA` names a folder with `mouse_3d/`). The calibration is not
metric: its own parameters multiply one camera's picture by 19, and every point lies behind the other camera. So lengths
are in *reconstruction units*. The kinematic model of notebook 5 runs on the whole session: a shoulder and an elbow with
yaw and pitch, whose velocities walk; walk, noise and both lengths are fitted by marginal likelihood.

Of each hundred frames three stretches are hidden: 1, 5 and 10 frames long. For each: the share of hidden coordinates
inside the posterior predictive 50 and 90 % intervals; the rms error of the predictive mean, and that of a straight line
between the frames next to the stretch. Lengths stand next to the quartiles of the distances in the recording. `--out`
has figure and film made of the same posterior, the film of `--shown` frames.

    python benchmarks/mouse.py [--frames 0:5110] [--method laplace] [--family gaussian] [--out FOLDER [--shown 0:300]]
"""

import argparse
import os
import sys
import time
from pathlib import Path

import arviz as az
import numpy as np
import pandas as pd
import torch

from invdyn.film import save_film
from invdyn.inference import infer_kinematics, learned_lengths, pooled
from invdyn.models import Body, Joint, Link
from invdyn.plots import plot_posterior, save_figure
from invdyn.recordings import Recording

RATE, UNIT = 30, "reconstruction units"
HIDDEN = {1: 10, 5: 40, 10: 75}
"""Length of a hidden stretch, and where it begins in each hundred frames."""
MOUSE = Body(
    "mouse",
    [
        Link("upper_arm", Joint("shoulder", "universal"), length=2.5, tip="elbow", mass=1.0),
        Link("forearm", Joint("elbow", "universal"), parent="upper_arm", length=1.5, tip="wrist", mass=1.0),
    ],
    gravity=(0.0, 0.0, 0.0),
)
"""Its masses have no influence."""


def session(frames: slice) -> np.ndarray:
    """Elbow and wrist (T, 2, 3) from the shoulder, which hardly moves."""
    place = Path(os.environ.get("INVDYN_DATA", "")) / "mouse_3d" / "costa_BA_3D_pts.npy"
    if not os.environ.get("INVDYN_DATA") or not place.exists():
        sys.exit("the mouse cannot be had here: set INVDYN_DATA to a folder with mouse_3d/costa_BA_3D_pts.npy")
    points = np.load(place, allow_pickle=False).T.reshape(-1, 3, 3)[frames]
    return points[:, 1:] - points[:, :1]


def stretches(count: int, length: int) -> np.ndarray:
    """Numbers (S, length) of the frames of each hidden stretch; those at the end of the recording are left out."""
    begins = np.arange(HIDDEN[length], count - length, 100)
    return begins[:, None] + np.arange(length)


def predictions(idata: az.InferenceData, points: np.ndarray) -> pd.DataFrame:
    """One row a length of stretch; see the top of the file."""
    draws = pooled(idata, group="posterior_predictive")["position"]
    draws = draws.transpose("sample", "time", "keypoint", "space").values
    rows = []
    for length in HIDDEN:
        frames = stretches(len(points), length)
        true, drawn = points[frames], draws[:, frames]
        share = np.arange(1, length + 1)[:, None, None] / (length + 1)
        before, after = points[frames[:, :1] - 1], points[frames[:, -1:] + 1]
        row = {"frames hidden": length, "coordinates": true.size}
        for level in (0.5, 0.9):
            low, high = np.quantile(drawn, [(1 - level) / 2, (1 + level) / 2], axis=0)
            row[f"{100 * level:.0f} % covers"] = ((low <= true) & (true <= high)).mean()
        row["rms error"] = np.sqrt(((drawn.mean(0) - true) ** 2).mean())
        row["straight line"] = np.sqrt(((before + share * (after - before) - true) ** 2).mean())
        rows.append(row)
    return pd.DataFrame(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", default="0:5110")
    parser.add_argument("--method", choices=("laplace", "smc"), default="laplace")
    parser.add_argument("--family", choices=("gaussian", "student_t"), default="gaussian")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--shown", default="0:300")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    points = session(slice(*map(int, arguments.frames.split(":"))))
    seen = points.copy()
    for length in HIDDEN:
        seen[stretches(len(points), length)] = np.nan
    recording = Recording(np.arange(len(points)) / RATE, seen, ("elbow", "wrist"), length_unit=UNIT)
    began = time.process_time()
    idata = infer_kinematics(
        recording, MOUSE, method=arguments.method, family=arguments.family, learn_lengths=True,
        num_filters=16, num_draws=16,
    )  # fmt: skip
    took = time.process_time() - began
    lengths, ends = learned_lengths(idata), {"upper_arm": points[:, 0], "forearm": points[:, 1] - points[:, 0]}
    print(f"\nlengths, from {len(points)} frames by {arguments.method} in {took:.0f} s of CPU\n")
    print("| bone | learned, reconstruction units | sd | distances in the recording: 5 % | 50 % | 95 % |")
    print("|---|---|---|---|---|---|")
    for link, (length, sd) in lengths.items():
        low, middle, high = np.quantile(np.linalg.norm(ends[link], axis=-1), [0.05, 0.5, 0.95])
        print(f"| {link} | {length:.3f} | {sd:.3f} | {low:.2f} | {middle:.2f} | {high:.2f} |")
    found = predictions(idata, points)
    print(f"\nstretches that were hidden\n\n| {' | '.join(found)} |\n|{'---|' * found.shape[1]}")
    for row in found.itertuples(index=False):
        print(f"| {' | '.join(f'{value:.3g}' for value in row)} |")
    if arguments.out:
        arguments.out.mkdir(parents=True, exist_ok=True)
        first, last = map(int, arguments.shown.split(":"))
        shown = idata.isel(time=slice(first, last))
        save_figure(plot_posterior(shown), arguments.out / "mouse.png")
        save_film(shown, arguments.out / "mouse.gif")
    if "unseen" in idata.attrs:
        print(f"\n{idata.attrs['unseen']}")
    if "charts" in idata.attrs:
        print(f"\n{idata.attrs['charts']}")


if __name__ == "__main__":
    main()
