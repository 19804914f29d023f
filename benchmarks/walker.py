"""A walker's arms from subsets of four cameras, against the triangulation that comes with the data.

`multiview_walker` (60 frames/s, 100 frames, eight keypoints by MediaPipe): reprojection error in the cameras used and
in those left out, lengths of upper arm and forearm, median distance from the points of all four cameras, and the
standard deviation that a point states. The arms were not measured: what counts is that a length stays the same, over
time and over subsets.

    INVDYN_DATA=… python benchmarks/walker.py
"""

import os
import time
from pathlib import Path

import numpy as np

from invdyn.recordings.cameras import Calibration, bundle_adjust, project, read_calibration, triangulate

SUBSETS = ("1234", "123", "234", "13", "24")
LINKS = {"R upper": (3, 4), "R fore": (4, 5), "L upper": (0, 1), "L fore": (1, 2)}


def tracks(folder: Path, names: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (T, P, C, 2) and confidences (T, P, C)."""
    files = [folder / f"{name}_mediapipe2d.csv" for name in names]
    tables = [np.genfromtxt(file, delimiter=",", skip_header=1)[:, 1:].reshape(-1, 8, 3) for file in files]
    whole = np.stack(tables, 2)
    return whole[..., :2], whole[..., 2]


def misses(calibration: Calibration, points: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Distances (T, P, C) of pixels and projections."""
    return np.stack(
        [np.linalg.norm(pixels[..., c, :] - project(k, points), axis=-1) for c, k in enumerate(calibration)], -1
    )


def lengths(points: np.ndarray) -> str:
    """Mean ± standard deviation of each link, m."""
    each = [np.linalg.norm(points[:, far] - points[:, near], axis=-1) for near, far in LINKS.values()]
    return " | ".join(f"{np.nanmean(length):.3f} ± {np.nanstd(length):.3f}" for length in each)


def main() -> None:
    folder = Path(os.environ["INVDYN_DATA"]).expanduser() / "multiview_walker"
    calibration = read_calibration(folder / "Calib.qca.txt")
    pixels, confidence = tracks(folder, calibration.names)
    given = np.genfromtxt(folder / "triangulated_mediapipe_arm3d_m.csv", delimiter=",", skip_header=1)[:, 1:]
    given = given.reshape(-1, 8, 3)
    shape = given.shape

    print(f"| cameras | median px | left out, px | {' | '.join(LINKS)} | to all four, mm | stated sd, mm | CPU s |")
    print("|---" * (len(LINKS) + 6) + "|")
    print(f"| with the data | {np.nanmedian(misses(calibration, given, pixels)):.1f} | | {lengths(given)} | | | |")
    best = None
    for subset in SUBSETS:
        used = [int(digit) - 1 for digit in subset]
        rest = [c for c in range(len(calibration)) if c not in used]
        some = calibration.select([calibration.names[c] for c in used])
        start = time.process_time()
        found = triangulate(
            some, pixels[:, :, used].reshape(-1, len(used), 2), confidence[:, :, used].reshape(-1, len(used))
        )
        took = time.process_time() - start
        points = found.points.reshape(shape)
        best = points if best is None else best
        inside = np.nanmedian(misses(some, points, pixels[:, :, used]))
        outside = ""
        if rest:
            others = calibration.select([calibration.names[c] for c in rest])
            outside = f"{np.nanmedian(misses(others, points, pixels[:, :, rest])):.1f}"
        apart = 1e3 * np.nanmedian(np.linalg.norm(points - best, axis=-1))
        sd = 1e3 * np.nanmedian(np.sqrt(np.trace(found.covariance, axis1=1, axis2=2)))
        print(f"| {subset} | {inside:.1f} | {outside} | {lengths(points)} | {apart:.0f} | {sd:.0f} | {took:.2f} |")

    print("\nPoses adjusted to these tracks; the lenses stay, or focal lengths are freed:\n")
    print("| freed | median px before | after | cameras moved by, mm | focal lengths, px | R upper | R fore | CPU s |")
    print("|---|---|---|---|---|---|---|---|")
    flat = pixels.reshape(-1, len(calibration), 2), confidence.reshape(-1, len(calibration))
    for freed in ((), ("focal",)):
        start = time.process_time()
        adjusted = bundle_adjust(calibration, *flat, freed)
        took = time.process_time() - start
        moved = [
            np.linalg.norm(a.position - b.position) for a, b in zip(adjusted.calibration, calibration, strict=True)
        ]
        focal = ", ".join(f"{camera.focal[0]:.0f}" for camera in adjusted.calibration)
        arms = " | ".join(lengths(adjusted.points.reshape(shape)).split(" | ")[:2])
        print(
            f"| {', '.join(freed) or 'nothing'} | {adjusted.before:.1f} | {adjusted.after:.1f} | "
            f"{', '.join(f'{1e3 * each:.0f}' for each in moved)} | {focal} | {arms} | {took:.1f} |"
        )


if __name__ == "__main__":
    main()
