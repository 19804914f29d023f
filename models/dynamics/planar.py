"""What all dynamics of a planar chain share: how its tips move, written out, and how large it is.

A chain of K links has its K tips for sites. Angles φ, ω, α of the links are absolute, running sums of the joints'. With
u = (cos φ, sin φ) and u⊥ = (−sin φ, cos φ), the tip of link k moves as

    ṗ_k = Σ_{i≤k} l_i ω_i u⊥_i        p̈_k = Σ_{i≤k} l_i (α_i u⊥_i − ω_i² u_i)

Sizes are of the chain stretched out beyond each joint. Interface, shapes and units: `interface.py`.
"""

import torch
from torch import Tensor

from invdyn.models.bodies.body import BodyParameters
from invdyn.models.dynamics.interface import Dynamics


def along(q: Tensor) -> Tensor:
    """Unit vectors u along the links, (..., K, 2)."""
    phi = q.cumsum(-1)
    return torch.stack([phi.cos(), phi.sin()], -1)


def across(u: Tensor) -> Tensor:
    """Unit vectors u⊥, a quarter turn counter-clockwise from those along the links, (..., K, 2)."""
    return torch.stack([-u[..., 1], u[..., 0]], -1)


class PlanarDynamics(Dynamics):
    """A planar chain; see the top of the file."""

    def site_velocities(self, q: Tensor, qd: Tensor, p: BodyParameters) -> Tensor:
        """ṗ, (..., K, 2) m/s."""
        omega = qd.cumsum(-1)
        return ((p.length * omega).unsqueeze(-1) * across(along(q))).cumsum(-2)

    def site_accelerations(self, q: Tensor, qd: Tensor, qdd: Tensor, p: BodyParameters) -> Tensor:
        """p̈, (..., K, 2) m/s²."""
        u, omega, alpha = along(q), qd.cumsum(-1), qdd.cumsum(-1)
        turning = (p.length * alpha).unsqueeze(-1) * across(u) - (p.length * omega**2).unsqueeze(-1) * u
        return turning.cumsum(-2)

    def torque_of(self, q: Tensor, site: int, force: Tensor, p: BodyParameters) -> Tensor:
        """Jᵀ F of a force (..., 2) N that pulls at a link's tip, (..., K)."""
        turned = across(along(q)) * p.length.unsqueeze(-1)
        lever = (turned[..., : site + 1, :] * force.unsqueeze(-2)).sum(-1)
        moment = lever.flip(-1).cumsum(-1).flip(-1)
        return torch.nn.functional.pad(moment, (0, q.shape[-1] - site - 1))

    def typical_inertia(self, p: BodyParameters) -> Tensor:
        """Σ I + m r² of the links from each joint outwards, (K,) kg·m²."""
        return torch.stack([(inertia + mass * reach**2).sum() for mass, reach, inertia in _beyond(p)])

    def typical_load(self, p: BodyParameters) -> Tensor:
        """Σ m r g of them, held level, (K,) N·m."""
        return torch.stack([(mass * reach).sum() for mass, reach, _ in _beyond(p)]) * p.gravity.norm()

    def reach(self, p: BodyParameters) -> Tensor:
        """Sum of the links' lengths, m."""
        return p.length.sum()

    def levers(self, p: BodyParameters) -> Tensor:
        """The links' lengths: a link's angle is seen by its ends."""
        return p.length


def _beyond(p: BodyParameters) -> list[tuple[Tensor, Tensor, Tensor]]:
    """Mass, reach of the centre of mass and inertia of the links from each joint outwards."""
    pieces = []
    for k in range(len(p.length)):
        reach = torch.stack([p.length[k:j].sum() + p.com[j] for j in range(k, len(p.length))])
        pieces.append((p.mass[k:], reach, p.inertia[k:]))
    return pieces
