"""What a particle filter leaves in a checkpoint, so that it continues to the same answer, to the bit."""

from typing import Any

import torch
from torch import Tensor

from invdyn.inference.execution.checkpoint import Checkpoint, random_state, restore_random_state
from invdyn.inference.filters.particles import History
from invdyn.inference.filters.proposal import Particles
from invdyn.recordings import InputError

Kept = tuple[int, Particles, dict[str, Tensor]]
"""Rows done, particles of the last, and all else that was saved by name."""


def save(
    checkpoint: Checkpoint, run: dict[str, Any], row: int, particles: Particles, history: History, **tensors: Tensor
) -> None:
    """Keep ``row`` rows of the filter that ``run`` describes, and the state of the random numbers."""
    device = next(iter(particles.values())).device
    whole = {
        **{f"particles.{name}": value for name, value in particles.items()},
        **{f"history.{name}": value for name, value in history.tensors().items()},
        **tensors,
        **random_state(device),
    }
    checkpoint.save(whole, step=row, run=run)


def resumed(checkpoint: Checkpoint, run: dict[str, Any], history: History, device: torch.device) -> Kept | None:
    """What :func:`save` kept, the history and the random numbers' state in their places; None where there is nothing.

    Raises InputError for the checkpoint of a filter that ``run`` does not describe.
    """
    found = checkpoint.load(device)
    if found is None:
        return None
    tensors, state = found
    if (theirs := state.get("run")) != run:
        theirs = theirs if isinstance(theirs, dict) else {}
        differs = ", ".join(name for name in {**run, **theirs} if theirs.get(name) != run.get(name))
        raise InputError(
            f"{checkpoint.folder}: the checkpoint of a filter with other {differs}; name another folder or delete it"
        )
    history.restore(_named(tensors, "history."))
    restore_random_state(tensors, device)
    return state["step"], _named(tensors, "particles."), tensors


def _named(tensors: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {name.removeprefix(prefix): value for name, value in tensors.items() if name.startswith(prefix)}
