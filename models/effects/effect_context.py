"""What effects are told: the moment within a step for forces, the view of the camera for what it sees.

Shapes: joint quantities (..., K), points (..., K, 2). Angles φ, ω, α of the links are absolute, running sums of the
joints'. With u = (cos φ, sin φ) and u⊥ = (−sin φ, cos φ), the tip of link k moves as

    ṗ_k = Σ_{i≤k} l_i ω_i u⊥_i        p̈_k = Σ_{i≤k} l_i (α_i u⊥_i − ω_i² u_i)
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from torch import Tensor

from invdyn.models.bodies.body import BodyParameters
from invdyn.models.dynamics.planar_symbolic import Dynamics
from invdyn.models.shapes import stacked


@dataclass
class Situation:
    """A moment within a step.

    Attributes:
        q, qd: (..., K) rad, rad/s.
        motor: (..., K) N·m, what the motors give: the command as the actuators make it.
        time: (..., 1) s, of the recording.
        elapsed: (..., 1) s, since its first row.
        step: s, the integrator's sub-step, (..., 1) or less.
        body: the links as the other effects leave them.
        dynamics: of this chain.
        split: the link that a hidden hinge makes two of, where the chain has one; places count the arm's own links.
    """

    q: Tensor
    qd: Tensor
    motor: Tensor
    time: Tensor
    elapsed: Tensor
    step: Tensor
    body: BodyParameters
    dynamics: Dynamics
    split: int | None = None

    @cached_property
    def bias(self) -> Tensor:
        """h(θ, θ̇) + c(θ), what would hold the motion steady, (..., K) N·m."""
        return self.dynamics.inverse(self.q, self.qd, torch.zeros_like(self.q), self.body)

    def at(self, joint: int, value: Tensor) -> Tensor:
        """A generalised force (..., 1) at one joint, as (..., K)."""
        value = value[..., 0]
        nothing = value.new_zeros(()).expand_as(value)
        return stacked([value if k == joint else nothing for k in range(self.q.shape[-1])])

    def at_tip(self, link: int, force: Tensor) -> Tensor:
        """Jᵀ F of a force (..., 2) N that pulls at a link's tip, (..., K)."""
        link += self.split is not None and link >= self.split
        phi = self.q.cumsum(-1)
        turned = torch.stack([-phi.sin(), phi.cos()], -1) * self.body.length.unsqueeze(-1)
        lever = (turned[..., : link + 1, :] * force.unsqueeze(-2)).sum(-1)
        moment = lever.flip(-1).cumsum(-1).flip(-1)
        return torch.nn.functional.pad(moment, (0, self.q.shape[-1] - link - 1))


@dataclass
class View:
    """What there is to see at a row.

    Attributes:
        q, qd: (..., K) rad, rad/s.
        acceleration: function of none, → θ̈ (..., K).
        turned: function of seconds (..., 1), negative ones too, → θ by then, (..., K) rad.
        ahead: function of the same → how far the tips move by then, (..., K, 2) m.
        body: the links.
        elapsed: (..., 1) s, since the first row.
        points: (..., K, 2) m, the tips, as the effects called before leave them.
        doubt: (..., K) 1 − c of the tracker's confidence c, 0 at tips that are not tracked; None where it has none.
    """

    q: Tensor
    qd: Tensor
    acceleration: Callable[[], Tensor]
    turned: Callable[[Tensor], Tensor]
    ahead: Callable[[Tensor], Tensor]
    body: BodyParameters
    elapsed: Tensor
    points: Tensor
    doubt: Tensor | None = None

    def seen_at(self, points: Tensor) -> "View":
        """The same view, with other points."""
        return replace(self, points=points)

    def moved(self, tip: int, shift: Tensor) -> Tensor:
        """The points, one of them moved by ``shift`` (..., 2) m."""
        here = torch.nn.functional.one_hot(torch.tensor(tip), self.points.shape[-2]).to(self.points)
        return self.points + here.unsqueeze(-1) * shift.unsqueeze(-2)

    def later(self, seconds: Tensor) -> Tensor:
        """The points, each (..., K or 1, 1) s later."""
        if seconds.shape[-2] == 1:
            return self.points + self.ahead(seconds[..., 0, :])
        each = [self.ahead(seconds[..., k, :])[..., k, :] for k in range(seconds.shape[-2])]
        return self.points + torch.stack(torch.broadcast_tensors(*each), -2)

    @cached_property
    def along(self) -> Tensor:
        """Unit vectors u along the links, (..., K, 2)."""
        phi = self.q.cumsum(-1)
        return torch.stack([phi.cos(), phi.sin()], -1)

    @cached_property
    def across(self) -> Tensor:
        """Unit vectors u⊥, a quarter turn counter-clockwise from the links, (..., K, 2)."""
        return torch.stack([-self.along[..., 1], self.along[..., 0]], -1)

    @cached_property
    def tip_velocity(self) -> Tensor:
        """ṗ, (..., K, 2) m/s."""
        omega = self.qd.cumsum(-1)
        return ((self.body.length * omega).unsqueeze(-1) * self.across).cumsum(-2)

    @cached_property
    def tip_acceleration(self) -> Tensor:
        """p̈, (..., K, 2) m/s²."""
        omega, alpha = self.qd.cumsum(-1), self.acceleration().cumsum(-1)
        length = self.body.length
        turning = (length * alpha).unsqueeze(-1) * self.across - (length * omega**2).unsqueeze(-1) * self.along
        return turning.cumsum(-2)
