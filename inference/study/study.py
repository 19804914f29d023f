"""A study: trials with their posteriors, and tables of what they say.

Estimates of trials are pooled over sessions and subjects (:mod:`.pooling`); torques are averaged at events
(:mod:`.averages`).
"""

from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from invdyn.inference.posterior.functionals import Z90, unit_at
from invdyn.inference.study.averages import average_curves
from invdyn.inference.study.pooling import MIN_TRIALS, Pooled, pool
from invdyn.inference.study.quantities import STATISTICS
from invdyn.inference.study.trial import How, Trial
from invdyn.inference.study.work import NOT_SETTLED, Part
from invdyn.recordings import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CONDITION = "condition"
FOUND = 0.975
"""Probability of a direction from which on a difference is said to be found: its 95 % interval leaves zero out."""


def estimates(rows: pd.DataFrame) -> tuple[np.ndarray, np.ndarray]:
    """Medians and errors (n,) of rows of trials: half a 90 % interval over that of the standard normal.

    A mean and a sd would be those of a few draws far off.
    """
    return rows["median"].to_numpy(), (rows["q95"] - rows["q05"]).to_numpy() / (2 * Z90)


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
    fits: tuple[Part, ...]
    sessions: tuple[tuple[tuple[int, ...], Part], ...]
    posteriors: dict[int, Part]
    left_out: dict[int, str]

    @cached_property
    def table(self) -> pd.DataFrame:
        """One row a trial, joint and quantity: labels, joint, quantity, unit, mean, sd, q05, median, q95."""
        rows = []
        for place, part in self.posteriors.items():
            numbers = part["statistics"].numpy()
            for q, (quantity, unit) in enumerate(part["quantities"].items()):
                for k, joint in enumerate(part["joints"]):
                    what = {"joint": joint, "quantity": quantity, "unit": unit_at(unit, part["turns"][k])}
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
    def doubts(self) -> pd.DataFrame:
        """Trials that count and may be wrong, each with why: a turn over a gap, say, or what its session shares."""
        rows = []
        for members, part in self.sessions:
            for place in members:
                own = self.fits[place]["notes"] if place in self.posteriors else []
                if len(members) > 1:  # what the session shares takes the place of what it found alone
                    own = [each for each in own if each != NOT_SETTLED]
                shared = part["notes"] if place in self.posteriors else []
                last = self.posteriors[place]["notes"] if place in self.posteriors else []
                rows += [(place, doubt) for doubt in (*own, *shared, *last)]
        labelled = [{**self.trials[place].labels, "doubt": doubt} for place, doubt in sorted(rows, key=itemgetter(0))]
        return pd.DataFrame(labelled, columns=None if rows else ["trial", "subject", "session", "doubt"])

    @property
    def parameters(self) -> pd.DataFrame:
        """What each session shares: one row a parameter and entry, with the number of its trials."""
        rows = []
        for members, part in self.sessions:
            first = self.trials[members[0]]
            where = {"subject": first.subject, "session": first.session, "trials": len(members)}
            for name, value in sorted(part["values"].items()):
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
                rows.append({**what, factor: level, **pooled.average(level).summary, "trials": counts[level]})
        return pd.DataFrame(rows)

    def difference(self, factor: str = CONDITION) -> pd.DataFrame:
        """Differences between levels of a factor, of each joint and quantity: mean of second − first, with interval.

        ``direction`` is the probability of the difference's sign; ``found`` says whether it is `FOUND` or more. With
        several subjects the difference is that of their population, else that of the one subject. ``confounded`` is
        "subject" or "session" where each level has one of its own: the difference may be theirs. Raises InputError for
        a factor that the trials do not have, or that has one level.
        """
        rows = []
        for what, pooled, counts in self._pooled(factor):
            for first, second in combinations(pooled.levels, 2):
                own = pooled.difference(first, second)
                found = {"direction": own.direction, "found": own.direction >= FOUND}
                sizes = {"trials": counts[first] + counts[second], "confounded": pooled.confounded}
                rows.append({**what, "first": first, "second": second, **own.summary, **found, **sizes})
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

    def save(self, folder: str | Path, *, nwb: bool = False) -> list[Path]:
        """Write tables, posteriors, averages and figures into a folder (:mod:`.store`); returns the files.

        ``nwb`` adds a file of NWB for each session, and needs the extra `tracks`.
        """
        from invdyn.inference.study.store import save_study

        return save_study(self, Path(folder), nwb)

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
                rows = rows[np.isfinite(rows["mean"]) & (rows[factor].fillna("") != "")]
                if len(rows) < MIN_TRIALS:
                    continue
                labels = [rows[name].tolist() for name in (factor, "subject", "session")]
                pooled = pool(*estimates(rows), *labels)
                named = dict(zip(("joint", "quantity", "unit"), what, strict=True))
                found.append((named, pooled, Counter(labels[0])))
            self._pools[factor] = found
        return self._pools[factor]

    @cached_property
    def _pools(self) -> dict[str, list[tuple[dict[str, str], Pooled, Counter]]]:
        return {}
