"""Conversion of declared units to SI; units are never guessed (:mod:`.plausible` checks them).

Lengths become metres, angles radians and times seconds. Pixels point down the image: y ↦ −y makes them point up (the
image's height is not known, and only shifts the origin); they stay pixels unless a scale in metres a pixel is given.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .errors import InputError
from .recording import Recording

METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
RADIANS = {"rad": 1.0, "deg": np.pi / 180}
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "days": 86400.0}
FRAMES = "frames"  # numbers of frames, for which the frame rate is needed
KINDS = {"length": (*METRES, "px"), "angle": tuple(RADIANS), "time": (*TIMES, FRAMES)}


@dataclass(frozen=True)
class Units:
    """The declared units of a file's numbers, of `KINDS`, None = not declared; and where they are declared.

    `mapping` is the file that declares them for a robot's log, None for the option `--units`.
    """

    length: str | None = None
    angle: str | None = None
    time: str | None = None
    mapping: str | None = None

    def put(self, unit: str, tracks: Sequence[str] = ("angle",)) -> str:
        """How to declare another ``unit`` for numbers of a mapping's ``tracks``: "pass --units deg"."""
        if self.mapping is None:
            return f"pass --units {unit}"
        if unit in TIMES:
            return f'write time_unit = "{unit}" in {self.mapping}'
        lines = " and ".join(f'"{track} = …"' for track in tracks)
        return f'write unit = "{unit}" in each line {lines} of {self.mapping}'

    def accepts(self, unit: str) -> str:
        """How to declare this ``unit`` regardless of the numbers' size: "--units rad"."""
        if self.mapping is None:
            return f"--units {unit}"
        return f'time_unit = "{unit}" in {self.mapping}' if unit in TIMES else f'unit = "{unit}" in {self.mapping}'


def parse_units(text: str | None) -> Units:
    """Read a comma-separated list such as "px" or "mm,deg".

    Raises InputError for a unit that is not known, or two of one kind.
    """
    units = Units()
    for word in (text or "").split(","):
        if not (unit := word.strip()):
            continue
        kind = next((kind for kind, known in KINDS.items() if unit in known), None)
        if kind is None:
            known = ", ".join(", ".join(each) for each in KINDS.values())
            raise InputError(f"unknown unit {unit!r} in --units {text}: known are {known}")
        if getattr(units, kind) is not None:
            raise InputError(f"--units {text} names two units of {kind}")
        units = replace(units, **{kind: unit})
    return units


def to_si(
    recording: Recording,
    units: Units,
    scale: float | None = None,
    fps: float | None = None,
    shifting: Collection[str] = (),
) -> Recording:
    """Convert numbers as they stand in a file.

    Args:
        recording: numbers in `units`; its `length_unit` is ignored.
        units: a missing length means m, a missing angle rad, a missing time s.
        scale: metres a pixel; without it pixels stay pixels, with y up.
        fps: frames a second, of times that are numbers of frames.
        shifting: joints that shift, whose positions are in m for all units of angles.

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
        factors = [1.0 if name in shifting else RADIANS["deg"] for name in recording.joint_names]
        recording = replace(recording, angles=recording.angles * factors)
    if units.time == FRAMES:
        recording = replace(recording, time=recording.time / fps)
    elif units.time is not None:
        recording = replace(recording, time=recording.time * TIMES[units.time])
    return recording


def median_link_lengths(recording: Recording, chain: Sequence[str] | None = None) -> np.ndarray:
    """Median distance between successive keypoints of `chain` (by default all), over frames with both.

    Returns (len(chain) − 1,) in the recording's length unit; NaN where the two are never seen together.
    """
    if chain is None:
        return median_distances(recording.keypoints)
    return median_distances(np.stack([recording.keypoint(name) for name in chain], axis=1))


def in_body_lengths(recording: Recording, chain: Sequence[str] | None = None, length: float = 1.0) -> Recording:
    """Scale so that the chain, the sum of its median link lengths, is `length` long: for films with no scale.

    A length of 1 makes it the unit, "body length"; any other is a body's own, in m.

    Raises InputError when that sum is unknown or zero.
    """
    total = float(median_link_lengths(recording, chain).sum())
    if not (np.isfinite(total) and total > 0):
        raise InputError("the body's length is unknown: two neighbours of its chain are never seen together")
    return recording.scaled(length / total, "body length" if np.isclose(length, 1.0) else "m")


def median_distances(chain: np.ndarray) -> np.ndarray:
    """Medians over frames of the distances between neighbours, (T, P, S) → (P − 1,); NaN where no frame has both."""
    distances = np.linalg.norm(np.diff(chain, axis=1), axis=-1)
    return np.array([np.median(d[np.isfinite(d)]) if np.isfinite(d).any() else np.nan for d in distances.T])
