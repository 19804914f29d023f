"""The protocol of sensors: each owns its part of an observation row.

A row (O,) is the sensors' parts, one after the other (:mod:`.observation`). Each sensor knows its size and columns, its
dims in a posterior, its units, its parameters "emission.<name>", and predicts its part from the observable quantities
(:mod:`.view`). NaN is missing: entries that were not seen have no term in the likelihood (:mod:`.missing`).

A sensor whose entries have independent noise of one scale each derives from :class:`NoisySensor`, and returns location
and scale of its entries; the observation's noise family makes one distribution of all of them. Any other class that
satisfies :class:`Sensor` returns a distribution of its own.

Shapes: n entries of the sensor; P·d of P keypoints in d dimensions, for example.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Protocol, Self, runtime_checkable

import numpy as np
import torch
from pyro.distributions import Distribution, Normal
from torch import Tensor

from invdyn.models.bodies.protocol import ArticulatedBody
from invdyn.models.observation.view import View


@runtime_checkable
class Sensor(Protocol):
    """A part of an observation row; see the top of the file."""

    @property
    def name(self) -> str:
        """The name of its observations in a posterior, different for each sensor of a row."""

    @property
    def unit(self) -> str:
        """The word "length" for the recording's unit of length, else the unit itself, such as "rad"."""

    def bound(self, body: ArticulatedBody) -> Self:
        """The sensor on a body, whose names and dimensions it then knows.

        Raises ValueError if the body does not have what it observes.
        """

    def to(self, device: torch.device | str) -> Self:
        """The same with all that a row needs on ``device``."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of its part of a row, whose product is n; once bound."""

    @property
    def coords(self) -> Mapping[str, Sequence[str]]:
        """Names along each of the dims of that shape, in order; once bound."""

    def defaults(self, reach: float) -> dict[str, Tensor]:
        """Parameters, "emission.<name>", for a body of that reach (m), in float64."""

    def started(self, jitter: np.ndarray, reach: float) -> dict[str, np.ndarray]:
        """Parameters estimated from the noise sd (n,) of its columns, ``jitter``; none where it estimates none."""

    def predict(self, view: View, t: int | Tensor, parameters: Mapping[str, Tensor]) -> Distribution:
        """Distribution of its part of row ``t``, event shape (n,)."""


@runtime_checkable
class SensorWithStates(Protocol):
    """A :class:`Sensor` with correlated errors: M states of its own, which depend on nothing else.

    Each has a Markov transition of its own. The first ``independent_states`` of them (n, or 0) are added to one entry
    each of the sensor's part of a row. The others change several entries.
    """

    @property
    def states(self) -> int:
        """M."""

    @property
    def independent_states(self) -> int:
        """How many change one entry alone: n, or 0."""

    def initial_sd(self, parameters: Mapping[str, Tensor]) -> Tensor:
        """Standard deviations (..., M) in the first row, about 0."""

    def next_mean(self, memory: Tensor, dt: Tensor, parameters: Mapping[str, Tensor]) -> Tensor:
        """Mean (..., M), ``dt`` (..., 1) s after the states were ``memory``; linear in it."""

    def transition_sd(self, dt: Tensor, parameters: Mapping[str, Tensor]) -> Tensor:
        """Standard deviations (..., M) about that mean."""


class NoisySensor(ABC):
    """Base of the sensors whose entries have independent noise."""

    name: ClassVar[str]
    unit: ClassVar[str]

    @abstractmethod
    def location_scale(self, view: View, t: int | Tensor, parameters: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
        """Middle and width (..., n) of each entry's noise."""

    def predict(self, view: View, t: int | Tensor, parameters: Mapping[str, Tensor]) -> Distribution:
        """Gaussian noise."""
        loc, scale = self.location_scale(view, t, parameters)
        return Normal(loc, scale, validate_args=False).to_event(1)

    def to(self, device: torch.device | str) -> Self:
        """Itself, where it keeps no tensors."""
        return self

    def started(self, jitter: np.ndarray, reach: float) -> dict[str, np.ndarray]:
        """None."""
        return {}


@dataclass(frozen=True)
class NamedSensor(NoisySensor):
    """Base of those with one entry for each of their ``names`` along ``dim``, known once :meth:`Sensor.bound`."""

    names: tuple[str, ...] = field(default=(), kw_only=True)

    dim: ClassVar[str]

    @property
    def shape(self) -> tuple[int]:
        """(n,)."""
        return (len(self.names),)

    @property
    def coords(self) -> dict[str, Sequence[str]]:
        """The names."""
        return {self.dim: self.names}


def size(sensor: Sensor) -> int:
    """Entries n of a bound sensor."""
    return int(np.prod(sensor.shape, dtype=int))


def columns(sensor: Sensor) -> list[str]:
    """Names of a bound sensor's entries: those along its dims, joined, "elbow_x"."""
    names = [""]
    for along in sensor.coords.values():
        names = [f"{name}_{each}" if name else each for name in names for each in along]
    return names
