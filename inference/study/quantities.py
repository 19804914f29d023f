"""Numbers of one trial, of each drawn path by itself: functionals, onset, and values at events.

    onset       last time before the peak at which τ has the peak's sign and less than a tenth of its size, or the
                other sign; NaN where the trial begins above that                                             s
    at <event>  τ at the event's time, linear between rows; NaN outside of the recording                      N·m

The others are those of :mod:`.functionals`: peak, peak_time, impulse, peak_rate, work, mean_power. Times count from the
trial's first row, as recordings begin at other times of their clocks. A quantity that more
than half of the draws do not have is missing (NaN); else it is stated of the draws that have it. A peak whose sign
differs between draws has two places, and its mean is neither: peak, its time, rate and onset are stated of the draws
with the more frequent sign. Where this has a share of less than `ONE_SIGN` they are missing, too. It is
not larger, as small peaks are those that would be left out, which raises the average of the others.

Shapes: S draws, T rows, K joints, Q quantities.
"""

from collections.abc import Mapping

import arviz as az
import numpy as np

from invdyn.inference.posterior.functionals import functionals
from invdyn.inference.posterior.problem import DRAWS

STARTED, ONE_SIGN = 0.1, 0.75  # of a peak; of the draws
OF_PEAK = ("peak", "peak_time", "peak_rate", "onset")
STATISTICS = ("mean", "sd", "q05", "median", "q95")
"""Of draws, in the order of the last dimension of :func:`statistics`."""


def quantities(idata: az.InferenceData, events: Mapping[str, float]) -> dict[str, tuple[np.ndarray, str]]:
    """By name: values (S, K) of each draw, and the unit. Raises InputError as :func:`.functionals` does."""
    found = functionals(idata)
    values = {
        str(name): (each.transpose(*DRAWS, "joint").values.reshape(-1, each.sizes["joint"]), each.attrs["units"])
        for name, each in found.items()
    }
    time = idata["posterior"]["time"].values
    torque = idata["posterior"]["torque"].transpose(*DRAWS, "time", "joint").values
    torque, unit = torque.reshape(-1, *torque.shape[2:]), values["peak"][1]
    values["peak_time"] = (values["peak_time"][0] - time[0], "s")
    values["onset"] = (onset(time, torque) - time[0], "s")
    for event, when in events.items():
        values[f"at {event}"] = (at_times(time, torque, np.array([when]))[:, 0], unit)
    return values


def onset(time: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """Onset (S, K) of torques (S, T, K) at times (T,); see the top of the file."""
    row = np.abs(torque).argmax(-2, keepdims=True)
    peak = np.take_along_axis(torque, row, -2)
    rows = np.arange(len(time))[:, None]
    below = (torque * np.sign(peak) < STARTED * np.abs(peak)) & (rows < row)
    last = np.where(below, rows, -1).max(-2)
    return np.where(last >= 0, time[last], np.nan)


def at_times(time: np.ndarray, values: np.ndarray, when: np.ndarray) -> np.ndarray:
    """Values (S, N, K) at N times, linear between rows of (S, T, K); NaN outside of them."""
    inside = (when >= time[0]) & (when <= time[-1])
    place = np.interp(np.where(inside, when, time[0]), time, np.arange(len(time)))
    low = np.minimum(place.astype(int), len(time) - 2)
    share = (place - low)[:, None]
    found = values[:, low] * (1 - share) + values[:, low + 1] * share
    return np.where(inside[:, None], found, np.nan)


def statistics(values: Mapping[str, tuple[np.ndarray, str]]) -> np.ndarray:
    """(Q, K, 5) of :data:`STATISTICS` over draws; NaN where a quantity is missing, see the top of the file."""
    peak = values["peak"][0]
    positive = (peak > 0).mean(0)
    usual = (peak > 0) == (positive > 0.5)
    rows = []
    for name, (drawn, _) in values.items():
        of_peak = name in OF_PEAK
        there = np.isfinite(drawn) & (usual if of_peak else True)
        missing = (there.mean(0) < 0.5) | (of_peak & (usual.mean(0) < ONE_SIGN))
        own = np.where(missing, 0.0, np.where(there, drawn, np.nan))
        numbers = [np.nanmean(own, 0), np.nanstd(own, 0), *np.nanquantile(own, (0.05, 0.5, 0.95), axis=0)]
        rows.append(np.where(missing[:, None], np.nan, np.stack(numbers, -1)))
    return np.stack(rows)
