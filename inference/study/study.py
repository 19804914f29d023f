"""A study: many trials inferred together, session by session, with tables of what they say.

Trials are fitted alone, sessions share the parameters of trials that fit (:mod:`.work`), estimates of trials are
pooled over sessions and subjects (:mod:`.pooling`). All of it is done in parts, which workers share and a checkpoint
keeps, with the same bits for any number of workers and however often it was interrupted.
"""

import hashlib
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import torch

from invdyn.inference.execution.checkpoint import Checkpoint, digest
from invdyn.inference.execution.distribute import Tensors, distribute, inside
from invdyn.inference.execution.progress import Progress, stage
from invdyn.inference.execution.seeds import derived
from invdyn.inference.methods.registry import METHODS
from invdyn.inference.study.averages import average_curves
from invdyn.inference.study.pooling import MIN_TRIALS, Pooled, pool
from invdyn.inference.study.quantities import STATISTICS
from invdyn.inference.study.trial import How, Trial
from invdyn.inference.study.work import fit_trial, infer_trial, parameters_of, said, share_session
from invdyn.recordings import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CONDITION = "condition"
INTERVAL = (0.05, 0.95)
FOUND = 0.975
"""Probability of a direction from which on a difference is said to be found: its 95 % interval leaves zero out."""


@dataclass(frozen=True)
class Study:
    """Trials with their posteriors.

    Attributes:
        trials: all that were given.
        how: they were inferred.
        fits: of each trial alone.
        sessions: of each group that shares parameters: the places of its trials, and what they share.
        posteriors: by place, of the trials that are not left out.
        left_out: by place, why.
    """

    trials: tuple[Trial, ...]
    how: How
    fits: tuple[Tensors, ...]
    sessions: tuple[tuple[tuple[int, ...], Tensors], ...]
    posteriors: dict[int, Tensors]
    left_out: dict[int, str]

    @cached_property
    def table(self) -> pd.DataFrame:
        """One row a trial, joint and quantity: labels, joint, quantity, unit, mean, sd, q05, median, q95."""
        rows = []
        for place, part in self.posteriors.items():
            known, numbers = said(part), part["statistics"].numpy()
            for q, (quantity, unit) in enumerate(known["quantities"].items()):
                for k, joint in enumerate(known["joints"]):
                    own = unit if known["turns"][k] else unit.replace("N·m", "N")
                    what = {"joint": joint, "quantity": quantity, "unit": own}
                    rows.append(
                        {**self.trials[place].labels, **what, **dict(zip(STATISTICS, numbers[q, k], strict=True))}
                    )
        return pd.DataFrame(rows)

    @property
    def reasons(self) -> pd.DataFrame:
        """Trials that are left out, each with its reason."""
        rows = [{**self.trials[place].labels, "reason": reason} for place, reason in sorted(self.left_out.items())]
        return pd.DataFrame(rows, columns=None if rows else ["trial", "subject", "session", "reason"])

    @property
    def parameters(self) -> pd.DataFrame:
        """What each session shares: one row a parameter and entry, with the number of its trials and notes."""
        rows = []
        for members, part in self.sessions:
            first = self.trials[members[0]]
            where = {"subject": first.subject, "session": first.session, "trials": len(members)}
            for name, value in parameters_of(part).items():
                entries = enumerate(value.flatten().tolist())
                rows += [{**where, "parameter": name, "entry": k, "value": each} for k, each in entries]
        return pd.DataFrame(rows)

    def summary(self, factor: str = CONDITION) -> pd.DataFrame:
        """The average of each joint, quantity and level of a factor, over subjects: mean, q05, q95, and counts.

        Raises InputError for a factor that the trials do not have.
        """
        rows = []
        for what, pooled, counts in self._pooled(factor):
            for level in pooled.levels:
                average = pooled.average(level)
                ends = {"q05": average.quantile(INTERVAL[0]), "q95": average.quantile(INTERVAL[1])}
                rows.append({**what, factor: level, "mean": average.mean, **ends, "trials": counts[level]})
        return pd.DataFrame(rows)

    def difference(self, factor: str = CONDITION) -> pd.DataFrame:
        """Differences between levels of a factor, of each joint and quantity: mean of second − first, with interval.

        ``direction`` is the probability of the difference's sign; ``found`` says whether it is `FOUND` or more. With
        several subjects the difference is that of their population, else that of the one subject. Raises InputError
        for a factor that the trials do not have, or that has one level.
        """
        rows = []
        for what, pooled, counts in self._pooled(factor):
            for first, second in combinations(pooled.levels, 2):
                own = pooled.difference(first, second)
                numbers = {"mean": own.mean, "q05": own.quantile(INTERVAL[0]), "q95": own.quantile(INTERVAL[1])}
                found = {"direction": own.direction, "found": own.direction >= FOUND}
                sizes = {"trials": counts[first] + counts[second]}
                rows.append({**what, "first": first, "second": second, **numbers, **found, **sizes})
        if not rows:
            raise InputError(f"expected two levels of {factor!r} or more to compare, got one")
        return pd.DataFrame(rows)

    def averages(self, align: str, factor: str = CONDITION) -> pd.DataFrame:
        """Torques averaged over trials, aligned at an event: one row a time, joint and level; see :mod:`.averages`.

        Raises InputError for an event or a factor that the trials do not have.
        """
        self._check(factor)
        known = sorted({name for trial in self.trials for name in trial.events})
        if align not in known:
            raise InputError(f"expected an event among {', '.join(known) or 'none'}, got {align!r}")
        return average_curves(self.trials, self.posteriors, align, factor)

    def plot(self, align: str, factor: str = CONDITION) -> "Figure":
        """The averages as a figure, one panel a joint. Raises as :meth:`averages`."""
        from invdyn.inference.study.figure import plot_averages

        return plot_averages(self.averages(align, factor), align, factor)

    def save(self, folder: str | Path) -> list[Path]:
        """Write tables, posteriors, averages and figures into a folder (:mod:`.store`); returns the files."""
        from invdyn.inference.study.store import save_study

        return save_study(self, Path(folder))

    def _check(self, factor: str) -> None:
        known = sorted({name for trial in self.trials for name in trial.factors})
        if factor not in known:
            raise InputError(f"expected a factor among {', '.join(known) or 'none'}, got {factor!r}")

    def _pooled(self, factor: str) -> list[tuple[dict[str, str], Pooled, Counter]]:
        """Of each joint and quantity that two trials have: what it is, its posterior, and trials by level."""
        self._check(factor)
        if factor not in self._pools:
            found = []
            groups = self.table.groupby(["joint", "quantity", "unit"], sort=False) if len(self.table) else ()
            for what, rows in groups:
                rows = rows[np.isfinite(rows["mean"]) & (rows[factor] != "")]
                if len(rows) < MIN_TRIALS:
                    continue
                labels = [rows[name].tolist() for name in (factor, "subject", "session")]
                pooled = pool(rows["mean"].to_numpy(), rows["sd"].to_numpy(), *labels)
                named = dict(zip(("joint", "quantity", "unit"), what, strict=True))
                found.append((named, pooled, Counter(labels[0])))
            self._pools[factor] = found
        return self._pools[factor]

    @cached_property
    def _pools(self) -> dict[str, list[tuple[dict[str, str], Pooled, Counter]]]:
        return {}


def run_study(
    trials: Sequence[Trial],
    how: How | None = None,
    *,
    executor: Executor | None = None,
    checkpoint: str | Path | None = None,
    progress: Progress | None = None,
) -> Study:
    """Infer all trials, sharing within sessions.

    Args:
        trials: with names that differ.
        how: method, sizes, seed.
        executor: whose workers share trials and sessions; the result is the same to the bit.
        checkpoint: folder that keeps what is done; the same call goes on from there.
        progress: called with (trials or sessions done, all, what).

    Raises InputError for no trials, two of one name, an unknown method, or a checkpoint of another study; LostWork.
    """
    how = how or How()
    if how.method not in METHODS:
        raise InputError(f"expected a method among {', '.join(METHODS)}, got {how.method!r}")
    if not trials:
        raise InputError("expected one trial or more, got none")
    if twice := [name for name, count in Counter(trial.name for trial in trials).items() if count > 1]:
        raise InputError(f"expected trials with names of their own, got two called {twice[0]!r}")
    how.sizes.check()
    kept = None if checkpoint is None else Checkpoint(checkpoint, _fingerprint(trials, how))
    left_out = {place: trial.unread for place, trial in enumerate(trials) if trial.unread}

    def run(part: Any, places: Sequence[int], arguments: list[tuple], what: str) -> list[Tensors]:
        names = [f"{what} of {trials[place].name}" for place in places]
        where = {"executor": executor, "checkpoint": inside(kept, what)}
        return distribute(part, arguments, names, **where, progress=stage(progress, what))

    read = [place for place in range(len(trials)) if place not in left_out]
    alone = run(fit_trial, read, [(trials[place], how) for place in read], "fit")
    fits = dict(zip(read, alone, strict=True))
    left_out |= _reasons(fits)

    groups = _groups(trials, {place: fit for place, fit in fits.items() if place not in left_out})
    work = [([trials[i] for i in members], [fits[i] for i in members], how) for members in groups]
    shared = run(share_session, [members[0] for members in groups], work, "session")
    sessions = tuple(zip(groups, shared, strict=True))
    for members, part in sessions:
        if reason := said(part).get("left_out"):
            left_out |= dict.fromkeys(members, f"its session's parameters could not be fitted: {reason}")

    of = {place: part for members, part in sessions for place in members if place not in left_out}
    order = sorted(of)
    work = [(trials[i], how, fits[i], of[i], derived(how.seed, i)) for i in order]
    posteriors = dict(zip(order, run(infer_trial, order, work, "posterior"), strict=True))
    left_out |= _reasons(posteriors)
    used = tuple(each for each in sessions if "left_out" not in said(each[1]))
    whole = {place: part for place, part in posteriors.items() if place not in left_out}
    return Study(tuple(trials), how, tuple(fits.get(i, {}) for i in range(len(trials))), used, whole, left_out)


def _reasons(parts: dict[int, Tensors]) -> dict[int, str]:
    return {place: reason for place, part in parts.items() if (reason := said(part).get("left_out"))}


def _groups(trials: Sequence[Trial], fits: dict[int, Tensors]) -> list[tuple[int, ...]]:
    """Places of trials that share: of one session, with one body and the same parameters to fit."""
    groups: dict[Any, list[int]] = {}
    for place, fit in fits.items():
        form = tuple((name, tuple(value.shape)) for name, value in parameters_of(fit).items())
        trial = trials[place]
        groups.setdefault((trial.subject, trial.session, repr(trial.body), form), []).append(place)
    return [tuple(members) for members in groups.values()]


def _fingerprint(trials: Sequence[Trial], how: How) -> dict[str, Any]:
    """All that the numbers depend on."""
    tensors = []
    for recording in (trial.recording for trial in trials if trial.recording is not None):
        views = getattr(recording, "views", None)
        data = [recording.time, recording.keypoints, recording.angles, recording.torques, recording.confidence]
        data += [] if views is None else [views.pixels]
        tensors += [torch.as_tensor(each) for each in data if each is not None]
    bodies = hashlib.sha256("\n".join(repr(trial.body) for trial in trials).encode()).hexdigest()[:16]
    labels = [[*trial.labels.values(), *map(str, trial.events.items())] for trial in trials]
    return {
        "version": version("invdyn"),
        "recordings": digest(*tensors),
        "bodies": bodies,
        "trials": hashlib.sha256(repr(labels).encode()).hexdigest()[:16],
        "how": repr(how),
    }
