"""A recording, and what it would be in other units: what stands in a mapping changes there.

A log's angles are counted from zeros, and a servo's targets are torques by now. So a recording in another unit is read
once more, and not multiplied.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from .logs.mapping import JointMap
from .recording import Recording


@dataclass(frozen=True)
class TrackedFilm:
    """A film, the file of its tracks, and the name of the keypoint at the first joint."""

    path: Path
    tracks: Path
    base: str


@dataclass(frozen=True)
class Reading:
    """A recording, and how it was read.

    Attributes:
        recording: in SI units, if the units are right.
        again: of factors `angle`, `target` and `time`, the recording with these so many times as large; None where the
            recording has the file's own zeros and no targets, so that its numbers may be multiplied.
        targets: whether some of its torques are servos' targets.
        maps: of a robot's own log, whose joints are counted as the robot's file does, where each one's numbers come
            from; none of a mapping without entries. None of another recording.
        film: what its keypoints were tracked in, if they were.
    """

    recording: Recording
    again: Callable[..., Recording] | None = None
    targets: bool = False
    maps: tuple[JointMap, ...] | None = None
    film: TrackedFilm | None = None

    def rescaled(self, **scales: float) -> "Reading":
        """The reading in other units; factors of `angle`, `target` and `time`."""
        if self.again is not None:
            return replace(self, recording=self.again(**scales))
        recording, angle = self.recording, scales.get("angle", 1.0)
        angles = None if recording.angles is None else recording.angles * angle
        righted = replace(recording, angles=angles, time=recording.time * scales.get("time", 1.0))
        return replace(self, recording=righted)
