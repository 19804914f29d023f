"""One regression of all that a torque may lack and that it is linear in, at all joints at once.

    u − τ_file(q, q̇, q̈) = X β + e,     X = E[Y | encoders]

X are :mod:`.linear_effects` along a smoothed motion (:mod:`.measured_motion`). Row t of joint j has the weight

    w = 1/(1 + Σ_p β_p² var[Y_p]/σ_j²) · (ν + 1)/(ν + r²/σ_j²),     ν = 4

for what the smoother does not know of X, and for heavy tails (Lange, Little & Taylor 1989). A joint at rest has w = 0:
it may stick, under any torque. Which effects, and where, is decided by evidence over groups
(:mod:`.grouped_evidence`). What is left is taken to remember no more than the residual torque of a diagnosis does,
e^{−20 t}, or the low-pass filter.

With A = XᵀWX/σ² + Λ the covariance of β is A⁻¹ B A⁻¹, B the sum over blocks of rows of (Σ x w r/σ²)(…)ᵀ: blocks several
correlation times long, with as many degrees of freedom (Künsch 1989; White 1980).

How far that closes the gap is measured on the last third of the rows by a fit to the first two, in rms torque. Evidence
trusts a model that no robot obeys, and may fit what does not last. So where those rows are predicted better by far by
viscous and Coulomb friction at all joints, or by these and all links' numbers, as a plain least-squares fit has them,
that is the answer.

Shapes: R rows, K joints, P columns, p of them chosen. Units: rad, s, N·m.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.stats import t as student_t

from invdyn.diagnosis.problem.regressors import base_columns, nominal_link_numbers
from invdyn.diagnosis.regression.grouped_evidence import Choice, Chosen, Moments
from invdyn.diagnosis.regression.linear_effects import INERTIAL, LinearEffects, cutoff_of, linear_effects
from invdyn.diagnosis.regression.measured_motion import MeasuredMotion, measured_motion
from invdyn.diagnosis.regression.torque_closing import TorqueClosing, closing
from invdyn.diagnosis.rules import DEFAULT, FIXED, Rules
from invdyn.models import ArticulatedBody
from invdyn.models.dynamics.registry import dynamics_for
from invdyn.recordings import Recording

FRICTION = ("viscous_friction", "coulomb_friction")
PLAIN: tuple[tuple[str, ...] | None, ...] = (None, FRICTION, (*FRICTION, INERTIAL))
"""What is chosen by evidence, and fits without a choice that it must not be behind."""


@dataclass(frozen=True)
class Estimated:
    """A number: `parameter` of an effect at a place, with its 90 % interval; `of_file` is what the file has of it.

    ``parts`` are further numbers that are known with it alone, name → factor (:func:`.regressors.base_columns`).
    """

    effect: str
    place: str
    parameter: str
    value: float
    sd: float
    interval_90: tuple[float, float]
    unit: str
    of_file: float = 0.0
    parts: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Stated:
    """An effect and its places, all of them where `everywhere`; the nats that it gains over the set without it."""

    effect: str
    places: tuple[str, ...]
    everywhere: bool
    gain: float


@dataclass(frozen=True)
class Unseen:
    """Rows that a fit to the others is measured on: the motion, that fit's coefficients, what it leaves, filter, Hz."""

    motion: MeasuredMotion
    coefficients: Mapping[tuple[str, str, str], float]
    missing: np.ndarray
    left: np.ndarray
    cutoff: float
    memory: float


@dataclass(frozen=True)
class Regression:
    """What a regression says: effects, their numbers, and how much of the missing torque they explain.

    `joints` are the names of K; `torque` is of the held-out rows that `unseen` has, and so is `plain`, of viscous and
    Coulomb friction at all joints alone.
    """

    joints: tuple[str, ...]
    stated: tuple[Stated, ...]
    numbers: tuple[Estimated, ...]
    torque: TorqueClosing
    plain: TorqueClosing
    rows: int
    coefficients: Mapping[tuple[str, str, str], float] = field(default_factory=dict)
    unseen: Unseen | None = field(default=None, repr=False, compare=False)

    def to_json(self) -> dict[str, Any]:
        """As a JSON file has it."""
        return {
            "statements": [
                {"effect": s.effect, "places": list(s.places), "everywhere": s.everywhere, "gain_nats": s.gain}
                for s in self.stated
            ],
            "numbers": [
                {
                    "effect": each.effect,
                    "place": each.place,
                    "parameter": each.parameter,
                    "value": each.value,
                    "sd": each.sd,
                    "interval_90": list(each.interval_90),
                    "unit": each.unit,
                    "of_file": each.of_file,
                    "known_with": dict(each.parts),
                }
                for each in self.numbers
            ],
            "torque": self.torque.to_json(self.joints),
            "friction_alone": self.plain.to_json(self.joints),
            "rows": self.rows,
        }


@dataclass(frozen=True)
class Fitted:
    """A choice with its covariance (p, p), degrees of freedom, and the weights (R, K) of its rows."""

    chosen: Chosen
    covariance: np.ndarray
    freedom: int
    weights: np.ndarray


def regress(
    recording: Recording | Sequence[Recording],
    body: ArticulatedBody,
    *,
    passive: bool = False,
    rules: Rules = DEFAULT,
    held_out: Recording | Sequence[Recording] | None = None,
) -> Regression | None:
    """What a recording's torques lack, by regression.

    Args:
        recording: encoders or keypoints, with torques; one or several of one arm.
        body: the simulation, whose own friction, rotors, springs and servos count as known.
        passive: the torques are zero.
        rules: the numbers that it follows.
        held_out: another recording of the same arm, to measure on; by default the last third of ``recording``.

    None where torques are unknown, or too few rows show all joints. Raises InputError where keypoints do not fit.
    """
    motion = measured_motion(recording, body, passive=passive, rules=rules)
    if motion is None:
        return None
    other = None if held_out is None else measured_motion(held_out, body, passive=passive, rules=rules)
    cutoff = min(cutoff_of(each) for each in (motion, other) if each is not None)
    of = partial(linear_effects, dynamics_for(body), body, passive=passive, rules=rules, cutoff=cutoff)
    whole = of(motion=motion)
    first, last = motion.split(rules.outcome.fit_share) if other is None else (motion, other)
    known, unseen = of(motion=first), of(motion=last)
    fits = [_fit(known, first, rules, plain) for plain in PLAIN]
    left = [_left(unseen, each.chosen) for each in fits]
    size = np.maximum(np.sqrt((unseen.missing**2).mean(0)), 1e-300)
    tolerated = rules.evidence.tolerance * unseen.required
    errors = [float(np.linalg.norm(np.hypot(np.sqrt((each**2).mean(0)), tolerated) / size)) for each in left]
    behind = errors[0] > max(FIXED.max_behind_plain * min(errors), min(errors) + FIXED.min_plain_gain)
    best = int(np.argmin(errors)) if behind else 0
    fit = fits[best] if other is not None else _fit(whole, motion, rules, PLAIN[best])
    memory = float(correlation_times(_left(known, fits[best].chosen), first.stretch).max())
    torque = closing(unseen.missing, left[best], memory, rules)
    stated = tuple(
        Stated(s.kind, tuple(s.columns), len(s.columns) == _places(whole, s.kind), gain)
        for s, gain in zip(fit.chosen.statements, fit.chosen.gain, strict=True)
    )
    numbers = (*_of_joints(whole, fit, body), *_of_links(whole, fit, body))
    plain = closing(unseen.missing, left[PLAIN.index(FRICTION)], memory, rules)
    there = Unseen(last, _named(known, fits[best].chosen), unseen.missing, left[best], known.cutoff, memory)
    return Regression(
        body.joint_names, stated, numbers, torque, plain, len(motion.time), _named(whole, fit.chosen), there
    )


def _named(effects: LinearEffects, chosen: Chosen) -> dict[tuple[str, str, str], float]:
    """Coefficients by effect, place and parameter."""
    names = [(effects.kinds[p], effects.places[p], effects.names[p]) for p in chosen.columns]
    return dict(zip(names, chosen.values.tolist(), strict=True))


def _places(effects: LinearEffects, kind: str) -> int:
    return len({place for own, place in zip(effects.kinds, effects.places, strict=True) if own == kind})


def _fit(effects: LinearEffects, motion: MeasuredMotion, rules: Rules, plain: tuple[str, ...] | None = None) -> Fitted:
    """Weights and time constants from all columns, then the choice among them, then both again with it.

    Of ``plain`` kinds nothing is chosen: they are there at all places.
    """
    moving = effects.free & (np.abs(effects.values).max((1, 2)) > 0)
    kinds: dict[str, dict[str, tuple[int, ...]]] = {}
    for p in np.flatnonzero(moving):
        places = kinds.setdefault(effects.kinds[p], {})
        places[effects.places[p]] = (*places.get(effects.places[p], ()), int(p))
    moves = _moves(motion, rules)
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
        choice = Choice(moments, kinds, effects.size, effects.least, rules.evidence.tolerance * effects.required, rules)
        chosen = choice.chosen() if plain is None else choice.plain(plain)
        columns = np.array(chosen.columns, dtype=int)
        left = _left(effects, chosen)
        noise = np.maximum(chosen.noise, 1e-300)
        weights = moves * _weights(effects, columns, chosen.values, left, noise)
    covariance, freedom = _covariance(effects, chosen, weights, motion.stretch, correlation_times(left, motion.stretch))
    return Fitted(chosen, covariance, freedom, weights)


def _moves(motion: MeasuredMotion, rules: Rules) -> np.ndarray:
    """(R, K): 1 where a joint turns, 0 where it may stick; 1 everywhere for one that hardly ever turns."""
    speed = np.sqrt((motion.qd**2).mean(0))
    moves = np.abs(motion.qd) > np.maximum(rules.check.slow_velocity * speed, 2 * motion.qd_sd)
    return np.where(moves.mean(0) > FIXED.min_moving_share, moves, True).astype(float)


def _solved(
    effects: LinearEffects, columns: np.ndarray, prior: np.ndarray, weights: np.ndarray, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weighted ridge estimates (p,), what they leave (R, K), and its weighted rms (K,)."""
    scaled = np.sqrt(weights) / noise
    X = (effects.values[columns] * scaled).reshape(len(columns), -1)
    A = X @ X.T + np.diag(prior)
    unit = np.sqrt(np.diag(A))
    values = np.linalg.solve(A / unit[:, None] / unit, X @ (effects.missing * scaled).ravel() / unit) / unit
    left = effects.missing - np.tensordot(values, effects.values[columns], 1)
    return values, left, np.sqrt((weights * left**2).sum(0) / weights.sum(0)) + 1e-300


def _weights(
    effects: LinearEffects, columns: np.ndarray, values: np.ndarray, left: np.ndarray, noise: np.ndarray
) -> np.ndarray:
    """(R, K); see the top of the file."""
    unknown = np.tensordot(values**2, effects.variance[columns], 1) / noise**2
    spread, tail = 1 + unknown, FIXED.regression_tail
    return (tail + 1) / (tail + left**2 / noise**2 / spread) / spread


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
    folds = [_sums(effects, weights, slice(*pair)) for pair in pairwise(edges)]
    gram, cross, square = (np.sum(each, axis=0) for each in zip(*folds, strict=True))
    rows = np.maximum(weights.sum(0), 1e-300)
    return Moments(gram, cross, square, rows / tau, rows, tuple(folds))


def _sums(effects: LinearEffects, weights: np.ndarray, rows: slice) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """XᵀWX (K, P, P), XᵀWy (K, P) and yᵀWy (K,) of each joint over some rows."""
    X, y, w = effects.values[:, rows], effects.missing[rows], weights[rows]
    weighted = X * w
    gram = np.stack([weighted[:, :, k] @ X[:, :, k].T for k in range(w.shape[1])])
    return gram, np.einsum("prk,rk->kp", weighted, y), (w * y**2).sum(0)


def _covariance(
    effects: LinearEffects, chosen: Chosen, weights: np.ndarray, stretch: np.ndarray, tau: np.ndarray
) -> tuple[np.ndarray, int]:
    """A⁻¹ B A⁻¹ (p, p) over blocks, at least the posterior's of rows that count; and the blocks less one."""
    columns = list(chosen.columns)
    if not columns:
        return np.zeros((0, 0)), 1
    X, left = effects.values[columns], _left(effects, chosen)
    scaled = weights / chosen.noise**2
    prior = np.array([1 / (s.size * effects.size[p]) ** 2 for s in chosen.statements for p in s.every])
    gram = np.einsum("prk,rk,qrk->pq", X, scaled, X, optimize=True) + np.diag(prior)
    inverse = _inverse(gram)
    scores = np.einsum("prk,rk->rp", X, scaled * left)
    length = int(min(max(np.ceil(4 * tau.max()), 1), max(len(scores) // 8, 1)))
    block = np.unique(stretch * len(scores) + np.arange(len(scores)) // length, return_inverse=True)[1]
    count = int(block.max()) + 1
    sums = np.zeros((count, len(columns)))
    np.add.at(sums, block, scores)
    robust = inverse @ (sums.T @ sums) @ inverse * count / max(count - 1, 1)
    mean = np.einsum("prk,rk,qrk->pq", X, scaled / tau, X, optimize=True) + np.diag(prior)
    grow = np.sqrt(np.maximum(np.diag(_inverse(mean)) / np.maximum(np.diag(robust), 1e-300), 1.0))
    return robust * grow[:, None] * grow, max(count - 1, 1)


def _inverse(matrix: np.ndarray) -> np.ndarray:
    """Of a positive matrix (p, p), in units in which its diagonal is one."""
    unit = np.sqrt(np.diag(matrix))
    return np.linalg.pinv(matrix / unit[:, None] / unit, rcond=1e-12, hermitian=True) / unit[:, None] / unit


def _left(effects: LinearEffects, chosen: Chosen) -> np.ndarray:
    """(R, K) N·m of what is missing that chosen effects do not explain."""
    return effects.missing - np.tensordot(chosen.values, effects.values[list(chosen.columns)], 1)


def _estimate(value: float, sd: float, freedom: int) -> tuple[float, tuple[float, float]]:
    half = float(student_t.ppf(0.95, freedom)) * sd
    return sd, (value - half, value + half)


def _of_joints(effects: LinearEffects, fit: Fitted, body: Any) -> list[Estimated]:
    """Numbers of effects at joints.

    A gain is the motor's: where τ (1 + g) was commanded for τ, ε = −g/(1 + g). Other numbers were fitted in torques as
    commanded, and are divided by 1 + g.
    """
    pairs = list(zip(fit.chosen.columns, fit.chosen.values.tolist(), strict=True))
    gains = {effects.places[p]: 1 + value for p, value in pairs if effects.kinds[p] == "actuator_gain"}
    found = []
    for n, (p, value) in enumerate(pairs):
        kind, sd = effects.kinds[p], float(np.sqrt(max(fit.covariance[n, n], 0.0)))
        if kind == INERTIAL:
            continue
        commanded = gains.get(effects.places[p], 1.0)
        if kind == "actuator_gain":
            sd, value = sd / commanded**2, -value / commanded
        else:
            sd, value = sd / commanded, value / commanded
        sd, interval = _estimate(float(value), sd, fit.freedom)
        filed = -float(effects.least[p]) if np.isfinite(effects.least[p]) else 0.0
        found.append(
            Estimated(kind, effects.places[p], effects.names[p], float(value), sd, interval, effects.units[p], filed)
        )
    return found


def _of_links(effects: LinearEffects, fit: Fitted, body: Any) -> list[Estimated]:
    """Base parameters of links that were found to be otherwise, in whole: what the file has, and what is missing."""
    chosen = fit.chosen
    mine = [n for n, p in enumerate(chosen.columns) if effects.kinds[p] == INERTIAL]
    if not mine:
        return []
    columns = [chosen.columns[n] for n in mine]
    noise = np.sqrt(fit.weights) / chosen.noise
    rows = (effects.values[columns] * noise).reshape(len(columns), -1).T
    base, rest, factors = base_columns(rows)
    own = np.concatenate([each.ravel() for each in nominal_link_numbers(body)])
    offset = effects.kinds.index(INERTIAL)  # links' columns come last
    named = [f"{effects.names[p]} of {effects.places[p]}" for p in columns]
    found = []
    for i, b in enumerate(base):
        combination = np.zeros(len(columns))
        combination[b] = 1.0
        combination[rest] = factors[i]
        whole = np.zeros(len(chosen.columns))
        whole[mine] = combination
        nominal = float(combination @ own[[p - offset for p in columns]])
        value = nominal + float(whole @ chosen.values)
        sd, interval = _estimate(value, float(np.sqrt(max(whole @ fit.covariance @ whole, 0.0))), fit.freedom)
        parts = {named[j]: float(combination[j]) for j in rest if abs(combination[j]) > 1e-9}
        p = columns[b]
        name, place, unit = effects.names[p], effects.places[p], effects.units[p]
        found.append(Estimated(INERTIAL, place, name, value, sd, interval, unit, nominal, parts))
    return found
