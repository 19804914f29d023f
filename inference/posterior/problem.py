"""What an inference method is given: a state-space model and the rows that were observed.

    model          x_0 ~ initial(),  x_t ~ transition(x_{t−1}, t),  y_t ~ emission(x_t, t)
    observations   (T, O), NaN where missing

A problem also names what its posterior holds (:class:`Contents`), so that every method gives one layout
(:mod:`.posterior`) for any model. Here the states are named by number, or as the model names them;
:class:`.initialise.Problem` names torques, angles and keypoints instead.

Shapes: M chains, R draws of each, T rows, D states, O observed numbers a row.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor

from invdyn.models.state_space import StateSpaceModel

Variables = dict[str, tuple[list[str], Any]]
"""Name → dimensions and values, as xarray takes them."""

DRAWS = ["chain", "draw"]

STATES = "states"
"""Attribute "layout" of a posterior whose variable is the state."""


@dataclass(frozen=True)
class Contents:
    """What the groups of a posterior hold.

    Attributes:
        posterior, predictive: of each draw; dimensions begin with chain, draw.
        observed, constants: of the recording and the model.
        coords: names along each dimension.
        units: of each variable that has one.
        attributes: of the whole.
        observed_coords: names that differ for what was observed, such as the keypoints that were tracked.
    """

    posterior: Variables
    predictive: Variables
    observed: Variables
    constants: Variables
    coords: dict[str, Any]
    units: dict[str, str] = field(default_factory=dict)
    attributes: dict[str, Any] = field(default_factory=dict)
    observed_coords: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class StateSpaceProblem:
    """A model and its rows.

    Attributes:
        model: any state-space model.
        observations: (T, O) rows of the model's emission, NaN where missing.
        name: of the data set.
    """

    model: StateSpaceModel
    observations: Tensor
    name: str = field(default="rows", kw_only=True)

    @property
    def uncertain(self) -> tuple[str, ...]:
        """Parameters that have a prior."""
        return tuple(self.model.priors)

    def monitored(self, paths: Tensor) -> np.ndarray:
        """Return the numbers (M, R, T, …) whose mixing is stated: the states."""
        return paths.detach().double().cpu().numpy()

    def contents(self, paths: Tensor, rows: Tensor) -> Contents:
        """Return what the posterior holds.

        Args:
            paths: (M, R, T, D) draws of the states.
            rows: (M, R, T, O) draws of the observations given them.
        """
        model = self.model
        states = _names(model.state_names, paths.shape[-1])
        columns = _names(model.observation_names, rows.shape[-1])

        # One number a row needs no dimension of its own: ArviZ then pairs it with log_likelihood by row.
        single = rows.shape[-1] == 1
        row = ["time"] if single else ["time", "column"]
        observed = self.observations

        return Contents(
            posterior={"state": ([*DRAWS, "time", "state_name"], paths)},
            predictive={"y": ([*DRAWS, *row], rows.squeeze(-1) if single else rows)},
            observed={"y": (row, observed.squeeze(-1) if single else observed)},
            constants=_constants({name: v for name, v in model.parameters.items() if name not in model.priors}),
            coords={"time": np.arange(len(observed)), "state_name": states, "column": columns},
            attributes={"data": self.name, "model": type(model).__name__, "layout": STATES},
        )


def _names(given: tuple[str, ...], count: int) -> list[str]:
    return list(given) or [str(number) for number in range(count)]


def _constants(parameters: Mapping[str, Tensor]) -> Variables:
    return {
        name: ([f"{name}_dim_{axis}" for axis in range(value.ndim)], torch.as_tensor(value).detach().cpu())
        for name, value in parameters.items()
    }
