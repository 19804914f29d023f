"""Someone pushes: a force F on a keypoint between two moments, τ = Jᵀ F."""

import torch
from pyro.distributions import HalfNormal, Normal, Uniform
from torch import Tensor

from invdyn.models.effects.base import Effect, Parameter, Values
from invdyn.models.effects.effect_context import Situation
from invdyn.models.effects.scale import Scale

TYPICAL, SHORTEST = 0.15, 0.01
"""s, that pushes last, and that they last at least."""


class ExternalPush(Effect):
    """A constant force at a link's tip, given by its impulse, its middle and how long it lasts: F = J/T.

    What is seen follows the impulse in a straight line, and hardly the duration; it would not follow force, beginning
    and end so. The edges are ramps as long as the integrator's step, about the moment itself: whatever the step, sums
    over them give the impulse. Told apart from a burst of torque by repeating. ``xfrc_applied`` in MuJoCo.
    """

    phrase = "an external push"
    meaning = "a force from outside, for a short while"
    shown_by = "the same motion again, untouched"

    planar = True
    site = "keypoint"
    located = ("moment", "duration")
    pulls = True
    dated = True

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

    def described(self, values: Values) -> dict[str, tuple[Tensor, str]]:
        """Force, N, and its first and last moment, s."""
        duration = values["duration"].clamp_min(SHORTEST)
        half = duration / 2
        return {
            "force_x": (values["impulse_x"] / duration, "N"),
            "force_y": (values["impulse_y"] / duration, "N"),
            "start": (values["moment"] - half, "s"),
            "stop": (values["moment"] + half, "s"),
        }

    def force(self, p: Values, now: Situation) -> Tensor:
        """Jᵀ F, times how far the push is on."""
        duration = p["duration"].clamp_min(SHORTEST)
        edges = p["moment"] - duration / 2, p["moment"] + duration / 2
        on, off = (((now.time - edge) / now.step + 0.5).clamp(0.0, 1.0) for edge in edges)
        force = torch.cat(torch.broadcast_tensors(p["impulse_x"], p["impulse_y"]), -1) / duration
        return now.at_site(self.place[0], force) * (on - off)
