"""Numbers of a whole torque path, with intervals: peak, time of peak, impulse, largest rate, work, mean power.

A functional of each joint is computed of every drawn path by itself, and its interval is that of those numbers. What is
read off a band instead is off: at each row the band holds the torque, but the largest of its medians is no median of
the largest torque.

    peak        τ(t*), with its sign, t* = argmax_t |τ(t)|             N·m
    peak_time   t*                                                     s
    impulse     ∫ τ dt                                                 N·m·s
    peak_rate   (τ_t − τ_{t−1}) / δ_t where it is largest, with sign   N·m/s
    work        ∫ τ θ̇ dt                                               J
    mean_power  the same, over the recording's time                    W

All are of the torque at the recording's rows, whose integrals are trapezoids. This is their estimand. A rough torque
peaks higher between rows, and its rate grows without bound as rows come closer: those of another frame rate are others.

Shapes: paths (..., T, K) of T rows and K joints, functionals (..., K).
"""

import arviz as az
import numpy as np
import pandas as pd
import xarray as xr

from invdyn.inference.posterior.problem import DRAWS
from invdyn.recordings import InputError

INTERVAL = (0.05, 0.5, 0.95)
"""Quantiles of the table: median and ends of the 90 % interval."""
Z90 = 1.6448536269514722
"""Half a central 90 % interval of a Gaussian, in standard deviations."""
MIN_TIMES = 2
"""Rows that a rate and an integral need."""


def path_functionals(time: np.ndarray, torque: np.ndarray, velocity: np.ndarray) -> dict[str, np.ndarray]:
    """Functionals (..., K) of torques and velocities (..., T, K) at times (T,); see the top of the file."""

    def largest(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rows (..., 1, K) and values (..., K) that are farthest from zero."""
        row = np.abs(values).argmax(-2, keepdims=True)
        return row, np.take_along_axis(values, row, -2).squeeze(-2)

    row, peak = largest(torque)
    _, rate = largest(np.diff(torque, axis=-2) / np.diff(time)[:, None])
    work = np.trapezoid(torque * velocity, time, axis=-2)
    return {
        "peak": peak,
        "peak_time": time[row.squeeze(-2)],
        "impulse": np.trapezoid(torque, time, axis=-2),
        "peak_rate": rate,
        "work": work,
        "mean_power": work / (time[-1] - time[0]),
    }


def functionals(idata: az.InferenceData) -> xr.Dataset:
    """Functionals [chain, draw, joint] of each drawn path, with units of joints that turn.

    Raises InputError for a kinematic posterior, which has no torques, and for fewer than two rows.
    """
    posterior = idata["posterior"]
    if "torque" not in posterior:
        raise InputError("a kinematic posterior has no torques, and so no peaks, impulses or work of them")
    order = (*DRAWS, "time", "joint")
    chains = zip(*(posterior[name].transpose(*order).values for name in PATHS), strict=True)
    found = [path_functionals(_time(posterior), *chain) for chain in chains]  # of all at once copies would take GB
    values = {name: np.stack([each[name] for each in found]) for name in found[0]}
    unit = str(posterior["torque"].attrs["units"])
    energy = "J" if unit == "N·m" else unit
    units = {"peak": unit, "peak_time": "s", "impulse": f"{unit}·s", "peak_rate": f"{unit}/s"}
    units |= {"work": energy, "mean_power": "W" if energy == "J" else f"{energy}/s"}
    dims = [*DRAWS, "joint"]
    data = {name: (dims, number, {"units": units[name]}) for name, number in values.items()}
    return xr.Dataset(data, coords={name: posterior[name] for name in dims})


def functional_table(idata: az.InferenceData) -> pd.DataFrame:
    """One row a joint and functional: joint, functional, unit, median, q05, q95, and truth where it is known.

    The truth is that of the same rows, NaN where it misses one of them. Raises as :func:`functionals` does.
    """
    drawn = functionals(idata)
    joints = [str(name) for name in drawn["joint"].values]
    true = _true(idata)
    turns = idata["constant_data"].get("turns", xr.DataArray(np.ones(len(joints)))).values
    rows = []
    for k, joint in enumerate(joints):
        for name, values in drawn.items():
            low, median, high = np.quantile(values.isel(joint=k).values, INTERVAL)
            known = {} if true is None else {"truth": true[str(name)][k]}
            quantiles = {"median": median, "q05": low, "q95": high}
            unit = unit_at(values.attrs["units"], turns[k])
            rows.append({"joint": joint, "functional": name, "unit": unit, **quantiles, **known})
    return pd.DataFrame(rows)


PATHS = ("torque", "velocity")


def _true(idata: az.InferenceData) -> dict[str, np.ndarray] | None:
    constants = idata["constant_data"]
    names = [f"truth_{name}" for name in PATHS]
    if not set(names) <= set(constants):
        return None
    torque, velocity = (constants[name].transpose("time", "joint").values for name in names)
    whole = np.isfinite(torque).all(0)
    # A peak of what is not known is none: zeros keep argmax in order, and are not reported.
    found = path_functionals(_time(idata["posterior"]), np.where(whole, torque, 0.0), velocity)
    return {name: np.where(whole, values, np.nan) for name, values in found.items()}


def _time(posterior: xr.Dataset) -> np.ndarray:
    time = posterior["time"].values
    if len(time) < MIN_TIMES:
        raise InputError(f"expected {MIN_TIMES} rows or more for rates and integrals of torques, got {len(time)}")
    return time


def unit_at(unit: str, turns: bool) -> str:
    """The unit of a quantity of torques at a joint: one that shifts has a force."""
    return unit if turns else unit.replace("N·m", "N")
