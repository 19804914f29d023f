"""What effects on the dynamics know: the moment within a step. What is seen of it: `observation/view.py`.

Shapes: joint quantities (..., K), points (..., S, d).
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import torch
from torch import Tensor

from invdyn.models.dynamics.interface import Dynamics
from invdyn.models.shapes import stacked


@dataclass
class Situation:
    """A moment within a step.

    Attributes:
        q, qd: (..., K) rad, rad/s.
        motor: (..., K) N·m, what the motors give: the command as the actuators make it; for a friction's level with
            what servos answer, too.
        time: (..., 1) s, of the recording.
        elapsed: (..., 1) s, since its first row.
        step: s, the integrator's sub-step, (..., 1) or less.
        body: its numbers as the other effects leave them.
        dynamics: of this body.
        commanded: (..., K) N·m, of `motor` what was commanded; the rest is an unknown torque.
        split: the link that a hidden hinge makes two of, where the chain has one; places count the arm's own links.
    """

    q: Tensor
    qd: Tensor
    motor: Tensor
    time: Tensor
    elapsed: Tensor
    step: Tensor
    body: Any
    dynamics: Dynamics
    split: int | None = None
    commanded: Tensor | None = None

    @cached_property
    def bias(self) -> Tensor:
        """h(θ, θ̇) + c(θ), what would hold the motion steady, (..., K) N·m."""
        return self.dynamics.inverse(self.q, self.qd, torch.zeros_like(self.q), self.body)

    def at(self, joint: int, value: Tensor) -> Tensor:
        """A generalised force (..., 1) at one joint, as (..., K)."""
        value = value[..., 0]
        nothing = value.new_zeros(()).expand_as(value)
        return stacked([value if k == joint else nothing for k in range(self.q.shape[-1])])

    def at_site(self, site: int, force: Tensor) -> Tensor:
        """Jᵀ F of a force (..., d) N that pulls at a site, in the plane a link's tip, (..., K)."""
        site += self.split is not None and site >= self.split
        return self.dynamics.torque_of(self.q, site, force, self.body)
