"""Someone pushes: a force on a keypoint between two moments, Jᵀ F."""

import torch
from pyro.distributions import Normal, Uniform
from torch import Tensor

from invdyn.models.effects.base import Effect, Parameter, Values
from invdyn.models.effects.scale import Scale
from invdyn.models.effects.situation import Situation


class ExternalPush(Effect):
    """A constant force (F_x, F_y) at a link's tip from ``start`` to ``stop``, times of the recording.

    The edges are ramps as long as the integrator's step, about the moment itself: whatever the step, sums over them
    give the impulse F (stop − start). Told apart from a burst of torque by repeating. ``xfrc_applied`` in MuJoCo.
    """

    site = "keypoint"
    located = ("start", "stop")

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Force, N, and its first and last moment, s."""
        force = Normal(0.0, 3.0 * scale.torque[0] / scale.body.length[: self.place[0] + 1].sum().item())
        moment = Uniform(scale.time[0].item(), scale.time[-1].item())
        return (
            Parameter("force_x", "N", force),
            Parameter("force_y", "N", force),
            Parameter("start", "s", moment, None),
            Parameter("stop", "s", moment, None),
        )

    def force(self, p: Values, now: Situation) -> Tensor:
        """Jᵀ F, times how far the push is on."""
        on, off = (((now.time - p[edge]) / now.step + 0.5).clamp(0.0, 1.0) for edge in ("start", "stop"))
        force = torch.cat(torch.broadcast_tensors(p["force_x"], p["force_y"]), -1)
        return now.at_tip(self.place[0], force) * (on - off).clamp_min(0.0)
