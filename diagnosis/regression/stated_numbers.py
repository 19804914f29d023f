"""What a regression states, in the robot's own numbers and with their doubt.

A fit has coefficients β of columns in torques as they were commanded. A motor that gives τ where τ (1 + g) is commanded
has ε = 1/(1 + g) − 1; all other numbers of its joint are β/(1 + g). With γ that was found first (:mod:`.servo_gains`)

    1 + ε = 1/(γ (1 + g))

Where the motion of a joint does not tell g, all that is known in its servo's torque is as unsure as the gain, and by
the same factor: log-normal, with sd `servo_gain_sd`. No such factor makes a number that is there nothing. Links move by
base parameters, sums of numbers of several links.

The probability that a number is another than the file's, by more than is tolerated, weighs the two at even odds. With
b how far its estimate is beyond that, s its sd and F − 1 degrees of freedom (:mod:`.weighted_fit`), and the prior
N(0, u²) of a few sizes u,

    P/(1 − P) = mean over u of t(b; √(s² + u²))/t(b; s)

It is a half where a log tells nothing, and near 1 only where all parts of the log tell the same.

Shapes: R rows, K joints, P columns, p of them chosen. Units: rad, s, N·m.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.special import ndtri, stdtrit

from invdyn.diagnosis.catalogue.linear_laws import GAIN, INERTIAL, LOWER_BOUNDS
from invdyn.diagnosis.regression.grouped_evidence import Chosen
from invdyn.diagnosis.regression.linear_effects import LinearEffects, joints_of
from invdyn.diagnosis.regression.regressors import base_columns, nominal_link_numbers
from invdyn.diagnosis.regression.servo_gains import ServoGains
from invdyn.diagnosis.regression.weighted_fit import Fitted, left_by
from invdyn.diagnosis.rules import FIXED

Numbers = dict[tuple[str, str, str], float]
"""By effect, place and parameter."""


@dataclass(frozen=True)
class Estimated:
    """A number: `parameter` of an effect at a place, with its 90 % interval; `of_file` is what the file has of it.

    ``known_with`` are further numbers that are known with it alone, name → factor (:func:`.regressors.base_columns`).
    ``probability`` is that the robot's is another than the file's. ``by_part`` has values and sds of each recording, or
    third of one, where these differ (:mod:`.agreement`).
    """

    effect: str
    place: str
    parameter: str
    value: float
    sd: float
    interval_90: tuple[float, float]
    unit: str
    of_file: float = 0.0
    known_with: Mapping[str, float] = field(default_factory=dict)
    probability: float = 1.0
    by_part: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True)
class Stated:
    """An effect and its places, all of them where `everywhere`; nats that it gains over the set without it.

    `probability` is by place; of a link, that any of its numbers is another, or of all links', where none is its own.
    `rivals` are other effects, by place, that explain as much there: a log may not tell them apart.
    """

    effect: str
    places: tuple[str, ...]
    everywhere: bool
    gain_nats: float
    probability: Mapping[str, float] = field(default_factory=dict)
    rivals: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def sure(self) -> tuple[str, ...]:
        """Places at which it is there without much doubt."""
        return tuple(p for p in self.places if self.probability.get(p, 1.0) >= FIXED.sure_probability)


def stated(
    effects: LinearEffects, fit: Fitted, servos: ServoGains, memory: float, numbers: Sequence[Estimated]
) -> tuple[Stated, ...]:
    """What was chosen, and gains that are far from the file's; of ``memory`` rows one counts."""
    found = {s.kind: (tuple(s.columns), gain) for s, gain in zip(fit.chosen.statements, fit.chosen.gain, strict=True)}
    if servos.changed.any():
        places, gain = found.pop(GAIN, ((), 0.0))
        every = [name for name, new in zip(joints_of(effects), servos.changed, strict=True) if new or name in places]
        before, after = (np.sqrt((each**2).mean(0)) for each in (effects.of_file, left_by(effects, fit.chosen)))
        gain += len(effects.missing) / memory * float(np.log(before / after)[servos.changed].sum())
        found = {GAIN: (tuple(every), gain), **found}
    # of an effect with several numbers the first one makes it what it is, and any of them a link
    first = {(each.effect, each.place): each.probability for each in reversed(numbers)}
    links = sorted((each.probability, each.place) for each in numbers if each.effect == INERTIAL)
    any_link = links[-1][0] if links else 1.0
    first |= {(INERTIAL, place): probability for probability, place in links}
    return tuple(
        Stated(
            kind,
            places,
            len(places) == _places(effects, kind),
            gain,
            # numbers of links without a base parameter are in those of others
            {place: first.get((kind, place), any_link) for place in places},
            {place: fit.rivals[kind, place] for place in places if (kind, place) in fit.rivals},
        )
        for kind, (places, gain) in found.items()
    )


def named(effects: LinearEffects, chosen: Chosen, servos: ServoGains) -> Numbers:
    """Numbers by effect, place and parameter; a gain is the motor's."""
    names = [(effects.kinds[p], effects.places[p], effects.names[p]) for p in chosen.columns]
    found = dict(zip(names, chosen.values.tolist(), strict=True))
    factors = {place: 1 + max(value, LOWER_BOUNDS[GAIN]) for (kind, place, _), value in found.items() if kind == GAIN}
    of_command = {each.key for each in effects.shaped if each.of_command}
    for key, p in zip(names, chosen.columns, strict=True):
        if key[0] not in (INERTIAL, GAIN):
            scale = 1.0 if key[:2] in of_command else factors.get(key[1], 1.0)
            found[key] = max(found[key] / scale, float(effects.least[p]))
    for place, factor, new in zip(joints_of(effects), servos.factor.tolist(), servos.changed, strict=True):
        if new or place in factors:
            found[GAIN, place, "gain"] = 1 / (factor * factors.get(place, 1.0)) - 1
    there = {name[:2] for name in names}
    shapes = {(*each.key, each.shape.name): effects.shapes[each.key].value for each in effects.shaped}
    return {name: value for name, value in shapes.items() if name[:2] in there} | found


def drawn(effects: LinearEffects, fit: Fitted, servos: ServoGains) -> tuple[Numbers, ...]:
    """Numbers of draws from the coefficients' Gaussian, always the same; joints' tolerated torques are independent."""
    if not fit.chosen.columns:
        return ()
    rng = np.random.default_rng(0)
    whole = fit.covariance + fit.discrepancy.sum(0)
    sd = np.sqrt(np.maximum(np.diag(whole), np.finfo(float).tiny))
    correlation = whole / sd[:, None] / sd
    # columns that say nearly the same have eigenvalues that are below zero by rounding
    values = sd * rng.multivariate_normal(
        np.zeros(len(sd)), correlation, FIXED.regression_draws, check_valid="ignore", method="eigh"
    )
    floor = effects.least[list(fit.chosen.columns)]
    sets = (replace(fit.chosen, values=np.maximum(fit.chosen.values + each, floor)) for each in values)
    every = [named(effects, each, servos) for each in sets]
    for place in sorted(_without_scale(effects, fit.chosen, servos)):
        factors = np.exp(FIXED.servo_gain_sd * rng.standard_normal(len(every)))
        every = [_scaled(each, place, factor) for each, factor in zip(every, factors.tolist(), strict=True)]
    return tuple(every)


def _without_scale(effects: LinearEffects, chosen: Chosen, servos: ServoGains) -> set[str]:
    """Joints whose servo has another gain, of which the fit knows nothing."""
    known = {effects.places[p] for p in chosen.columns if effects.kinds[p] == GAIN}
    return {place for place, new in zip(joints_of(effects), servos.changed, strict=True) if new} - known


def _scaled(numbers: Numbers, place: str, factor: float) -> Numbers:
    """Numbers whose joint has a servo with so many times the gain; what is less than the file's stays above nothing."""
    mine = {key: value for key, value in numbers.items() if key[1] == place and key[0] not in (INERTIAL, GAIN)}
    own = {key: value * (factor if value > 0 else min(factor, 1.0)) for key, value in mine.items()}
    gain = (GAIN, place, "gain")
    return numbers | own | {gain: (1 + numbers[gain]) * factor - 1}


def of_joints(effects: LinearEffects, fit: Fitted, servos: ServoGains) -> list[Estimated]:
    """Numbers of effects at joints."""
    values, unsure = named(effects, fit.chosen, servos), _without_scale(effects, fit.chosen, servos)
    by_part = _by_part(effects, fit, servos)
    sds, more = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0)), fit.shift(np.eye(len(fit.chosen.columns)))
    fitted = {
        (effects.kinds[p], effects.places[p], effects.names[p]): each
        for p, *each in zip(fit.chosen.columns, fit.chosen.values.tolist(), sds.tolist(), more.tolist(), strict=True)
    }
    column = {(effects.kinds[p], effects.places[p], effects.names[p]): p for p in fit.chosen.columns}
    shapes = {(*each.key, each.shape.name): each for each in effects.shaped if not each.is_size}
    of_command = {each.key for each in effects.shaped if each.of_command}
    found = []
    for (kind, place, name), value in values.items():
        if kind == INERTIAL or (kind, place, name) in shapes:
            continue
        p = column.get((kind, place, name))
        gain = fitted.get((GAIN, place, "gain"), (0.0,))[0]
        scale = (1 + value if kind == GAIN else 1.0) / (1 + max(gain, LOWER_BOUNDS[GAIN]))
        scale = 1.0 if (kind, place) in of_command else scale
        sd, wider = (scale * each for each in fitted.get((kind, place, name), (0.0,) * 3)[1:])
        unit, size = ("1", 1.0) if p is None else (effects.units[p], float(effects.size[p]))
        filed = -float(effects.least[p]) if p is not None and kind != GAIN and np.isfinite(effects.least[p]) else 0.0
        probability = probability_of(value, sd, size if kind == GAIN else scale * size, fit)
        sd, interval = _estimate(value, float(np.hypot(sd, wider)), fit.freedom)
        if place in unsure and kind == GAIN:
            low, high = _times_unknown(1 + value, 0.0, fit.freedom)
            probability = probability_of(float(np.log1p(value)), FIXED.servo_gain_sd, size, fit)
            sd, interval = FIXED.servo_gain_sd * (1 + value), (low - 1, high - 1)
        elif place in unsure:
            interval = _times_unknown(value, sd, fit.freedom)
            sd = float(np.hypot(sd, FIXED.servo_gain_sd * value))
        apart = tuple((v, scale * s) for v, s in by_part.get((kind, place, name), np.zeros((0, 2))).tolist())
        found.append(Estimated(kind, place, name, value, sd, interval, unit, filed, {}, probability, apart))
    for (kind, place, name), each in shapes.items():
        if (kind, place, name) in values:
            own = effects.shapes[kind, place]
            found.append(Estimated(kind, place, name, own.value, own.sd, own.interval_90, each.shape.unit))
    return found


def _by_part(effects: LinearEffects, fit: Fitted, servos: ServoGains) -> dict[tuple[str, str, str], np.ndarray]:
    """Values, and sds as of coefficients, (R, 2), of parts of the rows that do not tell the same."""
    columns, parts = fit.chosen.columns, fit.parts
    if parts is None:
        return {}
    every = [named(effects, replace(fit.chosen, values=each), servos) for each in parts.values]
    one = np.eye(len(columns))
    apart = zip(columns, parts.spread(one), parts.sds(one).T, strict=True)
    told = {(effects.kinds[p], effects.places[p], effects.names[p]): sds for p, tau, sds in apart if tau > 0}
    return {key: np.stack([[each[key] for each in every], sds], -1) for key, sds in told.items()}


def of_others(effects: LinearEffects, fit: Fitted, servos: ServoGains) -> list[Estimated]:
    """Numbers of effects at joints that were not chosen, each as it would be by itself besides."""
    every = ((key, of_joints(effects, each, servos)) for key, each in fit.others.items())
    return [each for key, numbers in every for each in numbers if (each.effect, each.place) == key]


def _times_unknown(value: float, sd: float, freedom: int) -> tuple[float, float]:
    """90 % interval of a number, of t's distribution, times a factor that is log-normal, as in :func:`_scaled`."""
    share = (np.arange(FIXED.regression_draws) + 0.5) / FIXED.regression_draws
    own = value + sd * stdtrit(freedom, share)[:, None]
    factor = np.exp(FIXED.servo_gain_sd * ndtri(share))
    low, high = np.quantile(own * np.where(own > 0, factor, np.minimum(factor, 1.0)), (0.05, 0.95))
    return float(low), float(high)


def probability_of(value: float, sd: float, size: float, fit: Fitted) -> float:
    """P of the top of the file; ``size`` is of an effect as large as is usual."""
    value = max(abs(value) - fit.tolerance * size, 0.0)
    if sd == 0:
        return float(value != 0)
    wide = sd**2 + (size * np.array(FIXED.regression_sizes)) ** 2
    far = np.log1p(value**2 / (fit.freedom * sd**2)) - np.log1p(value**2 / (fit.freedom * wide))
    odds = np.exp(np.minimum(-0.5 * np.log(wide / sd**2) + 0.5 * (fit.freedom + 1) * far, 500.0)).mean()
    return float(odds / (1 + odds))


def of_links(effects: LinearEffects, fit: Fitted, body: Any) -> list[Estimated]:
    """Base parameters of links that were found to be otherwise, in whole: what the file has, and what is missing."""
    chosen = fit.chosen
    mine = [n for n, p in enumerate(chosen.columns) if effects.kinds[p] == INERTIAL]
    if not mine:
        return []
    columns = [chosen.columns[n] for n in mine]
    base, rest, factors = base_columns(effects.columns.triangle(columns, np.sqrt(fit.weights) / chosen.noise))
    own = np.concatenate([each.ravel() for each in nominal_link_numbers(body)])
    offset = effects.kinds.index(INERTIAL)  # links' columns come last
    named = [f"{effects.names[p]} of {effects.places[p]}" for p in columns]
    found = []
    for i, b in enumerate(base):
        combination = np.zeros(len(columns))
        combination[b] = 1.0
        combination[rest] = factors[i]
        whole = np.zeros(len(chosen.columns))
        whole[mine] = combination
        nominal = float(combination @ own[[p - offset for p in columns]])
        value = nominal + float(whole @ chosen.values)
        sd, more = float(np.sqrt(max(whole @ fit.covariance @ whole, 0.0))), float(fit.shift(whole[None])[0])
        parts = {named[j]: float(combination[j]) for j in rest if abs(combination[j]) > 1e-9}
        p = columns[b]
        name, place, unit = effects.names[p], effects.places[p], effects.units[p]
        size = float(np.linalg.norm(combination * effects.size[columns]))
        # a link's size is its number, and says nothing of the torque that is tolerated
        probability = probability_of(value - nominal, sd, size, replace(fit, tolerance=0.0))
        sd, interval = _estimate(value, float(np.hypot(sd, more)), fit.freedom)
        by_part: tuple[tuple[float, float], ...] = ()
        if fit.parts and fit.parts.spread(whole[None])[0] > 0:
            own_values, sds = nominal + fit.parts.values @ whole, fit.parts.sds(whole[None])[:, 0]
            by_part = tuple(zip(own_values.tolist(), sds.tolist(), strict=True))
        found.append(Estimated(INERTIAL, place, name, value, sd, interval, unit, nominal, parts, probability, by_part))
    return found


def _estimate(value: float, sd: float, freedom: int) -> tuple[float, tuple[float, float]]:
    half = float(stdtrit(freedom, 0.95)) * sd
    return sd, (value - half, value + half)


def _places(effects: LinearEffects, kind: str) -> int:
    return len({place for own, place in zip(effects.kinds, effects.places, strict=True) if own == kind})
