"""Pixels of one camera or several, as a tracker gives them: projected keypoints, and a tracker's correlated errors.

    y_cp ~ F(π_c(X_p(θ)) + b_cp, σ_cp s(confidence))

for camera c, keypoint p and each axis of the picture, px. π is :mod:`.pinhole`'s projection; F is the observation's
noise family, Student-t for a tracker's outliers. σ = "emission.pixel_scale" (C, P); s is that of :mod:`.confidence`,
with "emission.pixel_confidence_slope" and "…_drop" (C P,). A tracker's error in one view is not white: its estimate of
a joint is offset for as long as the limb is seen from one side. So b is a state, an Ornstein–Uhlenbeck process, exact
over any step,

    b' = a b + β √(1 − a²) η,   a = exp(−δ/ℓ),   b₀ ~ N(0, β²)

with β = "emission.bias_scale" (C, P) px and ℓ = "emission.bias_time" (1,) s. (As a constant it would not drift, and
intervals of lengths would be too narrow; marginalised, it would correlate all rows, which a filter cannot handle. A
latent state keeps both the intervals and the recursions, and its derivatives cost nothing: see
`StateSpaceModel.independent_sensor_states`.)

A keypoint that one camera sees counts, and one that is missing (NaN) has no term. Where by the model a camera cannot
see a point, its pixel is of something else, anywhere in the picture.

Unknowns of a camera may be learned: by how much its clock runs ahead of the rows, "camera.offset" (C,) s, and the error
of its pose, a rotation vector "camera.turn" (C, 3) rad and "camera.shift" (C, 3) m in its own frame.

Or the error of its rotation is integrated out: each camera then has a rotation vector as a state,
ω ~ N(0, "camera.turn_scale" (C,)²) about each axis of its frame, by b's law with a time of `ROTATION_TIME`. It shifts
all keypoints together and permanently. As independent errors of a tracker, intervals of points that few cameras see
would be too narrow. No camera is fixed.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Self

import numpy as np
import torch
from torch import Tensor

from invdyn.models.bodies.protocol import ArticulatedBody
from invdyn.models.observation.confidence import DEFAULT_DROP, DEFAULT_SLOPE, Confidence
from invdyn.models.observation.pinhole import PinholeCameras, moved, project
from invdyn.models.observation.sensor import NoisySensor
from invdyn.models.observation.view import View
from invdyn.models.shapes import join

DEFAULT_NOISE, DEFAULT_BIAS, DEFAULT_TIME = 2.0, 5.0, 0.3
"""Starting values: px, px and s."""
MIN_NOISE, MAX_NOISE = 0.05, 100.0
"""px, bounds of the noise estimated from a recording's jitter."""
DEFAULT_ROTATION = 0.01
"""rad, half a degree: prior sd of the error of a camera's rotation."""
ROTATION_TIME = 1e4
"""s, far beyond a recording: the rotation is constant, while the chain of states has a proper transition."""


@dataclass(frozen=True, eq=False)
class Pixels(NoisySensor):
    """Detections of P sites in the pictures of C cameras.

    Args:
        cameras: C of them.
        camera_names: theirs.
        size: (C, 2) width and height of the pictures, px.
        sites: which (P,), by place among the body's sites or by name.
        confidence: (T, C, P) the tracker's, or None.
        resolution: metres that a pixel spans at the keypoints, approximately: for a start, no part of the likelihood.
        timed, posed: whether clocks, or poses, have parameters.
        rotation_uncertain: whether ω is a state.
        lasting: whether b is a state.
        names: of the sites, known once :meth:`bound`; then all ``sites`` are places.

    Raises ValueError for names that are not as many as the cameras.
    """

    cameras: PinholeCameras
    camera_names: tuple[str, ...]
    size: Tensor
    sites: tuple[Any, ...]
    confidence: Any = None
    resolution: float = 3e-3
    timed: bool = False
    posed: bool = False
    rotation_uncertain: bool = False
    lasting: bool = True
    names: tuple[str, ...] = field(default=())

    name: ClassVar[str] = "pixel"
    unit: ClassVar[str] = "px"

    def __post_init__(self) -> None:
        if len(self.camera_names) != len(self.cameras.focal):
            raise ValueError(f"expected a name for each of {len(self.cameras.focal)} cameras, got {self.camera_names}")
        if isinstance(self.confidence, np.ndarray):
            known = Confidence.of(self.confidence.reshape(len(self.confidence), -1))
            object.__setattr__(self, "confidence", known)

    def bound(self, body: ArticulatedBody) -> Self:
        """The pixels of ``body``'s sites.

        Raises ValueError for sites that it does not have, and for a body in the plane.
        """
        known = body.keypoint_names
        if body.dimensions != 3:
            raise ValueError(f"expected a body in space for cameras, '{body.name}' has {body.dimensions} axes")
        places = [known.index(site) if site in known else site for site in self.sites]
        for site in places:
            if site not in range(len(known)):
                raise ValueError(f"expected keypoints among {', '.join(known)}, got {site!r}")
        sites = tuple(int(site) for site in places)
        return replace(self, sites=sites, names=tuple(known[site] for site in sites))

    def to(self, device: torch.device | str) -> Self:
        """See :meth:`Sensor.to`."""
        cameras = self.cameras.to(device, self.cameras.focal.dtype)
        confidence = None if self.confidence is None else self.confidence.to(device)
        return replace(self, cameras=cameras, size=self.size.to(device), confidence=confidence)

    @property
    def shape(self) -> tuple[int, int, int]:
        """(C, P, 2)."""
        return len(self.camera_names), len(self.sites), 2

    @property
    def coords(self) -> dict[str, Sequence[str]]:
        """Cameras, keypoints, and axes of a picture, to the right and down."""
        return {"camera": self.camera_names, "keypoint": self.names, "picture": ("u", "v")}

    def data(self) -> list[Tensor]:
        """See :meth:`.Observation.data`."""
        known = [] if self.confidence is None else [self.confidence.doubt, self.confidence.drop]
        return [*known, *(each for each in self.cameras if each is not None)]

    def defaults(self, reach: float) -> dict[str, Tensor]:
        """Noise of 2 px, correlated errors of 5 px, and cameras as calibrated."""
        cameras, points, _ = self.shape

        def constant(value: float, *shape: int) -> Tensor:
            return torch.full(shape, value, dtype=torch.float64)

        own = {"emission.pixel_scale": constant(DEFAULT_NOISE, cameras, points)}
        if self.lasting:
            own["emission.bias_scale"] = constant(DEFAULT_BIAS, cameras, points)
            own["emission.bias_time"] = constant(DEFAULT_TIME, 1)
        if self.confidence is not None:
            for name, start in (("slope", DEFAULT_SLOPE), ("drop", DEFAULT_DROP)):
                own[f"emission.pixel_confidence_{name}"] = constant(start, cameras * points)
        if self.timed:
            own["camera.offset"] = constant(0.0, cameras)
        if self.posed:
            own |= {f"camera.{name}": constant(0.0, cameras, 3) for name in ("turn", "shift")}
        if self.rotation_uncertain:
            own["camera.turn_scale"] = constant(DEFAULT_ROTATION, cameras)
        return own

    def started(self, jitter: np.ndarray, reach: float) -> dict[str, np.ndarray]:
        """The larger jitter of a detection's two axes."""
        return {"emission.pixel_scale": np.clip(jitter.reshape(self.shape).max(-1), MIN_NOISE, MAX_NOISE)}

    # -- the distribution of a row ---------------------------------------------------------------
    def location_scale(self, view: View, t: int | Tensor, parameters: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
        """Pixels of the sites, each with its correlated error, and their noise."""
        scale = parameters["emission.pixel_scale"].flatten(-2)
        if self.confidence is not None:
            slope, drop = (parameters[f"emission.pixel_confidence_{name}"] for name in ("slope", "drop"))
            scale = self.confidence.widened(scale, slope, drop, t)
        pixels, seen = self.projected(view, parameters)
        if self.lasting and view.memory is not None:
            pixels = pixels + view.memory[..., : self.independent_states].unflatten(-1, self.shape)
        anywhere = self.size.to(pixels)
        pixels = torch.where(seen[..., None], pixels, anywhere[:, None] / 2)
        scale = torch.where(seen, scale.unflatten(-1, self.shape[:2]), anywhere.amax(-1, keepdim=True))
        return pixels.flatten(-3), scale.repeat_interleave(2, -1).flatten(-2)

    def projected(self, view: View, parameters: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
        """Pixels (..., C, P, 2) of the sites without error, and whether cameras see them, (..., C, P)."""
        points = self._of_sites(view.points)
        cameras = self.cameras.to(points.device, points.dtype)
        if self.posed:
            cameras = moved(cameras, parameters["camera.turn"], parameters["camera.shift"])
        if self.rotation_uncertain and view.memory is not None:
            turn = view.memory[..., self.independent_states :].unflatten(-1, (-1, 3))
            cameras = moved(cameras, turn, torch.zeros_like(turn))
        if self.timed:
            # The row's moment, o s earlier by a clock that runs o ahead: to second order, as limbs change direction
            # within 20 ms.
            ahead = -parameters["camera.offset"][..., None, None]
            velocity, acceleration = self._of_sites(view.velocity), self._of_sites(view.site_acceleration)
            points = points.unsqueeze(-3) + ahead * (velocity.unsqueeze(-3) + 0.5 * ahead * acceleration.unsqueeze(-3))
        return project(cameras, points, each=self.timed)

    def _of_sites(self, values: Tensor) -> Tensor:
        """Of all sites' values (..., S, 3) those of the keypoints, (..., P, 3)."""
        # Entry by entry: a list of indices would be sent to the device in each row.
        return torch.stack([values[..., site, :] for site in self.sites], -2)

    # -- correlated errors --------------------------------------------------------------------------------
    @property
    def independent_states(self) -> int:
        """Number of the b, one for each entry of its part of a row, or 0 without correlated errors."""
        return int(np.prod(self.shape)) if self.lasting else 0

    @property
    def states(self) -> int:
        """Those, and three for each camera's rotation."""
        return self.independent_states + 3 * len(self.camera_names) * self.rotation_uncertain

    def initial_sd(self, parameters: Mapping[str, Tensor]) -> Tensor:
        """Standard deviations (..., states) of the first b, px, and of rotations, rad."""
        own = [parameters["emission.bias_scale"].repeat_interleave(2, -1).flatten(-2)] if self.lasting else []
        own += [parameters["camera.turn_scale"].repeat_interleave(3, -1)] if self.rotation_uncertain else []
        return join(*own)

    def next_mean(self, memory: Tensor, dt: Tensor, parameters: Mapping[str, Tensor]) -> Tensor:
        """Mean (..., states) of them, ``dt`` (..., 1) s after they were ``memory``."""
        return torch.exp(-self._pace(dt, parameters)) * memory

    def transition_sd(self, dt: Tensor, parameters: Mapping[str, Tensor]) -> Tensor:
        """Standard deviations (..., states) of them about that mean."""
        # 1 − a², without the digits that a difference near 0 would lose
        return self.initial_sd(parameters) * (-torch.expm1(-2 * self._pace(dt, parameters))).sqrt()

    def _pace(self, dt: Tensor, parameters: Mapping[str, Tensor]) -> Tensor:
        """How much of its time has passed for each of the states, (..., states), or for all of them, (..., 1)."""
        elapsed = dt / parameters["emission.bias_time"] if self.lasting else dt[..., :0]
        if not self.rotation_uncertain:
            return elapsed
        stands = (dt / ROTATION_TIME).expand(*dt.shape[:-1], self.states - self.independent_states)
        return join(elapsed.expand(*elapsed.shape[:-1], self.independent_states), stands)

    # -- a start -----------------------------------------------------------------------------------
    def about(self, points: Tensor) -> Tensor:
        """Pixels (..., C P 2) of all sites' ``points`` (..., S, 3), the picture's centre where a camera sees none."""
        pixels, seen = project(self.cameras.to(points.device, points.dtype), self._of_sites(points))
        return torch.where(seen[..., None], pixels, self.size.to(pixels)[:, None] / 2).flatten(-3)
