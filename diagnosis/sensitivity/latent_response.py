"""What a hidden hinge does along a known motion: its path (ψ, ψ̇), driven by it.

A hinge on a spring follows to first order: ψ_{t+1} = A_t ψ_t + b_t, with A and b by differences about rest, from the
deflection that the first row would hold. A changes only as the arm turns: where rows are evenly spaced it is worked out
for some of them, in straight lines between.

A gap forgets what was before as soon as there is contact: :mod:`invdyn.models.fixed_point`.

Shapes: T rows, D states without the hinge, S parameter sets.
"""

import numpy as np
import torch
from torch import Tensor

from invdyn.diagnosis.rules import DEFAULT, FIXED, Rules
from invdyn.models import ArmModel
from invdyn.models.fixed_point import settled
from invdyn.models.state_space import gaussian_mean


def latent_response(model: ArmModel, path: Tensor, count: int, rules: Rules = DEFAULT) -> tuple[Tensor, Tensor]:
    """Along ``path`` (T, D): paths (S, T, D + 2) with the hinge of ``model``, of S = ``count`` parameter sets.

    And the next states (S, T−1, D + 2) of their rows, to first order too.
    """
    rows, first = torch.arange(1, len(path)), model.torque_size
    hidden = slice(first, first + model.state_dim - path.shape[-1])
    still = path.new_zeros(len(path), model.state_dim - path.shape[-1])
    path = torch.cat([path[:, :first], still, path[:, first:]], -1).expand(count, -1, -1).clone()

    def moved(path: Tensor, rows: Tensor) -> Tensor:
        return gaussian_mean(model.transition(path[:, rows - 1], rows))

    if model.contact_states is not None or model.effects.hinge is None:
        path = settled(model, path)
        return path, moved(path, rows)

    sds = model.parameters[f"initial.hidden.{model.effects.hinge.key}"]
    nudges = torch.tensor(sds.tolist(), dtype=path.dtype) * 1e-3

    rest, some = moved(path, rows), steps_apart(model, path[0], rules.screening.slope_turn)

    def slope(nudge: Tensor) -> Tensor:
        shifted = path.clone()
        shifted[..., hidden] = nudge
        return (moved(shifted, rows[some]) - rest[:, some]) / nudge.sum()

    slopes = _between(torch.stack([slope(nudge) for nudge in torch.diag(nudges)], -1), some, len(rows))
    A, b = slopes[..., hidden, :].numpy(), rest[..., hidden].numpy()
    psi = np.empty((len(rows) + 1, *b[:, 0].shape))
    psi[0] = np.linalg.solve(np.eye(len(nudges)) - A[:, 0], b[:, 0, :, None])[..., 0]
    for t in range(len(rows)):
        psi[t + 1] = (A[:, t] @ psi[t, :, :, None])[..., 0] + b[:, t]
    path[..., hidden] = torch.as_tensor(psi).movedim(0, 1)
    return path, rest + (slopes @ path[:, :-1, hidden].unsqueeze(-1)).squeeze(-1)


def steps_apart(model: ArmModel, path: Tensor, turn: float) -> Tensor:
    """Steps of ``path`` (T, D), from 0, ``turn`` rad or one step apart, the first and the last among them; or all."""
    steps, count = model.time.diff(), len(path) - 1
    if steps.max() - steps.min() > FIXED.uneven_spacing * steps.min():
        return torch.arange(count)
    angle = model.split(path)[1].diff(dim=0).abs().amax(-1).cumsum(0)
    stretch = (angle / turn).floor()
    stretch[-1] = stretch[-1] + 1  # the last one counts
    return torch.cat([torch.zeros(1, dtype=torch.long), stretch.diff().nonzero()[:, 0] + 1])


def _between(values: Tensor, some: Tensor, count: int) -> Tensor:
    """(S, count, ...) in straight lines between ``values`` (S, J, ...) of steps ``some`` (J,)."""
    if len(some) == count:
        return values
    steps = torch.arange(count)
    left = (torch.searchsorted(some, steps, right=True) - 1).clamp(max=len(some) - 2)
    share = ((steps - some[left]) / (some[left + 1] - some[left])).to(values).reshape(-1, 1, 1)
    return torch.lerp(values[:, left], values[:, left + 1], share)
