"""Parameters that effects bring to a model, and the places that they need to be seen at."""

from collections.abc import Sequence
from typing import Any

import torch
from pyro.distributions import Distribution
from torch import Tensor
from torch.distributions import constraints

from invdyn.models.effects.base import PREFIX, Effect
from invdyn.models.effects.hidden import Hidden
from invdyn.models.effects.scale import Scale


def parameters_of(
    effects: Sequence[Effect], scale: Scale, dtype: torch.dtype, device: torch.device
) -> tuple[dict[str, Tensor], dict[str, Distribution]]:
    """Starting values (1,) and priors of what ``effects`` bring, by dotted name.

    A value stands where its effect is absent or, where it is never absent, in the middle of its grid or prior.
    """
    starts, priors = {}, {}
    for effect in effects:
        for parameter in effect.parameters(scale):
            name = f"{PREFIX}{effect.key}.{parameter.name}"
            start = parameter.absent
            if start is None:
                start = parameter.grid[len(parameter.grid) // 2] if parameter.grid else parameter.prior.mean.item()
            starts[name] = torch.full((1,), start, dtype=dtype, device=device)
            prior = parameter.prior  # Pyro's are float32 when written with plain numbers
            numbers = {each: getattr(prior, each).to(dtype) for each in prior.arg_constraints}
            priors[name] = type(prior)(**numbers).expand((1,)).to_event(1)
    return starts, priors


def hidden_scales(
    effects: Sequence[Effect], scale: Scale, dtype: torch.dtype, device: torch.device
) -> dict[str, Tensor]:
    """Standard deviations (H,) of hidden states in the first row, and from row to row, by dotted name."""
    found: dict[str, Any] = {}
    for effect in (each for each in effects if isinstance(each, Hidden)):
        sd = torch.tensor(effect.hidden_scale(scale), dtype=dtype, device=device)
        found |= {f"initial.hidden.{effect.key}": sd, f"noise.hidden.{effect.key}": 1e-4 * sd}
    return found


def check_tracked(effects: Sequence[Effect], tracked: Sequence[str]) -> None:
    """Raise ValueError for an effect on keypoints that are not among those ``tracked``."""
    for effect in effects:
        # a push needs no eye on the point that it acts on
        unseen = set(effect.where) - {*tracked, effect.form} if effect.sensor else None
        if unseen and effect.site in ("keypoint", "keypoints"):
            raise ValueError(
                f"{effect.name}: expected keypoints that are tracked, {', '.join(tracked) or 'none'}, "
                f"got {', '.join(sorted(unseen))}"
            )


def is_signed(prior: Distribution) -> bool:
    """Whether a parameter may be negative."""
    support = getattr(prior.support, "base_constraint", prior.support)
    return support is constraints.real
