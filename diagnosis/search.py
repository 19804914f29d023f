"""The search for causes: screen, refine the best, add another effect, measure again.

Forward selection with replacement over sets of at most four effects (Hastie, Tibshirani & Friedman 2009, §3.3), each
set scored by its tempered evidence and its prior (:mod:`.prior`):

    1  "no effect" by itself
    2  where the best single effect leaves something: from several values those that no screen tells the size of
       (``Effect.scan``), then sets of several by a beam search (:mod:`.together`)
    3  given the best set so far, screen every effect that could be added, those on what is seen also along the
       simulation's own path; refine the most promising ones
    4  where one has become two, drop the older and look for a better one in its place
    5  again from 3, until nothing that is added raises the posterior; effects whose parameters are searched
       (:mod:`.noise`) come after each screen, but play by itself only, and where nothing else explains the gap
    6  leave effects of the best set out, one by one, while that raises it; look for a better one in place of a single
       one, along its path

With unknown torque one effect is looked for that the camera shows: what changes the motion alone, a torque can imitate,
and only the prior of the torque could speak against it. What such effects gain is what that prior gives away for
nothing, as no limb obeys it; one of the observation has to gain more.

Everything that was refined stays in the pool, so that what the data cannot tell apart stands side by side; but a set
that is less probable than a part of it is no rival of that part (Madigan & Raftery 1994, "Occam's window").
"""

from collections.abc import Callable, Sequence
from itertools import product

import numpy as np
import torch
from torch import Tensor

from invdyn.diagnosis.noise import is_searched
from invdyn.diagnosis.paths import FIRM, led, lifted
from invdyn.diagnosis.pool import Search, considered, imitable
from invdyn.diagnosis.prior import MOST, log_prior_of
from invdyn.diagnosis.refine import ROUNDS, Refined, key_of, refine, refine_searched
from invdyn.diagnosis.screen import Screened, screen, sizes
from invdyn.diagnosis.setting import LOOSE, Setting
from invdyn.diagnosis.together import together
from invdyn.diagnosis.unknowns import Unknowns, unknowns
from invdyn.models.effects.base import Effect
from invdyn.models.effects.hidden import HiddenHinge
from invdyn.recordings import InputError

WIDTH, SWAPS, SETS = (10, 3, 2), 1, 2
"""Candidates refined when the first, second, … effect is sought, when one is to take another's place, and sets
of several that are refined as a whole."""

FORWARD = len(WIDTH)
"""Effects that are added one by one; more only as sets."""

HOPELESS, SHARE = 60.0, 0.1
"""Candidates beyond the third are refined where the screen has them within so many nats of the best, or, until one
leaves nothing, has them gain so large a share of what the best gains: where much is to be gained, it errs by much."""

KIN = (
    ("actuator_delay", "camera_latency", ("delay", "latency"), 1.0),
    ("camera_latency", "actuator_delay", ("latency", "delay"), 1.0),
    ("gravity_tilt", "camera_roll", ("angle", "angle"), -1.0),
    ("camera_roll", "gravity_tilt", ("angle", "angle"), -1.0),
)
"""Effects that stand in for one another exactly: names, parameters, and the factor between them."""

MISTAKES = ("outliers", "label_swap")
"""Effects that leave stray detections, and are not looked for where there are none."""

DOUBT = 5.0
"""Nats by which the screen may err: less promising ones are not refined."""

FAINT = 3.0
"""d′ of an effect of typical size under which the recording could not have shown it."""


def search(
    setting: Setting,
    path: Tensor,
    stray: bool,
    without: Sequence[str] = (),
) -> Search:
    """Search for causes among the catalogue ``without`` some effects' names, from what :func:`data_path` says.

    Raises InputError where the simulation runs away from the recording whatever torque is added.
    """
    candidates = considered(setting, without)
    none = _attempt(refine, setting, (), {}, path, LOOSE)
    if none is None:
        raise InputError(
            f"{setting.problem.recording.name}: body {setting.model.body.name!r} cannot follow it, even with torque "
            "of its own at each joint: check units, lengths and masses, or give a calmer stretch: --frames 0:500"
        )
    found = Search(candidates, {none.key: none}, [], path, stray)
    if setting.regime != "unknown_torque":
        found.aside = led(setting, setting.model, path, FIRM)
        if (alone := _attempt(refine, setting, (), {}, found.aside, FIRM)) is not None:
            found.add(alone)
    for number in range(1 if setting.regime == "unknown_torque" else FORWARD):
        best = found.ranked[0]
        if not number <= len(best.effects) < MOST:
            break
        screened = _extend(setting, found, best, WIDTH[number])
        if not found.first:
            found.first = screened
            if setting.regime != "unknown_torque" and not found.ranked[0].complete:
                _several(setting, found)
                _reduce(setting, found)
        grown = found.ranked[0]
        if len(grown.effects) == 2 and len(best.effects) == 1:
            for old in best.effects:
                rest = tuple(effect for effect in grown.effects if effect.key != old.key)
                base = found.pool.get(key_of(rest)) or _attempt(
                    refine, setting, rest, _values(grown), grown.path, LOOSE
                )
                if base is not None:
                    found.add(base)
                    _extend(setting, found, base, SWAPS)
    _reduce(setting, found)
    if len(found.ranked[0].effects) == 1 and setting.regime != "unknown_torque":
        _exchange(setting, found)
    return found


def _reduce(setting: Setting, found: Search) -> None:
    """Leave an effect of the best set out, from the path and the values that it was found with, while that is better.

    A set may be what it took to get near the parameters of one of its members.
    """
    best = found.ranked[0]
    tried = set()
    while len(best.effects) > 1:
        for effect in best.effects:
            rest = tuple(e for e in best.effects if e is not effect)
            if key_of(rest) not in tried and not all(is_searched(e) for e in rest):
                kept = best.searched if any(is_searched(e) for e in rest) else {}
                cause = _attempt(refine, setting, rest, _values(best), best.path, FIRM, **kept)
                if cause is not None:
                    found.add(cause)
            tried.add(key_of(rest))
        if found.ranked[0] is best:
            return
        best = found.ranked[0]


def _extend(setting: Setting, found: Search, base: Refined, width: int) -> list[Screened]:
    """Screen every effect that may join ``base``, refine the best ``width``, and keep them."""
    taken = {effect.key for effect in base.effects}
    free = [e for e in found.candidates if e.key not in taken]
    busy = any(isinstance(effect, HiddenHinge) for effect in base.effects)
    straight = [e for e in free if not is_searched(e) and not (busy and isinstance(e, HiddenHinge))]
    common, alone = unknowns(setting, base.effects), not base.effects and setting.regime != "unknown_torque"
    if base.effects:
        model, path, point = base.model, base.path, base.mean
    else:
        # The body as it is stated: without a cause its numbers have been bent to stand in for one.
        model, path, point = setting.model, found.path, common.mean
    few = base.complete and bool(base.effects)
    screened = screen(setting, model, path, straight, common, point, few)
    _refine_promising(
        setting, found, base, _seen_aside(setting, found.aside, screened, common) if alone else screened, width
    )
    _refine_kin(setting, found, len(base.effects) + 1)
    if alone:
        for effect in (e for e in free if e.scan):
            if found.ranked[0].complete:
                break
            if (cause := _attempt(_scan, setting, base, effect, found.top - HOPELESS)) is not None:
                found.add(cause)
    play = alone and not found.ranked[0].complete
    idle = _idle(screened) if setting.regime == "unknown_torque" else -np.inf
    for effect in free:
        if (
            is_searched(effect)
            and (found.stray or effect.name not in MISTAKES)
            and (play or not isinstance(effect, HiddenHinge))
            and (cause := _attempt(refine_searched, setting, base, effect, max(found.top - HOPELESS, idle))) is not None
        ):
            found.add(cause)
    return screened


def _seen_aside(setting: Setting, path: Tensor, screened: Sequence[Screened], common: Unknowns) -> list[Screened]:
    """Effects on what is seen stand where they do best: along the data's path, or along the simulation's own ``path``.

    Under a residual torque the arm follows the data; what the camera makes of them shows beside one that does not.
    """
    effects = [s.effect for s in screened if s.effect is not None and s.effect.side == "observation"]
    aside = {
        s.effect.key: s
        for s in screen(setting, setting.model, path, effects, common, common.mean)
        if s.effect is not None
    }
    best = [max(s, aside.get(s.effect.key, s), key=lambda s: s.log_evidence) if s.effect else s for s in screened]
    return sorted(best, key=lambda s: -s.log_evidence)


def _exchange(setting: Setting, found: Search) -> None:
    """Look for a better effect in place of a single one, along the path that it has found.

    Where Gauss–Newton goes astray, one of several effects that are alike may be the only one to arrive.
    """
    (old,) = found.ranked[0].effects
    base, path = found.pool[""], lifted(setting.model, found.ranked[0].path)
    common = unknowns(setting, ())
    free = [e for e in found.candidates if e.key != old.key and not is_searched(e)]
    screened = screen(setting, setting.model, path, free, common, common.mean, quiet=True)
    near = [s for s in screened if s.effect is None or s.log_evidence > found.top - HOPELESS]
    _refine_promising(setting, found, base, near, SWAPS)
    _refine_kin(setting, found, 1)


def _refine_promising(setting: Setting, found: Search, base: Refined, screened: Sequence[Screened], width: int) -> None:
    """Refine those of the screened effects, added to ``base``, that may raise the posterior, ``width`` at most."""
    # An effect must raise the posterior, which its prior lowers; the screen errs by some nats.
    nothing, temper = next(s.log_evidence for s in screened if s.effect is None), found.temper
    alone = log_prior_of(base.effects, found.candidates)
    promising = [
        s
        for s in screened
        if s.effect is not None
        and temper * (s.log_evidence - nothing) + log_prior_of((*base.effects, s.effect), found.candidates)
        > alone - DOUBT
    ]
    most = screened[0].log_evidence - nothing
    if setting.regime == "unknown_torque":
        promising = [s for s in promising if s.log_evidence > _idle(screened) and s.dprime > FAINT]
    for place, each in enumerate(promising[:width]):
        gained, top = each.log_evidence - nothing, found.top
        # Along the path of one that leaves nothing, others get their chance (:func:`_exchange`).
        least = most - HOPELESS if found.ranked[0].complete else min(most - HOPELESS, SHARE * most)
        if place >= (1 if found.ranked[0].complete else 3) and gained < least:
            continue
        values = {f"{each.effect.key}.{name}": value for name, value in each.values.items()} | _values(base)
        limits = {
            "enough": top - HOPELESS,
            "doubtful": top - max(HOPELESS, (1 - SHARE) * (top - base.log_evidence)),
        }
        effects = (*base.effects, each.effect)
        cause = _attempt(refine, setting, effects, values, each.path, each.size, **base.searched, **limits)
        if cause is not None:
            found.add(cause)


def _idle(screened: Sequence[Screened]) -> float:
    """The highest evidence of effects that an unknown torque imitates: so many nats its prior gives for nothing."""
    return max(s.log_evidence for s in screened if s.effect is None or imitable(s.effect))


def _attempt(work: Callable[..., Refined | None], *arguments, **options) -> Refined | None:
    """A refinement; None where it leads to parameters with which the simulation does not run at all."""
    try:
        return work(*arguments, **options)
    except (ValueError, np.linalg.LinAlgError, torch.linalg.LinAlgError):
        return None


def _several(setting: Setting, found: Search) -> None:
    """Refine the best pairs, then, where they leave something, the best sets of three, and so on."""
    common, none = unknowns(setting, ()), found.pool[""].log_evidence
    for sets in together(setting, setting.model, found.path, found.first, common, found.candidates, SETS):
        for each in sets:
            top = found.top
            limits = {"enough": top - HOPELESS, "doubtful": top - max(HOPELESS, (1 - SHARE) * (top - none))}
            cause = _attempt(refine, setting, each.effects, each.values, found.path, each.size, **limits)
            if cause is not None:
                found.add(cause)
        _refine_kin(setting, found, len(sets[0].effects))
        if found.ranked[0].complete:
            break


def _refine_kin(setting: Setting, found: Search, number: int) -> None:
    """Refine the exact or near equivalents of what was found, of causes with so many effects, from values that follow.

    A screen along the data's path cannot see them: the path itself is what they shift.
    """
    for cause in list(found.pool.values()):
        if len(cause.effects) != number or cause.log_evidence < found.top - HOPELESS:
            continue
        for mine in cause.effects:
            for name, other, parameter, factor in KIN:
                twin = next((e for e in found.candidates if e.key == other), None)
                if mine.key != name or twin is None or any(e.key == other for e in cause.effects):
                    continue
                if setting.regime == "unknown_torque" and imitable(twin):
                    continue
                rest = tuple(e for e in cause.effects if e is not mine)
                known = _values(cause)
                value = known.pop(f"{mine.key}.{parameter[0]}")
                values = known | {f"{other}.{parameter[1]}": factor * value}
                size = float(sizes(setting.regime)[int(cause.by_size.argmax())])
                other_one = _attempt(refine, setting, (*rest, twin), values, found.path, size, **cause.searched)
                if other_one is not None:
                    found.add(other_one)


def _scan(setting: Setting, base: Refined, effect: Effect, enough: float) -> Refined:
    """Refine an effect from the best of its starting values, each on a path of its own, if that has ``enough`` nats."""
    effects = (*base.effects, effect)
    model = setting.model.with_effects(*effects)

    def refined(values: dict[str, float], path: Tensor, rounds: int) -> Refined:
        known = {name: torch.tensor([v], dtype=torch.float64) for name, v in values.items()}
        there = model.replace(**{f"effect.{k}": v for k, v in known.items() if f"effect.{k}" in model.parameters})
        path = led(setting, there, lifted(model, path), FIRM)
        return refine(setting, effects, values, path, FIRM, rounds=rounds, **base.searched)

    tried = []
    for point in product(*effect.scan.values()):
        values = _values(base) | {f"{effect.key}.{name}": v for name, v in zip(effect.scan, point, strict=True)}
        tried.append(refined(values, base.path, 1))
    best = max(tried, key=lambda cause: cause.log_evidence)
    most = max(base.log_evidence, base.log_evidence + (1 - SHARE) * (enough - base.log_evidence))
    return best if best.log_evidence < most else refined(_values(best), best.path, ROUNDS)


def _values(cause: Refined) -> dict[str, float]:
    noise = {name: float(value) for name, value in cause.noise.items()}
    return dict(zip(cause.names, cause.mean.tolist(), strict=True)) | noise
