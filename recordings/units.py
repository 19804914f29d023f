"""Units are declared, converted here once, and checked against what is plausible; they are never guessed.

Lengths become metres and angles radians. Pixels point down the image: y ↦ −y turns them up (the image's
height is not known, and only shifts the origin); they stay pixels unless a scale in metres a pixel is given.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .errors import InputError
from .recording import Recording

METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
RADIANS = {"rad": 1.0, "deg": np.pi / 180}
LARGEST_EXTENT = 20.0  # m between two keypoints of one body; pixels and millimetres exceed it
LARGEST_ANGLE = 50.0  # rad, eight turns of a joint; degrees exceed it
WORST_LINK_RATIO = 3.0  # observed over given link length; a wrong unit is off by far more


@dataclass(frozen=True)
class Units:
    """What a file's numbers mean: `length` is px, mm, cm or m, `angle` deg or rad; None = not declared."""

    length: str | None = None
    angle: str | None = None


def parse_units(text: str | None) -> Units:
    """Read a comma-separated list such as "px" or "mm,deg".

    Raises InputError for a unit that is not known, or two of one kind.
    """
    units = Units()
    for word in (text or "").split(","):
        if not (unit := word.strip()):
            continue
        kind = "length" if unit in (*METRES, "px") else "angle"
        if kind == "angle" and unit not in RADIANS:
            raise InputError(f"unknown unit {unit!r} in --units {text}: known are px, mm, cm, m, deg, rad")
        if getattr(units, kind) is not None:
            raise InputError(f"--units {text} names two units of {kind}")
        units = replace(units, **{kind: unit})
    return units


def to_si(recording: Recording, units: Units, scale: float | None = None) -> Recording:
    """Convert numbers as they stand in a file.

    Args:
        recording: numbers in `units`, whatever its `length_unit` says.
        units: a missing length means m, a missing angle rad.
        scale: metres a pixel; without it pixels stay pixels, with y up.

    Raises:
        InputError: a scale that is not positive, or without pixels; pixels in three dimensions.
    """
    if scale is not None and units.length != "px":
        raise InputError("a scale (metres a pixel) needs --units px")
    if units.length == "px":
        if recording.keypoints.shape[-1] != 2:
            raise InputError("these keypoints have three coordinates, so they cannot be px: pass --units mm or m")
        recording = replace(recording, keypoints=recording.keypoints * [1.0, -1.0], length_unit="px")
        if scale is not None:
            recording = recording.scaled(scale, "m")
    else:
        recording = recording.scaled(METRES[units.length or "m"], "m")
    if recording.angles is not None and units.angle == "deg":
        recording = replace(recording, angles=recording.angles * RADIANS["deg"])
    return recording


def check_magnitudes(recording: Recording, units: Units) -> None:
    """Raise InputError when lengths are too large for metres, or angles for radians that nobody declared."""
    if recording.length_unit == "m" and (extent := _extent(recording)) > LARGEST_EXTENT:
        raise InputError(
            f"keypoints spread over {extent:.3g} m, too much for one body; these look like pixels: "
            "pass --units px (or mm, cm)"
        )
    if units.angle is None and recording.angles is not None:
        largest = np.nanmax(np.abs(recording.angles), initial=0.0)
        if largest > LARGEST_ANGLE:
            raise InputError(
                f"angles reach {largest:.3g}, too much for radians; these look like degrees: "
                "pass --units deg (--units rad if radians they are)"
            )


def check_plausible(
    recording: Recording, link_lengths: Sequence[float], base: Sequence[float] | None = (0.0, 0.0)
) -> None:
    """Compare the keypoints' median distances with a body's link lengths; a wrong unit shows at once.

    Args:
        recording: keypoints along the chain: the K links' tips, or the base and then the K tips.
        link_lengths: K lengths, m.
        base: place of the first joint in the recording's frame, m, when it is not itself a keypoint; None
            leaves the first link unchecked.

    Raises:
        InputError: a distance that is off by more than a factor of 3. Nothing is compared when the recording
            is not in metres or its keypoints are not this chain.
    """
    chain = recording.keypoints
    if recording.length_unit != "m" or chain.shape[1] not in (len(link_lengths), len(link_lengths) + 1):
        return
    names = recording.keypoint_names
    if chain.shape[1] == len(link_lengths):
        origin = np.full((len(chain), 1, chain.shape[-1]), np.nan)
        if base is not None:
            origin[..., :] = 0.0
            origin[..., : len(base)] = base
        chain, names = np.concatenate([origin, chain], axis=1), ("the base", *names)
    for k, (observed, length) in enumerate(zip(_median_distances(chain), link_lengths, strict=True)):
        if np.isfinite(observed) and not 1 / WORST_LINK_RATIO <= observed / length <= WORST_LINK_RATIO:
            raise InputError(
                f"{names[k]} and {names[k + 1]} lie {observed:.3g} m apart (median), but the body's link is "
                f"{length:.3g} m long: check --units, or the body's lengths"
            )


def median_link_lengths(recording: Recording, chain: Sequence[str] | None = None) -> np.ndarray:
    """Median distance between successive keypoints of `chain` (by default all), over frames with both.

    Returns (len(chain) − 1,) in the recording's length unit; NaN where the two are never seen together.
    """
    if chain is None:
        return _median_distances(recording.keypoints)
    return _median_distances(np.stack([recording.keypoint(name) for name in chain], axis=1))


def in_body_lengths(recording: Recording, chain: Sequence[str] | None = None) -> Recording:
    """Divide by the chain's length, the sum of its median link lengths: for films with no scale.

    Raises InputError when that sum is unknown or zero.
    """
    total = float(median_link_lengths(recording, chain).sum())
    if not (np.isfinite(total) and total > 0):
        raise InputError("the body's length is unknown: two neighbours of its chain are never seen together")
    return recording.scaled(1 / total, "body length")


def _extent(recording: Recording) -> float:
    """Median over frames of the box diagonal of the keypoints; of a single keypoint's whole track."""
    points = recording.keypoints if recording.keypoints.shape[1] > 1 else recording.keypoints.swapaxes(0, 1)
    points = points[np.isfinite(points).all(axis=-1).any(axis=1)]  # rows may carry a command and no keypoints
    if len(points) == 0:
        return 0.0
    size = np.nanmax(points, axis=1) - np.nanmin(points, axis=1)
    return float(np.median(np.linalg.norm(size, axis=-1)))


def _median_distances(chain: np.ndarray) -> np.ndarray:
    """(T, P, S) → (P − 1,), NaN where no frame has both ends."""
    distances = np.linalg.norm(np.diff(chain, axis=1), axis=-1)
    return np.array([np.median(d[np.isfinite(d)]) if np.isfinite(d).any() else np.nan for d in distances.T])
