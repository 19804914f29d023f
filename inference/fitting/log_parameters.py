"""A model's free parameters as one vector, in logarithms.

    φ = log(θ / θ_start),   φ ~ N(0, diag sd²): a factor of e^±sd about the start

Shapes: P entries.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
import torch
from torch import Tensor

from invdyn.models.state_space import StateSpaceModel


@dataclass(frozen=True)
class Free:
    """One parameter to be fitted: its entries separately, or ``tied`` to one common factor.

    ``sd`` is the prior's standard deviation of log(θ/θ_start); ``entries`` the flat indices that are
    free, all of them by default. One that may be negative has a ``unit`` instead, in its own measure: it is
    θ_start + unit φ, and φ has the prior. Entries of one parameter may have several of these.
    """

    name: str
    tied: bool = False
    sd: float = 2.0
    entries: tuple[int, ...] | None = None
    unit: float | None = None

    def indices(self, size: int) -> tuple[int, ...]:
        """Flat indices of the free entries among ``size``."""
        return tuple(range(size)) if self.entries is None else self.entries


M = TypeVar("M", bound=StateSpaceModel)
"""The class of the model, which is kept."""


class LogParameters(Generic[M]):
    """A model's free parameters as one vector φ = log(θ/θ_start), whose prior is N(0, diag sd²).

    Attributes:
        labels: (P) names of φ's entries, such as "body.mass[0]"; without an index where there is one only.
        sd: (P,) of the prior.
    """

    def __init__(self, model: M, free: Sequence[Free]):
        self.model, self.free = model, tuple(free)
        for name in (f.name for f in self.free if model.parameters[f.name].ndim == 0):
            raise ValueError(
                f"parameter {name}: expected a tensor of one entry or more to fit, such as (1,), got a number"
            )
        entries = [f.indices(model.parameters[f.name].numel()) for f in self.free]
        sizes = [1 if f.tied else len(own) for f, own in zip(self.free, entries, strict=True)]
        self.slices = np.split(np.arange(sum(sizes)), np.cumsum(sizes))[:-1]
        self.sd = np.array([f.sd for n, f in zip(sizes, self.free, strict=True) for _ in range(n)], float)
        self.labels = [
            f.name if size == 1 else f"{f.name}[{k}]"
            for f, own, size in zip(self.free, entries, sizes, strict=True)
            for k in own[:size]
        ]

    def of(self, values: Mapping[str, Tensor]) -> np.ndarray:
        """φ (P,) of parameters' ``values`` by name, their mean where entries are tied; 0 where there are none."""
        phi = np.zeros(len(self.sd))
        for f, index in zip(self.free, self.slices, strict=True):
            if (value := values.get(f.name)) is None:
                continue
            start = self.model.parameters[f.name]
            off = (value / start).log() if f.unit is None else (value - start) / f.unit
            own = off.flatten()[list(f.indices(start.numel()))].double()
            own = torch.where(own.isfinite(), own, torch.nan)  # entries that are 0, as of a root, tell nothing
            phi[index] = own.nanmean().item() if f.tied else own.numpy()
        return np.nan_to_num(phi)

    def at(self, phi: Tensor) -> M:
        """The model at φ (P,), or at a batch of them (B, P) with parameters (B, 1, own shape); differentiable."""
        values: dict[str, Tensor] = {}
        for f, index in zip(self.free, self.slices, strict=True):
            start = self.model.parameters[f.name]
            own = phi[..., index].to(start)
            place = own.new_zeros(len(index), start.numel())
            free = list(f.indices(start.numel()))
            place[torch.arange(len(index)) if len(index) > 1 else 0, free] = 1.0
            change = own @ place
            if phi.ndim == 2:
                change = change.unsqueeze(-2)
            change = change.reshape(*change.shape[:-1], *start.shape)
            there = values.get(f.name, start)
            values[f.name] = there * change.exp() if f.unit is None else there + f.unit * change
        return self.model.replace(**values)
