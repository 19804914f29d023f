"""One regression of all that a torque may lack and that it is linear in, at all joints at once.

    u − τ_file(q, q̇, q̈) = X β + e,     X = E[Y | encoders]

X are :mod:`.linear_effects` along a smoothed motion (:mod:`.measured_motion`); the fit is :mod:`.weighted_fit`.

How far that closes the gap is measured on the last third of the rows by a fit to the first two, in rms torque. Evidence
trusts a model that no robot obeys, and may fit what does not last. So where those rows are predicted better by far by
viscous and Coulomb friction at all joints, or by these and all links' numbers, as a plain least-squares fit has them,
that is the answer.

Shapes: R rows, K joints, P columns, p of them chosen. Units: rad, s, N·m.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.stats import t as student_t

from invdyn.diagnosis.regression.grouped_evidence import Chosen
from invdyn.diagnosis.regression.linear_effects import (
    INERTIAL,
    LinearEffects,
    cutoff_of,
    linear_effects,
    required_by_file,
)
from invdyn.diagnosis.regression.measured_motion import MeasuredMotion, measured_motion
from invdyn.diagnosis.regression.regressors import base_columns, nominal_link_numbers
from invdyn.diagnosis.regression.servo_gains import ServoGains, servo_gains
from invdyn.diagnosis.regression.torque_closing import TorqueClosing, closing
from invdyn.diagnosis.regression.weighted_fit import Fitted, correlation_times, left_by, weighted_fit
from invdyn.diagnosis.rules import DEFAULT, FIXED, Rules
from invdyn.models import ArticulatedBody
from invdyn.models.dynamics.registry import dynamics_for
from invdyn.recordings import Recording

GAIN = "actuator_gain"
FRICTION = ("viscous_friction", "coulomb_friction")
PLAIN: tuple[tuple[str, ...] | None, ...] = (None, FRICTION, (*FRICTION, INERTIAL))
"""What is chosen by evidence, and fits without a choice that it must not be behind."""


@dataclass(frozen=True)
class Estimated:
    """A number: `parameter` of an effect at a place, with its 90 % interval; `of_file` is what the file has of it.

    ``known_with`` are further numbers that are known with it alone, name → factor (:func:`.regressors.base_columns`).
    """

    effect: str
    place: str
    parameter: str
    value: float
    sd: float
    interval_90: tuple[float, float]
    unit: str
    of_file: float = 0.0
    known_with: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Stated:
    """An effect and its places, all of them where `everywhere`; nats that it gains over the set without it."""

    effect: str
    places: tuple[str, ...]
    everywhere: bool
    gain_nats: float


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

    `joints` are the names of K. `coefficients` are all numbers, of links that move as one each by itself, and `draws`
    are from their Gaussian, always of the same seed. `torque` is of the held-out rows that `unseen` has, and so is
    `plain`, of viscous and Coulomb friction at all joints alone.
    """

    joints: tuple[str, ...]
    stated: tuple[Stated, ...]
    numbers: tuple[Estimated, ...]
    torque: TorqueClosing
    plain: TorqueClosing
    rows: int
    coefficients: Mapping[tuple[str, str, str], float] = field(default_factory=dict)
    unseen: Unseen | None = field(default=None, repr=False, compare=False)
    draws: tuple[Mapping[tuple[str, str, str], float], ...] = field(default=(), repr=False, compare=False)

    def to_json(self) -> dict[str, Any]:
        """As a JSON file has it, once :func:`..assessment.result.plain` was called on it."""
        return {
            "statements": self.stated,
            "numbers": self.numbers,
            "torque": self.torque.to_json(self.joints),
            "friction_alone": self.plain.to_json(self.joints),
            "rows": self.rows,
        }


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
    first, last = motion.split(rules.outcome.fit_share) if other is None else (motion, other)
    dynamics = dynamics_for(body)
    gains = servo_gains(first, required_by_file(dynamics, body, first), body)
    of = partial(linear_effects, dynamics, body, passive=passive, rules=rules, cutoff=cutoff)
    for _ in range(FIXED.servo_gain_passes if gains.changed.any() else 0):
        known = of(motion=first, factor=gains.factor)
        chosen = weighted_fit(known, first, rules, None, _columns_of(known, gains)).chosen
        if (better := _nearer(known, chosen, gains)) is gains:
            break
        gains = better
    of = partial(of, factor=gains.factor)
    whole = of(motion=motion)
    known, unseen = of(motion=first), of(motion=last)
    before = _columns_of(whole, gains)
    fits = [weighted_fit(known, first, rules, plain, before) for plain in PLAIN]
    left = [left_by(unseen, each.chosen) for each in fits]
    size = np.maximum(np.sqrt((unseen.missing**2).mean(0)), 1e-300)
    tolerated = rules.evidence.tolerance * unseen.required
    errors = [float(np.linalg.norm(np.hypot(np.sqrt((each**2).mean(0)), tolerated) / size)) for each in left]
    behind = errors[0] > max(FIXED.max_behind_plain * min(errors), min(errors) + FIXED.min_plain_gain)
    best = int(np.argmin(errors)) if behind else 0
    fit = fits[best] if other is not None else weighted_fit(whole, motion, rules, PLAIN[best], before)
    memory = float(correlation_times(left_by(known, fits[best].chosen), first.stretch).max())
    torque = closing(unseen.of_file, left[best], memory, rules)
    stated = _stated(whole, fit, gains, body)
    numbers = (*_of_joints(whole, fit, gains, body), *_of_links(whole, fit, body))
    plain = closing(unseen.of_file, left[PLAIN.index(FRICTION)], memory, rules)
    there = Unseen(last, _named(known, fits[best].chosen, gains), unseen.of_file, left[best], known.cutoff, memory)
    return Regression(
        body.joint_names,
        stated,
        numbers,
        torque,
        plain,
        len(motion.time),
        _named(whole, fit.chosen, gains),
        there,
        _drawn(whole, fit, gains),
    )


def _columns_of(effects: LinearEffects, servos: ServoGains) -> list[int]:
    """Columns of the gains that were estimated first."""
    new = {place for place, changed in zip(_joints(effects), servos.changed, strict=True) if changed}
    every = enumerate(zip(effects.kinds, effects.places, strict=True))
    return [p for p, (kind, place) in every if kind == GAIN and place in new]


def _drawn(effects: LinearEffects, fit: Fitted, servos: ServoGains) -> tuple[dict[tuple[str, str, str], float], ...]:
    """Numbers of draws from the Gaussian of the coefficients."""
    if not fit.chosen.columns:
        return ()
    rng = np.random.default_rng(0)
    values = rng.multivariate_normal(fit.chosen.values, fit.covariance, FIXED.regression_draws, method="eigh")
    floor = effects.least[list(fit.chosen.columns)]
    every = (replace(fit.chosen, values=np.maximum(each, floor)) for each in values)
    return tuple(_named(effects, each, servos) for each in every)


def _nearer(effects: LinearEffects, chosen: Chosen, servos: ServoGains) -> ServoGains:
    """Servos' gains about which the next regression is made; the same where this one finds them."""
    found = {
        effects.places[p]: 1 + v for p, v in zip(chosen.columns, chosen.values, strict=True) if effects.kinds[p] == GAIN
    }
    more = np.where(servos.changed, [found.get(place, 1.0) for place in _joints(effects)], 1.0)
    if np.abs(np.log(more)).max() < FIXED.equal_servo_gain:
        return servos
    return ServoGains(servos.factor * more)


def _stated(effects: LinearEffects, fit: Fitted, servos: ServoGains, body: Any) -> tuple[Stated, ...]:
    """What was chosen; servos with a gain that the file has not are stated where nothing was chosen there."""
    found = {s.kind: (tuple(s.columns), gain) for s, gain in zip(fit.chosen.statements, fit.chosen.gain, strict=True)}
    if servos.changed.any():
        places, gain = found.pop(GAIN, ((), 0.0))
        every = [name for name, new in zip(body.joint_names, servos.changed, strict=True) if new or name in places]
        before, after = (np.sqrt((each**2).mean(0)) for each in (effects.of_file, left_by(effects, fit.chosen)))
        gain += float((len(effects.missing) * np.log(before / after))[servos.changed].sum())
        found = {GAIN: (tuple(every), gain), **found}
    return tuple(
        Stated(kind, places, len(places) == _places(effects, kind), gain) for kind, (places, gain) in found.items()
    )


def _named(effects: LinearEffects, chosen: Chosen, servos: ServoGains) -> dict[tuple[str, str, str], float]:
    """Numbers by effect, place and parameter; a gain is the motor's."""
    names = [(effects.kinds[p], effects.places[p], effects.names[p]) for p in chosen.columns]
    found = dict(zip(names, chosen.values.tolist(), strict=True))
    factors = {place: 1 + value for (kind, place, _), value in found.items() if kind == GAIN}
    for key, p in zip(names, chosen.columns, strict=True):
        if key[0] not in (INERTIAL, GAIN):
            found[key] = max(found[key] / factors.get(key[1], 1.0), float(effects.least[p]))
    for place, factor, new in zip(_joints(effects), servos.factor.tolist(), servos.changed, strict=True):
        if new or place in factors:
            found[GAIN, place, "gain"] = 1 / (factor * factors.get(place, 1.0)) - 1
    return found


def _joints(effects: LinearEffects) -> list[str]:
    return [place for kind, place in zip(effects.kinds, effects.places, strict=True) if kind == "viscous_friction"]


def _places(effects: LinearEffects, kind: str) -> int:
    return len({place for own, place in zip(effects.kinds, effects.places, strict=True) if own == kind})


def _estimate(value: float, sd: float, freedom: int) -> tuple[float, tuple[float, float]]:
    half = float(student_t.ppf(0.95, freedom)) * sd
    return sd, (value - half, value + half)


def _of_joints(effects: LinearEffects, fit: Fitted, servos: ServoGains, body: Any) -> list[Estimated]:
    """Numbers of effects at joints.

    A gain is the motor's: where τ (1 + g) was commanded for τ, ε = 1/(1 + g) − 1. Other numbers were fitted in torques
    as commanded, and are divided by 1 + g.
    """
    values = _named(effects, fit.chosen, servos)
    sds = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0)).tolist()
    own = {(effects.kinds[p], effects.places[p], effects.names[p]): p for p in fit.chosen.columns}
    sd_of = dict(zip(own, sds, strict=True))
    fitted = dict(zip(own, fit.chosen.values.tolist(), strict=True))
    found = []
    for (kind, place, name), value in values.items():
        if kind == INERTIAL:
            continue
        sd = sd_of.get((kind, place, name), 0.0) / (1 + fitted.get((GAIN, place, "gain"), 0.0))
        sd *= 1 + value if kind == GAIN else 1.0
        p = own.get((kind, place, name))
        filed = -float(effects.least[p]) if p is not None and kind != GAIN and np.isfinite(effects.least[p]) else 0.0
        unit = "1" if p is None else effects.units[p]
        sd, interval = _estimate(value, sd, fit.freedom)
        found.append(Estimated(kind, place, name, value, sd, interval, unit, filed))
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
