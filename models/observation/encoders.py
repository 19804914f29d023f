"""Encoders: the joints' coordinates themselves, whole turns counted.

y_k ~ F(θ_k, σ_k),     σ_k = "emission.angle_scale" (K,), rad
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
import torch
from torch import Tensor

from invdyn.models.bodies.protocol import ArticulatedBody
from invdyn.models.observation.sensor import NamedSensor
from invdyn.models.observation.view import View

DEFAULT_NOISE, MIN_NOISE, MAX_NOISE = 1e-3, 1e-5, 0.1
"""rad: the starting value, and bounds of the noise estimated from a recording's jitter."""


@dataclass(frozen=True)
class Encoders(NamedSensor):
    """One at each joint; ``names`` are the joints'."""

    name: ClassVar[str] = "angle"
    unit: ClassVar[str] = "rad"
    dim: ClassVar[str] = "joint"

    def bound(self, body: ArticulatedBody) -> Self:
        """The encoders of ``body``."""
        return replace(self, names=tuple(body.joint_names))

    def defaults(self, reach: float) -> dict[str, Tensor]:
        """A milliradian."""
        return {"emission.angle_scale": torch.full(self.shape, DEFAULT_NOISE).double()}

    def started(self, jitter: np.ndarray, reach: float) -> dict[str, np.ndarray]:
        """Their jitter."""
        return {"emission.angle_scale": np.clip(jitter, MIN_NOISE, MAX_NOISE)}

    def location_scale(self, view: View, t: int | Tensor, parameters: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
        """The angles as encoders show them."""
        return view.angles, parameters["emission.angle_scale"]
