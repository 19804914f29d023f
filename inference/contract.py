"""The contract between a state-space model, its rows and a method, checked once before anything runs.

A :class:`StateSpaceModel` gives three distributions. They are evaluated on small batches of simulated states
(:mod:`.probe`), and its parameters and rows are compared with what they say of themselves. Methods state further
preconditions by name (:mod:`.preconditions`).

A model is checked once: copies with other parameter values of the same shapes (:meth:`.StateSpaceModel.replace`,
:meth:`.StateSpaceModel.to`) inherit the result, copies with any other attribute do not. No random number of the
caller is used.

Shapes: observations (T, O).
"""

from collections.abc import Callable, Iterable
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
import torch
from torch import Tensor

from invdyn.inference.execution.seeds import seeded
from invdyn.inference.preconditions import LINEARISING, NEEDS
from invdyn.inference.probe import ModelError, Probe
from invdyn.models.state_space import StateSpaceModel

__all__ = ["ModelError", "check_model", "in_float64"]

M = TypeVar("M", bound=StateSpaceModel)
"""The class of the model, which is kept."""

INHERITED = "_checked"
"""Attribute that holds the result of a check: the model's attributes then, and the verdicts."""

Verdicts = dict[str, str | None]
"""By need, the message of what a model lacks of it; None if nothing."""


def check_model(model: StateSpaceModel, observations: Any, *, needs: Iterable[str] = ()) -> Tensor:
    """Check a model against its rows; return the observations (T, O) in the model's dtype, on its device.

    Args:
        model: any state-space model, with or without parameters.
        observations: (T, O) numbers, NaN where missing: a tensor, an array, or nested lists; of integers, too. Rows
            (T,) are taken for one column where ``observation_dim`` is 1.
        needs: preconditions of the method, names in :data:`NEEDS`. Methods that linearise compute in float64.

    Raises ModelError, one line, for anything that does not fit; ValueError for an unknown need.
    """
    needs = frozenset(needs)
    if unknown := needs - set(NEEDS):
        raise ValueError(f"expected needs among {', '.join(NEEDS)}, got {', '.join(sorted(unknown))}")
    _check_attributes(model)
    rows = _rows(model, observations)
    gaps = bool(torch.isnan(rows).any())
    for linearises in {need in LINEARISING for need in needs} or {False}:
        verdicts = _verdicts(model, rows, gaps, linearises)
        for need in NEEDS:
            if need in needs and (message := verdicts[need]) is not None:
                raise ModelError(message)
    return _as_model(model, rows)


def in_float64(model: M, observations: Tensor, *, needs: Iterable[str] = ()) -> tuple[M, Tensor]:
    """A model and its rows as methods that linearise take them; checked for these ``needs``, if there are some."""
    rows = check_model(model, observations, needs=needs) if needs else observations
    return model.to(dtype=torch.float64, device="cpu"), rows.detach().cpu().double()


def _verdicts(model: StateSpaceModel, rows: Tensor, gaps: bool, linearises: bool) -> Verdicts:
    """What the model lacks of each need; raises ModelError where it, or its rows, break the contract."""
    kinds = tuple((value.shape, *_type(value, linearises)) for value in model.parameters.values())
    key = (kinds or linearises, model.dtype, model.state_dim, model.observation_dim, model.num_steps, gaps)
    known = _known(model)
    if key in known:
        return known[key]

    _check_parameters(model)
    subject = model.to(dtype=torch.float64, device="cpu") if linearises else model
    device = next((value.device for value in subject.parameters.values()), rows.device)
    with torch.no_grad(), seeded(0, device):
        probe = Probe(subject, linearises, model.dtype)
        probe.check_rows(_as_model(model, rows).to(dtype=probe.dtype, device=subject.device))
        verdicts = {name: _lacks(need, probe) for name, need in NEEDS.items()}
    if probe.any_row_fits:  # otherwise other rows are checked again
        known[key] = verdicts
    return verdicts


def _type(value: Tensor, linearises: bool) -> tuple[torch.dtype, str]:
    """Of a parameter, where it is used."""
    if linearises:
        return torch.float64 if value.is_floating_point() else value.dtype, "cpu"
    return value.dtype, str(value.device)


def _lacks(need: Callable[[Probe], None], probe: Probe) -> str | None:
    try:
        need(probe)
    except ModelError as error:
        return str(error)
    return None


def _as_model(model: StateSpaceModel, rows: Tensor) -> Tensor:
    """Rows in the model's type, on its device."""
    same = rows.to(dtype=model.dtype, device=model.device)
    if same.dtype != rows.dtype:
        _check_infinite(same, f"{same.dtype} holds no number so large, use model.to(torch.float64)")
    return same


# -- what was checked before -----------------------------------------------------------------------
def _known(model: StateSpaceModel) -> dict[Any, Verdicts]:
    """Results of earlier checks of a model with these attributes, but for parameter values; a new dict for another."""
    kind, own = type(model), vars(model)
    now = {
        name: value
        for name, value in own.items()
        if name not in ("parameters", "priors", "learned", INHERITED)
        and not isinstance(getattr(kind, name, None), cached_property)
    }
    before, known = own.get(INHERITED, ({}, {}))
    if not (before.keys() == now.keys() and all(_same(before[name], value) for name, value in now.items())):
        known = {}
    own[INHERITED] = now, known
    return known


def _same(one: object, other: object) -> bool:
    return one is other or (isinstance(one, int | float | str) and one == other)


# -- attributes, parameters, rows ------------------------------------------------------------------
def _check_attributes(model: StateSpaceModel) -> None:
    if not isinstance(model, StateSpaceModel):
        raise ModelError(f"model: expected a StateSpaceModel, got {type(model).__name__}: subclass it")
    name = type(model).__name__
    for attribute in ("state_dim", "observation_dim", "num_steps"):
        value = getattr(model, attribute, None)
        if not isinstance(value, int) or value < 1:
            raise ModelError(f"{name}.{attribute}: expected a whole number above 0, got {value!r}: set it in the class")
    parameters = getattr(model, "parameters", None)
    if not isinstance(parameters, dict):
        got = "none" if parameters is None else type(parameters).__name__
        raise ModelError(f"{name}.parameters: expected a dict, got {got}: call super().__init__({{…}})")
    for key, value in parameters.items():
        if not isinstance(value, Tensor):
            got = type(value).__name__
            raise ModelError(f"{name}.parameters[{key!r}]: expected a tensor, got {got}: use torch.tensor(…)")


def _check_parameters(model: StateSpaceModel) -> None:
    """Numbers of one floating type on one device; a limit may be infinite."""
    label = f"{type(model).__name__}.parameters"
    devices = {str(value.device) for value in model.parameters.values()}
    if len(devices) > 1:
        raise ModelError(f"{label}: expected one device, got {' and '.join(sorted(devices))}: use model.to(device=…)")
    types = {str(value.dtype) for value in model.parameters.values() if value.is_floating_point()}
    if len(types) > 1:
        raise ModelError(f"{label}: expected one type, got {' and '.join(sorted(types))}: use model.to(torch.float64)")
    for key, value in model.parameters.items():
        if bool(torch.isnan(value).any()):
            raise ModelError(f"{label}[{key!r}]: expected numbers, got NaN: give it a value")


def _rows(model: StateSpaceModel, observations: Any) -> Tensor:
    """Observations as a tensor (T, O), of a type of their own."""
    steps, width = model.num_steps, model.observation_dim
    wanted = f"observations: expected rows ({steps}, {width}) = (num_steps, observation_dim)"
    try:
        rows = observations if isinstance(observations, Tensor) else torch.as_tensor(np.asarray(observations))
    except (TypeError, ValueError) as error:
        got = type(observations).__name__
        raise ModelError(f"{wanted} of numbers, got {got}: give a tensor or an array, NaN where missing") from error
    if rows.is_complex():
        raise ModelError(f"{wanted} of real numbers, got {rows.dtype}: use their real and imaginary parts")
    if rows.ndim == 1 and width == 1:
        rows = rows.unsqueeze(-1)
    if rows.ndim != 2 or rows.shape[-1] != width:
        raise ModelError(f"{wanted}, got shape {tuple(rows.shape)}: one row a time step, one column an entry")
    if len(rows) != steps:
        raise ModelError(f"{wanted}, got {len(rows)} rows: set num_steps, or cut the rows")
    if not rows.is_floating_point():
        rows = rows.double()
    _check_infinite(rows, "mark missing ones by NaN")
    return rows


def _check_infinite(rows: Tensor, fix: str) -> None:
    if bool((infinite := torch.isinf(rows).any(-1)).any()):
        row = int(infinite.int().argmax())
        raise ModelError(f"observations: expected finite numbers, got infinity in row {row}: {fix}")
