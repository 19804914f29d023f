"""What a hinge that nobody sees does along a motion that is known: its path (ψ, ψ̇), driven by it.

A hinge on a spring follows to first order: ψ_{t+1} = A_t ψ_t + b_t, with A and b by differences about rest, from the
deflection that the first row would hold. Where rows are evenly spaced, A, which follows the posture, is looked at every
few rows and is a straight line between.

A gap forgets what was before as soon as there is contact: :meth:`.StateSpaceModel.settled`.

Shapes: T rows, D states without the hinge, S parameter sets.
"""

import torch
from torch import Tensor

from invdyn.models import ArmModel
from invdyn.models.state_space import gaussian_mean

EVERY, EVEN = 0.02, 0.01
"""s between the rows at which A is looked at, and by what share of it rows' intervals may differ for that."""


def driven(model: ArmModel, path: Tensor, count: int) -> Tensor:
    """Paths (S, T, D + 2) along ``path`` (T, D), with the hinge of ``model``, of S = ``count`` parameter sets."""
    rows, first = torch.arange(1, len(path)), model.torque_size
    hidden = slice(first, first + model.state_dim - path.shape[-1])
    still = path.new_zeros(len(path), model.state_dim - path.shape[-1])
    path = torch.cat([path[:, :first], still, path[:, first:]], -1).expand(count, -1, -1).clone()

    def moved(path: Tensor, rows: Tensor) -> Tensor:
        return gaussian_mean(model.transition(path[:, rows - 1], rows))[..., hidden]

    if model.driven is not None:
        return model.settled(path)
    nudges = torch.tensor(model.parameters["initial.hidden_scale"].tolist(), dtype=path.dtype) * 1e-3
    some = _some(model.dt[1:])

    def nudged(nudge: Tensor) -> Tensor:
        shifted = path.clone()
        shifted[..., hidden] = nudge
        return (moved(shifted, rows[some]) - b[:, some]) / nudge.sum()

    b = moved(path, rows)
    A = _between(torch.stack([nudged(nudge) for nudge in torch.diag(nudges)], -1), some, len(rows))
    psi = torch.linalg.solve(torch.eye(len(nudges), dtype=path.dtype) - A[:, 0], b[:, 0])
    for t in range(path.shape[1]):
        path[:, t, hidden] = psi
        if t < len(rows):
            psi = (A[:, t] @ psi.unsqueeze(-1)).squeeze(-1) + b[:, t]
    return path


def _some(dt: Tensor) -> Tensor:
    """Numbers of the rows at which A is looked at, the first and the last among them; ``dt`` (T − 1,) s."""
    usual = dt.median()
    even = bool(((dt - usual).abs() < EVEN * usual).all())
    every = max(1, round(EVERY / float(usual))) if even else 1
    return torch.unique(torch.cat([torch.arange(0, len(dt), every), torch.tensor([len(dt) - 1])]))


def _between(values: Tensor, some: Tensor, count: int) -> Tensor:
    """Values (S, N, …) at rows ``some`` on straight lines to all of ``count`` rows."""
    if len(some) == count:
        return values
    rows = torch.arange(count)
    after = torch.searchsorted(some, rows).clamp(1)
    share = ((rows - some[after - 1]) / (some[after] - some[after - 1])).to(values)
    share = share.reshape(-1, *[1] * (values.dim() - 2))
    return values[:, after - 1] * (1 - share) + values[:, after] * share
