"""What inverse dynamics are linear in: each link's mass m, first moment m c and second moments J about its joint.

    τ = Y(q, q̇, q̈) φ,     φ = (m, m c, J) of every link                (Atkeson, An & Hollerbach 1986)

Some of them act only together: base parameters (Gautier & Khalil 1990), found by a QR with pivoting (Gautier 1991).

Shapes: R rows, K joints, L links, P = 3 L columns in the plane, 10 L in space. Units: rad, s, kg, m, N·m.
"""

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
import scipy.linalg
import torch
from torch import Tensor

from invdyn.diagnosis.rules import FIXED
from invdyn.models.bodies.inertia import NAMES
from invdyn.models.bodies.point_mass import point_moments
from invdyn.models.bodies.protocol import AXES
from invdyn.models.dynamics.interface import Dynamics
from invdyn.models.effects.inertias import has_inertias, inertia_of


class Moving(Protocol):
    """Angles, velocities and accelerations along a motion, each (R, K)."""

    @property
    def q(self) -> np.ndarray:
        """Rad."""

    @property
    def qd(self) -> np.ndarray:
        """Rad/s."""

    @property
    def qdd(self) -> np.ndarray:
        """Rad/s²."""


def link_regressors(dynamics: Dynamics, body: Any, motion: Moving, units: Any = None) -> np.ndarray:
    """Y of each link's m, first moments m c and second moments J about its joint, (P, R, K).

    In the plane P is 3 for each link, in space 10; quantity by quantity, each of all links. None of another body.
    ``units`` are :func:`unit_numbers` of the body, where they are known already.
    """
    if not has_inertias(body):
        return np.empty((0, *motion.q.shape))
    own = unit_numbers(body) if units is None else units
    return np.asarray(link_torques(dynamics, own, *map(torch.as_tensor, (motion.q, motion.qd, motion.qdd))).numpy())


def link_torques(dynamics: Dynamics, units: Any, q: Tensor, qd: Tensor, qdd: Tensor) -> Tensor:
    """The same (P, R, K) of ``units`` along tensors (R, K), differentiable."""
    found = dynamics.inverse(q, qd, qdd, units).reshape(-1, units.mass.shape[-1], *q.shape)
    n = 1 if units.com.ndim == units.mass.ndim else 3
    # at a distance of one metre a kilogram has moments, which are taken from it
    return torch.cat([found[:1], found[1 : 1 + n] - found[:1], found[1 + n :]]).flatten(0, 1)


def unit_numbers(body: Any) -> Any:
    """A body's numbers with a unit of one quantity at one link and nothing else, for each of P; None of another body.

    In one batch (P, 1): a kilogram at the joint, one at a metre along each axis, and each moment by itself.
    """
    if not has_inertias(body):
        return None
    n, r = (1, 1) if body.dimensions == 2 else (3, 6)
    links = len(body.link_names)
    mass, com, moments = np.zeros((1 + n + r, 1)), np.zeros((1 + n + r, n)), np.zeros((1 + n + r, r))
    mass[: 1 + n], com[1 : 1 + n], moments[1 + n :] = 1.0, np.eye(n), np.eye(r)
    moments[1 : 1 + n] = -point_moments(torch.eye(n, dtype=torch.float64)).numpy()

    def of_each(values: np.ndarray) -> torch.Tensor:
        """Values (C, m) given to one link after the other: (C L, 1, L, m)."""
        return torch.as_tensor(np.einsum("cm,kl->cklm", values, np.eye(links))).flatten(0, 1).unsqueeze(1)

    given = [of_each(each) for each in (mass, com, moments)]
    masses, coms, inertias = (each[..., 0] if each.shape[-1] == 1 else each for each in given)
    return body.parameters()._replace(mass=masses, com=coms, inertia=inertias)


def inverse(dynamics: Dynamics, numbers: Any, motion: Moving) -> np.ndarray:
    """Torques that a body of these ``numbers`` asks for, (..., R, K)."""
    q, qd, qdd = (torch.as_tensor(each) for each in (motion.q, motion.qd, motion.qdd))
    return np.asarray(dynamics.inverse(q, qd, qdd, numbers).numpy())


def filed_torques(body: Any, q: Any, qd: Any, qdd: Any, sign: Any) -> list[Any]:
    """What the file's joints take besides: friction, rotors and springs, N·m; a column (R,) for each of the K joints.

    Angles, velocities, accelerations and the velocities' ``sign``, (R, K) each, are arrays or tensors.
    """
    found = []
    for k, own in enumerate(body.joint_parts):
        column = own.damping * qd[..., k] + own.friction * sign[..., k] + own.armature * qdd[..., k]
        found.append(column + own.stiffness * (q[..., k] - own.rest))
    return found


def nominal_link_numbers(body: Any) -> list[np.ndarray]:
    """Each link's m (1, L), m c (n, L) and J (r, L), of a chain in the plane n = r = 1, of a tree 3 and 6."""
    if not has_inertias(body):
        return []
    p = body.parameters()
    every = [inertia_of(p, k) for k in range(len(body.link_names))]
    own = [(e.mass, e.mass * e.com, e.moments + e.mass * point_moments(e.com)) for e in every]
    return [torch.stack(quantity, -1).numpy() for quantity in zip(*own, strict=True)]


def link_axes(body: Any) -> list[Sequence[str]]:
    """Of m, m c and J what tells a link's own columns apart, as "x" or "xx"; "" where there is one."""
    return [("",), AXES, NAMES] if body.dimensions == 3 else [("",)] * 3


def link_names(body: Any, own: list[np.ndarray]) -> list[tuple[str, str]]:
    """Names and units of a link's columns, in the order of :func:`link_regressors`."""
    words = (("mass", "kg"), ("first moment", "kg·m"), ("second moment", "kg·m²"))
    found = zip(words, link_axes(body), strict=True)
    return [(f"{word} {axis}".strip(), unit) for (word, unit), every in found for axis in every] if own else []


def base_columns(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which columns of ``rows`` (N, P) are a base, those of the others that move at all, and these as sums of a base's.

    Numbers (B,) and (D,), and factors (B, D): rows[:, others] = rows[:, base] @ factors. Columns that say the same are
    ordered by their place, and not by rounding.
    """
    later = 1 + FIXED.negligible * np.arange(rows.shape[1])
    scale = np.maximum(np.linalg.norm(rows, axis=0), 1e-300) * later
    order = np.flatnonzero(scale > FIXED.negligible * scale.max(initial=0.0))
    if not order.size:
        return order, order, np.zeros((0, 0))
    _, r, pivot = scipy.linalg.qr(rows[:, order] / scale[order], mode="economic", pivoting=True)
    size = np.abs(np.diagonal(r))
    rank = int((size > FIXED.negligible**0.5 * size[0]).sum())
    base, rest = order[pivot[:rank]], order[pivot[rank:]]
    factors = scipy.linalg.solve_triangular(r[:rank, :rank], r[:rank, rank:]) * scale[rest] / scale[base][:, None]
    return base, rest, factors


def all_but_the_largest(rows: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Which of links' columns, of ``rows`` (N, P), are a base, but for the one whose nominal torque is largest."""
    base, rest, factors = base_columns(rows)
    free = np.zeros(rows.shape[1], dtype=bool)
    free[base] = True
    if base.size:
        torque = np.abs(own[base] + factors @ own[rest]) * np.linalg.norm(rows[:, base], axis=0)
        free[base[int(torque.argmax())]] = False
    return free
