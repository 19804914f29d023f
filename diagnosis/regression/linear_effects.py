"""Effects that torque is linear in, as columns along a smoothed motion: what the torque is expected to be.

A motion is known as a Gaussian at each row. Regressors are expectations given what was seen, E[Y|y], so that noise in
encoders biases nothing (regression calibration: Carroll, Ruppert, Stefanski & Crainiceanu 2006, ch. 4). Those of q̇ and
q̈ are means; of dry friction E[sgn q̇] = 2 Φ(m/s) − 1 for q̇ ~ N(m, s²). What stays unknown, var[Y|y], weakens a row.

    viscous     q̇                    Coulomb     sgn q̇                 rotor    q̈
    spring      q and a constant     constant    1                     gain     the torque that the file asks for
    link        Y(q, q̇, q̈) of its m, m c and J (:mod:`.regressors`)

A gain multiplies what was commanded, whose noise would bias it. Its column is what the file asks for: an instrument.
Servos' gains are near to what :mod:`.servo_gains` says; their own damping counts as the joint's. Rows at which such a
servo reaches its limits do not count, and what it gives there is not its gain's. Gains and masses have a factor in
common, which no torque tells: where gains are far from the file's, the links are the file's. What is missing and all
columns pass one filter (:mod:`.low_pass`).
Where no torque acts there are friction and links alone: a spring looks like a weight there, and a rotor like a link.
Friction that differs by direction, f₊ and f₋, is (f₊ + f₋)/2 of dry friction and a constant (f₊ − f₋)/2.

Shapes: R rows, K joints, P columns. Units: rad, s, N·m.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.special import erf

from invdyn.diagnosis.catalogue.linear_laws import (
    DAMPING,
    FILED,
    FRICTION,
    GAIN,
    INERTIAL,
    JOINT_KINDS,
    LINK_MASS,
    LOWER_BOUNDS,
)
from invdyn.diagnosis.regression.columns import Columns
from invdyn.diagnosis.regression.low_pass import low_passed
from invdyn.diagnosis.regression.measured_motion import MeasuredMotion, limited
from invdyn.diagnosis.regression.regressors import (
    all_but_the_largest,
    filed_torques,
    inverse,
    link_names,
    link_regressors,
    nominal_link_numbers,
    unit_numbers,
)
from invdyn.diagnosis.regression.shaped_effects import Along, Shape, Shaped, lowest, sizes_of
from invdyn.diagnosis.rules import FIXED, Rules
from invdyn.models.dynamics.interface import Dynamics


@dataclass(frozen=True)
class LinearEffects:
    """Columns along a motion.

    Attributes:
        missing: (R, K) torque that was given, less what the file asks for: by servos with the gains that they have.
        of_file: (R, K) the same by the file's servos, in their limits.
        usable: (R, K) whether no servo is at its limits.
        columns: expected torque of each column's unit; variance: of it.
        kinds, places, names, units: (P,) effect, joint or link, parameter, its unit.
        size: (P,) sd of the prior where an effect is as large as is usual.
        least: (P,) smallest value.
        unit: (K,) N·m, of an effect as large as is usual.
        required: (K,) rms of the torque that the file asks for, or that was given, where that is more.
        given: (K,) rms of the torque that was given.
        free: (P,) whether a column may be chosen. Where no torque acts, all links could be without mass: there the
            base parameter that asks for most torque is the file's.
        cutoff: Hz, of the filter.
        own_numbers: what the file has of links' columns, (P,) up to theirs.
        shapes: of the `shaped` effects, by effect and joint.
    """

    missing: np.ndarray
    of_file: np.ndarray
    usable: np.ndarray
    columns: Columns
    variance: Columns
    kinds: tuple[str, ...]
    places: tuple[str, ...]
    names: tuple[str, ...]
    units: tuple[str, ...]
    size: np.ndarray
    least: np.ndarray
    unit: np.ndarray
    required: np.ndarray
    given: np.ndarray
    free: np.ndarray
    cutoff: float
    own_numbers: np.ndarray = field(default_factory=lambda: np.zeros(0))
    shapes: Mapping[tuple[str, str], Shape] = field(default_factory=dict)
    shaped: tuple[Shaped, ...] = ()


@dataclass(frozen=True)
class Expected:
    """Along a motion what the file asks for, (R, K), and columns' means and variances, before any filter.

    Of each column `labels` has its effect, the number of its joint, and which of the effect's parameters; then come
    links', and those of effects that are `shaped`, with shapes as they are in `shapes`.
    """

    required: np.ndarray
    columns: Columns
    variance: Columns
    labels: tuple[tuple[str, int, int], ...]
    shaped: tuple[Shaped, ...] = ()
    shapes: Mapping[tuple[str, str], Shape] = field(default_factory=dict)

    def at(self, rows: slice) -> "Expected":
        """Some neighbouring rows of it."""
        columns, variance = (each.map(lambda X: X[:, rows]) for each in (self.columns, self.variance))
        return replace(self, required=self.required[rows], columns=columns, variance=variance)

    def with_shapes(
        self, along: Along, shaped: Sequence[Shaped], shapes: Mapping[tuple[str, str], Shape]
    ) -> "Expected":
        """The same with columns of effects whose shapes are known."""
        values, at, number = [[X] for X in self.columns.values], [[own] for own in self.columns.at], self.columns.number
        for each in shaped:
            for column in along.columns(each, shapes[each.key].value):
                for k in np.flatnonzero(column.any(0)):
                    values[k].append(column[None, :, k].numpy())
                    at[k].append(np.array([number]))
                number += 1
        columns = Columns(tuple(map(np.concatenate, values)), tuple(map(np.concatenate, at)), number)
        return replace(
            self,
            columns=columns,
            variance=replace(self.variance, number=number),
            shaped=tuple(shaped),
            shapes=shapes,
        )


def expected(dynamics: Dynamics, body: Any, motion: MeasuredMotion, passive: bool) -> Expected:
    """All columns of a body along a motion; where it is ``passive``, of friction and links alone."""
    K, sign, required = motion.q.shape[1], expected_sign(motion), required_by_file(dynamics, body, motion)
    one, none = np.ones_like(motion.q), np.zeros_like(motion.q)
    columns = (
        [(motion.qd, motion.qd_sd**2)],
        [(sign, 1 - sign**2)],
        [(motion.qdd, motion.qdd_sd**2)],
        [(motion.q, none), (-one, none)],
        [(one, none)],
        [(required, none)],
    )
    made = dict(zip(JOINT_KINDS, columns, strict=True))
    kinds = FRICTION if passive else tuple(made)
    labels = tuple((kind, k, n) for kind in kinds for k in range(K) for n in range(len(made[kind])))
    at = [np.array([p for p, (_, joint, _) in enumerate(labels) if joint == k]) for k in range(K)]
    means, variances = (
        [np.stack([made[kind][n][m][:, k] for kind, _, n in (labels[p] for p in at[k])]) for k in range(K)]
        for m in (0, 1)
    )
    links, of_links, number = _links(dynamics, body, motion)
    every = tuple(np.concatenate(each) for each in zip(means, links, strict=True))
    places = tuple(np.concatenate([own, len(labels) + mine]) for own, mine in zip(at, of_links, strict=True))
    return Expected(
        required,
        Columns(every, places, len(labels) + number),
        Columns(tuple(variances), tuple(at), len(labels) + number),
        labels,
    )


def _links(dynamics: Dynamics, body: Any, motion: MeasuredMotion) -> tuple[list[np.ndarray], list[np.ndarray], int]:
    """Links' columns (P_k, R) of each joint, which of all they are, and how many there are."""
    (R, K), units = motion.q.shape, unit_numbers(body)
    some = SimpleNamespace(**dict(zip(("q", "qd", "qdd"), np.random.default_rng(0).random((3, 3, K)), strict=True)))
    generic = link_regressors(dynamics, body, some, units)
    # a link moves the joints that it hangs from, and no others, in every motion
    at = [np.flatnonzero(generic[:, :, k].any(1)) for k in range(K)]
    found = [np.empty((len(own), R)) for own in at]
    for begin in range(0, R, FIXED.regressor_rows):
        rows = slice(begin, begin + FIXED.regressor_rows)
        block = link_regressors(dynamics, body, motion.at(rows), units)
        for k, own in enumerate(at):
            found[k][:, rows] = block[own, :, k]
    return found, at, len(generic)


def linear_effects(
    body: Any,
    motion: MeasuredMotion,
    along: Expected,
    passive: bool,
    rules: Rules,
    cutoff: float,
    factor: np.ndarray | float = 1.0,
    gain: np.ndarray | float = 0.0,
    without: Collection[str] = (),
) -> LinearEffects:
    """All columns of a body ``along`` a motion, in frequencies up to ``cutoff``, Hz.

    ``factor`` (K,) is how many times a servo makes too much of its target's distance. Of motors whose ``gain`` (K,) is
    known nearly, what a link takes is commanded 1 + g times. Effects ``without`` are not to be chosen.
    """
    joints, factors = body.joint_names, np.broadcast_to(factor, motion.q.shape[1])
    required, number = along.required, along.columns.number
    wanted, drag = motion.demanded / factor - motion.servo_drag, motion.servo_drag
    given = limited(body, wanted, motion.within / factor)
    needed, used = (np.sqrt((each**2).mean(0)) for each in (required, given + drag))
    whole = np.maximum(needed, used)
    unit = np.maximum(np.maximum(whole, rules.check.min_torque_scale * whole.max()), 1e-12)
    size, least, names = np.zeros(number), np.full(number, -np.inf), []
    for p, (kind, k, n) in enumerate(along.labels):
        name, of = JOINT_KINDS[kind][n]
        column = along.columns.of(p, k)
        moved = column - motion.q[:, k].mean() if name == "stiffness" else column
        found_first = kind == GAIN and factors[k] != 1.0
        size[p] = 1.0 if found_first else unit[k] / max(float(np.sqrt((moved**2).mean())), 1e-12)
        own = body.joint_parts[k]
        least[p] = LOWER_BOUNDS.get(kind, -np.inf)
        if kind in FILED and n == 0:
            own_damping = own.servo_damping if kind == DAMPING else 0.0
            least[p] = -getattr(own, FILED[kind]) - own_damping + 0.0
        names.append((kind, joints[k], name, of))
    usable, count = limited(body, wanted, np.zeros_like(wanted)[:, None]) == wanted, len(along.labels)
    more = [(each, parameter) for each in along.shaped for parameter in each.sizes]
    last = number - len(more)
    by_command = np.array([kind == GAIN for kind, _, _ in along.labels] + [False] * (number - count))
    by_command[last:] = [each.of_command for each, _ in more]
    by, times = np.broadcast_to(1 + np.asarray(gain), len(joints)), np.ones(number)
    times[last:] = [1 / factors[each.joint] if each.of_command else 1.0 for each, _ in more]
    shown = [
        np.where(by_command[at][:, None], usable[:, k], np.where((at < count) | (at >= last), 1.0, by[k])[:, None])
        * times[at][:, None]
        for k, at in enumerate(along.columns.at)
    ]
    columns = replace(along.columns, values=tuple(X * own for X, own in zip(along.columns.values, shown, strict=True)))
    numbers = nominal_link_numbers(body)
    links, free = np.arange(count, last), np.ones(number, dtype=bool)
    own_numbers = np.concatenate([each.ravel() for each in (*numbers, np.zeros(0))])
    floors = [np.full(each.size, max(float(np.abs(each).max()), 1e-12)) for each in numbers]
    size[links] = np.maximum(np.abs(own_numbers), FIXED.min_link_share * np.concatenate([*floors, np.zeros(0)]))
    if passive and len(links):
        free[links] = all_but_the_largest(columns.triangle(links), own_numbers)
    if (factors != 1.0).any():
        free[links] = False
    names += [(INERTIAL, link, name, of) for name, of in link_names(body, numbers) for link in body.link_names]
    names += [(*each.key, parameter.name, parameter.unit) for each, parameter in more]
    least[last:] = [lowest(parameter) for _, parameter in more]
    for p in range(last, number):
        found = {k: columns.of(p, k) for k in range(len(joints)) if p in columns.at[k]}
        size[p] = sizes_of(np.stack([*found.values()], -1)[None], unit[[*found]])[0] if found else 1.0
    if len(links) and not passive:
        columns = columns.and_sums(links.reshape(-1, len(body.link_names)).T, np.append(np.zeros(count), own_numbers))
        names += [(LINK_MASS, link, "share", "1") for link in body.link_names]
        rest = len(names) - number
        size, least = np.append(size, np.ones(rest)), np.append(least, np.full(rest, FIXED.min_link_left - 1))
        free = np.append(free, np.full(rest, (factors == 1.0).all()))
    kinds, places, parameters, units = zip(*names, strict=True)
    free &= ~np.isin(kinds, [*without, *([LINK_MASS] if INERTIAL in without else [])])
    return LinearEffects(
        low_passed(given + drag - required, motion, cutoff),
        low_passed(motion.torque + drag - required, motion, cutoff),
        usable,
        columns.map(lambda X: np.ascontiguousarray(low_passed(X.T, motion, cutoff).T)),
        replace(along.variance, number=columns.number),
        kinds,
        places,
        parameters,
        units,
        size,
        least,
        unit,
        whole,
        used,
        free,
        cutoff,
        np.append(np.zeros(count), own_numbers),
        along.shapes,
        along.shaped,
    )


def joints_of(effects: LinearEffects) -> list[str]:
    """Names of the K joints."""
    return [place for kind, place in zip(effects.kinds, effects.places, strict=True) if kind == DAMPING]


def expected_sign(motion: MeasuredMotion) -> np.ndarray:
    """E[sgn q̇] (R, K)."""
    return np.asarray(erf(motion.qd / (np.sqrt(2) * np.maximum(motion.qd_sd, 1e-300))))


def required_by_file(dynamics: Dynamics, body: Any, motion: MeasuredMotion) -> np.ndarray:
    """What the file asks for along a motion, (R, K): of links, joints and servos' damping."""
    joints = filed_torques(body, motion.q, motion.qd, motion.qdd, expected_sign(motion))
    return inverse(dynamics, body.parameters(), motion) + np.stack(joints, -1) + motion.servo_drag
