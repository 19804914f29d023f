"""Whole turns over gaps: which of the paths across what was not seen is the most probable.

A camera tells the angle of a link but for whole turns. Between neighbouring frames one way is plain; over a gap it may
not be. Two ways over a gap [a, b] that differ by n turns have the same ends, and the same velocities there. Where the
least acceleration bridges the first one, it bridges the second one with the cubic more

    φ' = φ + 2π n s² (3 − 2s),   s = (t − a) / (b − a) within the gap,   φ' = φ + 2π n after it.

Each is a start of its own (:func:`.gauss_newton`), and their evidences compare: turns cost torque. The best
one is kept, as long as there is a better one. Ways with a turn of one link more or less are tried, and of two links at
once. What is worth the search follows from a walk of the velocity ω. Between known velocities at both ends of a gap of
length Δ it leaves the angle's change a variance of q² Δ³ / 12, so that n turns more cost

    [ (d + 2π n)² − d² ] 6 / (q² Δ³) nats,   d = φ_b − φ_a − (ω_a + ω_b) Δ/2,   q² = ⟨(ω_{t+Δ} − ω_t)²⟩ / Δ.

The walk is a rough guide, so only what costs ``DEAREST`` is left out. The gap with the cheapest turn comes first. A
doubt is reported where another way has more than ``REPORTED`` of the probability.

Of links in the plane that no encoder counts. A link that turns by more than half a turn from row to row is beyond this:
gap or none, its turns cannot be identified. Shapes: T rows, K links, C ways, path (T, D).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np
import torch
from torch import Tensor

from invdyn.inference.execution.progress import Report
from invdyn.inference.fitting.log_parameters import Free
from invdyn.inference.fitting.marginal_likelihood import Fit, fit
from invdyn.inference.smoothing.gauss_newton import gauss_newton
from invdyn.models import ArmModel
from invdyn.models.articulated.start import path_through
from invdyn.models.divergence import Diverged
from invdyn.models.kinematics import link_angles

REPORTED = 0.05
"""Probability of another way from which it is reported: what a 90 % band leaves at each end."""


DEAREST = -math.log(np.finfo(np.float64).eps)
"""nats of the walk beyond which a way is not looked at: double precision does not tell its probability from none."""


@dataclass(frozen=True)
class Doubt:
    """A gap over which another way is nearly as likely.

    Attributes:
        begin, end: s, of the last row before it and the first one after.
        turns: of each link by name, how many more the other way makes, counter-clockwise.
        probability: of the other way, against the one that was kept.
    """

    begin: float
    end: float
    turns: dict[str, int]
    probability: float

    def __str__(self) -> str:
        ways = " and ".join(
            f"{link} {abs(n)} turn{'s' * (abs(n) > 1)} {'counter-' * (n > 0)}clockwise"
            for link, n in self.turns.items()
        )
        return (
            f"warning: from {round(self.begin, 3):.13g} to {round(self.end, 3):.13g} s, where keypoints are missing, "
            f"{ways} more is a way "
            f"of probability {self.probability:.0%}: torques there are those of the likelier way"
        )


def fit_over_gaps(
    model: ArmModel,
    observations: Tensor,
    free: Sequence[Free],
    progress: Report | None = None,
    origin: float = 0.0,
    begin: Mapping[str, Tensor] | None = None,
    start: Tensor | None = None,
) -> tuple[Fit[ArmModel], list[str]]:
    """The fit from the way with the most probable turns over gaps, before it and after it, and what is in doubt.

    ``origin`` is the recording's time, s, at which the model's is 0; ``begin`` as of :func:`fit`; a path to ``start``
    from has such turns, as that of a similar model.
    """
    if not gaps(model, observations):
        return fit(model, observations, free, start=start, progress=progress, begin=begin), []
    if start is None:
        start, _ = most_probable_turns(model, observations)
    fitted = fit(model, observations, free, start=start, progress=progress, begin=begin)
    path, doubts = most_probable_turns(fitted.model, observations, fitted.path)
    if differs_in_turns(model, path, fitted.path):
        fitted = fit(model, observations, free, start=path, progress=progress)
        _, doubts = most_probable_turns(fitted.model, observations, fitted.path)
    return fitted, [str(replace(each, begin=each.begin + origin, end=each.end + origin)) for each in doubts]


def most_probable_turns(
    model: ArmModel, observations: Tensor, path: Tensor | None = None
) -> tuple[Tensor, list[Doubt]]:
    """The mode (T, D) with the most probable turns over gaps, from a ``path`` or the model's own; and what is in doubt.

    Raises as :func:`.gauss_newton` does.
    """
    model, observations = model.to(dtype=torch.float64, device="cpu"), observations.detach().cpu().double()
    here, left = gauss_newton(model, observations, start=path), gaps(model, observations)
    path, evidence, doubts = here.path, here.log_evidence.item(), []
    while left:
        priced = [(gap, _ways(model, path, gap, links)) for gap, links in left.items()]
        gap, ways = min(priced, key=lambda each: min(each[1].values(), default=math.inf))
        if not ways:
            break
        starts = torch.stack([_with(dict(way), model, path, gap) for way in ways])
        try:
            others = gauss_newton(model, observations, start=starts)
        except Diverged:  # none of them is a way
            del left[gap]
            continue
        gains = np.nan_to_num(others.log_evidence.numpy() - evidence, nan=-np.inf)
        best = int(gains.argmax())
        if gains[best] > 0:
            path, evidence = others.path[best], others.log_evidence[best].item()
            continue  # and a turn more, perhaps
        del left[gap]
        if (probability := 1 / (1 + math.exp(min(-gains[best], 700.0)))) > REPORTED:
            begin, end = (float(model.time[row]) for row in gap)
            turns = {model.body.link_names[link]: n for link, n in list(ways)[best]}
            doubts.append(Doubt(begin, end, turns, probability))
    return path, doubts


def gaps(model: ArmModel, observations: Tensor) -> dict[tuple[int, int], list[int]]:
    """By rows (last seen, next seen) around what is missing: the links that are not seen between them.

    None of a body in space, and of links that an encoder counts.
    """
    if not model.body.is_chain or not model.observation.tracked:
        return {}
    angle, wrapped = link_angles(observations, model.observation, model.body_parameters())
    unseen = np.isnan(angle) & wrapped.all(axis=0)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], unseen.any(axis=1), [False]]).astype(int)))
    within = [(a - 1, b) for a, b in edges.reshape(-1, 2).tolist() if a > 0 and b < len(angle)]
    return {(a, b): np.flatnonzero(unseen[a:b].any(axis=0)).tolist() for a, b in within}


def differs_in_turns(model: ArmModel, path: Tensor, other: Tensor) -> bool:
    """Whether a path (T, D) makes other turns than another one."""
    return bool(((model.split(path)[1] - model.split(other)[1]).abs() > math.pi).any())


def _ways(
    model: ArmModel, path: Tensor, gap: tuple[int, int], links: Sequence[int]
) -> dict[tuple[tuple[int, int], ...], float]:
    """By turns of one link, or of two at once, ((link, n), …): their price in nats."""
    _, angle, velocity = (part.detach().numpy() for part in model.split(path))
    angle, velocity = angle.cumsum(-1), velocity.cumsum(-1)
    a, b = gap
    span = float(model.time[b] - model.time[a])
    off = angle[b] - angle[a] - (velocity[a] + velocity[b]) * span / 2
    per_turn = 6 / span**2 / np.maximum(((velocity[b - a :] - velocity[: a - b]) ** 2).mean(0), 1e-300)
    sets = [*combinations(links, 1), *combinations(links, 2)]
    ways = [tuple(zip(own, turns, strict=True)) for own in sets for turns in product((1, -1), repeat=len(own))]
    prices = [sum(float(_price(off[link], n) * per_turn[link]) for link, n in way) for way in ways]
    return {way: price for way, price in zip(ways, prices, strict=True) if price < DEAREST}


def _price(off: float, turns: int) -> float:
    return (off + 2 * math.pi * turns) ** 2 - off**2


def _with(way: dict[int, int], model: ArmModel, path: Tensor, gap: tuple[int, int]) -> Tensor:
    _, angle, _ = model.split(path)
    begin, end = model.time[gap[0]], model.time[gap[1]]
    share = ((model.time - begin) / (end - begin)).clamp(0, 1)
    turns = torch.zeros(angle.shape[-1] + 1, dtype=path.dtype)
    for link, n in way.items():
        turns[link] += n
        turns[link + 1] -= n  # the joint beyond makes up for it: that link stays as it is
    more = 2 * math.pi * (share**2 * (3 - 2 * share)).unsqueeze(-1) * turns[:-1]
    return path_through(model, angle + more, like=path)
