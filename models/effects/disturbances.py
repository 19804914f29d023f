"""Forces from outside, a base that shakes or leans: one effect a class.

base_motion    a base that shakes: b(t) = a sin 2πft + c cos 2πft under the first joint
external_push  someone pushes: a force F on a keypoint between two moments, τ = Jᵀ F
gravity_tilt   gravity from another direction, as the frame is not level: R(α) g
"""

import math
from collections.abc import Sequence
from typing import Any, Self

import torch
from pyro.distributions import HalfNormal, LogNormal, Normal, Uniform
from torch import Tensor

from invdyn.models.bodies.protocol import AXES, ArticulatedBody
from invdyn.models.effects.base import Effect, Parameter, Scale, Situation, Values, View, rotated
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


TYPICAL, MIN_DURATION = 0.15, 0.01
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
        duration = p["duration"].clamp_min(MIN_DURATION)
        edges = p["moment"] - duration / 2, p["moment"] + duration / 2
        on, off = (((now.time - edge) / now.step + 0.5).clamp(0.0, 1.0) for edge in edges)
        force = torch.cat(torch.broadcast_tensors(p["impulse_x"], p["impulse_y"]), -1) / duration
        return now.at_site(self.place[0], force) * (on - off)


class GravityTilt(Effect):
    """Gravity rotated by an angle, in the frame of the body and of the camera.

    In the plane counter-clockwise; only encoders or a picture of the base distinguish it from a rolled camera. A plumb
    line does not: both rotate it. In space the base leans about the two axes of the frame that are nearest to level: a
    rotation vector of these two coordinates.
    """

    site = "arm"
    about: tuple[int, ...] = ()
    """Axes of the frame about which it may rotate, by number; none in the plane."""

    @classmethod
    def everywhere(cls, body: ArticulatedBody, keypoints: Sequence[str]) -> list[Self]:
        """One, where there is gravity."""
        return [cls()] if any(body.gravity) else []

    def _bound(self, body: ArticulatedBody, where: Sequence[str]) -> Self:
        other = super()._bound(body, where)
        if body.dimensions == 3:
            upright = max(range(3), key=lambda axis: abs(body.gravity[axis]))
            other.about = tuple(axis for axis in range(3) if axis != upright)
        return other

    @property
    def _names(self) -> tuple[str, ...]:
        return tuple(f"about_{AXES[axis]}" for axis in self.about) or ("angle",)

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Angle, rad; in space two."""
        return tuple(Parameter(name, "rad", Normal(0.0, 0.15)) for name in self._names)

    def body(self, p: Values, body: Any) -> Any:
        """R g."""
        if not self.about:
            return body._replace(gravity=rotated(body.gravity, p["angle"]))
        angles = [p[name][..., 0] for name in self._names]
        vector = [torch.zeros_like(angles[0])] * 3
        for axis, angle in zip(self.about, angles, strict=True):
            vector[axis] = angle
        return body._replace(gravity=turned(body.gravity, torch.stack(vector, -1)))


def turned(vector: Tensor, by: Tensor) -> Tensor:
    """Vectors (..., 3) rotated by rotation vectors (..., 3), rad (Rodrigues): smooth where these are 0."""
    vector, by = torch.broadcast_tensors(vector, by)
    angle = (by.square().sum(-1, keepdim=True) + 1e-30).sqrt()
    once = torch.linalg.cross(by, vector)
    twice = torch.linalg.cross(by, once)
    return vector + torch.sinc(angle / torch.pi) * once + 0.5 * torch.sinc(angle / (2 * torch.pi)) ** 2 * twice
