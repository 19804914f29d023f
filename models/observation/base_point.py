"""The base's own keypoint: a tracker's detections of the first joint, of a body that is carried about.

    y ~ F(r_0 + b, σ),     σ = "emission.base_scale" (1,), length unit

with r_0 the first joint's place by the body's file and b its displacement (:mod:`..articulated.moving_base`).

Shapes: d axes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np
import torch
from torch import Tensor

from invdyn.models.bodies.protocol import ArticulatedBody, axes
from invdyn.models.observation.keypoints import MAX_NOISE, MIN_NOISE
from invdyn.models.observation.sensor import NoisySensor
from invdyn.models.observation.view import View


@dataclass(frozen=True)
class BasePoint(NoisySensor):
    """Of a body in the plane or a tree; ``along`` are its axes, known once :meth:`bound`."""

    along: tuple[str, ...] = ()

    name: ClassVar[str] = "base_position"
    unit: ClassVar[str] = "length"

    def bound(self, body: ArticulatedBody) -> Self:
        """On a body, whose first joint has a place. Raises ValueError for a body of another kind."""
        if not {"base", "position"} & {*type(body.parameters())._fields}:
            raise ValueError(f"expected a chain in the plane or a tree, whose first joint has a place: '{body.name}'")
        return replace(self, along=tuple(axes(body)))

    @property
    def shape(self) -> tuple[int]:
        """(d,)."""
        return (len(self.along),)

    @property
    def coords(self) -> dict[str, Sequence[str]]:
        """Axes of space."""
        return {"space": self.along}

    def defaults(self, reach: float) -> dict[str, Tensor]:
        """Noise of a fiftieth of the reach."""
        return {"emission.base_scale": torch.full((1,), 0.02 * reach).double()}

    def started(self, jitter: np.ndarray, reach: float) -> dict[str, np.ndarray]:
        """The larger jitter of its coordinates."""
        return {"emission.base_scale": np.clip(jitter.max(keepdims=True), MIN_NOISE * reach, MAX_NOISE * reach)}

    def location_scale(self, view: View, t: int | Tensor, parameters: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
        """The base where it is."""
        place = first_joint(view.body)
        loc = place if view.base is None else place + view.base[0]
        scale = parameters["emission.base_scale"]
        return loc, scale.expand(*scale.shape[:-1], len(self.along))


def first_joint(numbers: Any) -> Tensor:
    """Where the first joint is by the ``numbers`` of a chain in the plane or of a tree, (..., d) m."""
    place: Tensor = numbers.base if hasattr(numbers, "base") else numbers.position[..., 0, :]
    return place
