"""Dynamics of short planar chains by the generated Euler–Lagrange functions.

`euler_lagrange.py` gives M, b, G in the links' absolute angles φ; here they become D, h, c of the joints:
φ is the running sum of q, a joint's torque the sum of the generalised forces F from its link outwards.
Forward dynamics solves M φ̈ = F − b − G by M = L diag(d) Lᵀ, unrolled into elementwise operations: on 64,000
2×2 matrices the Cholesky factors alone would take three times as long as all of this. It is traced once for a number
of joints, and runs as machine code where no gradient is asked for (:mod:`.traced.compiled`): the same bits, sooner.
Interface, shapes and units: `interface.py`.
"""

from collections.abc import Sequence
from functools import cache
from itertools import accumulate, pairwise
from typing import Any, NamedTuple

import torch
from torch import Tensor

from invdyn.models.bodies.body import BodyParameters
from invdyn.models.dynamics.euler_lagrange import ARGUMENTS, MOVING, torch_functions
from invdyn.models.dynamics.planar import PlanarDynamics
from invdyn.models.dynamics.traced.compiled import Compiled, is_plain, is_there
from invdyn.models.dynamics.traced.expressions import Graph, Scalar
from invdyn.models.dynamics.traced.programs import Program, program
from invdyn.models.shapes import common, stacked

MAX_SYMBOLIC = 4  # joints; beyond, a recursion is shorter than the written-out expressions

PAYS = 100
"""Calls of torch that cost what compiling forward dynamics does."""

_functions = cache(torch_functions)


class _Angle(NamedTuple):
    """An angle by its cosine and sine."""

    cosine: Scalar
    sine: Scalar

    def cos(self) -> Scalar:
        return self.cosine

    def sin(self) -> Scalar:
        return self.sine


class _Seen(NamedTuple):
    """A body that came: its coefficients in forward dynamics, their leading dimensions, whether they are plain."""

    body: BodyParameters
    numbers: list[Tensor]
    batch: tuple[int, ...]
    is_plain: bool


class SymbolicDynamics(PlanarDynamics):
    """A planar chain by SymPy's Euler–Lagrange equations; interface, shapes and units as in `Dynamics`.

    The equations are derived, or read from the cache, at first use. Forward dynamics become machine code (extra
    `fast`) after about `compile_after` calls; 0 compiles at once, infinity never.
    Raises `ValueError` unless 1 ≤ num_joints ≤ 4.
    """

    def __init__(self, num_joints: int, compile_after: float = PAYS):
        if num_joints not in range(1, MAX_SYMBOLIC + 1):
            raise ValueError(
                f"SymbolicDynamics expects 1 to {MAX_SYMBOLIC} joints, got {num_joints!r}; "
                "RecursiveDynamics takes any number"
            )
        self.num_joints = num_joints
        self._known: dict[str, tuple[BodyParameters, list]] = {}
        self._programs: dict[bool, Program] = {}
        self._seen: dict[bool, _Seen] = {}
        self._compiled, self._after = Compiled(compile_after) if is_there() else None, compile_after

    def __reduce__(self) -> tuple:
        """By its number of joints: machine code is made anew, once for all copies that come to a process."""
        return symbolic_dynamics, (self.num_joints, self._after)

    def inertia_matrix(self, q: Tensor, p: BodyParameters) -> Tensor:
        """D(θ), kg·m², (..., K, K)."""
        self._check(q=q)
        M, K = self._matrix(self._full_shape("inertia", p, phi=q)), self.num_joints
        D: dict[tuple[int, int], Tensor] = {}
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
        traced, seen = self._forward(p, own_inertia is not None)
        phi = stacked(list(accumulate(q.unbind(-1))))
        joint = {"cos": phi.cos(), "sin": phi.sin(), "qd": qd, "tau": tau}
        if own_inertia is not None:
            joint["own"] = own_inertia
        batch = common(seen.batch, *(value.shape[:-1] for value in joint.values()))
        plain = seen.is_plain and is_plain(*joint.values(), *seen.numbers[:1])
        if self._compiled and plain and self._compiled.pays(traced, batch):
            return self._compiled("forward", traced, joint, seen.numbers, batch)
        columns = {word: value.unbind(-1) for word, value in joint.items()}
        return stacked(traced.values([columns[word][place] for word, place in traced.moving], seen.numbers))

    def response(self, q: Tensor, tau: Tensor, p: BodyParameters, own_inertia: Tensor | None = None) -> Tensor:
        """(D + diag I_own)⁻¹ τ, rad/s², (..., K)."""
        self._check(q=q, tau=tau)
        _, tau = torch.broadcast_tensors(q, tau)  # a single link's inertia is the same at any angle
        own = None if own_inertia is None else own_inertia.unbind(-1)
        M = self._matrix(self._evaluate("inertia", p, phi=q))
        return stacked(_accelerations(M, _link_forces(tau.unbind(-1)), own))

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

    def _forward(self, p: BodyParameters, with_own: bool) -> tuple[Program, _Seen]:
        """The program of forward dynamics, ``with_own`` inertias of the joints or without; the body as it takes it."""
        seen = self._seen.get(with_own)
        if seen is None or seen.body is not p:
            coefficients = self._numbers("system", p)
            if with_own not in self._programs:
                self._programs[with_own] = self._traced(len(coefficients), with_own)
            traced = self._programs[with_own]
            numbers = traced.numbers([coefficients[place] for _, place in traced.constants])
            seen = _Seen(p, numbers, common(*(number.shape for number in numbers)), is_plain(*p))
            if not any(value.requires_grad for value in p):
                self._seen[with_own] = seen
        return self._programs[with_own], seen

    def _traced(self, coefficients: int, with_own: bool) -> Program:
        graph, K = Graph(), self.num_joints

        def arguments(word: str, count: int = K, moving: bool = True) -> list[Scalar]:
            return [graph.argument((word, place), moving) for place in range(count)]

        phi = [_Angle(*each) for each in zip(arguments("cos"), arguments("sin"), strict=True)]
        rates, numbers = list(accumulate(arguments("qd"))), arguments("number", coefficients, moving=False)
        outputs = _functions(K)["system"].values(phi, rates, numbers)
        force = [f - x for f, x in zip(_link_forces(arguments("tau")), outputs[-K:], strict=True)]
        own = arguments("own") if with_own else None
        return program(graph, _accelerations(self._matrix(outputs[:-K]), force, own))

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

    def _matrix(self, upper: Sequence) -> list[list]:
        """A symmetric matrix, as rows, from its upper triangle, row by row."""
        K = self.num_joints
        entry = dict(zip(((i, j) for i in range(K) for j in range(i, K)), upper, strict=True))
        return [[entry[min(i, j), max(i, j)] for j in range(K)] for i in range(K)]


@cache
def symbolic_dynamics(num_joints: int, compile_after: float) -> SymbolicDynamics:
    """The `SymbolicDynamics` of so many joints, one for all models of a process: they share its machine code."""
    return SymbolicDynamics(num_joints, compile_after)


def _joint_torque(force: Sequence[Tensor]) -> Tensor:
    """Aᵀ F: each joint carries the generalised forces of its own link and of all further out, (..., K)."""
    return stacked(list(accumulate(reversed(force)))[::-1])


def _link_forces(tau: Sequence) -> list:
    """F = A⁻ᵀ τ, K entries."""
    return [*(inner - outer for inner, outer in pairwise(tau)), tau[-1]]


def _accelerations(M: list[list], force: list, own_inertia: Sequence | None) -> list:
    """θ̈, K entries, of generalised forces, by M with the joints' own inertias added: ½ Σ I_k (φ̇_k − φ̇_{k−1})²."""
    if own_inertia is not None:
        for k, own in enumerate(own_inertia):
            M[k][k] = M[k][k] + own
            if k:
                M[k - 1][k - 1] = M[k - 1][k - 1] + own
                M[k - 1][k] = M[k][k - 1] = M[k][k - 1] - own
    phidd = _solve(M, force)
    return [phidd[0], *(outer - inner for inner, outer in pairwise(phidd))]


def _solve(M: list[list], y: list) -> list:
    """Solve M x = y by M = L diag(d) Lᵀ; M as rows, all entries tensors that broadcast, or what is traced."""
    K = len(y)
    M, y, L = [list(row) for row in M], list(y), dict[tuple[int, int], Any]()
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
