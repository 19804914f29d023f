"""The observable quantities at a row, for effects on observations, and then for the sensors; errors of a tracker.

Shapes: joint quantities (..., K), sites and what is seen of them (..., S, d), P keypoints. In the plane sites are the
links' tips.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import torch
from torch import Tensor

from invdyn.models.dynamics.interface import Dynamics


@dataclass(frozen=True)
class Outlier:
    """Detections far from their keypoint: probability (..., 1) of each keypoint in each row, and sd, m.

    The sd is (..., 1, 1), the same for all, or (..., P, d) for each coordinate.
    """

    rate: Tensor
    scale: Tensor


@dataclass(frozen=True)
class Shift:
    """All keypoints of a row shifted together: probability (..., 1) of each row.

    The shift is ξ ``along`` (..., P, d) m, ξ ~ N(0, 1); each coordinate has an independent error of sd ``independent``
    (..., P, d) m in addition.
    """

    rate: Tensor
    along: Tensor
    independent: Tensor


@dataclass(frozen=True)
class Swap:
    """Two keypoints, by number, exchanged with a probability (..., 1) in each row."""

    one: int
    other: int
    rate: Tensor


@dataclass
class View:
    """A row of an articulated body in its state.

    Attributes:
        q, qd: (..., K) rad, rad/s.
        points: (..., S, d) m, the sites, as changed by the effects called before.
        angles: (..., K) rad, as encoders show them.
        body: its numbers.
        dynamics: of this body.
        acceleration: function of none, → θ̈ (..., K).
        angles_after: function of seconds (..., 1), negative ones too, → θ by then, (..., K) rad.
        ahead: function of the same → how far the sites move by then, (..., S, d) m.
        clock: function of none, → s since the first row, (..., 1).
        doubt: (..., S) 1 − c of the tracker's confidence c, 0 at sites that are not tracked; None without confidence.
        noise: function that changes the sites' standard deviations (..., S, d), of the effects; None for none.
        mistakes: occasional errors of the tracker.
        memory: (..., M) states of all sensors; for a sensor's own method, its own states. None where there are none.
        base: b, ḃ and b̈ of a base that moves, (..., d) m, m/s, m/s², which points have in them; None of one at rest.
    """

    q: Tensor
    qd: Tensor
    points: Tensor
    angles: Tensor
    body: Any
    dynamics: Dynamics
    acceleration: Callable[[], Tensor]
    angles_after: Callable[[Tensor], Tensor]
    ahead: Callable[[Tensor], Tensor]
    clock: Callable[[], Tensor]
    doubt: Tensor | None = None
    noise: Callable[[Tensor], Tensor] | None = None
    mistakes: Sequence[Outlier | Swap | Shift] = field(default=())
    memory: Tensor | None = None
    base: tuple[Tensor, Tensor, Tensor] | None = None

    def seen_at(self, points: Tensor) -> "View":
        """The same view with other points."""
        return replace(self, points=points)

    def moved(self, site: int, shift: Tensor) -> Tensor:
        """The points, one of them moved by ``shift`` (..., d) m."""
        here = torch.nn.functional.one_hot(torch.tensor(site), self.points.shape[-2]).to(self.points)
        return self.points + here.unsqueeze(-1) * shift.unsqueeze(-2)

    def later(self, seconds: Tensor) -> Tensor:
        """The points, each (..., S or 1, 1) s later."""
        if seconds.shape[-2] == 1:
            return self.points + self.ahead(seconds[..., 0, :])
        each = [self.ahead(seconds[..., k, :])[..., k, :] for k in range(seconds.shape[-2])]
        return self.points + torch.stack(torch.broadcast_tensors(*each), -2)

    @cached_property
    def elapsed(self) -> Tensor:
        """(..., 1) s, since the first row."""
        return self.clock()

    @cached_property
    def along(self) -> Tensor:
        """Of a planar chain unit vectors u along the links, (..., K, 2)."""
        phi = self.q.cumsum(-1)
        return torch.stack([phi.cos(), phi.sin()], -1)

    @cached_property
    def across(self) -> Tensor:
        """Of a planar chain unit vectors u⊥, a quarter turn counter-clockwise from the links, (..., K, 2)."""
        return torch.stack([-self.along[..., 1], self.along[..., 0]], -1)

    @cached_property
    def velocity(self) -> Tensor:
        """The sites' ṙ, (..., S, d) m/s."""
        own = self.dynamics.site_velocities(self.q, self.qd, self.body)
        return own if self.base is None else own + self.base[1].unsqueeze(-2)

    @cached_property
    def site_acceleration(self) -> Tensor:
        """The sites' r̈, (..., S, d) m/s²."""
        own = self.dynamics.site_accelerations(self.q, self.qd, self.acceleration(), self.body)
        return own if self.base is None else own + self.base[2].unsqueeze(-2)
