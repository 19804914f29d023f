"""A known force on a site of the body, such as of a handle or a force plate: τ = Jᵀ(θ) F(t).

F is a straight line between its samples, which have a clock of their own. It adds to the joints' torques, which are
then those of muscles or motors alone.
"""

import hashlib
from collections.abc import Sequence

import torch
from torch import Tensor

from invdyn.models.effects.base import Effect, Parameter, Scale, Situation, Values


class AppliedForce(Effect):
    """A force (N, d) N on a keypoint of the body, in the recording's frame, at times (N,) s of the model's clock."""

    site = "keypoint"

    def __init__(self, where: str, time: Sequence[float] | Tensor, force: Sequence[Sequence[float]] | Tensor):
        super().__init__(where)
        self.time = torch.as_tensor(time, dtype=torch.float64)
        self.force_on = torch.as_tensor(force, dtype=torch.float64)

    def __repr__(self) -> str:
        data = hashlib.sha256(self.time.numpy().tobytes() + self.force_on.numpy().tobytes()).hexdigest()
        return f"AppliedForce({self.where[0]!r}, {data})"

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """None: it is known."""
        return ()

    def at(self, time: Tensor) -> Tensor:
        """F at times (..., 1), (..., d); beyond the samples as at the nearest one."""
        times, force = self.time.to(time.device), self.force_on.to(time.device)
        moment = time[..., 0].double().clamp(times[0], times[-1])
        after = torch.searchsorted(times, moment.contiguous()).clamp(1, len(times) - 1)
        share = ((moment - times[after - 1]) / (times[after] - times[after - 1])).unsqueeze(-1)
        return ((1 - share) * force[after - 1] + share * force[after]).to(time.dtype)

    def force(self, p: Values, now: Situation) -> Tensor:
        """Jᵀ F."""
        return now.at_site(self.place[0], self.at(now.time))
