"""Which effects a torque lacks, by evidence over statements such as "Coulomb friction at every joint".

A statement is an effect at one joint, at several, or at all, and has one sd s for all its places (a prior shared across
joints). With y what is missing, X the columns of a set of statements, and noise of each joint's own size σ_j,

    β ~ N(0, diag(s² u²)) =: N(0, Λ⁻¹),     A = Λ + Σ_j c_j/σ_j² X_jᵀ W_j X_j

    log p = −½ Σ_j c_j n_j (log σ_j² + RSS_j/(n_j σ_j²)) − ½ βᵀ Λ β − ½ log |A| + ½ log |Λ| + log P(set)

Errors of neighbouring rows are correlated: of n rows, c n count (c = 1/τ, τ the integrated autocorrelation time: Geyer
1992). σ is the most probable one, s the best of a few. P(set) is that of :mod:`..problem.prior`: P(n), P(effect), and
P(one | several | all). The set grows and shrinks by the step that gains most, until none gains.

No model of a real robot is right, and evidence takes what is left for chance. So a step counts only if it also predicts
better, by more than the standard error of that: in F folds of neighbouring rows, each predicted by a fit to the others
(Stone 1974; Racine 2000; the one-standard-error rule: Breiman, Friedman, Olshen & Stone 1984).

Gains of all motors and masses of all links have a factor in common, which no torque shows. No single place can leave
such a set, as the others keep the factor. So steps keep the n places whose values are farthest from the median, too.
One that leaves such effects out counts where its error is no larger by a standard error.

A friction, a rotor or a spring that would be less than nothing at some joint is left out there.

Shapes: K joints, P columns, F folds.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from math import lgamma, log

import numpy as np

from invdyn.diagnosis.problem.prior import of_number
from invdyn.diagnosis.rules import FIXED, Rules


@dataclass(frozen=True)
class Moments:
    """Of each joint XᵀWX (K, P, P), XᵀWy (K, P), yᵀWy (K,), rows that count c n (K,), and all rows n (K,).

    `folds` has the first three of each fold.
    """

    gram: np.ndarray
    cross: np.ndarray
    square: np.ndarray
    count: np.ndarray
    rows: np.ndarray
    folds: tuple[tuple[np.ndarray, np.ndarray, np.ndarray], ...] = ()


@dataclass(frozen=True)
class Statement:
    """An effect at places, each with its columns, and the prior's s."""

    kind: str
    columns: Mapping[str, tuple[int, ...]]
    size: float

    @property
    def every(self) -> list[int]:
        """All columns."""
        return [p for each in self.columns.values() for p in each]


@dataclass(frozen=True)
class Chosen:
    """Statements, their coefficients by column (p,), noise σ (K,), and log p.

    `gain` is that of each over a set without it; `unseen` (F,) the squared errors of folds that were not fitted, in all
    that is missing.
    """

    statements: tuple[Statement, ...] = ()
    columns: tuple[int, ...] = ()
    values: np.ndarray = field(default_factory=lambda: np.zeros(0))
    noise: np.ndarray = field(default_factory=lambda: np.zeros(0))
    score: float = -np.inf
    gain: tuple[float, ...] = ()
    unseen: np.ndarray = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True)
class Choice:
    """All that may be stated: for each kind its places and their columns; sizes and least values of columns (P,).

    `tolerated` (K,) N·m is what need not be explained: noise is that much at least. `within` names kinds whose columns
    are among those of another: a place has one of them. Effects of `common` kinds have a factor in common.
    Of some kinds so many shapes were `tried` at each place: the best one has the prior of one among them, and it is
    asked for where its special case is stated.
    """

    moments: Moments
    kinds: Mapping[str, Mapping[str, tuple[int, ...]]]
    size: np.ndarray
    least: np.ndarray
    tolerated: np.ndarray
    rules: Rules
    within: Mapping[str, str] = field(default_factory=dict)
    common: Collection[str] = ()
    tried: Mapping[str, int] = field(default_factory=dict)

    def chosen(self, usual: Sequence[str] = ()) -> Chosen:
        """The set of highest score that single steps lead to; effects of ``usual`` kinds are in it at all places."""
        best = self._fitted(tuple(Statement(kind, self.kinds[kind], 1.0) for kind in usual if kind in self.kinds))
        best = replace(best, unseen=self._unseen(best))
        while True:
            steps = self._odd_steps(best, usual) if usual else self._steps(best)
            tried = [self._fitted(step) for step in steps]
            least = best.score + self.rules.search.equal_gain
            better = sorted((each for each in tried if each.score > least), key=lambda each: -each.score)
            predicted = (replace(each, unseen=self._unseen(each)) for each in better)
            if (step := next((each for each in predicted if self._counts(best, each)), None)) is None:
                break
            best = step
        return best

    def plain(self, kinds: Sequence[str]) -> Chosen:
        """Effects of these ``kinds`` at all places, under next to no prior: as a least-squares fit has them."""
        every = tuple(Statement(kind, self.kinds[kind], FIXED.plain_size) for kind in kinds if kind in self.kinds)
        return self._fitted(every)

    def including(self, best: Chosen, columns: Sequence[int]) -> Chosen:
        """The set with the effects at the places that these ``columns`` are of, whether they gain or not."""
        places = {(kind, place) for kind, own in self.kinds.items() for place in own if {*own[place]} & {*columns}}
        statements = {statement.kind: statement for statement in best.statements}
        for kind, place in sorted(places):
            own = statements.get(kind, Statement(kind, {}, 1.0))
            statements[kind] = replace(own, columns={**own.columns, place: self.kinds[kind][place]})
        return self._fitted(tuple(statements.values())) if places else best

    def without_least(self, columns: Sequence[int]) -> "Choice":
        """The same, but that coefficients of some ``columns`` may be anything."""
        least = self.least.copy()
        least[list(columns)] = -np.inf
        return replace(self, least=least)

    def with_gains(self, best: Chosen) -> Chosen:
        """The set with what each of its statements gains."""
        without = [self._fitted(_less(best.statements, n)) for n in range(len(best.statements))]
        return replace(best, gain=tuple(float(best.score - each.score) for each in without))

    def rivals(self, best: Chosen) -> dict[tuple[str, str], tuple[str, ...]]:
        """By an effect and its place those that would explain as much in its stead, within a few nats.

        There alone, or at all places of its statement.
        """
        found: dict[tuple[str, str], list[str]] = {}
        least = best.score - self.rules.evidence.confirm_within
        for n, statement in enumerate(best.statements):
            for place, kind in product(statement.columns, self.kinds):
                others = self.kinds[kind]
                taken = next((s for s in best.statements if s.kind == kind), Statement(kind, {}, statement.size))
                if place not in others or place in taken.columns:
                    continue
                rest = [s for s in _less(best.statements, n) if s.kind != kind]
                alone, whole = {place: others[place]}, {p: others[p] for p in statement.columns if p in others}
                here = replace(taken, columns={**taken.columns, **alone})
                sets = [(*rest, _but(statement, {place}), here), (*rest, replace(taken, columns=whole))]
                tried = [self._fitted(tuple(s for s in some if s.columns)) for some in sets]
                there = [each for each in tried if any(s.kind == kind and place in s.columns for s in each.statements)]
                if max((each.score for each in there), default=-np.inf) > least:
                    found.setdefault((statement.kind, place), []).append(kind)
        return {key: tuple(kinds) for key, kinds in found.items()}

    def _steps(self, best: Chosen) -> Iterator[tuple[Statement, ...]]:
        """Sets that differ by one statement's presence, places or size."""
        now, value = best.statements, dict(zip(best.columns, best.values.tolist(), strict=True))
        taken = {statement.kind: n for n, statement in enumerate(now)}
        for n in range(len(now)):
            yield _less(now, n)
        for kind, every in self.kinds.items():
            special = next((s for s, wider in self.within.items() if wider == kind and kind in self.tried), kind)
            stated = {place for s in now if s.kind in (kind, special) for place in s.columns}
            places = every if special == kind else {place: own for place, own in every.items() if place in stated}
            rest = _less(now, taken[kind]) if kind in taken else tuple(now)
            own = now[taken[kind]] if kind in taken else None
            sets: list[tuple[str, ...]] = [tuple(places)] if len(places) > 1 else []
            if own is None:
                sets += [(place,) for place in places]
            else:
                mine = set(own.columns)
                sets += [tuple(p for p in places if (p in mine) != (p == other)) for other in places]
                sets += [tuple(own.columns), *_farthest(own, value)]
            for some, size in product(filter(None, dict.fromkeys(sets)), FIXED.regression_sizes):
                yield (*rest, Statement(kind, {place: places[place] for place in some}, size))

    def _odd_steps(self, best: Chosen, usual: Sequence[str]) -> Iterator[tuple[Statement, ...]]:
        """Sets with one effect more at one place, of one prior sd, or with another prior sd of those ``usual``."""
        for kind, every in self.kinds.items():
            mine = next((s.columns for s in best.statements if s.kind == kind), {})
            odd = [{**mine, place: own} for place, own in every.items() if place not in mine]
            sizes, sets = (FIXED.regression_sizes, [every]) if kind in usual else ([FIXED.odd_size], odd)
            for some, size in product(sets, sizes):
                yield (*(s for s in best.statements if s.kind != kind), Statement(kind, some, size))

    def _fitted(self, statements: tuple[Statement, ...]) -> Chosen:
        """Coefficients, noise and score of a set; places where a value is less than it may be are left out."""
        m = self.moments
        noise = np.sqrt(np.maximum(m.square / m.rows, 1e-300))
        of = {statement.kind: set(statement.columns) for statement in statements}
        statements = tuple(_but(s, of.get(self.within.get(s.kind, ""), set())) for s in statements)
        while True:
            columns = [p for statement in statements for p in statement.every]
            prior = np.array([1 / (s.size * self.size[p]) ** 2 for s in statements for p in s.every])
            own = np.array(columns, dtype=int)
            gram, cross = m.gram[:, own[:, None], own], m.cross[:, own]
            flat = gram.reshape(len(gram), len(own) ** 2)
            for _ in range(3):
                weight = m.count / m.rows / noise**2
                A = np.diag(prior) + (weight @ flat).reshape(len(own), len(own))
                unit = np.sqrt(np.diag(A))
                even = A / unit[:, None] / unit
                values = np.linalg.solve(even, weight @ cross / unit) / unit
                left = m.square - 2 * cross @ values + gram @ values @ values
                left = np.maximum(left, m.rows * np.maximum(self.tolerated**2, 1e-300))
                noise = np.sqrt(left / m.rows)
            low = {p for p, value in zip(columns, values, strict=True) if value < self.least[p]}
            if not low:
                break
            below = [{place for place, own in s.columns.items() if low & set(own)} for s in statements]
            statements = tuple(_but(s, places) for s, places in zip(statements, below, strict=True))
        statements = tuple(s for s in statements if s.columns)
        determinant = np.linalg.slogdet(even)[1] + 2 * np.log(unit).sum() - np.log(prior).sum()
        fit = -0.5 * float(m.count @ (np.log(noise**2) + 1.0)) - 0.5 * float(prior @ values**2) - 0.5 * determinant
        return Chosen(statements, tuple(columns), values, noise, fit + self._log_prior(statements))

    def _counts(self, before: Chosen, after: Chosen) -> bool:
        """Whether a step predicts better; of one that leaves out `common` effects, no worse by a standard error."""

        def others(of: Chosen) -> dict[str, set[str]]:
            return {s.kind: set(s.columns) for s in of.statements if s.kind not in self.common}

        several = len({*self.common} & {s.kind for s in before.statements}) > 1
        free = several and others(before) == others(after)
        if len(after.columns) >= len(before.columns) or not free:
            return lower(before.unseen, after.unseen)
        error = before.unseen.std(ddof=1) / np.sqrt(len(before.unseen))
        return bool(after.unseen.mean() <= before.unseen.mean() + error)

    def left_out(self, chosen: Chosen) -> np.ndarray:
        """(F, p) coefficients of fits without one fold each."""
        m, columns = self.moments, list(chosen.columns)
        prior = np.diag([1 / (s.size * self.size[p]) ** 2 for s in chosen.statements for p in s.every])
        weight, found = m.count / m.rows / chosen.noise**2, np.zeros((len(m.folds), len(columns)))
        for n, (gram, cross, _) in enumerate(m.folds if columns else ()):
            A = prior + np.einsum("k,kpq->pq", weight, (m.gram - gram)[:, columns][:, :, columns])
            unit = np.sqrt(np.diag(A))
            found[n] = np.linalg.solve(A / unit[:, None] / unit, weight @ (m.cross - cross)[:, columns] / unit) / unit
        return found

    def _unseen(self, chosen: Chosen) -> np.ndarray:
        """(F,) squared errors of each fold by a fit to the others, in those of all missing torque, over joints."""
        columns, found = list(chosen.columns), []
        for (gram, cross, square), values in zip(self.moments.folds, self.left_out(chosen), strict=True):
            own, mine = gram[:, columns][:, :, columns], cross[:, columns]
            left = square - 2 * mine @ values + np.einsum("kpq,p,q->k", own, values, values)
            found.append(float((left / np.maximum(self.moments.square, 1e-300)).sum()))
        return np.array(found)

    def _log_prior(self, statements: Sequence[Statement]) -> float:
        """Log P(n) n!/E^n Π P(places | effect) P(s)."""
        total = log(of_number(len(statements), self.rules)) + lgamma(len(statements) + 1)
        for statement in statements:
            total -= log(len(self.kinds)) + log(len(FIXED.regression_sizes))
            total += log_of_places(len(statement.columns), len(self.kinds[statement.kind]), self.rules)
            total -= len(statement.columns) * log(self.tried.get(statement.kind, 1))
        return total


def _farthest(own: Statement, value: Mapping[int, float]) -> Iterator[tuple[str, ...]]:
    """The n places of a statement with one column each whose values are farthest from the median, for each n."""
    if any(len(columns) > 1 for columns in own.columns.values()):
        return
    values = {place: value[p] for place, (p,) in own.columns.items()}
    middle = float(np.median(list(values.values())))
    order = sorted(values, key=lambda place: -abs(values[place] - middle))
    yield from (tuple(order[:n]) for n in range(1, len(order)))


def lower(before: np.ndarray, after: np.ndarray) -> bool:
    """Whether folds' errors (F,) are lower by more than the standard error of the difference."""
    gain = before - after
    return bool(gain.mean() > gain.std(ddof=1) / np.sqrt(len(gain)))


def log_of_places(count: int, places: int, rules: Rules) -> float:
    """Log P(one | several | all), and which ones, of ``count`` among ``places``."""
    if places == 1:
        return 0.0
    one, several, every = rules.evidence.places_prior
    if count == 1:
        return log(one / places)
    if count == places:
        return log(every if places > 2 else every + several)
    return log(several / max(2**places - places - 2, 1))


def _but(statement: Statement, places: Collection[str]) -> Statement:
    """A statement without some of its places."""
    return replace(statement, columns={p: own for p, own in statement.columns.items() if p not in places})


def _less(statements: Sequence[Statement], number: int) -> tuple[Statement, ...]:
    return (*statements[:number], *statements[number + 1 :])
