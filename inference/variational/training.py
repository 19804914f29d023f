"""Steps of SVI that can be interrupted: Pyro's parameters, its optimiser and random numbers, in a checkpoint.

What continues from a checkpoint ends where it would have ended, to the bit: the parameters' unconstrained values, each
one's moments and learning rate, and the state of torch's generators are all that a step hands to the next.
"""

from collections.abc import Callable

import pyro
import torch
from pyro.infer import SVI
from pyro.optim import PyroOptim
from torch import Tensor

from invdyn.inference.execution.checkpoint import Checkpoint, random_state, restore_random_state
from invdyn.recordings import InputError


def train(
    svi: SVI,
    steps: int,
    *data: Tensor,
    checkpoint: Checkpoint | None = None,
    every: int = 10,
    report: Callable[[int, int], None] | None = None,
) -> None:
    """Take ``steps`` steps of ``svi`` on ``data``, less those that ``checkpoint`` says are done.

    Args:
        svi: its optimiser a ``PyroOptim`` that keeps its state in tensors and numbers, as Adam does.
        steps: in all.
        data: arguments of model and guide, a tensor the first of them.
        checkpoint: where to go on from, if it holds anything, and what to write every so many steps.
        every: steps between two checkpoints.
        report: called with (steps done, steps).

    Raises InputError for the checkpoint of another run; ValueError when ``every`` is less than one.
    """
    if every < 1:
        raise ValueError(f"expected at least one step between checkpoints, got {every}")
    device = data[0].device
    done = 0 if checkpoint is None else _resumed(checkpoint, svi, data, device)
    for step in range(done + 1, steps + 1):
        svi.step(*data)
        if checkpoint is not None and (step % every == 0 or step == steps):
            _save(checkpoint, svi.optim, step, device)
        if report is not None:
            report(step, steps)


def _save(checkpoint: Checkpoint, optimiser: PyroOptim, step: int, device: torch.device) -> None:
    """Keep the parameters, each one's optimiser (numbers as JSON, tensors as such), and the random numbers' state."""
    tensors = {f"parameter.{name}": value.data for name, value in pyro.get_param_store().named_parameters()}
    numbers = {}
    for name, state in optimiser.get_state().items():
        own = state["state"].get(0, {})  # Pyro has an optimiser for each parameter, its only one
        tensors |= {f"optimiser.{name}.{key}": value for key, value in own.items() if isinstance(value, Tensor)}
        scalars = {key: value for key, value in own.items() if not isinstance(value, Tensor)}
        numbers[name] = {"state": scalars, "param_groups": state["param_groups"]}
    checkpoint.save(tensors | random_state(device), step=step, optimiser=numbers)


def _resumed(checkpoint: Checkpoint, svi: SVI, data: tuple[Tensor, ...], device: torch.device) -> int:
    """Steps done, with all that they left in its place; 0 where there is no checkpoint."""
    found = checkpoint.load(device)
    if found is None:
        return 0
    tensors, kept = found
    with torch.random.fork_rng(devices=[device] if device.type == "cuda" else []):
        svi.evaluate_loss(*data)  # makes the parameters, with their constraints
    for name, value in pyro.get_param_store().named_parameters():
        saved = tensors.get(f"parameter.{name}")
        if saved is None or saved.shape != value.shape:
            shape = "none" if saved is None else tuple(saved.shape)
            raise InputError(
                f"{checkpoint.folder}: the checkpoint of another run: parameter {name} of shape {shape} there, "
                f"{tuple(value.shape)} here; name another folder or delete it"
            )
        value.data.copy_(saved)
    state = {}
    # The last part is the optimiser's own: one parameter's name may begin with another's.
    parts = [(*key.rpartition("."), value) for key, value in tensors.items()]
    for name, numbers in kept["optimiser"].items():
        own = {key: value for owner, _, key, value in parts if owner == f"optimiser.{name}"}
        state[name] = {"state": {0: numbers["state"] | own}, "param_groups": numbers["param_groups"]}
    svi.optim.set_state(state)
    restore_random_state(tensors, device)
    return kept["step"]
