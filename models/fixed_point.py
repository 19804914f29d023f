"""States that the others drive by jumps, as those others make them: the gap of a gear with backlash along a motion.

    g_t = f_t(g_{t−1}),  t = 1 … T−1,   g_0 and all other states given

Every row at once is sent one row on, then those again that come after one that was changed, until nothing is: contact
makes a gap forget what was before, so few passes do (fixed-point iteration). Between contacts a gap forgets nothing,
and a change would travel a row a pass; there slopes carry it on, as in Newton's method over a whole sequence (Lim, Zhu,
Selfridge and Kasim, "Parallelizing non-linear sequential models over the sequence length", ICLR 2024, eq. 3–6):

    g_t ← f_t(ĝ_{t−1}) + ∂f_t/∂g (g_{t−1} − ĝ_{t−1}),   ĝ the last pass's

Slopes are differences; one that straddles a contact is left out. A last pass over all rows is without them, so that
what lies at a stop lies there to the bit.

Shapes: paths (..., T, D), R rows of them, E contact states.
"""

import torch
from torch import Tensor

from invdyn.models.state_space import StateSpaceModel, gaussian_mean

CLOSE = 1e-12
"""Change of a state by which it stays."""
LEAPS, PASSES = 10, 40
"""Passes at most with slopes, and after them without: so many rows are forgotten by themselves."""
FEW = 20_000
"""Rows, of all parameter sets together, up to which passes have slopes. They cost three passes without, and where a gap
seldom meets a stop those end with a third of the rows unsettled; of more rows, most are settled sooner."""
NUDGE, STEEP = 1e-6, 20.0
"""Difference for slopes, and the slope from which on it is a jump."""


@torch.no_grad()
def settled(model: StateSpaceModel, path: Tensor) -> Tensor:
    """The path (..., T, D) with the model's ``contact_states`` settled; one that is so already stays to the bit.

    The path itself where the model has none.
    """
    if model.contact_states is None:
        return path
    every = rows = torch.arange(1, path.shape[-2])
    path, sets, leapt = path.clone(), path.shape[:-2].numel(), False
    for _ in range(LEAPS):
        leaps = sets * len(rows) <= FEW
        rows = _pass(model, path, rows, leaps)
        if not len(rows):
            break
        leapt |= leaps
    if leapt:
        rows = _pass(model, path, every, whole=True)
    for _ in range(PASSES):
        if not len(rows):
            break
        rows = _pass(model, path, rows)
    return path


def _pass(model: StateSpaceModel, path: Tensor, rows: Tensor, leaps: bool = False, whole: bool = False) -> Tensor:
    """Send ``rows`` (R,) of ``path`` on in place, those that change or the ``whole``; the rows after a change.

    Of the whole, any change counts: what follows a contact may have many times as much of it.
    """
    before, here = path[..., rows - 1, :], path[..., rows, model.contact_states]
    if leaps:
        moved = _carried(here, *_sent(model, before, rows), rows)
    else:
        moved = gaussian_mean(model.transition(before, rows))[..., model.contact_states]
    close = 0.0 if whole else CLOSE
    changed = ~((moved - here).abs().movedim(-2, 0).flatten(1).amax(1) <= close)  # NaN, too, is a change
    taken = torch.ones_like(changed) if whole else changed
    path[..., rows[taken], model.contact_states] = moved[..., taken, :]
    after = rows[changed] + 1
    return after[after < path.shape[-2]]


def _sent(model: StateSpaceModel, before: Tensor, rows: Tensor) -> tuple[Tensor, Tensor]:
    """Values f_t (..., R, E) of rows that follow states ``before`` (..., R, D), and its slopes (..., R, E, E)."""
    nudges = NUDGE * torch.eye(before.shape[-1], dtype=before.dtype)[model.contact_states]
    nudges = torch.cat([torch.zeros_like(nudges[:1]), nudges]).reshape(-1, *[1] * (before.ndim - 1), before.shape[-1])
    f = gaussian_mean(model.transition(before + nudges, rows))[..., model.contact_states]
    slopes = ((f[1:] - f[0]) / NUDGE).movedim(0, -1)
    return f[0], torch.where((slopes.abs() < STEEP).all(-1).all(-1)[..., None, None], slopes, 0.0)


def _carried(here: Tensor, f: Tensor, slopes: Tensor, rows: Tensor) -> Tensor:
    """Values f_t (..., R, E) and what each row's change from ``here`` adds to the next one's, if that is among them."""
    old, new, change_of, numbers = here.numpy(), f.clone().numpy(), slopes.numpy(), rows.tolist()
    for i in range(1, len(numbers)):
        if numbers[i] == numbers[i - 1] + 1:
            change = new[..., i - 1, :] - old[..., i - 1, :]
            new[..., i, :] += (change_of[..., i, :, :] @ change[..., None])[..., 0]
    return torch.from_numpy(new)
