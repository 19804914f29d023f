"""What a camera makes of the picture: one effect a class.

camera_latency   keypoints that come late: a row shows p(t − δ)
camera_roll      a camera that is not level: R(α) p, the picture rotated about the frame's origin
camera_scale     a camera whose scale is off: p → s p about the frame's origin
camera_yaw       the plane of motion seen obliquely: (x cos ψ, y) D / (D + x sin ψ)
lens_distortion  radial distortion of the lens: p (1 + k₁ |p|²), Brown's first term
rolling_shutter  a camera that reads its rows one after the other: a point at height y is seen at t + ρ y

A row's state is the arm's when its picture was taken. Of a camera that is late, the motors are late to that state, and
encoders, whose clock is the motors', are ahead: u'(t) = u(t − δ), and encoders show θ(t + δ).
"""

import math
from abc import abstractmethod

import torch
from pyro.distributions import HalfNormal, LogNormal, Normal, StudentT
from torch import Tensor

from invdyn.models.effects.base import Command, Effect, Parameter, Scale, Values, View, quantiles, rotated


class Optics(Effect):
    """Base of the camera's effects on all points: about the frame's origin, in the variant about any centre.

    The origin is a choice of the calibration, and no property of the lens, as its centre is.
    """

    planar = True
    sensor, site, order = "keypoints", "arm", 2

    @abstractmethod
    def about_origin(self, scale: Scale) -> tuple[Parameter, ...]:
        """Parameters of f."""

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Those of f; in the variant the centre, m."""
        if not self.variant:
            return self.about_origin(scale)
        prior, grid = Normal(0.0, 0.5 * scale.reach), (-0.4 * scale.reach, 0.4 * scale.reach)
        centre = (Parameter(f"centre_{axis}", "m", prior, None, grid) for axis in "xy")
        return (*self.about_origin(scale), *centre)

    @abstractmethod
    def seen(self, p: Values, points: Tensor) -> Tensor:
        """What f makes of points (..., K, 2) m."""

    def points(self, p: Values, view: View) -> Tensor:
        """The picture, c + f(p − c)."""
        if not self.variant:
            return self.seen(p, view.points)
        centre = torch.cat(torch.broadcast_tensors(p["centre_x"], p["centre_y"]), -1).unsqueeze(-2)
        return centre + self.seen(p, view.points - centre)


class CameraRoll(Optics):
    """All points rotated counter-clockwise by an angle about the origin.

    With the base at the origin, only encoders or a picture of the base distinguish it from tilted gravity.
    """

    def about_origin(self, scale: Scale) -> tuple[Parameter, ...]:
        """Angle, rad: nine cameras in ten are level to 3°, as few bases are (:mod:`.disturbances`); any may be."""
        return (Parameter("angle", "rad", StudentT(3.0, 0.0, 0.02)),)

    def seen(self, p: Values, points: Tensor) -> Tensor:
        """R(angle) p."""
        return rotated(points, p["angle"].unsqueeze(-1))


class CameraScale(Optics):
    """All points s times as far from the origin as they are.

    Only a base off the origin or a known strength of gravity distinguishes it from longer links.
    """

    def about_origin(self, scale: Scale) -> tuple[Parameter, ...]:
        """Factor s, a pure number."""
        return (Parameter("scale", "1", LogNormal(0.0, 0.07), 1.0),)

    def seen(self, p: Values, points: Tensor) -> Tensor:
        """S p."""
        return p["scale"].unsqueeze(-1) * points


class CameraYaw(Optics):
    """The plane is rotated by ψ about the vertical through the origin, its +x side away from the camera at D.

    What is farther away looks smaller: that asymmetry distinguishes it from a scale.
    """

    def about_origin(self, scale: Scale) -> tuple[Parameter, ...]:
        """Angle ψ, rad: few cameras stand far from square; distance D of the camera from the origin, m."""
        distance = LogNormal(math.log(3.5 * scale.reach), 0.4)
        return (
            Parameter("angle", "rad", StudentT(3.0, 0.0, 0.085), 0.0, (-0.2, -0.12, -0.06, 0.06, 0.12, 0.2)),
            Parameter("distance", "m", distance, None, tuple(n * scale.reach for n in (2.0, 3.5, 6.0))),
        )

    def seen(self, p: Values, points: Tensor) -> Tensor:
        """Perspective about the origin."""
        angle, distance = p["angle"], p["distance"]
        x, y = points.unbind(-1)
        away = (distance + x * angle.sin()).maximum(0.1 * distance)  # nothing is behind the camera
        return torch.stack(torch.broadcast_tensors(x * angle.cos(), y), -1) * (distance / away).unsqueeze(-1)


class LensDistortion(Optics):
    """Points move along their radius from the frame's origin; k₁ > 0 is a pincushion, < 0 a barrel.

    Its growth with the third power of the radius distinguishes it from a scale.
    """

    def about_origin(self, scale: Scale) -> tuple[Parameter, ...]:
        """Coefficient k₁, m⁻²."""
        return (Parameter("k1", "m⁻²", Normal(0.0, 0.08 / scale.reach**2)),)

    def seen(self, p: Values, points: Tensor) -> Tensor:
        """P (1 + k₁ |p|²)."""
        return points * (1 + p["k1"].unsqueeze(-1) * points.square().sum(-1, keepdim=True))


class RollingShutter(Effect):
    """The delay with which a point is seen depends on its height then: two steps from τ = 0, the slope at the first,

        τ ← τ + (ρ y(t + τ) − τ) / (1 − ρ ẏ(t)).

    ρ < 0 where the picture is read from its top. The product of velocity and height distinguishes it from latency.
    """

    planar = True
    sensor, site, order = "keypoints", "arm", 1

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Time ρ per height, s/m."""
        return (Parameter("readout", "s/m", Normal(0.0, 0.15 / (max(scale.speed) * scale.reach))),)

    def points(self, p: Values, view: View) -> Tensor:
        """p(t + τ)."""
        readout = p["readout"].unsqueeze(-1)
        stretch = (1 - readout * view.velocity[..., 1:]).clamp_min(0.2)
        delay = readout * view.points[..., 1:] / stretch
        missed = readout * view.later(delay)[..., 1:] - delay
        return view.later(delay + missed / stretch)


class CameraLatency(Effect):
    """The picture in a row was taken δ before its time. Encoders are followed over δ
    (:mod:`..articulated.observation_model`).

    Only encoders distinguish it from motors that act late. Without commands, too, it has no effect at all.
    """

    sensor, site = "keypoints", "arm"

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Latency δ, s."""
        prior = HalfNormal(0.03)
        return (Parameter("latency", "s", prior, 0.0, quantiles(prior, 6)),)

    def command(self, p: Values, command: Command) -> Command:
        """u(t − δ)."""
        return command.delayed(p["latency"])

    def angles(self, p: Values, view: View) -> Tensor:
        """θ(t + δ)."""
        return view.angles_after(p["latency"])
