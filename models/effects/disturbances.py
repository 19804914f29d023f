"""Forces from outside and a base that shakes: one effect a class.

base_motion    a base that shakes: b(t) = a sin 2πft + c cos 2πft under the first joint
external_push  someone pushes: a force F on a keypoint between two moments, τ = Jᵀ F
"""

import math

import torch
from pyro.distributions import HalfNormal, LogNormal, Normal, Uniform
from torch import Tensor

from invdyn.models.effects.base import Effect, Parameter, Scale, Situation, Values, View
from invdyn.models.shapes import joined_by_column

LOWEST, HIGHEST, FINEST = 0.3, 10.0, 120  # Hz, and frequencies in the grid at most


class BaseMotion(Effect):
    """The base moves to and fro in the plane, t from the first row: every keypoint by b(t), and gravity by −b̈.

    Tracks of the base and the background distinguish it from a shaking camera.
    """

    planar = True
    site = "arm"

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Amplitudes, m, of sine and cosine along x and y, and frequency f, Hz.

        A recording of length T resolves frequencies to 1/T; the grid's step is half of it, unless that gives too many.
        """
        amplitude = Normal(0.0, 0.02 * scale.reach)
        count = min(FINEST, max(5, math.ceil(2 * (HIGHEST - LOWEST) * scale.duration)))
        grid = torch.linspace(LOWEST, HIGHEST, count)
        names = ("sine_x", "cosine_x", "sine_y", "cosine_y")
        frequency = Parameter("frequency", "Hz", LogNormal(math.log(2.5), 0.8), None, tuple(grid.tolist()))
        return (*(Parameter(name, "m", amplitude) for name in names), frequency)

    def pull(self, p: Values, now: Situation) -> Tensor:
        """The load of the gravity −b̈ = (2πf)² b that the base's frame has in addition."""
        extra = (2 * math.pi * p["frequency"]) ** 2 * _shift(p, now.elapsed)
        return -now.dynamics.gravity_load(now.q, now.body._replace(gravity=extra))

    def points(self, p: Values, view: View) -> Tensor:
        """All points moved by b(t)."""
        return view.points + _shift(p, view.elapsed).unsqueeze(-2)


def _shift(p: Values, elapsed: Tensor) -> Tensor:
    """b(t), (..., 2) m."""
    angle = 2 * math.pi * p["frequency"] * elapsed
    sine, cosine = angle.sin(), angle.cos()
    return joined_by_column(*(p[f"sine_{axis}"] * sine + p[f"cosine_{axis}"] * cosine for axis in "xy"))


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
