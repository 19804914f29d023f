"""Every limit that readers apply: what a file may cost, and which numbers are plausible.

Costs were chosen on a machine with 2 GiB of memory, on which no file may end the process, and such that recordings of
an hour are read. The sender pays for a file's own bytes, so these limits grow with them; a small file gets a fixed
share. All are checked before anything is unpacked (:mod:`.budget`).

Limits of plausibility are outside of what all real recordings at hand show, and inside of what a wrong unit or an
exchanged file causes.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Limits:
    """What a reader may take.

    Attributes:
        memory: bytes of arrays of a small file.
        memory_ratio: bytes of arrays for each byte of a larger file.
        unpacked_ratio: bytes that a compressed stream may unpack to, for each byte of the file; `memory` at least.
        chunk: bytes of one compressed chunk, unpacked; it is in memory as a whole.
        document: bytes of a text that is parsed as a whole.
        yaml: bytes of YAML, whose parser takes a second for 100 kB.
        message: bytes of a log's message.
        numbers: of a log, in all its tracks.
        tracks: of a log.
        records: of a small log.
        record_bytes: of a larger log, for each record; skipping one takes a microsecond.
        message_numbers: that a message counts for at least, since it takes as long to read.
        query_steps: of SQLite's virtual machine, in all queries; about 5 s.
    """

    memory: int = 2**30
    memory_ratio: int = 10
    unpacked_ratio: int = 100
    chunk: int = 2**28
    document: int = 2**24
    yaml: int = 2**20
    message: int = 2**24
    numbers: int = 2**25
    tracks: int = 10_000
    records: int = 2**23
    record_bytes: int = 64
    message_numbers: int = 16
    query_steps: int = 500_000_000


@dataclass(frozen=True)
class Plausible:
    """Numbers that a real recording has.

    Attributes:
        extent: m between two keypoints of one body, at most; pixels and millimetres exceed it.
        angle: rad, eight revolutions of a joint, at most; degrees exceed it.
        length_ratio: observed over given link length, or its inverse, at most, for an uncertain length.
        known_length_ratio: the same for an exact one: a picture only shortens, markers and lenses change a fifth.
        body_length_error: of a body whose lengths are fractions of its own, at most.
        wrong_angle: rad, median difference of angles from the keypoints' directions, at least, in a wrong unit.
        right_angle: the same in the right unit, at most.
        interval: s between rows, at least: a tenth of a fast camera's or a motor controller's.
        typical_interval: s, between a film's 1/30 and a robot's log: which unit of time to suggest.
        froude: v²/(g L), at most: four revolutions a second of a link of .3 m.
        speed_baseline: √(L/g), over which a speed is taken.
        misfit: median relative error of distances, at most, if names of keypoints are right; noise and markers next
            to their joints rarely reach it.
        misfit_left: of the misfit, at most, after exchanging two names that were exchanged.
        repeats: rows with the same position to the last digit, at least, for a warning.
        farther: times the longest step of a track that a number which stands for missing is off, but for 0, at least.
        finer: times a track's resolution that its noise is, at least, if no position repeats by chance.
        least_noise: of a track's range, under which a track is simulated, or drawn, without noise.
        positions: rows with a position, at least, for their longest step to be meaningful.
        low_likelihood: of a keypoint's median.
        stamp_difference: frame intervals between two cameras' stamps of one moment, at most.
        pixel_extent: px, at least, of tracks in pixels; smaller ones are taken to be in metres.
        reprojection: median reprojection error over the body's extent in a picture, usually at most.
        reprojection_of_trackers: the same, at most, of any tracker.
        reprojection_left: of the error, at most, after exchanging two cameras that were exchanged.
        first_interval: median intervals from a log's time stamp of 0 to the next one, at most, if 0 is a time.
    """

    extent: float = 20.0
    angle: float = 50.0
    length_ratio: float = 3.0
    known_length_ratio: float = 1.5
    body_length_error: float = 0.2
    wrong_angle: float = 0.5
    right_angle: float = 0.15
    interval: float = 1e-5
    typical_interval: float = 0.02
    froude: float = 20.0
    speed_baseline: float = 0.1
    misfit: float = 0.15
    misfit_left: float = 0.3
    repeats: int = 3
    farther: float = 3.0
    finer: float = 5.0
    least_noise: float = 1e-4
    positions: int = 10
    low_likelihood: float = 0.5
    stamp_difference: float = 0.05
    pixel_extent: float = 20.0
    reprojection: float = 0.01
    reprojection_of_trackers: float = 0.1
    reprojection_left: float = 0.5
    first_interval: float = 10.0


LIMITS = Limits()
PLAUSIBLE = Plausible()
