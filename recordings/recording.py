"""What was observed: time, keypoints, confidence, and, where known, encoder angles and commanded torques.

SI units and radians; what was not seen is NaN and stays NaN. Shapes: T frames, P keypoints, S = 2 or 3
space axes (x right, y up in 2-D; z up in 3-D), K joints.
"""

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .errors import InputError
from .units import Units

MAX_VALUE = 1e7
"""Of any coordinate, angle, torque or confidence, in its own unit: m, px, rad, deg, N·m. A film has 10⁴ pixels, a map
of a country 10⁷ metres; what is larger is no measurement, and its powers leave a float's range."""
MAX_TIME = 1e20
"""s; nanoseconds since 1970 are 2 · 10¹⁸."""
MIN_STEP = 1e-7
"""s between two rows, a hundred times faster than any sensor of an arm."""


def check_time(time: np.ndarray, where: Callable[[int], str] = "frame {}".format) -> None:
    """Raise InputError unless `time` (T,) is finite, strictly increasing and has two entries or more.

    `where` turns a 0-based index into the words that name it, such as a file's line number.
    """
    if len(time) < 2:
        raise InputError(f"a recording needs at least 2 frames, this one has {len(time)}")
    if (bad := ~np.isfinite(time)).any():
        first = int(bad.argmax())
        raise InputError(f"time is {time[first]} at {where(first)}: every row needs a finite time, in seconds")
    check_range("time", time, where, MAX_TIME)
    step = np.diff(time)
    if (step <= 0).any():
        first = int((step <= 0).argmax()) + 1
        kind = "repeats" if step[first - 1] == 0 else "runs backwards"
        raise InputError(
            f"time {kind} at {where(first)} ({time[first - 1]:g} s, then {time[first]:g} s): "
            "times must increase; drop or sort the rows"
        )
    if (step < MIN_STEP).any():
        first = int((step < MIN_STEP).argmax()) + 1
        raise InputError(
            f"time advances by {step[first - 1]:.3g} s at {where(first)}, too little for a row of its own: "
            "drop the row, or give times in seconds"
        )


def check_range(what: str, values: np.ndarray, where: Callable[[int], str], largest: float = MAX_VALUE) -> None:
    """Raise InputError unless all numbers of `values` (T, …) lie within ±`largest`; NaN is missing."""
    if (beyond := np.abs(values) > largest).any():
        frame, *_ = place = tuple(np.argwhere(beyond)[0])
        if np.isinf(value := values[place]):
            raise InputError(f"{what} is infinite at {where(frame)}: leave a missing value empty (NaN)")
        raise InputError(
            f"{what} is {value:.3g} at {where(frame)}: expected numbers up to {largest:.0e}; leave a missing one empty"
        )


@dataclass(frozen=True, eq=False)
class Recording:
    """A recording of one articulated body.

    Attributes:
        time: (T,) s, strictly increasing; it need not be regular.
        keypoints: (T, P, S) in `length_unit`, NaN = missing; P = 0 when only encoders were recorded.
        keypoint_names: P names.
        confidence: (T, P) the tracker's own score, any scale, or None.
        angles: (T, K) rad, Denavit–Hartenberg (θ₁ from the x axis, each further one relative to its parent,
            counter-clockwise), NaN = missing, or None without encoders.
        torques: (T, K) N·m, the commanded torque, constant until the next row; NaN = not known; or None.
        joint_names: K names; () when neither angles nor torques are known.
        name: said in figures and messages.
        length_unit: "m", "px", or "body length" after normalisation.
        units: what a file's numbers were declared to be before they became SI (`parse_units`); a declared unit is not
            doubted.

    Raises:
        InputError: shapes or names that do not fit, fewer than two frames, times that are not finite and
            increasing, values that are infinite or beyond `MAX_VALUE`, or nothing observed at all.
    """

    time: np.ndarray
    keypoints: np.ndarray
    keypoint_names: tuple[str, ...]
    confidence: np.ndarray | None = None
    angles: np.ndarray | None = None
    torques: np.ndarray | None = None
    joint_names: tuple[str, ...] = ()
    name: str = "recording"
    length_unit: str = "m"
    units: Units = dataclasses.field(default_factory=Units)

    def __post_init__(self) -> None:
        for field in ("time", "keypoints", "confidence", "angles", "torques"):
            if (value := getattr(self, field)) is not None:
                object.__setattr__(self, field, _as_floats(field, value))
        for field in ("keypoint_names", "joint_names"):
            names = tuple(getattr(self, field))
            if len(set(names)) != len(names):
                raise InputError(f"{field} has a name twice: {', '.join(names)}")
            object.__setattr__(self, field, names)
        self._check_shapes()
        check_time(self.time)
        for field in ("keypoints", "confidence", "angles", "torques"):
            value = getattr(self, field)
            if value is not None:
                check_range(field, value, "frame {}".format)
        if not any(np.isfinite(v).any() for v in (self.keypoints, self.angles) if v is not None):
            raise InputError("nothing is observed: no keypoint and no angle has a value in any frame")

    def _check_shapes(self) -> None:
        frames, points, joints = len(self.time), len(self.keypoint_names), len(self.joint_names)
        if self.time.ndim != 1:
            raise InputError(f"time must have shape (T,), got {self.time.shape}")
        if self.keypoints.shape not in ((frames, points, 2), (frames, points, 3)):
            raise InputError(
                f"keypoints must have shape (T, P, 2) or (T, P, 3) with T = {frames} times and "
                f"P = {points} keypoint names, got {self.keypoints.shape}"
            )
        expected = {"confidence": (frames, points), "angles": (frames, joints), "torques": (frames, joints)}
        for field, shape in expected.items():
            if (value := getattr(self, field)) is not None and value.shape != shape:
                raise InputError(f"{field} must have shape {shape}, got {value.shape}")

    @property
    def num_frames(self) -> int:
        """T."""
        return len(self.time)

    @property
    def duration(self) -> float:
        """Last time less first, s."""
        return float(self.time[-1] - self.time[0])

    @property
    def frame_interval(self) -> float:
        """Median time between frames, s."""
        return float(np.median(np.diff(self.time)))

    def keypoint(self, name: str) -> np.ndarray:
        """Track of one keypoint, (T, S). Raises InputError when there is none of that name."""
        if name not in self.keypoint_names:
            raise InputError(f"no keypoint {name!r}; the recording has {', '.join(self.keypoint_names) or 'none'}")
        return self.keypoints[:, self.keypoint_names.index(name)]

    def select(self, start: int | None = None, stop: int | None = None) -> "Recording":
        """Frames start … stop−1, as Python slices do; times stay. Raises InputError if under 2 remain."""
        return self.at(slice(start, stop))

    def at(self, frames: slice | np.ndarray) -> "Recording":
        """Some frames, a slice or a mask (T,); times stay. Raises InputError if under 2 remain."""
        chosen: dict[str, Any] = {
            field: None if (value := getattr(self, field)) is None else value[frames]
            for field in ("time", "keypoints", "confidence", "angles", "torques")
        }
        return replace(self, **chosen)

    def relative_to(self, keypoint: str) -> "Recording":
        """Every keypoint less that one's track, frame by frame; where it is missing, all are.

        It hides how that one moves, and all get its noise.
        """
        return replace(self, keypoints=self.keypoints - self.keypoint(keypoint)[:, None])

    def about(self, keypoint: str) -> "Recording":
        """Every keypoint less the middle, axis by axis the median, of that one's track; raises as `keypoint` does."""
        return self.moved(-np.nanmedian(self.keypoint(keypoint), axis=0))

    def with_keypoints(self, names: Sequence[str]) -> "Recording":
        """Those keypoints alone, in that order. Raises ValueError for a name that it does not have."""
        order, confidence = [self.keypoint_names.index(name) for name in names], self.confidence
        return replace(
            self,
            keypoints=self.keypoints[:, order],
            keypoint_names=tuple(names),
            confidence=None if confidence is None else confidence[:, order],
        )

    def with_joints(self, names: Sequence[str]) -> "Recording":
        """Those joints alone, in that order. Raises ValueError for a name that it does not have."""
        order = [self.joint_names.index(name) for name in names]
        return replace(
            self,
            joint_names=tuple(names),
            angles=None if self.angles is None else self.angles[:, order],
            torques=None if self.torques is None else self.torques[:, order],
        )

    def moved(self, shift: Sequence[float]) -> "Recording":
        """Every keypoint and that shift, (S,)."""
        return replace(self, keypoints=self.keypoints + np.asarray(shift))

    @property
    def points(self) -> "Recording":
        """The recording without pixels of cameras, which :class:`.cameras.Filmed` has in addition."""
        return self

    def scaled(self, factor: float, unit: str) -> "Recording":
        """Keypoints times `factor`, now in `unit`. Raises InputError unless the factor is from 10⁻⁹ to 10⁹."""
        if not 1e-9 <= factor <= 1e9:
            raise InputError(f"a scale must be positive, from 1e-09 to 1e+09, got {factor:g}")
        return replace(self, keypoints=self.keypoints * factor, length_unit=unit)


def _as_floats(field: str, value: object) -> np.ndarray:
    try:
        return np.array(value, dtype=np.float64)  # a copy: the caller's array may change later
    except (TypeError, ValueError) as error:
        raise InputError(f"{field} must be an array of numbers: {error}") from None
