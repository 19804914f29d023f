"""Dynamics of short planar chains by the generated Euler–Lagrange functions.

`euler_lagrange.py` gives M, b, G in the links' absolute angles φ; here they become D, h, c of the joints:
φ is the running sum of q, a joint's torque the sum of the generalised forces F from its link outwards.
Forward dynamics solves M φ̈ = F − b − G by M = L diag(d) Lᵀ, unrolled into elementwise operations: on 64,000
2×2 matrices the Cholesky factors alone would take three times as long as all of this. Interface, shapes and
units: `interface.py`.
"""

from collections.abc import Sequence
from functools import cache
from itertools import accumulate, pairwise

import torch
from torch import Tensor

from invdyn.models.bodies.body import BodyParameters
from invdyn.models.dynamics.euler_lagrange import ARGUMENTS, MOVING, torch_functions
from invdyn.models.dynamics.planar import PlanarDynamics
from invdyn.models.shapes import common, stacked

MAX_SYMBOLIC = 4  # joints; beyond, a recursion is shorter than the written-out expressions

_functions = cache(torch_functions)


class SymbolicDynamics(PlanarDynamics):
    """A planar chain by SymPy's Euler–Lagrange equations; interface, shapes and units as in `Dynamics`.

    The equations are derived, or read from the cache, at first use. Raises `ValueError` unless
    1 ≤ num_joints ≤ 4.
    """

    def __init__(self, num_joints: int):
        if num_joints not in range(1, MAX_SYMBOLIC + 1):
            raise ValueError(
                f"SymbolicDynamics expects 1 to {MAX_SYMBOLIC} joints, got {num_joints!r}; "
                "RecursiveDynamics takes any number"
            )
        self.num_joints = num_joints
        self._known: dict[str, tuple[BodyParameters, list]] = {}

    def inertia_matrix(self, q: Tensor, p: BodyParameters) -> Tensor:
        """D(θ), kg·m², (..., K, K)."""
        self._check(q=q)
        M, K, D = self._matrix(self._full_shape("inertia", p, phi=q)), self.num_joints, {}
        for i in reversed(range(K)):  # D = Aᵀ M A: sums from (i, j) outwards
            for j, row_sum in zip(reversed(range(i, K)), accumulate(reversed(M[i])), strict=False):
                D[i, j] = D[j, i] = row_sum + D[i + 1, j] if i + 1 < K else row_sum
        return torch.stack([torch.stack([D[i, j] for j in range(K)], -1) for i in range(K)], -2)

    def coriolis(self, q: Tensor, qd: Tensor, p: BodyParameters) -> Tensor:
        """h(θ, θ̇), N·m, (..., K)."""
        self._check(q=q, qd=qd)
        return _joint_torque(self._full_shape("coriolis", p, phi=q, w=qd))

    def gravity_load(self, q: Tensor, p: BodyParameters) -> Tensor:
        """c(θ) = ∂V/∂θ, N·m, (..., K)."""
        self._check(q=q)
        return _joint_torque(self._full_shape("gravity_load", p, phi=q))

    def forward(
        self, q: Tensor, qd: Tensor, tau: Tensor, p: BodyParameters, own_inertia: Tensor | None = None
    ) -> Tensor:
        """θ̈ = (D + diag I_own)⁻¹(τ − h − c), rad/s², (..., K)."""
        self._check(q=q, qd=qd, tau=tau)
        M, load = self._system(q, qd, p)
        return _accelerations(M, [f - x for f, x in zip(_link_forces(tau), load, strict=True)], own_inertia)

    def response(self, q: Tensor, tau: Tensor, p: BodyParameters, own_inertia: Tensor | None = None) -> Tensor:
        """(D + diag I_own)⁻¹ τ, rad/s², (..., K)."""
        self._check(q=q, tau=tau)
        _, tau = torch.broadcast_tensors(q, tau)  # a single link's inertia is the same at any angle
        return _accelerations(self._matrix(self._evaluate("inertia", p, phi=q)), _link_forces(tau), own_inertia)

    def inverse(self, q: Tensor, qd: Tensor, qdd: Tensor, p: BodyParameters) -> Tensor:
        """τ = D θ̈ + h + c, N·m, (..., K)."""
        self._check(q=q, qd=qd, qdd=qdd)
        M, load = self._system(q, qd, p)
        phidd = list(accumulate(qdd.unbind(-1)))
        inertial = [sum(m * a for m, a in zip(row, phidd, strict=True)) for row in M]
        return _joint_torque([f + x for f, x in zip(inertial, load, strict=True)])

    def kinetic_energy(self, q: Tensor, qd: Tensor, p: BodyParameters) -> Tensor:
        """½ θ̇ᵀ D θ̇, J, (...)."""
        self._check(q=q, qd=qd)
        return self._full_shape("kinetic_energy", p, phi=q, w=qd)[0]

    def potential_energy(self, q: Tensor, p: BodyParameters) -> Tensor:
        """V(θ) = −Σ m g·r, J, zero at the origin of the frame, (...)."""
        self._check(q=q)
        return self._full_shape("potential_energy", p, phi=q)[0]

    def keypoints(self, q: Tensor, p: BodyParameters) -> Tensor:
        """Positions (x, y) of the tips in the recording's frame, m, (..., K, 2)."""
        self._check(q=q)
        return stacked(self._full_shape("keypoints", p, phi=q)).unflatten(-1, (self.num_joints, 2))

    def _evaluate(self, name: str, p: BodyParameters, **joint: Tensor) -> list:
        """Outputs of a generated expression; `phi` and `w` are given as q and qd."""
        moving = [list(accumulate(joint[word].unbind(-1))) for word in ARGUMENTS[name] if word in MOVING]
        return _functions(self.num_joints)[name].values(*moving, self._numbers(name, p))

    def _numbers(self, name: str, p: BodyParameters) -> list:
        """The body's own coefficients, once for as long as the same body is asked about: for all stages of a row.

        Not if they are learned: each backward pass needs them anew.
        """
        body, numbers = self._known.get(name, (None, []))
        if body is not p:
            given = (getattr(p, word).unbind(-1) for word in ARGUMENTS[name] if word not in MOVING)
            numbers = _functions(self.num_joints)[name].numbers(*given)
            if not any(value.requires_grad for value in p):
                self._known[name] = p, numbers
        return numbers

    def _full_shape(self, name: str, p: BodyParameters, **joint: Tensor) -> list[Tensor]:
        """Outputs in the shape of the whole batch, those too that depend on the body alone or on nothing."""
        body = [getattr(p, word) for word in ARGUMENTS[name] if word not in MOVING]
        shape = common(*(value.shape[:-1] for value in (*joint.values(), *body)))
        like = joint["phi"]
        outputs = self._evaluate(name, p, **joint)
        return [x.expand(shape) if isinstance(x, Tensor) else like.new_full(shape, x) for x in outputs]

    def _system(self, q: Tensor, qd: Tensor, p: BodyParameters) -> tuple[list[list[Tensor]], list[Tensor]]:
        """M as K rows of K, and b + G as K entries, each no larger than what it depends on."""
        outputs = self._evaluate("system", p, phi=q, w=qd)
        return self._matrix(outputs[: -self.num_joints]), outputs[-self.num_joints :]

    def _matrix(self, upper: Sequence[Tensor]) -> list[list[Tensor]]:
        """A symmetric matrix, as rows, from its upper triangle, row by row."""
        K = self.num_joints
        entry = dict(zip(((i, j) for i in range(K) for j in range(i, K)), upper, strict=True))
        return [[entry[min(i, j), max(i, j)] for j in range(K)] for i in range(K)]


def _joint_torque(force: Sequence[Tensor]) -> Tensor:
    """Aᵀ F: each joint carries the generalised forces of its own link and of all further out, (..., K)."""
    return stacked(list(accumulate(reversed(force)))[::-1])


def _link_forces(tau: Tensor) -> list[Tensor]:
    """F = A⁻ᵀ τ, K entries."""
    joint = tau.unbind(-1)
    return [*(inner - outer for inner, outer in pairwise(joint)), joint[-1]]


def _accelerations(M: list[list[Tensor]], force: list[Tensor], own_inertia: Tensor | None) -> Tensor:
    """θ̈ (..., K) of generalised forces, by M with the joints' own inertias added: ½ Σ I_k (φ̇_k − φ̇_{k−1})²."""
    if own_inertia is not None:
        for k, own in enumerate(own_inertia.unbind(-1)):
            M[k][k] = M[k][k] + own
            if k:
                M[k - 1][k - 1] = M[k - 1][k - 1] + own
                M[k - 1][k] = M[k][k - 1] = M[k][k - 1] - own
    phidd = _solve(M, force)
    return stacked([phidd[0], *(outer - inner for inner, outer in pairwise(phidd))])


def _solve(M: list[list[Tensor]], y: list[Tensor]) -> list[Tensor]:
    """Solve M x = y by M = L diag(d) Lᵀ; M as rows, all entries tensors that broadcast."""
    K = len(y)
    M, y, L = [list(row) for row in M], list(y), {}
    for j in range(K):
        for i in range(j + 1, K):
            L[i, j] = M[j][i] / M[j][j]
            y[i] = y[i] - L[i, j] * y[j]
            for k in range(i, K):
                M[i][k] = M[i][k] - L[i, j] * M[j][k]
    x = [y[j] / M[j][j] for j in range(K)]
    for j in reversed(range(K)):
        for i in range(j + 1, K):
            x[j] = x[j] - L[i, j] * x[i]
    return x
