"""What a model needs of a body: a chain in the plane, a tree in space, or one of your own.

A body has K joints, whose coordinates torques move, and S *sites*: named points of its links, which keypoints show. Its
numbers are a named tuple of tensors, each (..., own shape), gravity (..., d) m/s² among them; leading dimensions are
many parameter sets. What they mean is between a body and its dynamics
(:func:`invdyn.models.dynamics.registry.dynamics_for`); a model keeps them as its parameters "body.<name>", and asks for
no more than this.
"""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import torch
from pyro.distributions import Distribution
from torch import Tensor

from invdyn.models.bodies.joint_parts import NOTHING, JointParts

AXES = "xyz"


class ArticulatedBody:
    """Rigid links on joints. A class of its own derives from it, has what stands first, and replaces what differs."""

    if TYPE_CHECKING:  # each is what a class makes of it, a field as well as a property

        @property
        def name(self) -> str:
            """Its own."""

        @property
        def dimensions(self) -> int:
            """d, coordinates of a point: 2 in the plane, 3 in space."""

        @property
        def gravity(self) -> Sequence[float]:
            """The d numbers of m/s²."""

        @property
        def num_joints(self) -> int:
            """K."""

        @property
        def joint_names(self) -> tuple[str, ...]:
            """Of the K coordinates."""

        @property
        def keypoint_names(self) -> tuple[str, ...]:
            """Of the S sites."""

        @property
        def link_names(self) -> tuple[str, ...]:
            """Of its links."""

        def parameters(self) -> Any:
            """The numbers where priors stand at their means and learned ones at their starts, in float64."""

    @property
    def is_chain(self) -> bool:
        """Whether it is a chain of sticks in the plane, with `BodyParameters` as its numbers."""
        return False

    @property
    def signed(self) -> frozenset[str]:
        """Its numbers that may be negative."""
        return frozenset({"gravity"})

    @property
    def base_keypoint(self) -> str | None:
        """Name of a point that stands still at the first joint; None where there is none."""
        return None

    @property
    def joint_parts(self) -> tuple[JointParts, ...]:
        """What each of the K joints has besides: friction, a rotor, a spring, a motor, or nothing."""
        return (NOTHING,) * self.num_joints

    @property
    def file_counting(self) -> tuple[np.ndarray, np.ndarray]:
        """Signs s and zeros z (K,): a joint at q in the file's own counting has the angle z + s q."""
        return np.array([own.sign for own in self.joint_parts]), np.array([own.zero for own in self.joint_parts])

    @property
    def hand(self) -> tuple[int, int] | None:
        """Numbers of the link and of its site that carry a load; None where no one place does."""
        return None

    def moved_by(self, link: int) -> tuple[int, ...]:
        """Numbers of the joints that move a link against the next one inwards which moves by itself."""
        return (link,)

    @property
    def priors(self) -> Mapping[str, Mapping[int, Distribution]]:
        """Those of its numbers that have one, by the number's name and the entry's flat index."""
        return {}

    @property
    def has_priors(self) -> bool:
        """Whether any number has a prior."""
        return bool(self.priors)

    @property
    def learned(self) -> Mapping[str, tuple[int, ...]]:
        """Entries of its numbers that are to be fitted, by the number's name."""
        return {}

    @property
    def hanging(self) -> Sequence[float]:
        """K coordinates in which a simulation begins: at rest, or near it."""
        return [0.0] * self.num_joints

    def with_uncertainty(self) -> Self:
        """The body with what it states of its numbers' uncertainty made priors."""
        return self

    def completed(self, numbers: Any) -> Any:
        """A model's numbers with those that follow from others made to."""
        return numbers

    def drawn(self, numbers: Any) -> dict[str, Tensor]:
        """Of a model's numbers those that are drawn or learned, by :meth:`sample`, at Pyro's sites."""
        if not (self.has_priors or self.learned):
            return {}
        return dict(self.sample(dtype=numbers.gravity.dtype, device=numbers.gravity.device)._asdict())

    def sample(
        self, prefix: str = "", dtype: torch.dtype = torch.float64, device: torch.device | str | None = None
    ) -> Any:
        """The numbers with priors drawn by ``pyro.sample`` and learned ones looked up by ``pyro.param``."""
        numbers = self.parameters()
        return type(numbers)(*(value.to(dtype=dtype, device=device) for value in numbers))

    def described(self, numbers: Any) -> dict[str, tuple[list[str], Tensor]]:
        """Its numbers (own shape) with the names of their dims, as a posterior keeps them."""
        own = {kept_as(name): value.detach() for name, value in numbers._asdict().items()}
        dims = {name: [f"{name}_{i}" for i in range(value.ndim)] for name, value in own.items()} | {
            "gravity": ["space"]
        }
        return {name: (dims[name], value) for name, value in own.items()}


def kept_as(name: str) -> str:
    """Under which name a posterior keeps one of a body's numbers: "position" is that of the keypoints there."""
    return "origin" if name == "position" else name


def axes(body: ArticulatedBody) -> list[str]:
    """Names of a body's d axes."""
    return list(AXES[: body.dimensions])
