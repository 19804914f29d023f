"""The fast screen: evidence of every candidate along the data's own path, the residual torque's size integrated out.

Data and all candidates' columns are whitened for every size of the residual (:mod:`.whiten`); each candidate's evidence
is then a small regression (:mod:`.evidence`). A cause found with the smallest size leaves nothing to explain.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.special import logsumexp
from torch import Tensor

from invdyn.diagnosis.kept_units import kept_unit
from invdyn.diagnosis.problem.cause import key_of
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.problem.unknowns import Unknowns
from invdyn.diagnosis.rules import DEFAULT, FIXED, Rules
from invdyn.diagnosis.sensitivity.bursts import burst_products
from invdyn.diagnosis.sensitivity.evidence import Regression, regression
from invdyn.diagnosis.sensitivity.sensitivities import Columns, Hypothesis, hypotheses, slopes, spans, unchanged
from invdyn.diagnosis.sensitivity.whiten import filter_of, linear_of, products
from invdyn.diagnosis.side_by_side import side_by_side
from invdyn.inference.smoothing.linearisation import Linearisation
from invdyn.models import ArmModel
from invdyn.models.effects.base import Effect
from invdyn.models.effects.hidden import HiddenHinge


def windows(
    problem: DiagnosisProblem, model: ArmModel, path: Tensor, linear: Linearisation
) -> list[tuple[float, float]]:
    """Stretches of time in which a burst of torque on the joints would explain most: a few for each of three sizes.

    And a short one within the first of them, where that explains more beyond chance: what acts for a row or two
    differs from a long weak push.
    """
    K = model.body.num_joints
    response = linear.F[:, :, :K].copy()
    response[:, :K] = 0.0
    residual = problem.rules.residual
    sizes = np.array([residual.spike_size, residual.slab_sizes[0], residual.slab_sizes[2]])
    about = filter_of(problem, model, path, sizes, linear)

    count = int((~problem.observations.isnan()).sum())

    def gains_of(times: Sequence[tuple[float, float]]) -> np.ndarray:
        """Twice the nats (3, W) that a burst in each stretch explains, under each size."""
        own, with_data, data = burst_products(about, response, model.time.numpy(), times)
        total = data + np.trace(own, axis1=-2, axis2=-1).sum(-1)
        A = own + 1e-9 * total[:, None, None, None] * np.eye(K)
        return np.einsum("gwi,gwij,gwj->gw", with_data, np.linalg.inv(A), with_data) * count / data[:, None]

    times, rules = spans(model, problem.rules), problem.rules.screening
    gains = gains_of(times)
    firsts, most = gains.argmax(-1), gains.max(-1)
    found = set()
    for gain in gains:
        for _ in range(rules.num_peaks):
            top = int(gain.argmax())
            found.add(times[top])
            gain[max(top - 2, 0) : top + 3] = -np.inf
    window, count_short = rules.burst_window, rules.num_short_windows
    shifts = np.linspace(-window / 2, window / 2, count_short)
    middles = {sum(times[first]) / 2 + shift for first in firsts for shift in shifts}
    short = [(middle - window / count_short, middle + window / count_short) for middle in sorted(middles)]
    gains = gains_of(short)
    for gain, least in zip(gains, most, strict=True):
        if gain.max() > least + rules.min_short_gain:
            found.add(short[int(gain.argmax())])
    return sorted(found)


def blocks(
    model: ArmModel,
    effects: Sequence[Effect],
    path: Tensor,
    times: Sequence[tuple[float, float]] = (),
    rules: Rules = DEFAULT,
) -> Iterator[tuple[list[Hypothesis], list[Columns], list[int]]]:
    """Effects' hypotheses and columns, in blocks that memory holds; and each hypothesis' first column, side by side.

    One block without any where there are no effects.
    """
    plain = unchanged(model, path)
    found: list[Hypothesis] = []
    pieces: list[Columns] = []
    first: list[int] = []
    count = 0
    room = FIXED.max_block_columns * FIXED.max_block_rows // max(len(path), FIXED.max_block_rows)
    for effect in effects:
        mine, columns = hypotheses(model, effect, path, plain, times, rules)
        if count and count + columns.g.shape[-1] > room:
            yield found, pieces, first
            found, pieces, first, count = [], [], [], 0
        found += mine
        first += [count] * len(mine)
        pieces.append(columns)
        count += columns.g.shape[-1]
    yield found, pieces, first


def stacked(pieces: Sequence[Columns]) -> Columns:
    """Columns of several effects as one."""
    return Columns(np.concatenate([c.g for c in pieces], -1), np.concatenate([c.d for c in pieces], -1))


def evidences(
    grams: np.ndarray,
    log_det: np.ndarray,
    count: int,
    found: Sequence[Hypothesis],
    first: Sequence[int],
    common: Unknowns,
    point: np.ndarray,
) -> list[Regression]:
    """Regression of every hypothesis, one result per size; hypothesis −1 (the last) is "no effect".

    Args:
        grams: (G, 1 + J, 1 + J) products of data and columns for each size.
        log_det: (G,) Σ ½ log |S_t|.
        count: numbers that were seen.
        found, first: hypotheses, and the first column of each.
        common: unknowns of all hypotheses, to which the last columns belong.
        point: where these stand.
    """
    shared = len(common.names)
    own = max((len(h.free) for h in found), default=0)
    p = own + shared
    H = len(found) + 1
    index, offset = np.zeros((H, p), int), np.zeros(H, int)
    mean, sd = np.zeros((H, p)), np.ones((H, p))  # an effect's own are expanded about their absence, or a grid point
    lower, upper = np.full((H, p), -np.inf), np.full((H, p), np.inf)
    for i, (h, start) in enumerate(zip(found, first, strict=True)):
        n = len(h.free)
        index[i, :n] = 1 + start + np.array(h.columns)
        offset[i] = 0 if h.offset is None else 1 + start + h.offset
        sd[i, :n], lower[i, :n], upper[i, :n] = h.sd, h.lower, h.upper
    index[:, own:] = grams.shape[-1] - shared + np.arange(shared)
    mean[:, own:], sd[:, own:] = common.mean - point, common.sd
    lower[:, own:], upper[:, own:] = common.lower - point, common.upper - point
    return [
        regression(gram, index, offset, mean, sd, lower, upper, count, own_log_det)
        for gram, own_log_det in zip(grams, log_det, strict=True)
    ]


@dataclass(frozen=True)
class Screened:
    """Evidence of one effect at one place.

    Attributes:
        effect: bound; None for "no effect".
        log_evidence: sizes and grid integrated out.
        best: its best grid point; None for "no effect".
        columns: of that point: what is added as it is, if anything, then those of ``best.free``.
        values: estimates of all parameters there, by name.
        elsewhere: those at the best other time, of an effect that acts for a while.
        size: the residual's, at its best.
        dprime: how far an effect of typical size would move the whitened data, in their sds; infinite for none.
        path: (T, D) along which.
    """

    effect: Effect | None
    log_evidence: float
    best: Hypothesis | None
    columns: Columns | None
    values: dict[str, float]
    elsewhere: dict[str, float] | None
    size: float
    dprime: float
    path: Tensor


@dataclass(frozen=True)
class Added(Screened):
    """Of an effect, and not of none."""

    effect: Effect
    best: Hypothesis
    columns: Columns


def added(screened: Iterable[Screened]) -> list[Added]:
    """All but "no effect", in their order."""
    return [s for s in screened if isinstance(s, Added)]


def _own(hypothesis: Hypothesis, start: int) -> np.ndarray:
    """Numbers of a hypothesis' columns, one after the other: what is added as it is, if anything, and what is free."""
    added = () if hypothesis.offset is None else (hypothesis.offset,)
    return start + np.array([*added, *hypothesis.columns])


def visibility(gram: np.ndarray, kappa: float, mine: Sequence[Hypothesis], first: Sequence[int]) -> float:
    """d′ of the most visible parameter at two thirds of its prior's sd, or of an offset."""
    largest = 0.0
    for hypothesis, start in zip(mine, first, strict=True):
        if hypothesis.offset is not None:
            norm = gram[1 + start + hypothesis.offset, 1 + start + hypothesis.offset]
            largest = max(largest, float(np.sqrt(norm)))
            continue
        for column, sd in zip(hypothesis.columns, hypothesis.sd, strict=True):
            norm = gram[1 + start + column, 1 + start + column]
            largest = max(largest, float(0.67 * sd * np.sqrt(norm)))
    return largest / kappa


def estimates(hypothesis: Hypothesis, result: Regression, number: int) -> dict[str, float]:
    """All parameters at a grid point, those that are free moved to where the regression has them, within bounds."""
    values = dict(hypothesis.point)
    for i, name in enumerate(hypothesis.free):
        change = np.clip(result.mean[number, i], hypothesis.lower[i], hypothesis.upper[i])
        values[name] = hypothesis.point[name] + float(change)
    return values


def _best_places(
    table: np.ndarray, found: Sequence[Hypothesis], window: float
) -> tuple[tuple[int, int], tuple[int, int] | None]:
    """Size and hypothesis of the largest evidence in ``table`` (G, H), and of that at another time, s apart."""
    size, place = (int(k) for k in np.unravel_index(table.argmax(), table.shape))
    moments = np.array([hypothesis.point.get("moment", 0.0) for hypothesis in found])
    apart = np.abs(moments - moments[place]) > window
    if not apart.any():
        return (size, place), None
    other, there = (int(k) for k in np.unravel_index(np.where(apart, table, -np.inf).argmax(), table.shape))
    return (size, place), (other, there)


@kept_unit("screen", Screened, Added, Hypothesis, Columns)
def screen(
    problem: DiagnosisProblem,
    model: ArmModel,
    path: Tensor,
    effects: Sequence[Effect],
    common: Unknowns,
    point: np.ndarray,
    quiet: bool = False,
    times: Sequence[tuple[float, float]] = (),
) -> list[Screened]:
    """Evidence of each effect added to ``model``, and of none, best first.

    ``common`` are unknowns that stay free in all of them; ``point`` is where they stand in ``model``. ``quiet`` says
    that ``model`` leaves little, so that the smaller sizes do. ``times`` are stretches in which to look for what acts
    for a while; by default those in which it would explain most.
    """
    problem.budget.start(*(key_of((*model.effects, effect)) for effect in effects))
    levels = problem.regime.sizes[: 3 if quiet and problem.regime.knows_torque else None]
    # What an effect adds is small: half of the sub-steps tell it as well.
    quick = model.in_substeps((model.substeps + 1) // 2)
    rest = slopes(quick, common, point, problem.rules.screening.slope_step * common.sd, path)
    weights = problem.regime.log_prior_of_first(len(levels))
    screened: list[Screened] = []
    linear = linear_of(problem, model, path)
    about = filter_of(problem, model, path, levels, linear)
    if not times and any(p.located for e in effects for p in e.bound(model.body).parameters(model.scale)):
        times = windows(problem, model, path, linear)
    for found, pieces, first in blocks(quick, effects, path, times, problem.rules):
        own = [_own(h, start) for h, start in zip(found, first, strict=True)]
        columns = stacked([*pieces, rest])
        problem.budget.spend(FIXED.column_cost * columns.g.shape[-1], model, len(path))
        whitened = products(problem, about, columns, [slice(1 + o[0], 2 + o[-1]) for o in own])
        results = evidences(whitened.gram, whitened.log_det, whitened.count, found, first, common, point)
        table = np.stack([r.log_evidence for r in results]) + weights[:, None]  # (G, H)
        none = table[:, -1]
        likely = int(none.argmax())
        kappa = float(results[likely].kappa[-1])
        # Beside a limb's own torque; a simulation would have none, were its gap explained.
        shown = whitened.gram[0 if problem.regime.knows_torque else likely]
        keys = [h.effect.key for h in found]
        for key in dict.fromkeys(keys):
            mine = [i for i, other in enumerate(keys) if other == key]
            part = table[:, mine] + np.array([found[i].log_weight for i in mine])
            (size, place), other = _best_places(part, [found[i] for i in mine], problem.rules.screening.burst_window)
            best = found[mine[place]]
            screened.append(
                Added(
                    best.effect,
                    float(logsumexp(part)),
                    best,
                    Columns(columns.g[..., own[mine[place]]], columns.d[..., own[mine[place]]]),
                    estimates(best, results[size], mine[place]),
                    None if other is None else estimates(found[mine[other[1]]], results[other[0]], mine[other[1]]),
                    float(levels[size]),
                    visibility(shown, kappa, [found[i] for i in mine], [first[i] for i in mine]),
                    path,
                )
            )
    screened.append(Screened(None, float(logsumexp(none)), None, None, {}, None, 0.0, np.inf, path))
    return sorted(screened, key=lambda s: -s.log_evidence)


def screen_in_halves(
    workers: int, problem: DiagnosisProblem, model: ArmModel, path: Tensor, effects: Sequence[Effect], *given: Any
) -> list[Screened]:
    """What :func:`screen` says, half of the effects side by side with the rest; ``given`` are its other arguments."""
    halves = halved([(effect, cost_of(effect.bound(model.body), model)) for effect in effects])
    one, *rest = side_by_side(
        [partial(screen, problem, model, path, half, *given) for half in halves], workers, problem.budget
    )
    return sorted([*one, *(s for other in rest for s in added(other))], key=lambda s: -s.log_evidence)


def halved(costs: Sequence[tuple[Effect, int]]) -> list[list[Effect]]:
    """Effects in two halves of equal cost, fewer than two in one: costliest first, to where less is (Graham 1969)."""
    halves: list[list[Effect]] = [[] for _ in costs[:2]] or [[]]
    filled = [0] * len(halves)
    for effect, cost in sorted(costs, key=lambda each: -each[1]):
        lighter = filled.index(min(filled))
        halves[lighter].append(effect)
        filled[lighter] += cost
    return halves


def cost_of(effect: Effect, model: ArmModel) -> int:
    """Columns of an effect, and a few for any; one of a hidden hinge costs as much as several of another's."""
    parameters = effect.parameters(model.scale)
    straight = sum(not p.grid for p in parameters)
    points = math.prod(len(p.grid) or 1 for p in parameters)
    each = FIXED.hinge_cost if isinstance(effect, HiddenHinge) else 1
    return FIXED.effect_cost + points * (straight or len(parameters) + 1) * each
