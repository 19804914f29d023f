"""The paper's derivation: SymPy obtains a planar chain's equations of motion by Euler–Lagrange.

    T = Σ ½ m v·v + ½ I φ̇²      V = −Σ m g·r      d/dt ∂(T−V)/∂φ̇ − ∂(T−V)/∂φ = F

The generalised coordinates are the links' absolute angles φ = A θ (A: lower-triangular ones), in which the terms stay
short: M(φ) φ̈ + b(φ, φ̇) + G(φ) = F. Joint torques are τ = Aᵀ F, so D = Aᵀ M A, h = Aᵀ b, c = Aᵀ G. Biderman et al.
(2020), eqs. 1–3. :func:`derive` returns the formulas, to be printed; :class:`SymbolicDynamics` evaluates them, as an
alternative to :mod:`.planar` that shares nothing with it. Units: SI and radians.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import torch
from torch import Tensor

from invdyn.models.bodies.planar import BodyParameters
from invdyn.models.dynamics.interface import Dynamics
from invdyn.models.shapes import common

MAX_JOINTS = 4
"""Beyond, deriving takes minutes."""
WORDS = ("phi", "w", "length", "mass", "com", "inertia", "gravity", "base")
"""Arguments of every formula: φ, φ̇ and the body's numbers."""


@dataclass(frozen=True)
class Equations:
    """SymPy expressions of a chain of K links in absolute angles φ and angular velocities w = φ̇; SymPy has no types.

    `symbols` maps `WORDS` to lists of symbols.
    """

    symbols: dict
    inertia: Any  # M, (K, K)
    coriolis: Any  # b, (K, 1)
    gravity_load: Any  # G, (K, 1)
    kinetic_energy: Any  # T
    potential_energy: Any  # V
    keypoints: Any  # tips, (K, 2)

    def in_joint_angles(self) -> tuple:
        """Return D (K, K), h (K, 1), c (K, 1) in the joint angles θ and velocities θ̇, and those symbols.

        These are the equations as papers print them: D θ̈ + h + c = τ.
        """
        import sympy as sp

        K = len(self.symbols["phi"])
        q, qd = sp.symbols(f"theta1:{K + 1}", real=True), sp.symbols(f"thetadot1:{K + 1}", real=True)
        A = sp.Matrix(K, K, lambda i, j: 1 if j <= i else 0)
        joint = dict(zip(self.symbols["phi"], A * sp.Matrix(q), strict=True))
        joint.update(zip(self.symbols["w"], A * sp.Matrix(qd), strict=True))
        M, b, G = (matrix.subs(joint) for matrix in (self.inertia, self.coriolis, self.gravity_load))
        return A.T * M * A, A.T * b, A.T * G, q, qd


@cache
def derive(num_joints: int) -> Equations:
    """Derive the `Equations` of a chain of `num_joints` links."""
    import sympy as sp
    from sympy.simplify.fu import TR8  # products of sines and cosines become those of sums and differences

    symbols = {word: list(sp.symbols(f"{word}1:{num_joints + 1}", real=True)) for word in WORDS[:-2]}
    symbols |= {word: list(sp.symbols(f"{word}_x {word}_y", real=True)) for word in WORDS[-2:]}
    phi, w = symbols["phi"], symbols["w"]
    gravity, joint = sp.Matrix(symbols["gravity"]), sp.Matrix(symbols["base"])
    kinetic, potential, tips = sp.Integer(0), sp.Integer(0), []
    for k in range(num_joints):
        direction = sp.Matrix([sp.cos(phi[k]), sp.sin(phi[k])])
        com = joint + symbols["com"][k] * direction
        velocity = com.jacobian(phi) * sp.Matrix(w)
        kinetic += symbols["mass"][k] * velocity.dot(velocity) / 2 + symbols["inertia"][k] * w[k] ** 2 / 2
        potential -= symbols["mass"][k] * gravity.dot(com)
        joint = joint + symbols["length"][k] * direction
        tips.append(joint.T)
    kinetic, potential = sp.expand(TR8(sp.expand(kinetic))), sp.expand(potential)

    momentum = sp.Matrix([kinetic.diff(velocity) for velocity in w])
    coriolis = momentum.jacobian(phi) * sp.Matrix(w) - sp.Matrix([kinetic.diff(angle) for angle in phi])
    return Equations(
        symbols=symbols,
        inertia=momentum.jacobian(w),
        coriolis=coriolis.expand(),
        gravity_load=sp.Matrix([potential.diff(angle) for angle in phi]),
        kinetic_energy=kinetic,
        potential_energy=potential,
        keypoints=sp.Matrix.vstack(*tips),
    )


@cache
def _function(num_joints: int, name: str) -> Callable[..., list]:
    """An expression of `Equations` as a function of lists of scalar tensors, in the order of `WORDS`."""
    import sympy as sp

    equations = derive(num_joints)
    entries = sp.Matrix([getattr(equations, name)])
    torch_names = {"cos": torch.cos, "sin": torch.sin}
    given = [equations.symbols[word] for word in WORDS]
    made: Callable[..., list] = sp.lambdify(given, list(entries), modules=[torch_names], cse=True)
    return made


class SymbolicDynamics(Dynamics):
    """A planar chain by the derived equations; interface, shapes and units as in `Dynamics`.

    Raises `ValueError` unless 1 ≤ num_joints ≤ 4.
    """

    def __init__(self, num_joints: int):
        if num_joints not in range(1, MAX_JOINTS + 1):
            raise ValueError(f"expected 1 to {MAX_JOINTS} joints for symbolic dynamics, got {num_joints!r}")
        self.num_joints = num_joints

    def inertia_matrix(self, q: Tensor, p: BodyParameters) -> Tensor:
        """D(θ) = Aᵀ M A, kg·m², (..., K, K)."""
        M = self._values("inertia", p, q).unflatten(-1, (self.num_joints, self.num_joints))
        A = torch.ones_like(M[..., :, :]).tril()
        return A.mT @ M @ A

    def coriolis(self, q: Tensor, qd: Tensor, p: BodyParameters) -> Tensor:
        """h(θ, θ̇) = Aᵀ b, N·m, (..., K)."""
        return _joint_torque(self._values("coriolis", p, q, qd))

    def gravity_load(self, q: Tensor, p: BodyParameters) -> Tensor:
        """c(θ) = Aᵀ G, N·m, (..., K)."""
        return _joint_torque(self._values("gravity_load", p, q))

    def forward(
        self, q: Tensor, qd: Tensor, tau: Tensor, p: BodyParameters, own_inertia: Tensor | None = None
    ) -> Tensor:
        """θ̈ = (D + diag I_own)⁻¹(τ − h − c), rad/s², (..., K)."""
        self._check(q=q, qd=qd, tau=tau)
        D, load = self.inertia_matrix(q, p), self.coriolis(q, qd, p) + self.gravity_load(q, p)
        if own_inertia is not None:
            D = D + torch.diag_embed(own_inertia)
        return torch.linalg.solve(D, (tau - load).unsqueeze(-1)).squeeze(-1)

    def inverse(self, q: Tensor, qd: Tensor, qdd: Tensor, p: BodyParameters) -> Tensor:
        """τ = D θ̈ + h + c, N·m, (..., K)."""
        self._check(q=q, qd=qd, qdd=qdd)
        inertial = (self.inertia_matrix(q, p) @ qdd.unsqueeze(-1)).squeeze(-1)
        return inertial + self.coriolis(q, qd, p) + self.gravity_load(q, p)

    def kinetic_energy(self, q: Tensor, qd: Tensor, p: BodyParameters) -> Tensor:
        """T, J, (...)."""
        return self._values("kinetic_energy", p, q, qd).squeeze(-1)

    def potential_energy(self, q: Tensor, p: BodyParameters) -> Tensor:
        """V(θ) = −Σ m g·r, J, zero at the origin of the frame, (...)."""
        return self._values("potential_energy", p, q).squeeze(-1)

    def keypoints(self, q: Tensor, p: BodyParameters) -> Tensor:
        """Positions (x, y) of the tips in the recording's frame, m, (..., K, 2)."""
        return self._values("keypoints", p, q).unflatten(-1, (self.num_joints, 2))

    def _values(self, name: str, p: BodyParameters, q: Tensor, qd: Tensor | None = None) -> Tensor:
        """Entries of an expression, (..., entries)."""
        qd = torch.zeros_like(q) if qd is None else qd
        self._check(q=q, qd=qd)
        given = {"phi": q.cumsum(-1), "w": qd.cumsum(-1), **p._asdict()}
        batch = common(*(value.shape[:-1] for value in given.values()))
        entries = _function(self.num_joints, name)(*(given[word].unbind(-1) for word in WORDS))
        tensors = [x if isinstance(x, Tensor) else q.new_tensor(float(x)) for x in entries]
        return torch.stack([x.expand(batch) for x in tensors], -1)


def _joint_torque(force: Tensor) -> Tensor:
    """Aᵀ F: each joint carries the generalised forces of its own link and of all further out, (..., K)."""
    return force.flip(-1).cumsum(-1).flip(-1)
