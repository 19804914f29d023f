"""One regression of all that a torque may lack and that it is linear in, at all joints at once.

    u − τ_file(q, q̇, q̈) = X β + e,     X = E[Y | encoders]

X are :mod:`.linear_effects` along a smoothed motion (:mod:`.measured_motion`); the fit is :mod:`.weighted_fit`.

How far that closes the gap is measured on the last third of the rows by a fit to the first two, in rms torque. Evidence
trusts a model that no robot obeys, and may fit what does not last. So where those rows are predicted better by far by
viscous and Coulomb friction at all joints, or by these and all links' numbers, as a plain least-squares fit has them,
that is the answer, unless it leaves more torque of all joints together. A servo's gain that was found first is dropped
where it leaves as much of them as the file's: where no gravity loads a hinge, its gain, damping and rotor have a factor
in common, which no torque tells.

Shapes: R rows, K joints, P columns, p of them chosen. Units: rad, s, N·m.
"""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from invdyn.diagnosis.catalogue.linear_laws import FRICTION, GAIN, INERTIAL, ODD, USUAL
from invdyn.diagnosis.regression.as_model import model_on, torque_missed, with_coefficients
from invdyn.diagnosis.regression.grouped_evidence import Chosen
from invdyn.diagnosis.regression.linear_effects import (
    Expected,
    LinearEffects,
    expected,
    expected_sign,
    joints_of,
    linear_effects,
)
from invdyn.diagnosis.regression.low_pass import cutoff_of
from invdyn.diagnosis.regression.measured_motion import MeasuredMotion, measured_motion
from invdyn.diagnosis.regression.servo_gains import ServoGains, servo_gains
from invdyn.diagnosis.regression.shape_profile import Shapes, first_shapes, nearer_shapes
from invdyn.diagnosis.regression.shaped_effects import Along, Shaped, shaped_effects
from invdyn.diagnosis.regression.stated_numbers import (
    Estimated,
    Stated,
    drawn,
    named,
    of_joints,
    of_links,
    of_others,
    stated,
)
from invdyn.diagnosis.regression.torque_closing import TorqueClosing, closing
from invdyn.diagnosis.regression.weighted_fit import Fitted, correlation_times, left_by, weighted_fit
from invdyn.diagnosis.rules import DEFAULT, FIXED, Rules
from invdyn.models import ArticulatedBody
from invdyn.models.dynamics.registry import dynamics_for
from invdyn.recordings import Recording

PLAIN: tuple[tuple[str, ...] | None, ...] = (None, (*USUAL, INERTIAL, *ODD), FRICTION, (*FRICTION, INERTIAL))
"""What is chosen by evidence, also beside all that is usual, and fits without a choice that it must not be behind."""


@dataclass(frozen=True)
class Unseen:
    """Rows that a fit to the others is measured on: the motion, that fit's coefficients, what it leaves, filter, Hz.

    ``fitted`` is the motion of the others, and ``fitted_missing`` what the file misses there.
    """

    motion: MeasuredMotion
    coefficients: Mapping[tuple[str, str, str], float]
    missing: np.ndarray
    left: np.ndarray
    cutoff: float
    fitted: MeasuredMotion
    fitted_missing: np.ndarray


@dataclass(frozen=True)
class Regression:
    """What a regression says: effects, their numbers, and how much of the missing torque they explain.

    `joints` are the names of K. `coefficients` are all numbers, of links that move as one each by itself, and `draws`
    are from their Gaussian, always of the same seed. `far_gains` are of servos by joint, times the file's: no
    search about the file's numbers comes to them. `torque` is of the held-out rows that `unseen` has, and so is
    `plain`, of viscous and Coulomb friction at all joints alone. `others` are numbers of effects that are not stated,
    with their probabilities, and `examined` the names of all effects that could have been stated. The parts that may
    tell other numbers are so many `recordings`, or thirds of one.
    """

    joints: tuple[str, ...]
    stated: tuple[Stated, ...]
    numbers: tuple[Estimated, ...]
    torque: TorqueClosing
    plain: TorqueClosing
    rows: int
    coefficients: Mapping[tuple[str, str, str], float]
    unseen: Unseen = field(repr=False, compare=False)
    draws: tuple[Mapping[tuple[str, str, str], float], ...] = field(repr=False, compare=False)
    far_gains: Mapping[str, float] = field(compare=False)
    others: tuple[Estimated, ...]
    examined: frozenset[str] = frozenset()
    recordings: int = 1

    def to_json(self) -> dict[str, Any]:
        """As a JSON file has it, once :func:`..assessment.result.plain` was called on it."""
        return {
            "statements": self.stated,
            "numbers": self.numbers,
            "others": self.others,
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
    without: Collection[str] = (),
) -> Regression | None:
    """What a recording's torques lack, by regression.

    Args:
        recording: encoders or keypoints, with torques; one or several of one arm.
        body: the simulation, whose own friction, rotors, springs and servos count as known.
        passive: the torques are zero.
        rules: the numbers that it follows.
        held_out: another recording of the same arm, to measure on; by default the last third of ``recording``.
        without: names of effects that are not looked for.

    None where torques are unknown, or too few rows show all joints. Raises InputError where keypoints do not fit.
    """
    motion = measured_motion(recording, body, passive=passive, rules=rules)
    if motion is None:
        return None
    other = None if held_out is None else measured_motion(held_out, body, passive=passive, rules=rules)
    cutoff = min(cutoff_of(each) for each in (motion, other) if each is not None)
    dynamics = dynamics_for(body)
    along = expected(dynamics, body, motion, passive)
    if other is None:
        count = int(rules.outcome.fit_share * len(motion.time))
        first, last = ((motion.at(rows), along.at(rows)) for rows in (slice(count), slice(count, None)))
    else:
        first, last = (motion, along), (other, expected(dynamics, body, other, passive))
    of = partial(linear_effects, body, passive=passive, rules=rules, cutoff=cutoff, without=without)
    own = ServoGains(np.ones(body.num_joints))
    gains = own if GAIN in without else servo_gains(first[0], first[1].required, body)
    # a file that is wrong about most servos is corrected first
    shaped = () if gains.changed.mean() > 0.5 else shaped_effects(body, motion, passive, without)
    pieces = tuple(Along(body, dynamics, each, expected_sign(each)) for each, _ in (first, last))
    tried = partial(_with_shapes, of, first, last, shaped, pieces, rules)
    found = tried(gains)
    if found.gains.changed.any():
        filed = tried(own)
        while (worse := found.no_better_than(filed)).any():
            found = tried(ServoGains(np.where(worse, 1.0, found.gains.factor)))
    known, unseen, gains, best = found.known, found.unseen, found.gains, found.best
    fitted = [left_by(known, each.chosen) for each in found.fits]
    memory = float(correlation_times(fitted[best], first[0].stretch).max())
    by_fit = [named(known, each.chosen, gains) for each in found.fits]
    coefficients, left = by_fit[best], found.left
    if passive:
        left, fitted = ([_missed(each, body, rows, cutoff) for each in by_fit] for rows in (last[0], first[0]))
    torque, plain = (
        closing(unseen.of_file, left[n], (known.of_file, fitted[n])) for n in (best, PLAIN.index(FRICTION))
    )
    there = Unseen(last[0], coefficients, unseen.of_file, left[best], known.cutoff, first[0], known.of_file)
    whole = known
    if other is None:
        along = along.with_shapes(Along(body, dynamics, motion, expected_sign(motion)), known.shaped, known.shapes)
        whole = _near(of(motion=motion, along=along, factor=gains.factor, gain=found.motors), gains)
    fit = weighted_fit(whole, motion, rules, PLAIN[best], _columns_of(known, gains), others=True)
    numbers = (*of_joints(whole, fit, gains), *of_links(whole, fit, body))
    return Regression(
        body.joint_names,
        stated(whole, fit, gains, memory, numbers),
        numbers,
        torque,
        plain,
        len(motion.time),
        named(whole, fit.chosen, gains),
        there,
        drawn(whole, fit, gains),
        {name: 1 / g for name, g in zip(body.joint_names, gains.factor.tolist(), strict=True) if g != 1.0},
        tuple(of_others(whole, fit, gains)),
        frozenset(whole.kinds).difference(without),
        int(motion.recording.max()) + 1,
    )


def _missed(found: Mapping, body: ArticulatedBody, motion: MeasuredMotion, cutoff: float) -> np.ndarray:
    """(R, K) that an arm under no torque misses with what was found (:mod:`.as_model`)."""
    file = model_on(motion, body, passive=True)
    return torque_missed(with_coefficients(file, found), motion, cutoff, file)


@dataclass(frozen=True)
class _Tried:
    """Fits as `PLAIN` has them, about servos' `gains`: to rows that are `known`, and what they leave of `unseen` ones.

    Columns of links are of motors with the gains `motors` (K,).

    `best` is the number of the fit that is the answer, `left` (R, K) is of each.
    """

    known: LinearEffects
    unseen: LinearEffects
    gains: ServoGains
    motors: np.ndarray
    fits: list[Fitted]
    left: list[np.ndarray]
    best: int

    def no_better_than(self, filed: "_Tried") -> np.ndarray:
        """(K,) whether a gain leaves as much as the file does, or as a fit about the file's with a gain near that.

        Shares of what a servo then gives are compared with that fit, unless most servos' gains are far: they are equal.
        """
        own, other = (_rms(each.left[each.best]) for each in (self, filed))
        share, before = own / np.maximum(self.unseen.given, 1e-300), other / np.maximum(filed.unseen.given, 1e-300)
        near = ~_gains_of(filed.known, filed.fits[filed.best].chosen).far.changed
        as_much = (FIXED.max_behind_plain * share > before) & near & (self.gains.changed.mean() <= 0.5)
        return self.gains.changed & (as_much | (FIXED.max_behind_plain * own > _rms(self.unseen.of_file)))


Rows = tuple[MeasuredMotion, Expected]


def _with_shapes(
    of: Callable[..., LinearEffects],
    first: Rows,
    last: Rows,
    shaped: Sequence[Shaped],
    pieces: Sequence[Along],
    rules: Rules,
    gains: ServoGains,
) -> _Tried:
    """Fits of linear effects, then of ``shaped`` ones too, along the ``pieces`` of motion that both rows are."""
    found = _tried(of, first, last, gains, rules)
    shapes: Shapes | None = first_shapes(shaped, pieces[0], found.known, found.fits[0], found.gains.factor)
    for _ in range(FIXED.shape_passes):
        if not shapes:
            break
        rows = [(m, a.with_shapes(piece, shaped, shapes)) for piece, (m, a) in zip(pieces, (first, last), strict=True)]
        found = _tried(of, rows[0], rows[1], gains, rules, found.fits[PLAIN.index(FRICTION) :])
        shapes = nearer_shapes(shaped, pieces[0], found.known, found.fits[0], found.gains.factor)
    return found


def _tried(
    of: Callable[..., LinearEffects],
    first: Rows,
    last: Rows,
    gains: ServoGains,
    rules: Rules,
    plain_fits: Sequence[Fitted] = (),
) -> _Tried:
    """Fits to ``first`` about ``gains``, or nearer ones, and the choice among them by the ``last`` rows.

    ``plain_fits`` are those without a choice, where they are known.
    """
    for _ in range(FIXED.servo_gain_passes if gains.changed.any() else 0):
        known = of(motion=first[0], along=first[1], factor=gains.factor)
        chosen = weighted_fit(known, first[0], rules, None, _columns_of(known, gains)).chosen
        if (better := _nearer(known, chosen, gains)) is gains:
            break
        gains = better
    gains, found = gains.far, np.zeros(len(gains.factor))
    for _ in range(2):  # a motor's gain times a link's number is of second order: it is known once both are, nearly
        motors = found
        of_gains = partial(of, factor=gains.factor, gain=motors)
        known, unseen = (_near(of_gains(motion=motion, along=along), gains) for motion, along in (first, last))
        before = _columns_of(known, gains)
        every = PLAIN[: PLAIN.index(FRICTION)] if plain_fits else PLAIN
        fits = [*(weighted_fit(known, first[0], rules, plain, before) for plain in every), *plain_fits]
        found = _gains_of(known, fits[0].chosen).factor - 1
        if gains.changed.any() or not found.any():  # the links are the file's there
            break
    left = [left_by(unseen, each.chosen) for each in fits]
    size = np.maximum(_rms(unseen.missing), 1e-300)
    tolerated = rules.evidence.tolerance * unseen.required
    errors = [float(np.linalg.norm(np.hypot(_rms(each), tolerated) / size)) for each in left]
    whole = [float(np.linalg.norm(_rms(each))) for each in left]
    other = min((n for n in range(len(left)) if whole[n] <= FIXED.max_behind_plain * whole[0]), key=errors.__getitem__)
    behind = errors[0] > max(FIXED.max_behind_plain * errors[other], errors[other] + FIXED.min_plain_gain)
    return _Tried(known, unseen, gains, motors, fits, left, other if behind else 0)


def _rms(values: np.ndarray) -> np.ndarray:
    """Of rows (R, K), by joint (K,)."""
    return np.asarray(np.sqrt((values**2).mean(0)))


def _columns_of(effects: LinearEffects, servos: ServoGains) -> list[int]:
    """Columns of the gains that were estimated first."""
    new = {place for place, changed in zip(joints_of(effects), servos.changed, strict=True) if changed}
    every = enumerate(zip(effects.kinds, effects.places, strict=True))
    return [p for p, (kind, place) in every if kind == GAIN and place in new]


def _near(effects: LinearEffects, servos: ServoGains) -> LinearEffects:
    """Gains that were found first stay within what a regression about them takes; others are the file's then."""
    own = _columns_of(effects, servos)
    least = effects.least.copy()
    least[own] = math.exp(-FIXED.linear_servo_gain) - 1
    return replace(effects, least=least)


def _gains_of(effects: LinearEffects, chosen: Chosen) -> ServoGains:
    """Gains that a choice has, times those that it is about."""
    found = {
        effects.places[p]: 1 + v for p, v in zip(chosen.columns, chosen.values, strict=True) if effects.kinds[p] == GAIN
    }
    return ServoGains(np.array([found.get(place, 1.0) for place in joints_of(effects)]))


def _nearer(effects: LinearEffects, chosen: Chosen, servos: ServoGains) -> ServoGains:
    """Servos' gains about which the next regression is made; the same where this one finds them."""
    more = np.where(servos.changed, _gains_of(effects, chosen).factor, 1.0)
    if np.abs(np.log(more)).max() < FIXED.equal_servo_gain:
        return servos
    return ServoGains(servos.factor * more)
