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
    """What a reader may take."""

    memory: int = 2**30  # bytes of arrays of a small file
    memory_ratio: int = 10  # bytes of arrays for each byte of a larger file
    # bytes that a compressed stream may unpack to, for each byte of the file; `memory` at least
    unpacked_ratio: int = 100
    chunk: int = 2**28  # bytes of one compressed chunk, unpacked; it is in memory as a whole
    document: int = 2**24  # bytes of a text that is parsed as a whole
    yaml: int = 2**20  # bytes of YAML, whose parser takes a second for 100 kB
    message: int = 2**24  # bytes of a log's message
    numbers: int = 2**25  # of a log, in all its tracks
    tracks: int = 10_000  # of a log
    records: int = 2**23  # of a small log
    record_bytes: int = 64  # of a larger log, for each record; skipping one takes a microsecond
    message_numbers: int = 16  # that a message counts for at least, since it takes as long to read
    query_steps: int = 500_000_000  # of SQLite's virtual machine, in all queries; about 5 s


@dataclass(frozen=True)
class Plausible:
    """Numbers that a real recording has."""

    extent: float = 20.0  # m between two keypoints of one body, at most; pixels and millimetres exceed it
    angle: float = 50.0  # rad, eight revolutions of a joint, at most; degrees exceed it
    length_ratio: float = 3.0  # observed over given link length, or its inverse, at most, for an uncertain length
    # the same for an exact one: a picture only shortens, markers and lenses change a fifth
    known_length_ratio: float = 1.5
    body_length_error: float = 0.2  # of a body whose lengths are fractions of its own, at most
    # rad, median difference of angles from the keypoints' directions, at least, in a wrong unit
    wrong_angle: float = 0.5
    right_angle: float = 0.15  # the same in the right unit, at most
    interval: float = 1e-5  # s between rows, at least: a tenth of a fast camera's or a motor controller's
    typical_interval: float = 0.02  # s, between a film's 1/30 and a robot's log: which unit of time to suggest
    froude: float = 20.0  # v²/(g L), at most: four revolutions a second of a link of .3 m
    speed_baseline: float = 0.1  # √(L/g), over which a speed is taken
    # median relative error of distances, at most, if names of keypoints are right; noise and markers next to their
    # joints rarely reach it
    misfit: float = 0.15
    misfit_left: float = 0.3  # of the misfit, at most, after exchanging two names that were exchanged
    repeats: int = 3  # rows with the same position to the last digit, at least, for a warning
    # times the longest step of a track that a number which stands for missing is off, but for 0, at least
    farther: float = 3.0
    finer: float = 5.0  # times a track's resolution that its noise is, at least, if no position repeats by chance
    least_noise: float = 1e-4  # of a track's range, under which a track is simulated, or drawn, without noise
    positions: int = 10  # rows with a position, at least, for their longest step to be meaningful
    low_likelihood: float = 0.5  # of a keypoint's median
    stamp_difference: float = 0.05  # frame intervals between two cameras' stamps of one moment, at most
    pixel_extent: float = 20.0  # px, at least, of tracks in pixels; smaller ones are taken to be in metres
    reprojection: float = 0.01  # median reprojection error over the body's extent in a picture, usually at most
    reprojection_of_trackers: float = 0.1  # the same, at most, of any tracker
    reprojection_left: float = 0.5  # of the error, at most, after exchanging two cameras that were exchanged
    # median intervals from a log's time stamp of 0 to the next one, at most, if 0 is a time
    first_interval: float = 10.0


LIMITS = Limits()
PLAUSIBLE = Plausible()
