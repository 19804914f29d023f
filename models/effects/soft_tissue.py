"""A marker on soft tissue: it lags behind its bone, p − κ p̈, or slides on it as the joint rotates.

The first is what slow motion leaves of a mass on a spring and a damper, of natural frequency ω = 1/√κ. The variant is
all of it, for motion about as fast: the marker is at p + δ with

    δ̈ + 2ζω δ̇ + ω² δ = −p̈

from row to row in closed form, with p̈ a straight line in between, that of the cubic through p and ṗ at both ends.
"""

from typing import ClassVar, Self

import torch
from pyro.distributions import HalfNormal, Normal, Uniform
from torch import Tensor

from invdyn.models.effects.base import Effect, Parameter, Scale, Values, View
from invdyn.models.effects.hidden import Follower, Motion

STIFFEST = 1e-8
"""s², least κ that is none at all: a frequency of 1.6 kHz."""
DAMPING_RATIOS = (0.1, 0.3, 0.6)  # that are tried, of a prior from .02 to .98


class SoftTissue(Effect):
    """The keypoint at a link's tip is thrown outwards by −κ p̈: tissue of a natural frequency 1/√κ, far below it.

    ``SoftTissue("elbow", "sliding")`` is skin that the joint at the tip pulls along as it rotates by θ (for the last
    tip, that at its link's near end): p + (a + a' θ) u + (b + b' θ) u⊥. Fast motion and other postures distinguish
    either from a fixed offset.
    """

    planar = True
    sensor, site = "keypoints", "keypoint"
    forms: ClassVar[tuple[str, ...]] = ("sliding",)

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Compliance κ, s²; sliding, a' and b', m/rad, and a and b, m."""
        k = self.place[0]
        if self.form is None:
            return (_compliance(scale, k),)
        prior = Normal(0.0, 0.05 * scale.body.length[k].item())
        slides = [Parameter(f"{way}_per_rad", "m/rad", prior) for way in ("along", "across")]
        return (*slides, Parameter("along", "m", prior), Parameter("across", "m", prior))

    def points(self, p: Values, view: View) -> Tensor:
        """The tip moved."""
        k = self.place[0]
        if self.form is None:
            return view.moved(k, -p["kappa"] * view.site_acceleration[..., k, :])
        joint = min(k + 1, view.q.shape[-1] - 1)
        angle = view.q[..., joint : joint + 1]
        along, across = (p[way] + p[f"{way}_per_rad"] * angle for way in ("along", "across"))
        return view.moved(k, along * view.along[..., k, :] + across * view.across[..., k, :])


def _compliance(scale: Scale, k: int) -> Parameter:
    """κ, s²."""
    return Parameter("kappa", "s²", HalfNormal(0.1 / scale.speed[k] ** 2))


class Wobble(Follower):
    """Soft tissue as a mass on a spring: hidden states δ, m, and δ̇, m/s, along x and y each."""

    name = "soft_tissue"
    variant = 1
    sensor, site = "keypoints", "keypoint"
    states = 4

    @classmethod
    def in_place_of(cls, tissue: Effect) -> Self | None:
        """Of soft tissue; None of skin that slides."""
        if tissue.form is not None:
            return None
        other = cls(*tissue.where)
        other.name, other.place = tissue.name, tissue.place
        return other

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Compliance κ = 1/ω², s², and the damping ratio ζ, a pure number."""
        ratio = Parameter("damping_ratio", "1", Uniform(0.02, 0.98), None, DAMPING_RATIOS)
        return _compliance(scale, self.place[0]), ratio

    def hidden_scale(self, scale: Scale) -> tuple[float, ...]:
        """A twentieth of the reach, which tissue of a typical compliance swings through."""
        far = 0.05 * scale.reach
        fast = far * scale.speed[self.place[0]] / 0.1**0.5
        return far, far, fast, fast

    def follow(self, p: Values, hidden: Tensor, before: Motion, after: Motion, dt: Tensor) -> Tensor:
        """See :meth:`Follower.follow`; damping ratios are below one."""
        k = self.place[0]
        (p0, v0), (p1, v1) = ((x[..., k, :], v[..., k, :]) for x, v in (before, after))
        # of the cubic the second derivative, a + b t
        a = (6 * (p1 - p0) / dt - 4 * v0 - 2 * v1) / dt
        b = (6 * (v0 + v1) - 12 * (p1 - p0) / dt) / dt**2
        kappa, ratio = p["kappa"].clamp_min(STIFFEST), p["damping_ratio"]
        omega = kappa.rsqrt()
        rate, turning = ratio * omega, omega * (1 - ratio**2).sqrt()

        def steady(t: Tensor | float) -> Tensor:
            return kappa * (2 * rate * kappa * b - a - b * t)

        x, v = (state - rest for state, rest in zip(hidden.chunk(2, -1), (steady(0.0), -kappa * b), strict=True))
        decay, cos, sin = (-rate * dt).exp(), (turning * dt).cos(), (turning * dt).sin() / turning
        swung = decay * ((cos + rate * sin) * x + sin * v)
        swings = decay * ((cos - rate * sin) * v - sin / kappa * x)
        moved = torch.cat(torch.broadcast_tensors(swung + steady(dt), swings - kappa * b), -1)
        return torch.where(p["kappa"] > 0, moved, torch.zeros_like(moved))

    def shown(self, tips: Tensor, hidden: Tensor) -> Tensor:
        """One of them moved by δ."""
        here = torch.nn.functional.one_hot(torch.tensor(self.place[0]), tips.shape[-2]).to(tips)
        return tips + here.unsqueeze(-1) * hidden[..., :2].unsqueeze(-2)
