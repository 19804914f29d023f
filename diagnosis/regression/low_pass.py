"""The filter of a regression: frequencies in which a motion tells of torques.

An encoder's noise, and the roughness of its scale, enter q̈ as the square of frequency. What is missing and all columns
pass the same low-pass filter, without delay (parallel filtering: Gautier, Janot & Vandanjon 2013); it is a few times as
wide as the motion's velocity.

Shapes: R rows, K joints. Units: Hz, s.
"""

import numpy as np

from invdyn.diagnosis.regression.measured_motion import MeasuredMotion
from invdyn.diagnosis.rules import FIXED


def cutoff_of(motion: MeasuredMotion) -> float:
    """Hz up to which a motion tells of torques: a few times the frequency under which its velocity has most power."""
    longest = motion.stretch == np.bincount(motion.stretch).argmax()
    step = float(np.median(np.diff(motion.time)))
    window = np.hanning(longest.sum())[:, None]
    power = np.abs(np.fft.rfft(motion.qd[longest] * window, axis=0)) ** 2
    moving = power[:, power.sum(0) > 0]  # a joint at rest there has no frequency
    share = moving.cumsum(0) / moving.sum(0)
    frequency = np.fft.rfftfreq(int(longest.sum()), step)
    moves = [frequency[np.searchsorted(column, FIXED.velocity_power)] for column in share.T]
    return float(min(max(FIXED.cutoff_factor * max(moves, default=0.0), FIXED.min_cutoff), 0.4 / step))


def low_passed(values: np.ndarray, motion: MeasuredMotion, cutoff: float) -> np.ndarray:
    """Values (…, R, K) of a motion's rows through a Butterworth filter of order 4, forwards and backwards."""
    from scipy.signal import butter, sosfiltfilt  # half a second to import, which most runs do not need

    edges = np.flatnonzero(np.diff(motion.stretch)) + 1
    found = []
    for time, each in zip(np.split(motion.time, edges), np.split(values, edges, axis=-2), strict=True):
        rate = 1 / float(np.median(np.diff(time)))  # recordings may have rates of their own
        sections = butter(4, min(cutoff, 0.45 * rate), fs=rate, output="sos")
        found.append(sosfiltfilt(sections, each, axis=-2, padlen=min(27, len(time) - 1)))
    return np.concatenate(found, -2)
