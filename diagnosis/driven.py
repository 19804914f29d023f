"""What a hinge that nobody sees does along a motion that is known: its path (ψ, ψ̇), driven by it.

A hinge on a spring follows to first order: ψ_{t+1} = A_t ψ_t + b_t, with A and b by differences about rest, from the
deflection that the first row would hold.

A gap forgets what was before as soon as there is contact: :meth:`.StateSpaceModel.settled`.

Shapes: T rows, D states without the hinge, S parameter sets.
"""

import torch
from torch import Tensor

from invdyn.models import ArmModel
from invdyn.models.state_space import gaussian_mean


def driven(model: ArmModel, path: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """Along ``path`` (T, D): paths (S, T, D + 2) with the hinge of ``model``, of S = ``count`` parameter sets.

    And the next states (S, T−1, D + 2) of their rows, to first order too.
    """
    rows, first = torch.arange(1, len(path)), model.torque_size
    hidden = slice(first, first + model.state_dim - path.shape[-1])
    still = path.new_zeros(len(path), model.state_dim - path.shape[-1])
    path = torch.cat([path[:, :first], still, path[:, first:]], -1).expand(count, -1, -1).clone()

    def moved(path: Tensor) -> Tensor:
        return gaussian_mean(model.transition(path[:, :-1], rows))

    if model.driven is not None:
        path = model.settled(path)
        return path, moved(path)

    nudges = torch.tensor(model.parameters["initial.hidden_scale"].tolist(), dtype=path.dtype) * 1e-3

    def nudged(nudge: Tensor) -> Tensor:
        shifted = path.clone()
        shifted[..., hidden] = nudge
        return moved(shifted)

    rest = moved(path)
    slopes = torch.stack([(nudged(nudge) - rest) / nudge.sum() for nudge in torch.diag(nudges)], -1)
    A, b = slopes[..., hidden, :], rest[..., hidden]
    psi = torch.linalg.solve(torch.eye(len(nudges), dtype=path.dtype) - A[:, 0], b[:, 0])
    for t in range(path.shape[1]):
        path[:, t, hidden] = psi
        if t < len(rows):
            psi = (A[:, t] @ psi.unsqueeze(-1)).squeeze(-1) + b[:, t]
    return path, rest + (slopes @ path[:, :-1, hidden].unsqueeze(-1)).squeeze(-1)
