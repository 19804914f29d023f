"""How far an answer closes the gap in the units that engineers use, and whether the search is behind the regression.

    torque   1 − rms(e with)/rms(e without), e the torque that the simulation misses along the smoothed motion
    replay   the same of the angles' error over .5 and 2 s of replays from smoothed starts

On rows that neither answer was fitted to. Both are measured along one motion, through one low-pass filter
(:mod:`..regression.as_model`). Intervals are of one more motion like these (:mod:`..regression.torque_closing`).

An answer of the search that misses more torque than the regression's, or replays worse, by more than `max_behind_plain`
and `min_plain_gain` say, is not shown as the answer: the regression's is. Of replays the difference must exceed its own
standard error over parts of four, which fewer than eight replays do not have: of those the means alone are compared. An
answer that leaves nothing is shown in any case. Of effects that have states which no sensor shows, that change what
sensors see, or that act at one moment of a recording, no torque along other rows tells: they count as absent.

Shapes: R rows, K joints, H horizons, W replays. Units: N·m, rad, s.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from invdyn.diagnosis.problem.cause import FittedHypothesis
from invdyn.diagnosis.regression.as_model import (
    model_on,
    replay_errors,
    torque_missed,
    windows,
    with_coefficients,
)
from invdyn.diagnosis.regression.grouped_evidence import lower
from invdyn.diagnosis.regression.regress import Regression, Unseen
from invdyn.diagnosis.regression.torque_closing import TorqueClosing, closing, share_closed
from invdyn.diagnosis.rules import FIXED
from invdyn.models import ArmModel, ArticulatedBody
from invdyn.models.divergence import Diverged, diverging
from invdyn.models.effects.base import PREFIX
from invdyn.models.effects.hidden import Hidden

REGRESSION, SEARCH = "regression", "search"
Replays = tuple[float, Mapping[str, np.ndarray]]
"""A horizon, s, and errors (W,), rad, by answer."""


@dataclass(frozen=True)
class ReplayClosing:
    """Of one horizon, s: rms of angles' errors, rad, "nominal" and by answer; shares closed with their intervals."""

    horizon: float
    rms: Mapping[str, float]
    closed: Mapping[str, tuple[float, float, float]]


@dataclass(frozen=True)
class Closing:
    """By answer, "regression" and "search"; `shown` is the one that is shown."""

    joints: tuple[str, ...]
    torque: Mapping[str, TorqueClosing]
    replay: tuple[ReplayClosing, ...]
    shown: str

    def to_json(self) -> dict[str, Any]:
        """As a JSON file has it."""
        return {
            "shown": self.shown,
            "torque": {who: each.to_json(self.joints) for who, each in self.torque.items()},
            "replay": [
                {
                    "seconds": each.horizon,
                    "rms_rad": dict(each.rms),
                    "closed": {who: share for who, (share, _, _) in each.closed.items()},
                    "interval_90": {who: [low, high] for who, (_, low, high) in each.closed.items()},
                }
                for each in self.replay
            ],
        }


def measured(
    regression: Regression,
    body: ArticulatedBody,
    passive: bool,
    cause: FittedHypothesis | None = None,
    complete: bool = False,
) -> Closing:
    """The regression's answer, and a search's, on rows that the regression has not seen.

    ``cause`` is the search's as other rows know it; ``complete`` says that it leaves nothing.
    """
    there = regression.unseen
    nominal = model_on(there.motion, body, passive)
    models = {"nominal": nominal, REGRESSION: with_coefficients(nominal, there.coefficients)}
    torque = {REGRESSION: regression.torque}
    if cause is not None:
        models[SEARCH] = _of_cause(nominal, cause)
        file = nominal if passive else None
        first = _of_cause(model_on(there.fitted, body, passive), cause)
        own = torque_missed(first, there.fitted, there.cutoff, file)
        after = torque_missed(models[SEARCH], there.motion, there.cutoff, file)
        torque[SEARCH] = closing(there.missing, after, (there.fitted_missing, own))
    errors = _replayed(models, there)
    replay = tuple(_closing(*each) for each in errors)
    worse = cause is None or (not complete and bool(regression.stated) and behind(torque, errors))
    return Closing(regression.joints, torque, replay, REGRESSION if worse else SEARCH)


def _of_cause(nominal: ArmModel, cause: FittedHypothesis) -> ArmModel:
    """The simulation with a cause's effects and the body's numbers as it has them."""
    told = [effect for effect in cause.effects if not effect.sensor and not isinstance(effect, Hidden)]
    known = [effect for effect in told if not any(each.located for each in effect.parameters(nominal.scale))]
    numbers = cause.model.body.completed(cause.model.mechanics.given)._asdict()  # effects on them come once
    own = {f"body.{name}": numbers[name] for name in ("mass", "com", "inertia") if name in numbers}
    filed = {n: v for n, v in cause.model.parameters.items() if n.startswith("body.") and n[5:] not in numbers}
    keys = tuple(f"{PREFIX}{effect.key}." for effect in known)
    mine = {name: value for name, value in cause.model.parameters.items() if name.startswith(keys)}
    return nominal.with_effects(*known).replace(**own, **filed, **mine)


def behind(torque: Mapping[str, TorqueClosing], replays: Sequence[Replays]) -> bool:
    """Whether the search closes less than the regression on any measure, by more than is stated.

    Of fewer than eight replays, which make one part, no standard error is known, and the means decide.
    """
    left = {who: float(np.linalg.norm(each.after)) for who, each in torque.items()}
    if _more(left, float(np.linalg.norm(torque[REGRESSION].before))):
        return True
    for _, errors in replays:
        own = {who: _rms(each) for who, each in errors.items()}
        parts = [np.array_split(errors[who] ** 2, max(len(errors[who]) // 4, 1)) for who in (SEARCH, REGRESSION)]
        search, regression = (np.array([part.mean() for part in each]) for each in parts)
        if (len(search) < 2 or lower(search, regression)) and _more(own, own["nominal"]):
            return True
    return False


def _more(left: Mapping[str, float], whole: float) -> bool:
    """Whether the search leaves more than the regression does of so much."""
    known = left[REGRESSION]
    return left[SEARCH] > max(FIXED.max_behind_plain * known, known + FIXED.min_plain_gain * whole)


def _replayed(models: Mapping[str, ArmModel], there: Unseen) -> list[Replays]:
    starts = windows(there.motion)
    if not len(starts):
        return []
    errors: dict[str, np.ndarray] = {}
    for who, model in models.items():
        try:
            with diverging():
                errors[who] = replay_errors(model, there.motion, starts)
        except Diverged:
            errors[who] = np.full((len(FIXED.replay_horizons), len(starts)), np.pi)
    return [(horizon, {who: e[n] for who, e in errors.items()}) for n, horizon in enumerate(FIXED.replay_horizons)]


def _closing(horizon: float, errors: Mapping[str, np.ndarray]) -> ReplayClosing:
    rms = {who: _rms(each) for who, each in errors.items()}
    shares = {who: share_closed(errors["nominal"], each) for who, each in errors.items() if who != "nominal"}
    return ReplayClosing(horizon, rms, shares)


def _rms(errors: np.ndarray) -> float:
    return float(np.sqrt((errors**2).mean()))
