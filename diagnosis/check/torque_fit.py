"""How much of the torques that were given a body's motion explains, with what a file may be wrong about left free.

Inverse dynamics are linear in a link's mass m, first moment m c and inertia J about its joint (Atkeson, An & Hollerbach
1986), and so is what a joint has besides:

    τ = Y(q, q̇, q̈) φ + b q̇ + f tanh(q̇/v) + I_a q̈,     φ = φ₀ + δ,     δ ~ N(0, (.3 φ₀)²),     b, f, I_a ≥ 0

The misfit is the root of the least value of mean ((u − τ)/u_rms)² + λ Σ (β/sd)²: 0 where all is explained, 1 where
nothing is. Normal equations are kept for each joint, as they depend on the motion alone: torques of another sign, unit
or gear cost one solution of P equations. Those of a joint counted from elsewhere follow from five motions, as Y is a
trigonometric polynomial of degree two in each angle:

    Y(q − c) = Σ_j D(c − c_j) Y(q − c_j),     D(x) = (1 + 2 cos x + 2 cos 2x)/5,     c_j = 2π j/5

Shapes: R rows, K joints, P unknowns. Units: rad, s, N·m.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy.linalg
from scipy.optimize import lsq_linear, nnls

from invdyn.diagnosis.check.torque_regression import Motion, joint_regressors, passive
from invdyn.diagnosis.regression.regressors import inverse, link_regressors, nominal_link_numbers, unit_numbers
from invdyn.diagnosis.rules import FIXED
from invdyn.models.dynamics.interface import Dynamics


@dataclass(frozen=True)
class Explained:
    """What a motion explains: `misfit` of all joints, of each (K,), and coefficients (P,) in the regressors' order.

    `left` (K,) N·m is the rms of what is not explained, `required` (K,) N·m of what is; `penalty` is λ Σ (β/sd)².
    `independent` values of the motion determine them, by ``factor.T @ factor`` (P, P) with a ``ridge`` λ.
    """

    misfit: float
    by_joint: np.ndarray
    values: np.ndarray
    left: np.ndarray
    required: np.ndarray
    penalty: float
    independent: float
    factor: np.ndarray
    ridge: float

    def missed(self, joints: Sequence[int]) -> float:
        """The misfit of these joints, all if none, in terms of what is required of them.

        No remedy that makes torques small, or another joint's large, makes that better.
        """
        return float(np.hypot(share(self.left, self.required, joints), np.sqrt(self.penalty)))

    def missed_elsewhere(self, joints: Sequence[int], more: int) -> float:
        """The same in rows that are not fitted, by generalised cross-validation (Craven & Wahba 1979).

        ``more`` numbers than the coefficients are fitted. One that its prior determines counts less than 1.
        """
        bound = scipy.linalg.solve_triangular(self.factor, np.eye(len(self.factor)), check_finite=False)
        numbers = more + len(bound) - self.ridge * float((bound**2).sum())
        return self.missed(joints) / max(1 - numbers / self.independent, FIXED.negligible)


def share(left: np.ndarray, required: np.ndarray, joints: Sequence[int]) -> float:
    """Of what is ``required`` (K,) of some joints, all if none, what is ``left`` (K,)."""
    of = list(joints) or slice(None)
    return float(np.linalg.norm(left[of]) / max(float(np.linalg.norm(required[of])), 1e-300))


@dataclass(frozen=True)
class _Equations:
    """Of one motion, joint by joint: columns (K, P, R), the file's own torques (R, K), what a unit moves (3K,)."""

    columns: np.ndarray
    required: np.ndarray
    moved: np.ndarray

    @cached_property
    def gram(self) -> np.ndarray:
        """Columns' products (K, P, P)."""
        return self.columns @ self.columns.transpose(0, 2, 1)


class TorqueFit:
    """Fits of a body's motions, with the equations of the last few kept. `of` joints are those that turn, (K,)."""

    def __init__(self, dynamics: Dynamics, body: Any):
        self.dynamics, self.body = dynamics, body
        quantities = nominal_link_numbers(body)
        self._own = np.concatenate([each.ravel() for each in (*quantities, np.empty(0))])
        largest = [np.full(each.size, max(float(np.abs(each).max()), 1e-12)) for each in quantities]
        self._floor = np.concatenate([*largest, np.empty(0)])
        self._units = unit_numbers(body)
        self._kept: dict[tuple[bytes, ...], _Equations] = {}

    def explain(self, motion: Motion, offsets: Sequence[int] = ()) -> Explained:
        """The misfit of a motion; at ``offsets`` joints a constant torque is free, whose values come last."""
        return self._solved(motion, self._equations(motion), offsets)

    def left_by_values(self, motion: Motion, values: np.ndarray) -> np.ndarray:
        """Rms (K,) N·m of what a motion's torques miss, with coefficients (P,) found in another by :meth:`explain`."""
        own = self._equations(motion)
        left = motion.torque - own.required - np.einsum("p,kpr->rk", values, own.columns[:, : len(values)])
        return np.asarray(np.sqrt((left**2).mean(0)))

    def recounted(self, motion: Motion, joint: int) -> Callable[[float], Explained]:
        """From the zero of a joint that turns, rad, to what the motion explains then."""
        nodes = math.tau * np.arange(5) / 5
        motions = [motion.recounted(joint, float(c)) for c in nodes]
        every = [self._made(each) for each in motions]
        # what springs of the file take is linear in the angle, and no trigonometric polynomial
        springs = [passive(self.body, each) for each in motions]
        columns = np.stack([each.columns for each in every])
        rigid = np.stack([each.required - spring for each, spring in zip(every, springs, strict=True)])

        def at(zero: float) -> Explained:
            angle = zero - nodes
            weight = (1 + 2 * np.cos(angle) + 2 * np.cos(2 * angle)) / 5
            moved = motion.recounted(joint, zero)
            required = np.tensordot(weight, rigid, 1) + passive(self.body, moved)
            return self._solved(moved, replace(every[0], columns=np.tensordot(weight, columns, 1), required=required))

        return at

    def _equations(self, motion: Motion) -> _Equations:
        key = tuple(each.tobytes() for each in (motion.q, motion.qd, motion.qdd))
        if (known := self._kept.get(key)) is None:
            if len(self._kept) >= FIXED.kept_equations:
                del self._kept[next(iter(self._kept))]
            known = self._kept[key] = self._made(motion)
        return known

    def _made(self, motion: Motion) -> _Equations:
        joints = joint_regressors(motion)
        constant = np.eye(motion.q.shape[1])[:, None] * np.ones_like(motion.q)
        links = link_regressors(self.dynamics, self.body, motion, self._units)
        columns = np.concatenate([links, joints, constant])
        rigid = (
            np.tensordot(self._own, links, 1) if len(links) else inverse(self.dynamics, self.body.parameters(), motion)
        )
        required = rigid + passive(self.body, motion)
        moved = np.maximum(np.sqrt((joints**2).mean(1)).sum(-1), 1e-12)
        return _Equations(np.ascontiguousarray(columns.transpose(2, 0, 1)), required, moved)

    def _solved(self, motion: Motion, own: _Equations, offsets: Sequence[int] = ()) -> Explained:
        rules, (rows, K), links = motion.rules.check, motion.torque.shape, len(self._own)
        size, needed = (np.sqrt((each**2).mean(0)) for each in (motion.torque, own.required))
        unit = np.maximum(np.maximum(size, rules.min_torque_scale * needed.max()), 1e-12)
        use = np.concatenate([np.arange(links + 3 * K), links + 3 * K + np.asarray(offsets, int)])
        of_links = rules.link_sd * np.maximum(np.abs(self._own), 0.01 * self._floor)
        sd = np.concatenate([of_links, np.tile(unit, 3) / own.moved, 100 * unit[list(offsets)]])
        weight = 1 / (unit**2 * rows * K)
        left = motion.torque - own.required
        columns = own.columns[:, use]
        A = np.tensordot(weight, own.gram, 1)[np.ix_(use, use)] * sd * sd[:, None]
        A[np.diag_indices_from(A)] += rules.ridge
        b = sd * np.einsum("kpr,rk,k->p", columns, left, weight, optimize=True)
        r = scipy.linalg.cholesky(A, check_finite=False)
        target = scipy.linalg.solve_triangular(r, b, trans="T", check_finite=False)
        scaled = _bounded(r, target, links, len(offsets))
        values = scaled * sd
        off = left - (values @ columns).T
        missed = (off**2).mean(0) / unit**2
        penalty = rules.ridge * float((scaled**2).sum())
        required = np.sqrt(((motion.torque - off) ** 2).mean(0))
        by_joint = np.sqrt(missed)
        misfit = float(np.sqrt(missed.mean() + penalty))
        independent = K * motion.independent
        return Explained(misfit, by_joint, values, by_joint * unit, required, penalty, independent, r, rules.ridge)


def _bounded(r: np.ndarray, target: np.ndarray, links: int, free: int) -> np.ndarray:
    """The x (P,) within bounds that is nearest to ``r x = target``, of a triangular ``r`` (P, P).

    ``links`` numbers come first, and seldom to their bounds; then joints', not negative; ``free`` ones come last.
    """
    plain = np.asarray(scipy.linalg.solve_triangular(r, target, check_finite=False))
    end = len(target) - free
    if np.abs(plain[:links]).max(initial=0.0) <= FIXED.max_link_sds and _inside(plain[links:end]):
        return plain
    # the free ones adapt to all others, and the links' to the joints': those are found by themselves
    own = r[links:, links:]
    if free:
        q, own = np.linalg.qr(np.concatenate([own[:, -free:], own[:, :-free]], 1))
        right = q.T @ target[links:]
        joints = _not_negative(own[free:, free:], right[free:])
        last = scipy.linalg.solve_triangular(own[:free, :free], right[:free] - own[:free, free:] @ joints)
        rest = np.concatenate([joints, last])
    else:
        rest = _not_negative(own, target[links:])
    first = scipy.linalg.solve_triangular(r[:links, :links], target[:links] - r[:links, links:] @ rest)
    if np.abs(first).max(initial=0.0) <= FIXED.max_link_sds and _inside(rest[: end - links]):
        return np.concatenate([first, rest])
    most = np.repeat([FIXED.max_link_sds, FIXED.max_joint_sds, np.inf], [links, end - links, free])
    least = np.repeat([-FIXED.max_link_sds, 0.0, -np.inf], [links, end - links, free])
    return np.asarray(lsq_linear(r, target, (least, most), method="bvls").x)


def _inside(joints: np.ndarray) -> bool:
    return bool(((joints >= 0) & (joints <= FIXED.max_joint_sds)).all())


def _not_negative(r: np.ndarray, target: np.ndarray) -> np.ndarray:
    return np.asarray(nnls(r, target)[0]) if len(target) else target
