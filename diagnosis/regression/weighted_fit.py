"""A weighted fit of the effects that a torque lacks, with a covariance that knows of correlated errors.

Row t of joint j has the weight

    w = 1/(1 + Σ_p β_p² var[Y_p]/σ_j²) · (ν + 1)/(ν + r²/σ_j²),     ν = 4

for what the smoother does not know of X, and for heavy tails (Lange, Little & Taylor 1989). A joint at rest has w = 0:
it may stick, under any torque. Which effects, and where, is decided by evidence over groups
(:mod:`.grouped_evidence`). What is left is taken to remember no more than the residual torque of a diagnosis does,
e^{−20 t}, or the low-pass filter.

Weights depend on what is left: where β changes by δ, w r changes by w (2ν/(ν + r²/σ²) − 1) xᵀδ. With h_j the weighted
mean of this bracket over rows, and A = Σ_j h_j X_jᵀW_j X_j/σ_j² + Λ, the covariance of β is A⁻¹ B A⁻¹ (Huber 1981,
ch. 7). B is the sum over blocks of rows of (Σ x w r/σ²)(…)ᵀ: blocks several correlation times long (Künsch 1989; White
1980). Effects that no log has in this form differ by more from one part of it to the next. So the sd of each β is at
least that of a jackknife over F folds of neighbouring rows,

    s² = (F − 1)/F Σ_f (β_(−f) − mean)²,     F − 1 degrees of freedom                    (Shao & Wu 1989)

Neither shows a torque that no effect explains and that looks like one from the first row to the last. Up to the size
t_j that is tolerated at joint j it is not looked for. A sum aᵀβ of coefficients is shifted by no more than (Cauchy's
inequality at each joint)

    Σ_j √(aᵀ A⁻¹ C_j A⁻¹ a),     C_j = R Σ_t (h_j w t_j/σ_j²)² x xᵀ

which is added to its sd as of a discrepancy (Kennedy & O'Hagan 2001).

Shapes: R rows, K joints, P columns, p of them chosen. Units: rad, s, N·m.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise

import numpy as np

from invdyn.diagnosis.catalogue.linear_laws import CONTAINED, GAIN, INERTIAL, JOINT_KINDS, LINK_MASS, ODD
from invdyn.diagnosis.regression.agreement import Parts
from invdyn.diagnosis.regression.grouped_evidence import Choice, Chosen, Moments
from invdyn.diagnosis.regression.linear_effects import LinearEffects
from invdyn.diagnosis.regression.measured_motion import MeasuredMotion
from invdyn.diagnosis.rules import FIXED, Rules


@dataclass(frozen=True)
class Fitted:
    """A choice with its covariance (p, p), degrees of freedom, and the weights (R, K) of its rows.

    `discrepancy` (K + 1, p, p) are A⁻¹ C_j A⁻¹ of torques that are tolerated, and by what `parts` of the rows differ
    (:mod:`.agreement`): they add to what a number may be, and not to whether it is there.
    `others` are fits with one effect more, by that effect and its place, without regard to its least value.
    `rivals` are effects that would explain as much in the stead of one at its place.
    `tolerance` is the share of what the motion asks for that an effect must be of, to be called one.
    """

    chosen: Chosen
    covariance: np.ndarray
    freedom: int
    weights: np.ndarray
    discrepancy: np.ndarray
    tolerance: float = 0.0
    others: Mapping[tuple[str, str], "Fitted"] = field(default_factory=dict)
    rivals: Mapping[tuple[str, str], tuple[str, ...]] = field(default_factory=dict)
    parts: Parts | None = None

    def shift(self, sums: np.ndarray) -> np.ndarray:
        """(S,) largest shift of sums (S, p) of coefficients by torques that are tolerated."""
        squares = np.einsum("sp,kpq,sq->ks", sums, self.discrepancy, sums, optimize=True)
        return np.asarray(np.sqrt(np.maximum(squares, 0.0)).sum(0))


def weighted_fit(
    effects: LinearEffects,
    motion: MeasuredMotion,
    rules: Rules,
    plain: tuple[str, ...] | None = None,
    before: Sequence[int] = (),
    others: bool = False,
) -> Fitted:
    """Weights and time constants from all columns, then the choice among them, then both again with it.

    Of ``plain`` kinds nothing is chosen: they are there at all places, with those of `ODD` what gains besides. Columns
    ``before`` are, too: their coefficients were estimated before, and what is not known of them widens the others.
    ``others`` says that those of joints are wanted.
    """
    moving = effects.free & effects.columns.moving & (plain is not None or ~np.isin(effects.kinds, ODD))
    kinds: dict[str, dict[str, tuple[int, ...]]] = {}
    for p in np.flatnonzero(moving):
        places = kinds.setdefault(effects.kinds[p], {})
        places[effects.places[p]] = (*places.get(effects.places[p], ()), int(p))
    moves = _moves(motion, rules, effects.usable)
    weights, noise = moves, np.sqrt((effects.missing**2).mean(0)) + 1e-300
    columns = np.flatnonzero(moving)
    prior = 1 / effects.size[columns] ** 2
    for _ in range(3):
        values, left, noise = _solved(effects, columns, prior, weights, noise)
        weights = moves * _weights(effects, columns, values, left, noise)
    chosen = Chosen()
    step = float(np.median(np.diff(motion.time)))
    longest, least = 2 / (rules.residual.residual_decay * step), 1 / (2 * effects.cutoff * step)
    for _ in range(2):
        tau = np.clip(correlation_times(left, motion.stretch), least, max(least, longest))
        moments = _moments(effects, weights, tau)
        tolerated = rules.evidence.tolerance * effects.required
        tried = {kind: shape.count for (kind, _), shape in effects.shapes.items()}
        choice = Choice(
            moments, kinds, effects.size, effects.least, tolerated, rules, CONTAINED, (GAIN, INERTIAL, LINK_MASS), tried
        )
        usual = tuple(kind for kind in plain or () if kind not in ODD)
        chosen = choice.including(choice.plain(usual) if usual == plain else choice.chosen(usual), before)
        columns = np.array(chosen.columns, dtype=int)
        left = left_by(effects, chosen)
        noise = np.maximum(chosen.noise, 1e-300)
        weights = moves * _weights(effects, columns, chosen.values, left, noise)
    tau = correlation_times(left, motion.stretch)
    gram = effects.columns.sums(effects.missing, weights)[0]
    of = partial(_covariance, effects, choice, gram, weights, motion.stretch, tau)

    def fitted(each: Chosen, part: np.ndarray | None = None) -> Fitted:
        covariance, discrepancy = of(each)
        whole = Fitted(each, covariance, len(moments.folds) - 1, weights, discrepancy, rules.evidence.tolerance)
        if part is not None and each.columns:
            whole = _with_parts(whole, effects, choice, part)
        return _by_numbers(effects, whole)

    added = {}
    for kind, places in kinds.items() if others else ():
        for place, own in places.items():
            also = choice.without_least(own).including(chosen, own)
            if kind in JOINT_KINDS and set(own) <= set(also.columns) - set(chosen.columns):
                added[kind, place] = fitted(also)
    alike = choice.rivals(chosen) if others else {}
    others_there = {key: tuple(kind for kind in own if kind not in (INERTIAL, LINK_MASS)) for key, own in alike.items()}
    rivals = {key: own for key, own in others_there.items() if own and key[0] != LINK_MASS}
    return replace(fitted(choice.with_gains(chosen), motion.parts if others else None), others=added, rivals=rivals)


def _by_numbers(effects: LinearEffects, fit: Fitted) -> Fitted:
    """The same fit, where all numbers of a link are off by one factor as numbers of the link."""
    chosen = fit.chosen
    mine = [s for s in chosen.statements if s.kind == LINK_MASS]
    if not mine:
        return fit
    shares = {p: effects.places[p] for p in mine[0].every}
    at = [p for p, kind in enumerate(effects.kinds) if kind == INERTIAL and effects.places[p] in shares.values()]
    links = [p for p in at if effects.own_numbers[p]]
    kept = [n for n, p in enumerate(chosen.columns) if p not in shares]
    turn = np.zeros((len(kept) + len(links), len(chosen.columns)))
    turn[np.arange(len(kept)), kept] = 1.0
    for n, p in enumerate(chosen.columns):
        for row, link in enumerate(links):
            if p in shares and effects.places[link] == shares[p]:
                turn[len(kept) + row, n] = effects.own_numbers[link]
    columns = {place: tuple(p for p in links if effects.places[p] == place) for place in shares.values()}
    gains = chosen.gain or [0.0] * len(chosen.statements)
    merged = {s.kind: (s, g) for s, g in zip(chosen.statements, gains, strict=True)}
    share, gain = merged.pop(LINK_MASS)
    own, other = merged.get(INERTIAL, (replace(share, kind=INERTIAL, columns={}), gain))
    merged[INERTIAL] = replace(own, columns={**own.columns, **columns}), max(gain, other)
    return replace(
        fit,
        chosen=replace(
            chosen,
            statements=tuple(s for s, _ in merged.values()),
            columns=(*(chosen.columns[n] for n in kept), *links),
            values=turn @ chosen.values,
            gain=tuple(g for _, g in merged.values()) if chosen.gain else (),
        ),
        covariance=turn @ fit.covariance @ turn.T,
        discrepancy=turn @ fit.discrepancy @ turn.T,
        parts=fit.parts and fit.parts.turned(turn),
    )


def _with_parts(fit: Fitted, effects: LinearEffects, choice: Choice, part: np.ndarray) -> Fitted:
    """With estimates by each ``part`` (R,) of neighbouring rows alone, of which as many count, and their spread."""
    chosen, own, moments = fit.chosen, list(fit.chosen.columns), choice.moments
    edges = np.append(np.flatnonzero(np.diff(part, prepend=-1)), len(part))
    weight, found = moments.count / moments.rows / chosen.noise**2, []
    prior = [1 / (s.size * effects.size[p]) ** 2 for s in chosen.statements for p in s.every]
    for ends in pairwise(edges):
        gram, cross, _ = effects.columns.sums(effects.missing, fit.weights, slice(*ends))
        A = np.einsum("k,kpq->pq", weight, gram[:, own][:, :, own]) + np.diag(prior) / (len(edges) - 1)
        inverse = _inverse(A)
        found.append((inverse @ (weight @ cross[:, own]), inverse + fit.discrepancy.sum(0)))
    values, covariances = map(np.array, zip(*found, strict=True))
    parts = Parts(values, covariances, FIXED.disagreement / len(own))  # Bonferroni's level
    grow = parts.spread(np.eye(len(own))) / np.sqrt(np.maximum(np.diag(fit.covariance), 1e-300))
    between = fit.covariance * grow[:, None] * grow
    return replace(fit, parts=parts, discrepancy=np.concatenate([fit.discrepancy, [between]]))


def _moves(motion: MeasuredMotion, rules: Rules, usable: np.ndarray) -> np.ndarray:
    """(R, K): 1 in ``usable`` rows in which a joint turns, where it cannot stick; 1 everywhere where there are few."""
    speed = np.sqrt((motion.qd**2).mean(0))
    moves = usable & (np.abs(motion.qd) > np.maximum(rules.check.slow_velocity * speed, 2 * motion.qd_sd))
    return np.where(moves.mean(0) > FIXED.min_moving_share, moves, True).astype(float)


def _solved(
    effects: LinearEffects, columns: np.ndarray, prior: np.ndarray, weights: np.ndarray, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weighted ridge estimates (p,), what they leave (R, K), and its weighted rms (K,)."""
    gram, cross, _ = effects.columns.sums(effects.missing, weights / noise**2)
    A = gram.sum(0)[np.ix_(columns, columns)] + np.diag(prior)
    unit = np.sqrt(np.diag(A))
    values = np.linalg.solve(A / unit[:, None] / unit, cross.sum(0)[columns] / unit) / unit
    left = effects.missing - effects.columns.torque(columns, values)
    return values, left, np.sqrt((weights * left**2).sum(0) / weights.sum(0)) + 1e-300


def _weights(
    effects: LinearEffects, columns: np.ndarray, values: np.ndarray, left: np.ndarray, noise: np.ndarray
) -> np.ndarray:
    """(R, K); see the top of the file."""
    tails, spread = _tails(effects, columns, values, left, noise)
    return tails / spread


def _tails(
    effects: LinearEffects, columns: np.ndarray, values: np.ndarray, left: np.ndarray, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(R, K) of heavy tails, and by how much rows are less sure for what the smoother does not know."""
    spread, tail = 1 + effects.variance.torque(columns, values**2) / noise**2, FIXED.regression_tail
    return (tail + 1) / (tail + left**2 / noise**2 / spread), spread


def correlation_times(left: np.ndarray, stretch: np.ndarray) -> np.ndarray:
    """Integrated autocorrelation times (K,), rows, of what is left, (R, K): sums of pairs while they are positive."""
    found = np.ones(left.shape[1])
    longest = np.flatnonzero(stretch == np.bincount(stretch).argmax())
    for k in range(left.shape[1]):
        own = left[longest, k] - left[longest, k].mean()
        spectrum = np.abs(np.fft.rfft(own, 2 * len(own))) ** 2
        correlation = np.fft.irfft(spectrum)[: len(own) // 2]
        if correlation[0] <= 0:
            continue
        pairs = (correlation[:-1] + correlation[1:])[::2] / correlation[0]
        stop = int(np.argmax(pairs <= 0)) if (pairs <= 0).any() else len(pairs)
        found[k] = max(2 * pairs[:stop].sum() - 1, 1.0)
    return found


def _moments(effects: LinearEffects, weights: np.ndarray, tau: np.ndarray) -> Moments:
    """Of all rows, and of folds of neighbouring ones."""
    number = FIXED.cross_validation_folds
    edges = np.linspace(0, len(weights), number + 1).astype(int)
    folds = [effects.columns.sums(effects.missing, weights, slice(*pair)) for pair in pairwise(edges)]
    gram, cross, square = (np.sum(each, axis=0) for each in zip(*folds, strict=True))
    rows = np.maximum(weights.sum(0), 1e-300)
    return Moments(gram, cross, square, rows / tau, rows, tuple(folds))


def _covariance(
    effects: LinearEffects,
    choice: Choice,
    gram: np.ndarray,
    weights: np.ndarray,
    stretch: np.ndarray,
    tau: np.ndarray,
    chosen: Chosen,
) -> tuple[np.ndarray, np.ndarray]:
    """A⁻¹ B A⁻¹ (p, p), at least that of rows that count, and of the jackknife; and A⁻¹ C_j A⁻¹; ``gram`` is XᵀWX."""
    columns, noise = list(chosen.columns), chosen.noise
    if not columns:
        return np.zeros((0, 0)), np.zeros((len(noise), 0, 0))
    left, tail = left_by(effects, chosen), FIXED.regression_tail
    tails, _ = _tails(effects, np.array(columns), chosen.values, left, noise)
    slope = 2 * tail / (tail + 1) * (weights * tails).sum(0) / np.maximum(weights.sum(0), 1e-300) - 1
    fixed = gram[:, columns][:, :, columns] / noise[:, None, None] ** 2
    own = slope[:, None, None] * fixed
    prior = np.diag([1 / (s.size * effects.size[p]) ** 2 for s in chosen.statements for p in s.every])
    inverse = _inverse(own.sum(0) + prior)
    length = int(min(max(np.ceil(4 * tau.max()), 1), max(len(weights) // 8, 1)))
    block = np.unique(stretch * len(weights) + np.arange(len(weights)) // length, return_index=True)[1]
    sums = effects.columns.block_sums(weights / noise**2 * left, block)[:, columns]
    robust = inverse @ (sums.T @ sums) @ inverse * len(block) / max(len(block) - 1, 1)
    without = choice.left_out(chosen) @ (fixed.sum(0) + prior) @ inverse  # by weights that follow
    jackknife = (len(without) - 1) * without.var(0)
    least = np.maximum(np.diag(_inverse((own / tau[:, None, None]).sum(0) + prior)), jackknife)
    grow = np.sqrt(np.maximum(least / np.maximum(np.diag(robust), 1e-300), 1.0))
    shifted = len(weights) * (slope * weights / noise**2 * choice.tolerated) ** 2
    worst = effects.columns.sums(effects.missing, shifted)[0]
    return robust * grow[:, None] * grow, inverse @ worst[:, columns][:, :, columns] @ inverse


def _inverse(matrix: np.ndarray) -> np.ndarray:
    """Of a positive matrix (p, p), in units in which its diagonal is one."""
    unit = np.sqrt(np.diag(matrix))
    return np.linalg.pinv(matrix / unit[:, None] / unit, rcond=1e-12, hermitian=True) / unit[:, None] / unit


def left_by(effects: LinearEffects, chosen: Chosen) -> np.ndarray:
    """(R, K) N·m of what is missing that chosen effects do not explain."""
    return effects.missing - effects.columns.torque(chosen.columns, chosen.values)
