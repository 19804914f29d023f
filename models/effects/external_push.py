"""Someone pushes: a force F on a keypoint between two moments, τ = Jᵀ F."""

import torch
from pyro.distributions import HalfNormal, Normal, Uniform
from torch import Tensor

from invdyn.models.effects.base import Effect, Parameter, Scale, Situation, Values

TYPICAL, SHORTEST = 0.15, 0.01
"""s, typical and least duration of a push."""


class ExternalPush(Effect):
    """A constant force at a link's tip, given by its impulse, its middle and its duration: F = J/T.

    What is seen is linear in the impulse, and hardly depends on the duration; it would not be so in force, start and
    stop. The edges are ramps as long as the integrator's step, about the moment itself: for any step, sums over
    them give the impulse. A repetition distinguishes it from a burst of torque. ``xfrc_applied`` in MuJoCo.
    """

    planar = True
    site = "keypoint"

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Impulse, N·s, its middle and its duration, s."""
        force = 3.0 * scale.torque[0] / scale.body.length[: self.place[0] + 1].sum().item()
        impulse = Normal(0.0, TYPICAL * force)
        moment = Uniform(scale.time[0].double(), scale.time[-1].double())
        return (
            Parameter("impulse_x", "N·s", impulse),
            Parameter("impulse_y", "N·s", impulse),
            Parameter("moment", "s", moment, None),
            Parameter("duration", "s", HalfNormal(TYPICAL), None),
        )

    def pull(self, p: Values, now: Situation) -> Tensor:
        """Jᵀ F, times the share of the push that acts."""
        duration = p["duration"].clamp_min(SHORTEST)
        edges = p["moment"] - duration / 2, p["moment"] + duration / 2
        on, off = (((now.time - edge) / now.step + 0.5).clamp(0.0, 1.0) for edge in edges)
        force = torch.cat(torch.broadcast_tensors(p["impulse_x"], p["impulse_y"]), -1) / duration
        return now.at_site(self.place[0], force) * (on - off)
