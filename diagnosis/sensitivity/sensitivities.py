"""What a candidate cause would change in the recording: its columns along the data's own path.

Along the path x̄ of the data, an effect with parameters φ moves the next state by f_φ(x̄_t) − f(x̄_t) and
what is seen by h_φ(x̄_t) − h(x̄_t). A parameter that the effect follows in a straight line from "absent" on gives
one column, the secant over half its prior's sd. The others are laid on a grid. An effect without any
straight-line parameter gives an offset at each grid point, and the local slopes there.

Shapes: T rows, D states, O observations; a :class:`Columns` has J of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import torch
from torch import Tensor

from invdyn.diagnosis.problem.unknowns import Unknowns, bounds, prior_sd
from invdyn.diagnosis.rules import DEFAULT, FIXED, Rules
from invdyn.diagnosis.sensitivity.latent_response import latent_response
from invdyn.inference.smoothing.linearisation import emission_mean
from invdyn.models import ArmModel
from invdyn.models.effects.base import Effect, Parameter
from invdyn.models.effects.composition import moves_body
from invdyn.models.effects.hidden import HiddenHinge
from invdyn.models.state_space import gaussian_mean


@dataclass(frozen=True)
class Hypothesis:
    """An effect at one grid point, before its columns are known by number.

    Attributes:
        effect: bound.
        point: values of all parameters about which it is expanded, by name.
        free: names of the parameters that the columns belong to.
        sd: of their deviations from ``point``, whose prior mean is 0.
        lower, upper: (p,) smallest and largest deviation.
        log_weight: prior weight of the grid point within the effect.
        columns: numbers of the columns of ``free``, from 0.
        offset: number of the column added as it is, or None.
    """

    effect: Effect
    point: dict[str, float]
    free: tuple[str, ...]
    sd: tuple[float, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    log_weight: float
    columns: tuple[int, ...]
    offset: int | None


@dataclass(frozen=True)
class Columns:
    """Changes of the next state g (T−1, D, J) and of what is seen d (T, O, J), not yet whitened."""

    g: np.ndarray
    d: np.ndarray


def changes(
    model: ArmModel,
    effect: Effect,
    sets: Sequence[dict[str, float]],
    path: Tensor,
    plain: Tensor,
    rules: Rules = DEFAULT,
) -> tuple[Tensor, Tensor]:
    """What ``effect`` at each of S parameter sets makes of f and h along ``path`` (T, D): (S, T−1, D), (S, T, O).

    ``plain`` (T−1, D) is f without it.
    """
    most = FIXED.max_parameter_sets
    batches = (sets[i : i + most] for i in range(0, len(sets), most))
    parts = [_changed(model, effect, batch, path, plain, rules) for batch in batches]
    if len(parts) == 1:
        return parts[0]
    f, h = (torch.cat(each) for each in zip(*parts, strict=True))
    return f, h


def _changed(
    model: ArmModel,
    effect: Effect,
    sets: Sequence[dict[str, float]],
    path: Tensor,
    plain: Tensor,
    rules: Rules,
) -> tuple[Tensor, Tensor]:
    rows = torch.arange(len(path))
    names = sets[0].keys()
    values = {
        f"effect.{effect.key}.{name}": torch.tensor([s[name] for s in sets], dtype=path.dtype).reshape(-1, 1, 1)
        for name in names
    }
    hinge = isinstance(effect, HiddenHinge)
    with_effect = model.with_effects(effect).replace(**values)
    hidden = slice(model.torque_size, model.torque_size + with_effect.state_dim - model.state_dim)
    with torch.no_grad():
        if hinge:
            path, f = latent_response(with_effect, path, len(sets), rules)
        else:
            # What the camera alone makes of it moves no arm.
            f = gaussian_mean(with_effect.transition(path[..., :-1, :], rows[1:])) if moves_body(effect) else plain
        h = emission_mean(with_effect, path, rows)
        f = torch.cat([f[..., : hidden.start], f[..., hidden.stop :]], -1)
        return f.expand(len(sets), len(rows) - 1, -1), h.expand(len(sets), len(rows), -1)


def unchanged(model: ArmModel, path: Tensor) -> tuple[Tensor, Tensor]:
    """Next states f (T−1, D) and what is seen h (T, O), as ``model`` has them along ``path`` (T, D)."""
    rows = torch.arange(len(path))
    with torch.no_grad():
        return gaussian_mean(model.transition(path[:-1], rows[1:])), emission_mean(model, path, rows)


def hypotheses(
    model: ArmModel,
    effect: Effect,
    path: Tensor,
    plain: tuple[Tensor, Tensor],
    windows: Sequence[tuple[float, float]] = (),
    rules: Rules = DEFAULT,
) -> tuple[list[Hypothesis], Columns]:
    """All grid points of an effect and their columns.

    ``plain`` is what :func:`unchanged` gives; ``windows`` are times at which a push may have come.
    """
    effect = effect.bound(model.body)
    parameters = effect.parameters(model.scale)
    straight = [p for p in parameters if not p.grid]
    bent = [p for p in parameters if p.grid]
    if any(p.located for p in parameters):
        points = [{"moment": (start + stop) / 2, "duration": stop - start} for start, stop in windows]
        bent = []
        straight = [p for p in parameters if not p.located]
        rare = -np.log(max(2 * model.scale.duration / rules.screening.burst_window, 1.0))
    else:
        names = [p.name for p in bent]
        points = [dict(zip(names, values, strict=True)) for values in product(*(p.grid for p in bent))]
        rare = -np.log(len(points))
    # What is not on a grid is expanded about its absence, which it then has.
    absent: dict[str, float] = {p.name: p.absent for p in straight if p.absent is not None}
    sets: list[dict[str, float]] = []
    found: list[Hypothesis] = []
    pieces: list[tuple[int, int | None, float]] = []
    for point in points:
        base = absent | point
        if straight:
            free, first = straight, len(pieces)
            for p in straight:
                step = rules.screening.secant_step * prior_sd(p)
                sets.append(base | {p.name: absent[p.name] + step})
                pieces.append((len(sets) - 1, None, step))
            offset: int | None = None
        else:
            free, offset = bent, len(pieces)
            sets.append(base)
            here = len(sets) - 1
            pieces.append((here, None, 1.0))
            first = len(pieces)
            for p in bent:
                step = 0.1 * spacing(p, point[p.name])
                sets.append(base | {p.name: point[p.name] + step})
                pieces.append((len(sets) - 1, here, step))
        sd = [prior_sd(p) if straight else spacing(p, point[p.name]) for p in free]
        # Slopes at a grid point tell nothing of what lies beyond its neighbours.
        ends = [bounds(p, rules) if straight else neighbours(p, point[p.name], rules) for p in free]
        found.append(
            Hypothesis(
                effect,
                base,
                tuple(p.name for p in free),
                tuple(sd),
                tuple(low - base[p.name] for p, (low, _) in zip(free, ends, strict=True)),
                tuple(high - base[p.name] for p, (_, high) in zip(free, ends, strict=True)),
                rare,
                tuple(range(first, first + len(free))),
                offset,
            )
        )
    f0, h0 = plain
    f, h = changes(model, effect, sets, path, f0, rules)

    def column(values: Tensor, plain: Tensor, which: tuple) -> Tensor:
        here, other, step = which
        return (values[here] - (plain if other is None else values[other])) / step

    g = torch.stack([column(f, f0, which) for which in pieces], -1)
    d = torch.stack([column(h, h0, which) for which in pieces], -1)
    return found, Columns(g.numpy(), d.numpy())


def spacing(parameter: Parameter, value: float) -> float:
    """Half the distance between a grid point's neighbours."""
    low, high = _grid_neighbours(parameter, value)
    return float(max((high - low) / 2, 1e-12))


def neighbours(parameter: Parameter, value: float, rules: Rules = DEFAULT) -> tuple[float, float]:
    """A grid point's neighbours; at an end of the grid, as far beyond it as the last one is before, within bounds."""
    low, high = _grid_neighbours(parameter, value)
    if low == high:
        return bounds(parameter, rules)
    least, most = bounds(parameter, rules)
    if low == value:
        # Half of a number that has a sign is far enough towards zero.
        return max(2 * value - high, value / 2 if least >= 0 else least), high
    return low, min(2 * value - low, most) if high == value else high


def _grid_neighbours(parameter: Parameter, value: float) -> tuple[float, float]:
    """The grid points before and after one; itself at an end."""
    grid = np.sort(parameter.grid)
    place = int(np.argmin(np.abs(grid - value)))
    return float(grid[max(place - 1, 0)]), float(grid[min(place + 1, len(grid) - 1)])


def slopes(model: ArmModel, among: Unknowns, point: np.ndarray, step: np.ndarray, path: Tensor) -> Columns:
    """Differences of f and h in every unknown about ``point`` (p,), central but at a bound."""
    up, down = np.minimum(point + step, among.upper), np.maximum(point - step, among.lower)
    p = len(point)
    sets = np.repeat(point[None], 2 * p, 0)
    each = np.arange(p)
    sets[each, each], sets[p + each, each] = up, down
    rows = torch.arange(len(path))
    if not p:
        return Columns(np.zeros((len(path) - 1, model.state_dim, 0)), np.zeros((len(path), model.observation_dim, 0)))
    many = among.set_in(model, sets)
    with torch.no_grad():
        f = gaussian_mean(many.transition(path[..., :-1, :], rows[1:])).expand(2 * p, len(rows) - 1, -1)
        h = emission_mean(many, path, rows).expand(2 * p, len(rows), -1)
    width = torch.as_tensor(up - down).reshape(-1, 1, 1)

    def slope(values: Tensor) -> np.ndarray:
        return ((values[:p] - values[p:]) / width).movedim(0, -1).numpy()

    return Columns(slope(f), slope(h))


def spans(model: ArmModel, rules: Rules = DEFAULT) -> list[tuple[float, float]]:
    """Stretches of `burst_window` seconds, half of which each shares with the next, over all of a recording.

    One over the whole of a shorter one.
    """
    first, last = model.time[[0, -1]].tolist()
    window = rules.screening.burst_window
    starts = np.arange(first, max(last - window / 2, first + window / 4), window / 2)
    return [(float(s), float(min(s + window, last))) for s in starts]
