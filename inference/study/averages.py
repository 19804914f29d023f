"""Torques of many trials on one clock, aligned at an event, averaged with the doubt within and between trials.

At each time t after the event, each trial has a mean and a posterior sd of its torque, linear between its rows. These
are pooled as any other estimate (:mod:`.pooling`): over sessions and subjects, with the sd between trials. So the
band of the average holds both, what each trial leaves open and how trials, sessions and subjects differ. A second band
says where the true torque of a further trial lies.

Times are `TIMES` of the range that at least half of the trials of each level cover.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from invdyn.inference.execution.distribute import Tensors
from invdyn.inference.study.pooling import MIN_TRIALS, pool
from invdyn.inference.study.quantities import at_times
from invdyn.inference.study.trial import Trial
from invdyn.inference.study.work import said
from invdyn.recordings import InputError

TIMES, SETS = 41, 256
INTERVAL = (0.05, 0.95)


def average_curves(trials: Sequence[Trial], posteriors: Mapping[int, Tensors], align: str, factor: str) -> pd.DataFrame:
    """One row a joint, level and time: mean, q05, q95, of a further trial trial_q05 and trial_q95, unit, trials.

    Raises InputError where fewer than two trials have the event within them.
    """
    own = [
        place
        for place, part in posteriors.items()
        if _covers(part, trials[place].events.get(align, np.nan)) and trials[place].factors.get(factor)
    ]
    if len(own) < MIN_TRIALS:
        raise InputError(f"expected {MIN_TRIALS} trials or more with event {align!r} within them, got {len(own)}")
    levels = np.array([trials[place].factors[factor] for place in own])
    ends = np.array([_ends(posteriors[place]) - trials[place].events[align] for place in own])
    begin = max(np.median(ends[levels == level, 0]) for level in np.unique(levels))
    end = min(np.median(ends[levels == level, 1]) for level in np.unique(levels))
    times = np.linspace(begin, end, TIMES)
    mean, spread = (
        np.stack([_aligned(posteriors[place], name, times + trials[place].events[align]) for place in own])
        for name in ("mean", "spread")
    )
    known = said(posteriors[own[0]])
    rows = []
    for k, joint in enumerate(known["joints"]):
        unit = known["units"]["torque"]
        unit = unit if known["turns"][k] else unit.replace("N·m", "N")
        for n, time in enumerate(times):
            there = np.isfinite(mean[:, n, k])
            subject, session = (
                np.array([getattr(trials[i], each) for i in own])[there] for each in ("subject", "session")
            )
            if there.sum() < MIN_TRIALS:
                continue
            pooled = pool(mean[there, n, k], spread[there, n, k], levels[there], subject, session, SETS)
            for level in pooled.levels:
                average, further = pooled.average(level), pooled.new_trial(level)
                numbers = {"mean": average.mean, "q05": average.quantile(INTERVAL[0])}
                numbers |= {"q95": average.quantile(INTERVAL[1])}
                numbers |= {
                    f"trial_{end}": further.quantile(p) for end, p in zip(("q05", "q95"), INTERVAL, strict=True)
                }
                what = {"joint": joint, factor: level, "time": time}
                rows.append({**what, **numbers, "unit": unit, "trials": int((levels[there] == level).sum())})
    return pd.DataFrame(rows)


def _ends(part: Tensors) -> np.ndarray:
    return part["time"].numpy()[[0, -1]]


def _covers(part: Tensors, when: float) -> bool:
    first, last = _ends(part)
    return bool(first <= when <= last)  # of NaN neither


def _aligned(part: Tensors, name: str, times: np.ndarray) -> np.ndarray:
    """(N, K) at times on the trial's clock."""
    return at_times(part["time"].numpy(), part[name].numpy()[None], times)[0]
