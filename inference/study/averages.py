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

from invdyn.inference.posterior.functionals import unit_at
from invdyn.inference.study.pooling import MIN_TRIALS, pool
from invdyn.inference.study.quantities import at_times
from invdyn.inference.study.trial import Trial
from invdyn.inference.study.work import Part
from invdyn.recordings import InputError

TIMES = 41  # of a curve


def average_curves(trials: Sequence[Trial], posteriors: Mapping[int, Part], align: str, factor: str) -> pd.DataFrame:
    """One row a joint, level and time: mean, q05, q95, of a further trial trial_q05 and trial_q95, unit, trials.

    Raises InputError where fewer than two trials have the event within them, or a joint in common.
    """
    about = {
        place: part["time"].numpy()[[0, -1]] - trials[place].events.get(align, np.nan)
        for place, part in posteriors.items()
        if trials[place].factors.get(factor)
    }
    own = [place for place, (first, last) in about.items() if first <= 0 <= last]  # of NaN neither
    if len(own) < MIN_TRIALS:
        raise InputError(f"expected {MIN_TRIALS} trials or more with event {align!r} within them, got {len(own)}")
    levels = np.array([trials[place].factors[factor] for place in own])
    ends = np.array([about[place] for place in own])
    begin = max(np.median(ends[levels == level, 0]) for level in np.unique(levels))
    end = min(np.median(ends[levels == level, 1]) for level in np.unique(levels))
    times = np.unique(np.linspace(begin, end, TIMES))  # one where all begin or end at the event
    subjects, sessions = (np.array([getattr(trials[i], each) for i in own]) for each in ("subject", "session"))
    curves = [_aligned(posteriors[place], times + trials[place].events[align]) for place in own]
    rows = []
    for joint in dict.fromkeys(joint for each in curves for joint in each):
        # A trial whose body lacks the joint is not there.
        mean, spread = np.stack([each.get(joint, np.full((2, len(times)), np.nan)) for each in curves], axis=1)
        known = next(posteriors[place] for place, each in zip(own, curves, strict=True) if joint in each)
        unit = unit_at(known["units"]["torque"], known["turns"][known["joints"].index(joint)])
        for n, time in enumerate(times):
            there = np.isfinite(mean[:, n])
            if there.sum() < MIN_TRIALS:
                continue
            labels = levels[there], subjects[there], sessions[there]
            pooled = pool(mean[there, n], spread[there, n], *labels)
            for level in pooled.levels:
                further = pooled.new_trial(level).summary
                numbers = pooled.average(level).summary | {f"trial_{end}": further[end] for end in ("q05", "q95")}
                what = {"joint": joint, factor: level, "time": time}
                rows.append({**what, **numbers, "unit": unit, "trials": int((levels[there] == level).sum())})
    if not rows:
        raise InputError(f"expected a joint that {MIN_TRIALS} trials or more with event {align!r} have, got none")
    return pd.DataFrame(rows)


def _aligned(part: Part, times: np.ndarray) -> dict[str, np.ndarray]:
    """Mean and sd (2, N) of each joint at times on the trial's clock."""
    both = np.stack([part[name].numpy() for name in ("mean", "spread")])
    found = at_times(part["time"].numpy(), both, times)
    return {joint: found[:, :, k] for k, joint in enumerate(part["joints"])}
