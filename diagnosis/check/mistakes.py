"""What may be wrong with a log, rather than with a simulation: signs, zeros, units, columns, gears, offsets.

Each mistake is a change of the log that would put it right. It is believed where the torques are far from what the
motion asks for (:mod:`.torque_regression`), and near it once it is put right:

    τ' = s τ  under  θ' = z + s (θ − z) − c,   s = ±1,   z where the log has 0;
    t' = t/1000;     θ' = θ π/180;     columns exchanged;
    τ' = N τ;     τ' = τ − b

Several at once are found one after the other, those first that put most right. At the end each must have brought the
torques of the joints that it accuses to what a log that is right leaves of them, in a unit that no remedy changes: what
the motion asks of these joints. Else the last one is no mistake, and what comes before it is tested again.

A remedy is of a column that the log has: of a servo's target where no torque was logged. One that a mapping has already
is none. A joint that does not move is accused of nothing.

Shapes: K joints.
"""

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations
from operator import methodcaller

import numpy as np
from scipy.optimize import minimize_scalar

from invdyn.diagnosis.check.robot_terms import RobotTerms, servos
from invdyn.diagnosis.check.torque_fit import Explained, TorqueFit, share
from invdyn.diagnosis.check.torque_regression import Motion
from invdyn.diagnosis.rules import FIXED, Rules
from invdyn.inference.plausible_for_body import slides
from invdyn.recordings.logs.mapping import SHIFTS
from invdyn.recordings.units import TIMES, Units

TIME_UNITS = {"s": "seconds", "ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds"}
FITTED = ("zero", "scale", "gain", "offset")
"""Kinds with a number that is fitted: of equally good ones, one without a number comes first (Occam's razor). An arm of
one joint whose direction is the other way could have a zero elsewhere, but only a single one."""


@dataclass(frozen=True)
class Mistake:
    """Something that is wrong with a log.

    Attributes:
        kind: "torque sign", "direction", "angle sign", "zero", "degrees", "radians", "percent", "time", "exchanged",
            "gear", "scale", "gain" or "offset"; those of :mod:`.rows` and of :mod:`.command_times`.
        joints: which ones, by number; none for the whole log.
        words: what is wrong, after "at joint …" where there are joints.
        remedy: what to do about it.
        value: the zero, rad; the factor that torques, targets, gains or times lack; the gear; the offset, N·m.
        right: the motion with it put right; None where that motion cannot have it.
        scales: of a unit, the factors of `angle`, `target` and `time` that a :class:`.Reading` is put right by.
    """

    kind: str
    joints: tuple[int, ...]
    words: str
    remedy: str
    value: float
    right: Callable[[Motion], Motion | None] = lambda motion: None
    scales: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Found:
    """A mistake, and others that would do it nearly as well.

    `before` and `after` are what its joints' torques miss of what the motion asks of them, without and with the remedy,
    of a body with the numbers that fit once all mistakes are put right. `misfit` is that of all torques as they were.
    """

    mistake: Mistake
    before: float
    after: float
    others: tuple[Mistake, ...] = ()
    misfit: float = math.nan


def find(
    fit: TorqueFit, motion: Motion, *, encoders: bool, said: Units | None = None
) -> tuple[list[Found], Found | None]:
    """Mistakes of a log, none where it is right; and the first that was dropped, as its remedy leaves too much.

    Of angles and columns there are mistakes only where there are ``encoders``; ``said`` are the log's units, and where
    they stand. All are tried on few rows of the motion; the likely ones, and what is stated, on all.
    """
    rules, found = motion.rules.check, list[Found]()
    states, lefts = [motion], [fit.explain(motion)]
    while len(found) < rules.max_mistakes:
        own = lefts[-1].misfit
        if not own > rules.min_misfit:
            break
        few = states[-1].thinned(rules.scan_rows)
        scanned = sorted(_tried(fit, few, encoders, said), key=lambda each: each[0])
        likely = [m for left, m in scanned if left < max(rules.equal_misfit**2 * scanned[0][0], rules.min_misfit)]
        again = ((left_by(mistake, fit, states[-1]), mistake) for mistake in likely[: rules.max_refitted])
        tried = sorted(again, key=lambda each: each[0])
        limit = min(rules.max_remaining * own, rules.max_right_misfit)
        worth = [(misfit, mistake) for misfit, mistake in tried if misfit < limit]
        if not worth:
            break
        limit = max(rules.equal_misfit * worth[0][0], rules.min_misfit)
        rivals = [(misfit, mistake) for misfit, mistake in worth if misfit < limit]
        small = bool(np.ptp(states[-1].q, axis=0).max() < math.tau)
        best = min(rivals, key=partial(_order, small))[1]
        others = tuple(mistake for _, mistake in rivals if mistake is not best)
        found.append(Found(best, math.nan, math.nan, others, own))
        states.append(best.right(states[-1]) or states[-1])
        lefts.append(fit.explain(states[-1]))
    dropped = None
    while found and any(lefts[len(found)].missed(each.mistake.joints) > rules.max_joint_misfit for each in found):
        dropped = _stated(fit, [found.pop()], states[len(found) :], lefts[len(found) + 1])[0]
    return _stated(fit, found, states, lefts[len(found)]), dropped


def _order(small: bool, rival: tuple[float, Mistake]) -> tuple[bool, bool, bool, float, tuple[int, ...]]:
    """Which of equally good mistakes is said first; of two that mirror each other, that of the joint nearer the base.

    A gear of −1 that the file states is named before a sign that is nowhere written.
    Misfits are rounded: those of an arm and of its mirror image differ in the last digit alone.
    """
    misfit, mistake = rival
    degrees, joints = small and mistake.kind == "degrees", mistake.joints
    return degrees, mistake.kind in FITTED, mistake.kind != "gear", round(misfit, 9), joints


def _stated(fit: TorqueFit, found: Sequence[Found], states: Sequence[Motion], right: Explained) -> list[Found]:
    """Mistakes with what their joints miss before and after each, by the numbers that fit once all are put right."""
    left = [fit.left_by_values(each, right.values) for each in states[: len(found) + 1]]
    shares = [[share(each, right.required, own.mistake.joints) for each in left] for own in found]
    numbered = enumerate(zip(found, shares, strict=True))
    return [replace(each, before=of[n], after=of[n + 1]) for n, (each, of) in numbered]


def fixed(joints: int, encoders: bool, by_target: Sequence[bool] = ()) -> Iterator[Mistake]:
    """Those without a number that is looked for; ``by_target`` are joints whose log has a servo's target, no torque."""
    servo = np.array(by_target or [False] * joints)
    for group in _groups(joints):
        commands = _commands(servo[list(group)])
        turn = f"change the sign of its {commands}"
        words, right = f"the {commands} have the other sign", methodcaller("mirrored", group, torque=True)
        yield Mistake("torque sign", group, words, turn, -1.0, right)
        if encoders:
            words, turn = f"angles and {commands} are counted the other way (clockwise)", "change the signs of both"
            right = methodcaller("mirrored", group, angle=True, torque=True)
            yield Mistake("direction", group, words, turn, -1.0, right)
            words = f"the angles are counted the other way (clockwise), the {commands} are not"
            turn = "change the sign of its angles"
            yield Mistake("angle sign", group, words, turn, -1.0, methodcaller("mirrored", group, angle=True))
    if not encoders:
        return
    for one, other in combinations(range(joints), 2):
        order, plain = list(range(joints)), list(range(joints))
        order[one], order[other] = other, one
        commands = _commands(servo[[one, other]])
        for angles, torques, what in ((order, order, "columns"), (order, plain, "angles"), (plain, order, commands)):
            words, turn = f"the {what} are exchanged", f"exchange the two joints' {what}"
            yield Mistake("exchanged", (one, other), words, turn, 0.0, methodcaller("picked", angles, torques))


def _commands(by_target: np.ndarray) -> str:
    """What the log has of some joints."""
    return "servos' targets" if by_target.all() else "torques and servos' targets" if by_target.any() else "torques"


def _groups(joints: int) -> list[tuple[int, ...]]:
    """Each joint, and all of them together."""
    return [(k,) for k in range(joints)] + ([tuple(range(joints))] if joints > 1 else [])


def units(
    said: Units | None = None, targets: bool = False, stated: Mapping[str, Collection[str | None]] | None = None
) -> Iterator[Mistake]:
    """Of angles and times, in which :mod:`invdyn.recordings.plausible` may already have seen something wrong.

    Args:
        said: what was declared, and where: there it is put right.
        targets: there are servos' targets, which may be in another unit, too.
        stated: of a mapping, the units of its lines of an angle and of a target, None where a line says none: what
            stands there already is no remedy.
    """
    said = said or Units()
    stated = stated or {track: {said.angle} for track in ("angle", "target")}
    ways = (("degrees", "deg", "in degrees", math.pi / 180), ("radians", "rad", "in radians already", 180 / math.pi))
    for tracks in (("angle",), ("angle", "target"), ("target",))[: 1 + 2 * targets]:
        what = " and ".join({"angle": "the angles", "target": "the servos' targets"}[track] for track in tracks)
        own = {unit for track in tracks for unit in stated[track] if unit not in SHIFTS}
        for kind, unit, words, factor in ways:
            if not own <= ({None, "rad"} if unit == "deg" else {"deg"}):
                continue
            scales = dict.fromkeys(tracks, factor)
            right = methodcaller("in_unit", **scales)
            yield Mistake(kind, (), f"{what} are {words}", said.put(unit, tracks), factor, right, scales)
    for unit, name in TIME_UNITS.items():
        if unit == (said.time or "s"):
            continue
        factor = TIMES[unit] / TIMES.get(said.time or "s", 1.0)
        right, scales = methodcaller("in_time", factor), {"time": factor}
        yield Mistake("time", (), f"the times are in {name}", said.put(unit), factor, right, scales)


def gears(terms: RobotTerms, place: str, rules: Rules) -> Iterator[Mistake]:
    """Targets of servos that are counted where the actuator is, as MuJoCo's ctrl, or at the joint, and not as said.

    ``place`` is the mapping that says it.
    """
    said, filed, joints = terms.target.gear, terms.gears, len(terms.gears)
    for at, gear in (("the actuator, gear times the joint's (MuJoCo's ctrl)", filed), ("the joint", np.ones(joints))):
        off = np.abs(gear - said) > rules.check.gear_tolerance * np.abs(gear)
        wrong = [k for k in range(joints) if terms.by_target[k] and off[k]]
        for group in dict.fromkeys([tuple(wrong), *((k,) for k in wrong)]):
            if not group:
                continue
            numbers = " and ".join(f"gear = {gear[k]:g}" for k in group)
            turn = f'write {numbers} in the line "target = …" of each, in {place}'
            factor = np.ones(joints)
            factor[list(group)] = (said / gear)[list(group)]
            words, right = f"the servos' targets are counted at {at}", methodcaller("retargeted", factor)
            yield Mistake("gear", group, words, turn, float(gear[group[0]]), right)


def left_by(mistake: Mistake, fit: TorqueFit, motion: Motion) -> float:
    """The misfit of a motion once a mistake is put right; infinite where it cannot have it."""
    righted = mistake.right(motion)
    return math.inf if righted is None else fit.explain(righted).misfit


def known(motion: Motion, encoders: bool, said: Units | None) -> Iterator[Mistake]:
    """All without a number that is looked for."""
    terms, place = motion.terms, None if said is None else said.mapping
    yield from fixed(motion.q.shape[1], encoders, terms.by_target)
    if encoders:
        yield from units(said, any(terms.by_target), None if place is None else terms.stated)
    if place is not None:
        yield from gears(terms, place, motion.rules)


def _tried(fit: TorqueFit, motion: Motion, encoders: bool, said: Units | None) -> Iterator[tuple[float, Mistake]]:
    """All mistakes with the misfit that is left once each is put right."""
    joints, by_target, rules = motion.q.shape[1], motion.terms.by_target, motion.rules.check
    moving = np.ptp(motion.q, axis=0) > FIXED.negligible

    def left(mistake: Mistake) -> float:
        return left_by(mistake, fit, motion)

    if not moving.any():
        return
    for mistake in known(motion, encoders, said):
        if moving[list(mistake.joints)].all():
            yield left(mistake), mistake
    shifting = slides(fit.body)
    for k in np.flatnonzero(moving).tolist() if encoders else ():
        if fit.body.joint_names[k] in shifting:  # its zero is in m, and its dynamics no sum of cosines
            continue
        where = "its angles" if said is None or said.mapping is None else f"its zero in {said.mapping}"
        made = partial(zero, int(k), sign=float(motion.terms.sign[k]), where=where)
        at = fit.recounted(motion, k)
        by_zero = partial(_misfit_at, at)
        yield from _searched(made, by_zero, np.array(rules.zero_grid), math.radians(30), rules.min_zero)
    for group in _groups(joints):
        if moving[list(group)].all() and len({by_target[k] for k in group}) == 1:
            for factored in (_scale, _gain)[: 1 + by_target[group[0]]]:
                scaled = partial(factored, group, joints, by_target[group[0]])
                by_factor, grid = partial(_misfit_of, left, scaled), np.log(rules.factor_grid)
                yield from _searched(scaled, by_factor, grid, 0.6, math.log(rules.max_gain), ends=True)
    for k in np.flatnonzero(moving).tolist():
        free = fit.explain(motion, (k,))
        offset = float(free.values[-1])
        if np.ptp(motion.q[:, k]) < rules.min_turn:  # a constant is not told from its weight
            continue
        if abs(offset) > rules.min_offset * np.sqrt((motion.torque[:, k] ** 2).mean()):
            yield free.misfit, _offset(k, motion, offset)


def _misfit_at(at: Callable[[float], Explained], value: float) -> float:
    return at(value).misfit


def _misfit_of(left: Callable[[Mistake], float], made: Callable[[float], Mistake], value: float) -> float:
    return left(made(value))


def _searched(
    made: Callable[[float], Mistake],
    misfit: Callable[[float], float],
    grid: np.ndarray,
    width: float,
    least: float,
    ends: bool = False,
) -> Iterator[tuple[float, Mistake]]:
    """The best value of a number, on a grid and then within ``width`` of it, unless it is under ``least``.

    A grid that ``ends`` has none at its ends: there one joint's torques are so large that no other's count.
    """
    best = min(grid, key=misfit)
    near = minimize_scalar(misfit, bounds=(best - width, best + width), method="bounded", options={"xatol": 2e-3})
    far = ends and not grid.min() - 0.9 * width < near.x < grid.max() + 0.9 * width
    if abs(near.x) >= least and not far:
        yield float(near.fun), made(float(near.x))


def zero(joint: int, off: float, sign: float = 1.0, where: str = "its angles") -> Mistake:
    """A joint's angles are counted from ``off`` rad elsewhere; of a robot that counts by ``sign`` it is said so."""
    off = math.remainder(off, math.tau)
    shown = sign * off
    words = f"the angles' zero is {math.degrees(shown):+.0f}° off"
    turn = f"subtract {shown:.3g} rad ({math.degrees(shown):.0f}°) from {where}"
    return Mistake("zero", (joint,), words, turn, shown, lambda motion: motion.recounted(joint, off))


def _scale(group: tuple[int, ...], joints: int, by_target: bool, log: float) -> Mistake:
    factor = math.exp(log)
    given = np.ones(joints)
    given[list(group)] = factor
    commands = "servos' targets" if by_target else "torques"
    if factor > 1:
        before = "behind" if by_target else "before"
        words = f"the {commands} are {factor:.3g} times too small: {before} the gear, or in another unit"
    else:
        words = f"the {commands} are {1 / factor:.3g} times too large: in another unit"
        words += ", or before the gear" if by_target else ""
    turn = f"multiply its {'targets' if by_target else 'torques'} by {factor:.3g}"
    right = methodcaller("retargeted" if by_target else "commanded", given)
    return Mistake("scale", group, words, turn, factor, right)


def _gain(group: tuple[int, ...], joints: int, by_target: bool, log: float) -> Mistake:
    """A servo's gains in the robot's own file, which are as wrong as a unit in the log would be."""
    factor = math.exp(log)
    given = np.ones(joints)
    given[list(group)] = factor
    off = f"{factor:.3g} times too small" if factor > 1 else f"{1 / factor:.3g} times too large"
    turn = f"multiply them (kp and kv in MJCF) by {factor:.3g}, if the robot's controller says so"
    words = f"the servos' gains in the robot's file are {off}"
    return Mistake("gain", group, words, turn, factor, methodcaller("strengthened", given))


def _offset(joint: int, motion: Motion, offset: float) -> Mistake:
    """A constant torque; of a servo, whose log has none, it is one of its target to what the encoder shows."""
    constant = np.zeros(motion.q.shape[1])
    constant[joint] = offset
    words = f"the torques are {offset:+.3g} N·m off all along"
    turn = f"subtract {offset:.3g} N·m from its torques"
    if (servo := servos(motion.terms.body)[joint]) is not None:
        off = motion.terms.sign[joint] * offset / servo.gain
        unit, shown = ("rad", "angles") if servo.kind == "position" else ("rad/s", "velocities")
        words = f"the servo's targets are {off:+.3g} {unit} off against its {shown} all along"
        turn = f"subtract {off:.3g} {unit} from its targets"
        turn += f", or {-off:.3g} rad from its angles" if servo.kind == "position" else ""
    return Mistake("offset", (joint,), words, turn, offset, methodcaller("commanded", more=-constant))
