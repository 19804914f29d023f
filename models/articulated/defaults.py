"""The parameters of an articulated model: what they are where nothing is said, and given ones in their own shape."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from invdyn.models.bodies.joint_parts import NOTHING, PARTS
from invdyn.models.bodies.protocol import ArticulatedBody
from invdyn.models.dynamics.interface import Dynamics
from invdyn.models.effects.scale import typical_torque
from invdyn.models.observation.observation import Observation
from invdyn.models.torques import TorqueProcess

Value = Tensor | np.ndarray | float | Sequence[float]


def default_parameters(
    body: ArticulatedBody, dynamics: Dynamics, torque: TorqueProcess, observation: Observation
) -> dict[str, Tensor]:
    """Of a body in its nominal numbers, by dotted name, in float64: rad and rad/s of joints, N·m, m."""
    numbers = body.parameters()
    return {
        **{f"body.{name}": value for name, value in numbers._asdict().items()},
        **joint_numbers(body),
        **torque.defaults(typical_torque(dynamics, numbers)),
        **of_coordinates(body.num_joints, {"noise.angle": 1e-3, "noise.velocity": 1e-2}),
        **observation.defaults(dynamics.reach(numbers).item()),
    }


def of_coordinates(count: int, own: Mapping[str, float]) -> dict[str, Tensor]:
    """A model's ``own`` numbers, by dotted name, and those of its start: for so many coordinates, (count,) each."""
    start = {"angle": 0.0, "angle_scale": 1.0, "velocity": 0.0, "velocity_scale": 3.0}
    every = {**own, **{f"initial.{name}": value for name, value in start.items()}}
    return {name: torch.full((count,), value, dtype=torch.float64) for name, value in every.items()}


def joint_numbers(body: ArticulatedBody) -> dict[str, Tensor]:
    """What the body's file gives its joints, "body.damping" (K,) and so on; none of a body that has no such parts."""
    parts = body.joint_parts
    if all(each == NOTHING for each in parts):
        return {}
    return {
        f"body.{name}": torch.tensor([getattr(each, name) for each in parts], dtype=torch.float64) for name in PARTS
    }


class WrongValue(ValueError):
    """Of a parameter, or of another choice, that a model was given."""


def shaped(given: Mapping[str, Value], defaults: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Given parameters in the shape of their defaults, but for many sets at once; unknown ones as they are.

    Raises WrongValue for another shape, or for what is no number.
    """
    found: dict[str, Any] = dict(given)
    for name in given.keys() & defaults.keys():
        own = defaults[name]
        try:
            value = torch.as_tensor(given[name], dtype=torch.float64)
        except (TypeError, ValueError):  # what torch makes of a text, or of rows of several lengths
            raise WrongValue(f"parameter {name}: expected numbers, got {given[name]!r:.60}") from None
        try:
            found[name] = value.expand_as(own).clone() if value.ndim <= own.ndim else value
        except RuntimeError:
            expected = "a number" if own.ndim == 0 else f"a number or {tuple(own.shape)} of them"
            raise WrongValue(f"parameter {name}: expected {expected}, got {tuple(value.shape)}") from None
    return found
