"""Pixels of one camera or several, as a tracker gives them: what a camera sees, and what lasts of a tracker's error.

    y_cp ~ F(π_c(X_p(θ)) + b_cp, σ_cp s(confidence))

for camera c, keypoint p and each axis of the picture, px. π is :mod:`.pinhole`'s projection; F is the observation's
noise family, Student-t for a tracker's strays. σ = "emission.pixel_scale" (C, P); s is that of :mod:`.confidence`, with
"emission.pixel_confidence_slope" and "…_drop" (C P,). A tracker's error in one view is not white: it sits beside the
joint for as long as the limb is seen from there. So b is a state, an Ornstein–Uhlenbeck process, exact over any step,

    b' = a b + β √(1 − a²) η,   a = exp(−δ/ℓ),   b₀ ~ N(0, β²)

with β = "emission.bias_scale" (C, P) px and ℓ = "emission.bias_time" (1,) s. (As a constant it would not drift, and
lengths would be falsely sure; marginalised, it would tie all rows together, which a filter cannot have. A latent state
keeps both the intervals and the recursions, and its slopes cost nothing: see `StateSpaceModel.lone`.)

A keypoint that one camera sees counts, and one that is missing (NaN) has no term. Where the model says that a camera
cannot see a point, a pixel is of something else, and about anywhere in the picture.

What is not known of a camera may be learned: by how much its clock runs ahead of the rows, "camera.offset" (C,) s, and
its pose, off by a rotation vector "camera.turn" (C, 3) rad and "camera.shift" (C, 3) m in its own frame.

Or how it is turned is integrated out: a rotation vector a camera is a state then, ω ~ N(0, "camera.turn_scale" (C,)²)
about each axis of its frame, by b's law with a time of `STANDS`. All keypoints are off together by that, and for good:
as a tracker's errors each would be off by its own, and points of few cameras falsely sure. No camera is held.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Self

import numpy as np
import torch
from torch import Tensor

from invdyn.models.bodies.protocol import ArticulatedBody
from invdyn.models.observation.confidence import USUAL_DROP, USUAL_SLOPE, Confidence
from invdyn.models.observation.pinhole import PinholeCameras, moved, project
from invdyn.models.observation.sensor import NoisySensor
from invdyn.models.observation.view import View
from invdyn.models.shapes import join

USUAL, USUAL_BIAS, USUAL_TIME = 2.0, 5.0, 0.3
"""px, px and s, where nothing is known of them."""
LEAST, MOST_NOISE = 0.05, 100.0
"""px that jitter is believed to show."""
USUAL_TURN, STANDS = 0.01, 1e4
"""rad, half a degree, that a camera may be turned by, and s in which that changes: a chain of states needs steps."""


@dataclass(frozen=True, eq=False)
class Pixels(NoisySensor):
    """Detections of P sites in the pictures of C cameras.

    Args:
        cameras: C of them.
        camera_names: theirs.
        size: (C, 2) width and height of the pictures, px.
        sites: which (P,), by place among the body's sites or by name.
        confidence: (T, C, P) the tracker's, or None.
        resolution: metres that a pixel spans at the keypoints, about: for a start, no part of the likelihood.
        timed, posed: whether clocks, or poses, have parameters.
        turned: whether ω is there.
        lasting: whether b is there.
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
    turned: bool = False
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
        """Those of ``body``; raises ValueError for sites that it does not have, and for a body in the plane."""
        known = body.keypoint_names
        if body.space != 3:
            raise ValueError(f"expected a body in space before cameras, got '{body.name}', which has {body.space} axes")
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
        """A pixel or two of noise, some more that last, and cameras as they are said to be."""
        cameras, points, _ = self.shape

        def constant(value: float, *shape: int) -> Tensor:
            return torch.full(shape, value, dtype=torch.float64)

        own = {"emission.pixel_scale": constant(USUAL, cameras, points)}
        if self.lasting:
            own["emission.bias_scale"] = constant(USUAL_BIAS, cameras, points)
            own["emission.bias_time"] = constant(USUAL_TIME, 1)
        if self.confidence is not None:
            for name, usual in (("slope", USUAL_SLOPE), ("drop", USUAL_DROP)):
                own[f"emission.pixel_confidence_{name}"] = constant(usual, cameras * points)
        if self.timed:
            own["camera.offset"] = constant(0.0, cameras)
        if self.posed:
            own |= {f"camera.{name}": constant(0.0, cameras, 3) for name in ("turn", "shift")}
        if self.turned:
            own["camera.turn_scale"] = constant(USUAL_TURN, cameras)
        return own

    def started(self, jitter: np.ndarray, reach: float) -> dict[str, np.ndarray]:
        """The larger jitter of a detection's two axes."""
        return {"emission.pixel_scale": np.clip(jitter.reshape(self.shape).max(-1), LEAST, MOST_NOISE)}

    # -- the distribution of a row ---------------------------------------------------------------
    def location_scale(self, view: View, t: int | Tensor, parameters: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
        """Pixels of the sites, each with its lasting error, and their noise."""
        scale = parameters["emission.pixel_scale"].flatten(-2)
        if self.confidence is not None:
            slope, drop = (parameters[f"emission.pixel_confidence_{name}"] for name in ("slope", "drop"))
            scale = self.confidence.widened(scale, slope, drop, t)
        pixels, seen = self.projected(view, parameters)
        if self.lasting and view.memory is not None:
            pixels = pixels + view.memory[..., : self.alone].unflatten(-1, self.shape)
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
        if self.turned and view.memory is not None:
            turn = view.memory[..., self.alone :].unflatten(-1, (-1, 3))
            cameras = moved(cameras, turn, torch.zeros_like(turn))
        if self.timed:
            # The row's moment, o s earlier by a clock that runs o ahead: to second order, as limbs turn in 20 ms.
            ahead = -parameters["camera.offset"][..., None, None]
            velocity, bent = self._of_sites(view.velocity), self._of_sites(view.site_acceleration)
            points = points.unsqueeze(-3) + ahead * (velocity.unsqueeze(-3) + 0.5 * ahead * bent.unsqueeze(-3))
        return project(cameras, points, each=self.timed)

    def _of_sites(self, values: Tensor) -> Tensor:
        """Of all sites' values (..., S, 3) those of the keypoints, (..., P, 3)."""
        # Entry by entry: a list of indices would be sent to the device in each row.
        return torch.stack([values[..., site, :] for site in self.sites], -2)

    # -- what lasts --------------------------------------------------------------------------------
    @property
    def alone(self) -> int:
        """Numbers of the b, one for each entry of its part of a row, and 0 where nothing lasts."""
        return int(np.prod(self.shape)) if self.lasting else 0

    @property
    def states(self) -> int:
        """Those, and three of each camera that may be turned."""
        return self.alone + 3 * len(self.camera_names) * self.turned

    def begun(self, parameters: Mapping[str, Tensor]) -> Tensor:
        """Standard deviations (..., states) of the first b, px, and of turns, rad."""
        own = [parameters["emission.bias_scale"].repeat_interleave(2, -1).flatten(-2)] if self.lasting else []
        own += [parameters["camera.turn_scale"].repeat_interleave(3, -1)] if self.turned else []
        return join(*own)

    def onward(self, memory: Tensor, dt: Tensor, parameters: Mapping[str, Tensor]) -> Tensor:
        """Mean (..., states) of them, ``dt`` (..., 1) s after they were ``memory``."""
        return torch.exp(-self._pace(dt, parameters)) * memory

    def strayed(self, dt: Tensor, parameters: Mapping[str, Tensor]) -> Tensor:
        """Standard deviations (..., states) of them about that mean."""
        # 1 − a², without the digits that a difference near 0 would lose
        return self.begun(parameters) * (-torch.expm1(-2 * self._pace(dt, parameters))).sqrt()

    def _pace(self, dt: Tensor, parameters: Mapping[str, Tensor]) -> Tensor:
        """How much of its time has passed for each of the states, (..., states), or for all alike, (..., 1)."""
        lasts = dt / parameters["emission.bias_time"] if self.lasting else dt[..., :0]
        if not self.turned:
            return lasts
        stands = (dt / STANDS).expand(*dt.shape[:-1], self.states - self.alone)
        return join(lasts.expand(*lasts.shape[:-1], self.alone), stands)

    # -- a start -----------------------------------------------------------------------------------
    def about(self, points: Tensor) -> Tensor:
        """Pixels (..., C P 2) of all sites' ``points`` (..., S, 3), the picture's middle where a camera sees none."""
        pixels, seen = project(self.cameras.to(points.device, points.dtype), self._of_sites(points))
        return torch.where(seen[..., None], pixels, self.size.to(pixels)[:, None] / 2).flatten(-3)
