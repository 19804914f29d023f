"""What a model needs of a body: a chain in the plane, a tree in space, or one of your own.

A body has K joints, whose coordinates torques move, and S *sites*: named points of its links, which keypoints show. Its
numbers are a named tuple of tensors, each (..., own shape); leading dimensions are many parameter sets. What they mean
is between a body and its dynamics (:func:`invdyn.models.dynamics.registry.dynamics_for`); a model keeps them as its
parameters "body.<name>", and asks for no more than this.

A class of its own derives from :class:`BodyBase` for what most bodies have in common, and writes the rest.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, ClassVar, Protocol, Self, runtime_checkable

import torch
from torch import Tensor

from invdyn.models.bodies.joint_parts import JointParts

AXES = "xyz"


class Numbers(Protocol):
    """A body's numbers: a named tuple of tensors, gravity (..., d) m/s² among them."""

    _fields: ClassVar[tuple[str, ...]]

    @property
    def gravity(self) -> Tensor:
        """(..., d) m/s²."""

    def __iter__(self) -> Iterator[Tensor]: ...

    def _asdict(self) -> dict[str, Any]: ...

    def _replace(self, **kwargs: Any) -> Self: ...


@runtime_checkable
class ArticulatedBody(Protocol):
    """Rigid links on joints; see the top of the file."""

    @property
    def dimensions(self) -> int:
        """D, coordinates of a point: 2 in the plane, 3 in space."""

    @property
    def is_chain(self) -> bool:
        """Whether it is a chain of sticks in the plane, with `BodyParameters` as its numbers."""

    @property
    def signed(self) -> frozenset[str]:
        """Its numbers that may be negative."""

    @property
    def name(self) -> str:
        """Its own."""

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

    @property
    def base_keypoint(self) -> str | None:
        """Name of a point that stands still at the first joint; None where there is none."""

    @property
    def joint_parts(self) -> Sequence[JointParts | None]:
        """What each of the K joints has besides: friction, a rotor, a spring, a motor; None for nothing."""

    @property
    def hand(self) -> tuple[int, int] | None:
        """Numbers of the link and of its site that carry a load; None where no one place does."""

    def moved_by(self, link: int) -> tuple[int, ...]:
        """Numbers of the joints that move a link against the next one inwards which moves by itself."""

    @property
    def has_priors(self) -> bool:
        """Whether any number is a prior."""

    @property
    def learned(self) -> Mapping[str, tuple[int, ...]]:
        """Entries of its numbers that are to be fitted, by the number's name."""

    @property
    def hanging(self) -> Sequence[float]:
        """K coordinates in which a simulation begins: at rest, or near it."""

    def parameters(self) -> Any:
        """The numbers where priors stand at their means and learned ones at their starts, in float64."""

    def sample(
        self, prefix: str = "", dtype: torch.dtype = torch.float64, device: torch.device | str | None = None
    ) -> Any:
        """The numbers with priors drawn by ``pyro.sample`` and learned ones looked up by ``pyro.param``."""

    def with_uncertainty(self) -> Self:
        """The body with what it states of its numbers' uncertainty made priors."""

    def completed(self, numbers: Any) -> Any:
        """A model's numbers with those that follow from others made to."""

    def drawn(self, numbers: Any) -> dict[str, Tensor]:
        """Of a model's numbers those that are drawn or learned, by :meth:`sample`, at Pyro's sites."""

    def described(self, numbers: Any) -> dict[str, tuple[list[str], Tensor]]:
        """Its numbers (own shape) with the names of their dims, as a posterior keeps them."""


class BodyBase:
    """What most bodies have in common: no priors, no learned numbers, none that follow from others."""

    @property
    def signed(self) -> frozenset[str]:
        """Gravity."""
        return frozenset({"gravity"})

    @property
    def is_chain(self) -> bool:
        """It is none."""
        return False

    @property
    def base_keypoint(self) -> str | None:
        """None."""
        return None

    @property
    def joint_parts(self: ArticulatedBody) -> tuple[JointParts | None, ...]:
        """No joint has any."""
        return (None,) * self.num_joints

    @property
    def hand(self) -> tuple[int, int] | None:
        """Nowhere."""
        return None

    def moved_by(self, link: int) -> tuple[int, ...]:
        """The joint of the same number."""
        return (link,)

    @property
    def has_priors(self) -> bool:
        """No number is one."""
        return False

    @property
    def learned(self) -> Mapping[str, tuple[int, ...]]:
        """None."""
        return {}

    @property
    def hanging(self: ArticulatedBody) -> Sequence[float]:
        """All coordinates zero."""
        return [0.0] * self.num_joints

    def with_uncertainty(self) -> Self:
        """Itself."""
        return self

    def completed(self, numbers: Any) -> Any:
        """As they are."""
        return numbers

    def drawn(self: ArticulatedBody, numbers: Any) -> dict[str, Tensor]:
        """All of them, where any is a prior or learned."""
        if not (self.has_priors or self.learned):
            return {}
        return dict(self.sample(dtype=numbers.gravity.dtype, device=numbers.gravity.device)._asdict())

    def sample(
        self: ArticulatedBody,
        prefix: str = "",
        dtype: torch.dtype = torch.float64,
        device: torch.device | str | None = None,
    ) -> Any:
        """The nominal numbers."""
        numbers = self.parameters()
        return type(numbers)(*(value.to(dtype=dtype, device=device) for value in numbers))

    def described(self, numbers: Numbers) -> dict[str, tuple[list[str], Tensor]]:
        """Dims are called after the number, gravity's "space"."""
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
