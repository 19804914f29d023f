"""How much of the torques that were given a body's motion explains, with what a file may be wrong about left free.

Inverse dynamics are linear in a link's mass m, first moment m c and inertia J about its joint (Atkeson, An & Hollerbach
1986), and so is what a joint has besides:

    τ = Y(q, q̇, q̈) φ + b q̇ + f tanh(q̇/v) + I_a q̈,     φ = φ₀ + δ,     δ ~ N(0, (.3 φ₀)²),     b, f, I_a ≥ 0

The misfit is the root of the least value of mean ((u − τ)/u_rms)² + λ Σ (β/sd)²: 0 where all is explained, 1 where
nothing is. q̇ and q̈ come from local cubics (Savitzky & Golay 1964) along even rows. The torque passes the same
window, so that both lose the same.

Shapes: R rows, K joints, P unknowns. Units: rad, s, N·m.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.linalg
import torch
from scipy.optimize import lsq_linear
from scipy.signal import savgol_filter

from invdyn.diagnosis.problem.robot_terms import RobotTerms
from invdyn.diagnosis.rules import DEFAULT, Rules
from invdyn.models.dynamics.interface import Dynamics
from invdyn.models.effects.inertias import has_inertias, inertia_of, point_moments
from invdyn.recordings.logs.mapping import JointMap


@dataclass(frozen=True)
class Motion:
    """A motion and the torques given along it, each (R, K); `terms` are the robot's, None where they are unknown."""

    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    torque: np.ndarray
    terms: RobotTerms | None = None
    rules: Rules = DEFAULT

    def picked(self, angles: list[int], torques: list[int]) -> "Motion | None":
        """The motion with its columns in other orders; None where a servo's target would be another motor's torque."""
        if self.terms is None:
            q, qd, qdd = (each[:, angles] for each in (self.q, self.qd, self.qdd))
            return replace(self, q=q, qd=qd, qdd=qdd, torque=self.torque[:, torques])
        if (terms := self.terms.commanding(torques)) is None:
            return None
        q, qd, qdd = (terms.angles(each, angles, n == 0) for n, each in enumerate((self.q, self.qd, self.qdd)))
        return replace(self, q=q, qd=qd, qdd=qdd, torque=terms.torque(q, qd), terms=terms)

    def scaled(self, angle: Any = 1.0, torque: Any = 1.0, time: float = 1.0) -> "Motion":
        """Angles, torques (numbers or (K,)) and times multiplied; the robot's terms are dropped."""
        q, qd, qdd = self.q * angle, self.qd * angle / time, self.qdd * angle / time**2
        return Motion(q, qd, qdd, self.torque * torque, rules=self.rules)

    def in_unit(self, angle: float = 1.0, target: float = 1.0) -> "Motion | None":
        """Angles and servos' targets times factors, about the zeros of the log; None where no target is known."""
        if self.terms is None:
            return self.scaled(angle=angle) if target == 1 else None
        terms, zero = self.terms.retargeted(target), self.terms.angle.zero
        q, qd, qdd = zero + angle * (self.q - zero), angle * self.qd, angle * self.qdd
        return replace(self, q=q, qd=qd, qdd=qdd, torque=terms.torque(q, qd), terms=terms)

    def mirrored(self, joints: Sequence[int], angle: bool = False, torque: bool = False) -> "Motion":
        """Angles, commands or both of some joints counted the other way, about the zeros of the log."""
        sign = np.ones(self.q.shape[1])
        sign[list(joints)] = -1
        if self.terms is None:
            return self.scaled(angle=sign if angle else 1.0, torque=sign if torque else 1.0)
        terms, q, qd, qdd = self.terms, self.q, self.qd, self.qdd
        if angle:
            q, qd, qdd = terms.angle.zero + sign * (q - terms.angle.zero), sign * qd, sign * qdd
        if torque:
            terms = terms.mirrored(joints)
        return replace(self, q=q, qd=qd, qdd=qdd, torque=terms.torque(q, qd), terms=terms)

    def recounted(self, joint: int, zero: float) -> "Motion":
        """A joint's angle counted from elsewhere: less ``zero`` rad, which a servo's torque does not follow."""
        shift = np.zeros(self.q.shape[1])
        shift[joint] = zero
        return replace(self, q=self.q - shift, terms=None if self.terms is None else self.terms.recounted(shift))

    def retargeted(self, factor: np.ndarray) -> "Motion | None":
        """Servos' targets times factors (K,), about their zeros; None where no target is known."""
        if self.terms is None:
            return None
        terms = self.terms.retargeted(factor)
        return replace(self, torque=terms.torque(self.q, self.qd), terms=terms)


@dataclass(frozen=True)
class Explained:
    """What a motion explains: `misfit` of all joints, of each (K,), and coefficients (P,) in the regressors' order.

    `left` (K,) N·m is the rms of what is not explained, `required` (K,) N·m of what is; `penalty` is λ Σ (β/sd)².
    """

    misfit: float
    by_joint: np.ndarray
    values: np.ndarray
    left: np.ndarray
    required: np.ndarray
    penalty: float

    def missed(self, joints: Sequence[int]) -> float:
        """The misfit of these joints, all if none, in terms of what is required of them.

        No remedy that makes torques small, or another joint's large, makes that better.
        """
        return float(np.hypot(share(self.left, self.required, joints), np.sqrt(self.penalty)))


def share(left: np.ndarray, required: np.ndarray, joints: Sequence[int]) -> float:
    """Of what is ``required`` (K,) of some joints, all if none, what is ``left`` (K,)."""
    of = list(joints) or slice(None)
    return float(np.linalg.norm(left[of]) / max(float(np.linalg.norm(required[of])), 1e-300))


def smoothings(
    body: Any,
    time: np.ndarray,
    angle: np.ndarray,
    torque: np.ndarray,
    maps: Sequence[JointMap] | None = None,
    rules: Rules = DEFAULT,
) -> list[Motion]:
    """The motion under each of the windows that it is long enough for; arguments as :func:`smoothed`'s.

    A servo's torque is what it makes of its target, angle and velocity. ``maps`` are of a robot's own log, which counts
    its joints as the body's own file does.
    """
    made = (smoothed(time, angle, torque, window, rules) for window in rules.check.cubic_windows)
    return [_by_servos(motion, RobotTerms.of(body, motion.torque, maps)) for motion in made if motion is not None]


def _by_servos(motion: Motion, terms: RobotTerms) -> Motion:
    return replace(motion, torque=terms.torque(motion.q, motion.qd), terms=terms)


def passive(body: Any, motion: Motion) -> np.ndarray:
    """What the joints of the file take besides, (R, K): its friction, rotors and springs."""
    taken = np.zeros_like(motion.q)
    speed = np.maximum(np.sqrt((motion.qd**2).mean(0)), 1e-12)
    for k, parts in enumerate(getattr(body, "joint_parts", ())):
        if parts is not None:
            q, qd, qdd = motion.q[:, k], motion.qd[:, k], motion.qdd[:, k]
            dry = parts.friction * np.tanh(qd / (motion.rules.check.slow_velocity * speed[k]))
            taken[:, k] = parts.damping * qd + dry + parts.armature * qdd + parts.stiffness * (q - parts.rest)
    return taken


def smoothed(
    time: np.ndarray, angle: np.ndarray, torque: np.ndarray, window: int, rules: Rules = DEFAULT
) -> Motion | None:
    """Even rows of angles (T, K), NaN where missing, and of torques (T, K) that are constant from each row to the next.

    None where there are too few rows for the window.
    """
    use = np.isfinite(angle).all(1)
    if use.sum() < 2 * window:
        return None
    seen = time[use]
    step = float(np.median(np.diff(seen)))
    even = seen[0] + step * np.arange(int((seen[-1] - seen[0]) / step) + 1)
    if len(even) < 2 * window or len(even) > 50 * len(seen):
        return None
    rows = np.stack([np.interp(even, seen, q) for q in angle[use].T], -1)
    # constant: over half a row before and after each even one, on average
    total = np.concatenate([np.zeros((1, torque.shape[1])), np.cumsum(torque[:-1] * np.diff(time)[:, None], 0)])
    area = [np.stack([np.interp(even + way * step / 2, time, each) for each in total.T], -1) for way in (-1, 1)]
    width = np.minimum(even + step / 2, time[-1]) - np.maximum(even - step / 2, time[0])
    given = (area[1] - area[0]) / width[:, None]
    inner = slice(window // 2, len(even) - window // 2)
    stride = slice(None, None, max(1, len(even) * max(angle.shape[1], 2) // (2 * rules.check.max_fit_rows)))
    q, qd, qdd = (savgol_filter(rows, window, 3, deriv=n, delta=step, axis=0)[inner][stride] for n in range(3))
    return Motion(q, qd, qdd, savgol_filter(given, window, 3, axis=0)[inner][stride], rules=rules)


def link_regressors(dynamics: Dynamics, body: Any, motion: Motion) -> np.ndarray:
    """Y of each link's m, first moments m c and second moments J about its joint, (P, R, K).

    In the plane P is 3 for each link, in space 10; quantity by quantity, each of all links. None of another body.
    """
    numbers = body.parameters()
    if not has_inertias(body):
        return np.empty((0, *motion.q.shape))
    n, r = (1, 1) if body.dimensions == 2 else (3, 6)
    links = len(body.link_names)
    # columns in one batch: a kilogram at the joint, one at a metre along each axis, and each moment by itself
    mass, com, moments = np.zeros((1 + n + r, 1)), np.zeros((1 + n + r, n)), np.zeros((1 + n + r, r))
    mass[: 1 + n], com[1 : 1 + n], moments[1 + n :] = 1.0, np.eye(n), np.eye(r)
    moments[1 : 1 + n] = -point_moments(torch.eye(n, dtype=torch.float64)).numpy()

    def of_each(values: np.ndarray) -> torch.Tensor:
        """Values (C, m) given to one link after the other: (C L, 1, L, m)."""
        return torch.as_tensor(np.einsum("cm,kl->cklm", values, np.eye(links))).flatten(0, 1).unsqueeze(1)

    given = [of_each(each) for each in (mass, com, moments)]
    masses, coms, inertias = (each[..., 0] if each.shape[-1] == 1 else each for each in given)
    only = numbers._replace(mass=masses, com=coms, inertia=inertias)
    found = inverse(dynamics, only, motion).reshape(1 + n + r, links, *motion.q.shape)
    # at a distance of one metre a kilogram has moments, which are taken from it
    found[1 : 1 + n] -= found[:1]
    return found.reshape(-1, *motion.q.shape)


def inverse(dynamics: Dynamics, numbers: Any, motion: Motion) -> np.ndarray:
    """Torques that a body of these ``numbers`` asks for, (..., R, K)."""
    q, qd, qdd = (torch.as_tensor(each) for each in (motion.q, motion.qd, motion.qdd))
    return np.asarray(dynamics.inverse(q, qd, qdd, numbers).numpy())


def as_large(dynamics: Dynamics, body: Any, motion: Motion) -> Motion:
    """The motion with each joint's torques as large as they would have to be."""
    required, given = (
        np.sqrt((each**2).mean(0)) for each in (inverse(dynamics, body.parameters(), motion), motion.torque)
    )
    return motion.scaled(torque=required / np.maximum(given, 1e-12))


def joint_regressors(motion: Motion) -> np.ndarray:
    """q̇, tanh(q̇/v) and q̈ of each joint, (3K, R, K)."""
    K = motion.q.shape[1]
    speed = np.maximum(np.sqrt((motion.qd**2).mean(0)), 1e-12)
    each = (motion.qd, np.tanh(motion.qd / (motion.rules.check.slow_velocity * speed)), motion.qdd)
    return np.concatenate([np.eye(K)[:, None] * values for values in each])


def nominal_link_numbers(body: Any) -> list[np.ndarray]:
    """Each link's m (1, L), m c (n, L) and J (r, L), of a chain in the plane n = r = 1, of a tree 3 and 6."""
    if not has_inertias(body):
        return []
    p = body.parameters()
    every = [inertia_of(p, k) for k in range(len(body.link_names))]
    own = [(e.mass, e.mass * e.com, e.moments + e.mass * point_moments(e.com)) for e in every]
    return [torch.stack(quantity, -1).numpy() for quantity in zip(*own, strict=True)]


def left_by_values(dynamics: Dynamics, body: Any, motion: Motion, values: np.ndarray) -> np.ndarray:
    """Rms (K,) N·m of what a motion's torques miss, with coefficients (P,) that :func:`explain` found in another."""
    required = inverse(dynamics, body.parameters(), motion) + passive(body, motion)
    regressors = np.concatenate([link_regressors(dynamics, body, motion), joint_regressors(motion)])
    left = motion.torque - required - np.tensordot(values, regressors, 1)
    return np.asarray(np.sqrt((left**2).mean(0)))


def explain(dynamics: Dynamics, body: Any, motion: Motion, offsets: tuple[int, ...] = ()) -> Explained:
    """The misfit of a motion; at ``offsets`` joints a constant torque is free, whose values come last."""
    required = inverse(dynamics, body.parameters(), motion) + passive(body, motion)
    size, needed = (np.sqrt((each**2).mean(0)) for each in (motion.torque, required))
    unit = np.maximum(np.maximum(size, motion.rules.check.min_torque_scale * needed.max()), 1e-12)
    quantities = nominal_link_numbers(body)
    own = np.concatenate([each.ravel() for each in (*quantities, np.empty(0))])
    joints = joint_regressors(motion)
    constant = np.eye(len(unit))[list(offsets)][:, None] * np.ones_like(motion.torque)
    X = np.concatenate([link_regressors(dynamics, body, motion), joints, constant]) / unit
    moved = np.maximum(np.sqrt((joints**2).mean(1)).sum(-1), 1e-12)
    largest = [np.full(each.size, max(float(np.abs(each).max()), 1e-12)) for each in quantities]
    floor = np.concatenate([*largest, np.empty(0)])
    sd = np.concatenate(
        [
            motion.rules.check.link_sd * np.maximum(np.abs(own), 0.01 * floor),
            np.tile(unit, 3) / moved,
            100 * unit[list(offsets)],
        ]
    )
    lower = np.concatenate([np.full(len(own), -3.0), np.zeros(len(joints)), np.full(len(offsets), -np.inf)])
    upper = np.concatenate([np.full(len(own), 3.0), np.full(len(joints), 10.0), np.full(len(offsets), np.inf)])
    rows = (X.reshape(len(X), -1) * sd[:, None]).T / np.sqrt(motion.torque.size)
    left = ((motion.torque - required) / unit).ravel() / np.sqrt(motion.torque.size)
    q, r = np.linalg.qr(np.concatenate([rows, np.sqrt(motion.rules.check.ridge) * np.eye(len(sd))]))
    target = q.T @ np.concatenate([left, np.zeros(len(sd))])
    scaled = _bounded(r, target, lower, upper, len(own))
    off = (left - rows @ scaled).reshape(motion.torque.shape)
    missed = (off**2).sum(0)
    penalty = motion.rules.check.ridge * float((scaled**2).sum())
    total = missed.sum() + penalty
    by_joint = np.sqrt(missed * len(unit))
    explained = motion.torque - off * unit * np.sqrt(motion.torque.size)
    required_of = np.sqrt((explained**2).mean(0))
    return Explained(float(np.sqrt(total)), by_joint, scaled * sd, by_joint * unit, required_of, penalty)


def _bounded(r: np.ndarray, target: np.ndarray, lower: np.ndarray, upper: np.ndarray, first: int) -> np.ndarray:
    """The x (P,) within bounds that is nearest to ``r x = target``, of a triangular ``r`` (P, P).

    The ``first`` of them, links' numbers, seldom come to their bounds: the others are then found by themselves.
    """
    rest = lsq_linear(r[first:, first:], target[first:], (lower[first:], upper[first:]), method="bvls").x
    links = scipy.linalg.solve_triangular(r[:first, :first], target[:first] - r[:first, first:] @ rest)
    if ((lower[:first] <= links) & (links <= upper[:first])).all():
        return np.concatenate([links, rest])
    return np.asarray(lsq_linear(r, target, (lower, upper), method="bvls").x)
