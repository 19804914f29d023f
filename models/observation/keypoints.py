"""Keypoints: a camera's or a tracker's detections of a body's sites, in the plane or in space, and of its first joint.

    y_p ~ F(r_p(θ), σ_p s(c)),     σ_p = "emission.keypoint_scale" (P,), length unit
    y   ~ F(r_0 + b, σ),           σ = "emission.base_scale" (1,), of the base of a body that is carried about

with s(c) of the tracker's confidence (:mod:`.confidence`), γ = "emission.confidence_slope" and
δ = "emission.confidence_drop" (P,). Coordinates are ordered keypoint by keypoint. r_0 is the first joint's place by the
body's file and b its displacement (:mod:`..articulated.moving_base`).

Shapes: P keypoints, S sites, d dimensions, those of the body.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self, TypeVar

import numpy as np
import torch
from torch import Tensor

from invdyn.models.bodies.protocol import AXES, ArticulatedBody, axes
from invdyn.models.observation.confidence import DEFAULT_DROP, DEFAULT_SLOPE, Confidence
from invdyn.models.observation.mixture import MistakenRows
from invdyn.models.observation.sensor import NamedSensor, NoisySensor
from invdyn.models.observation.view import Outlier, Shift, Swap, View

MIN_NOISE, MAX_NOISE = 1e-5, 0.3
"""Of the reach: bounds of the noise estimated from a recording's jitter."""


S = TypeVar("S", Outlier, Shift)


@dataclass(frozen=True, eq=False, init=False)
class Keypoints(NoisySensor):
    """Detections of sites.

    Args:
        sites: which (P,), by place among the body's sites or by name, in the recording's order.
        confidence: (T, P) the tracker's, or None.
        names, coordinates: of the sites and d, known once :meth:`bound`; then all ``sites`` are places.
    """

    sites: tuple[int, ...]
    confidence: Confidence | None
    names: tuple[str, ...]
    coordinates: int

    name: ClassVar[str] = "position"
    unit: ClassVar[str] = "length"

    def __init__(
        self,
        sites: Sequence[int | str],
        confidence: np.ndarray | Confidence | None = None,
        names: tuple[str, ...] = (),
        coordinates: int | None = None,
    ):
        known = Confidence.of(confidence) if isinstance(confidence, np.ndarray) else confidence
        own = {"sites": tuple(sites), "confidence": known, "names": names, "coordinates": coordinates}
        for key, value in own.items():
            object.__setattr__(self, key, value)

    def bound(self, body: ArticulatedBody) -> Self:
        """The keypoints of ``body``; raises ValueError for sites that it does not have."""
        known = body.keypoint_names
        missing = [s for s in self.sites if (s not in known if isinstance(s, str) else s not in range(len(known)))]
        if missing:
            raise ValueError(f"expected keypoints among {', '.join(known)}, got {missing[0]!r}")
        sites = tuple(known.index(site) if isinstance(site, str) else int(site) for site in self.sites)
        return replace(self, sites=sites, names=tuple(known[site] for site in sites), coordinates=body.dimensions)

    def to(self, device: torch.device | str) -> Self:
        """See :meth:`Sensor.to`."""
        return self if self.confidence is None else replace(self, confidence=self.confidence.to(device))

    @property
    def shape(self) -> tuple[int, int]:
        """(P, d)."""
        return len(self.sites), self.coordinates

    @property
    def coords(self) -> dict[str, Sequence[str]]:
        """Keypoints, and axes of space."""
        return {"keypoint": self.names, "space": tuple(AXES[: self.coordinates])}

    def defaults(self, reach: float) -> dict[str, Tensor]:
        """Noise of a fiftieth of the reach."""
        parameters = {"emission.keypoint_scale": torch.full((len(self.sites),), 0.02 * reach).double()}
        if self.confidence is not None:
            for name, start in (("slope", DEFAULT_SLOPE), ("drop", DEFAULT_DROP)):
                parameters[f"emission.confidence_{name}"] = torch.full((len(self.sites),), start).double()
        return parameters

    def started(self, jitter: np.ndarray, reach: float) -> dict[str, np.ndarray]:
        """The larger jitter of a keypoint's coordinates."""
        return {
            "emission.keypoint_scale": np.clip(jitter.reshape(self.shape).max(1), MIN_NOISE * reach, MAX_NOISE * reach)
        }

    def location_scale(self, view: View, t: int | Tensor, parameters: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
        """The sites as seen, and their noise, as effects change it."""
        scale = parameters["emission.keypoint_scale"]
        if self.confidence is not None:
            slope, drop = (parameters[f"emission.confidence_{name}"] for name in ("slope", "drop"))
            scale = self.confidence.widened(scale, slope, drop, t)
        sd = scale.repeat_interleave(self.coordinates, -1)
        if view.noise is not None:
            every = [sd.new_ones(*sd.shape[:-1], self.coordinates)] * view.points.shape[-2]
            for site, width in zip(self.sites, sd.unflatten(-1, self.shape).unbind(-2), strict=True):
                every[site] = width
            sd = self.tracked(view.noise(torch.stack(every, -2))).flatten(-2)
        return self.tracked(view.points).flatten(-2), sd

    def tracked(self, values: Tensor) -> Tensor:
        """Of all sites' values (..., S, d) those of the keypoints, (..., P, d)."""
        # Entry by entry: a list of indices would be sent to the device in each row.
        return torch.stack([values[..., site, :] for site in self.sites], -2)

    def doubted(self, t: int | Tensor, like: Tensor, count: int) -> Tensor | None:
        """1 − c at row ``t``, (..., S) for ``count`` sites, of the type of ``like``; 0 where untracked or missing.

        None where no confidence is known.
        """
        if self.confidence is None:
            return None
        doubt = self.confidence.itself[t].to(like)
        every = [doubt.new_zeros(doubt.shape[:-1])] * count
        for site, own in zip(self.sites, doubt.unbind(-1), strict=True):
            every[site] = own
        return torch.stack(every, -1)

    def mistaken(self, loc: Tensor, scale: Tensor, mistakes: Sequence[Outlier | Swap | Shift]) -> MistakenRows:
        """Rows (..., O), keypoints first, of a tracker with mistakes, which name keypoints by site."""
        outliers = [self._of_keypoints(mistake) for mistake in mistakes if isinstance(mistake, Outlier)]
        swaps = [
            replace(mistake, one=self.sites.index(mistake.one), other=self.sites.index(mistake.other))
            for mistake in mistakes
            if isinstance(mistake, Swap)
        ]
        shift = next((self._of_keypoints(mistake) for mistake in mistakes if isinstance(mistake, Shift)), None)
        return MistakenRows(loc, scale, self.shape, outliers, swaps, shift)

    def _of_keypoints(self, mistake: S) -> S:
        """The tracked ones of all sites' widths."""
        widths = {name: value for name, value in vars(mistake).items() if name != "rate" and value.shape[-2] > 1}
        sizes: dict[str, Any] = {name: self.tracked(value) for name, value in widths.items()}
        return replace(mistake, **sizes)


@dataclass(frozen=True)
class BasePoint(NamedSensor):
    """Of a body in the plane or a tree; ``names`` are those of its axes."""

    name: ClassVar[str] = "base_position"
    unit: ClassVar[str] = "length"
    dim: ClassVar[str] = "space"

    def bound(self, body: ArticulatedBody) -> Self:
        """On a body, whose first joint has a place. Raises ValueError for a body of another kind."""
        if not {"base", "position"} & {*type(body.parameters())._fields}:
            raise ValueError(f"expected a chain in the plane or a tree, whose first joint has a place: '{body.name}'")
        return replace(self, names=tuple(axes(body)))

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
        return loc, scale.expand(*scale.shape[:-1], len(self.names))


def first_joint(numbers: Any) -> Tensor:
    """Where the first joint is by the ``numbers`` of a chain in the plane or of a tree, (..., d) m."""
    place: Tensor = numbers.base if hasattr(numbers, "base") else numbers.position[..., 0, :]
    return place
