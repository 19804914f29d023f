"""What a model asks of a body, whatever moves: a chain in the plane, a tree in space, or one of your own.

A body has K joints, whose coordinates torques move, and S *sites*: named points of its links, which keypoints show. Its
numbers are a named tuple of tensors, each (..., own shape); leading dimensions are many parameter sets. What they mean
is between a body and its dynamics (:func:`invdyn.models.dynamics.registry.dynamics_for`); a model keeps them as its
parameters "body.<name>", and asks for no more than this.

A class of its own may derive from :class:`ArticulatedBody` for what most bodies have in common.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, ClassVar, Protocol, Self, runtime_checkable

import torch
from torch import Tensor

AXES = "xyz"


class Numbers(Protocol):
    """A body's numbers: a named tuple of tensors, gravity (..., d) m/s² among them."""

    @property
    def gravity(self) -> Tensor:
        """(..., d) m/s²."""

    def __iter__(self) -> Iterator[Tensor]: ...

    def _asdict(self) -> dict[str, Any]: ...

    def _replace(self, **kwargs: Any) -> Self: ...


@runtime_checkable
class ArticulatedBody(Protocol):
    """Rigid links on joints; see the top of the file."""

    space: ClassVar[int]
    """d, coordinates of a point: 2 in the plane, 3 in space."""
    signed: ClassVar[frozenset[str]] = frozenset({"gravity"})
    """Numbers that may be negative."""

    name: str
    gravity: Sequence[float]
    """d numbers, m/s²."""

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

    def parameters(self) -> Numbers:
        """The numbers where priors stand at their means and learned ones at their starts, in float64."""

    def sample(
        self, prefix: str = "", dtype: torch.dtype = torch.float64, device: torch.device | str | None = None
    ) -> Numbers:
        """The numbers with priors drawn by ``pyro.sample`` and learned ones looked up by ``pyro.param``."""

    # -- what most bodies have in common -------------------------------------------------------
    @property
    def base_keypoint(self) -> str | None:
        """Name of a point that stands still at the first joint; None where there is none."""
        return None

    @property
    def has_priors(self) -> bool:
        """Whether any number is a prior."""
        return False

    def with_uncertainty(self) -> Self:
        """The body with what it states of its numbers' uncertainty made priors."""
        return self

    @property
    def learned(self) -> Mapping[str, tuple[int, ...]]:
        """Entries of its numbers that are to be fitted, by the number's name."""
        return {}

    def completed(self, numbers: Any) -> Any:
        """A model's numbers with those that follow from others made to."""
        return numbers

    def drawn(self, numbers: Any) -> dict[str, Tensor]:
        """Of a model's numbers those that are drawn or learned, by :meth:`sample`, at Pyro's sites."""
        return self.sample(dtype=numbers.gravity.dtype, device=numbers.gravity.device)._asdict()

    @property
    def hanging(self) -> Sequence[float]:
        """K coordinates in which it is at rest, as near as it can be told without its dynamics."""
        return [0.0] * self.num_joints

    def described(self, numbers: Any) -> dict[str, tuple[list[str], Tensor]]:
        """Its numbers (own shape) with the names of their dims, as a posterior keeps them."""
        own = {name: value.detach() for name, value in numbers._asdict().items()}
        return {name: ([f"{name}_{i}" for i in range(value.ndim)], value) for name, value in own.items()}


def axes(body: ArticulatedBody) -> list[str]:
    """Names of a body's d axes."""
    return list(AXES[: body.space])
