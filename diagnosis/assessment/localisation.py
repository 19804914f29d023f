"""Where the gap lies: side, joint, keypoint, time, and what it depends on; posterior shares, not an arg-max."""

from collections.abc import Mapping, Sequence

import numpy as np

from invdyn.diagnosis.assessment.result import Interval, Where
from invdyn.diagnosis.problem.cause import FittedHypothesis
from invdyn.diagnosis.problem.regime import Regime
from invdyn.diagnosis.rules import DEFAULT, Rules
from invdyn.models import ArmModel, ArticulatedBody
from invdyn.models.effects.base import Effect


def joints_of(effect: Effect, body: ArticulatedBody) -> list[int]:
    """Joints of the body that an effect acts at; none of one on the whole arm, or on what a camera sees."""
    filmed = effect.sensor not in ("", "encoders")
    if filmed or effect.site == "arm" or not effect.place:
        return []
    if effect.site == "link":
        return list(body.moved_by(effect.place[0]))
    return list(effect.place) if effect.site == "pair" else [effect.place[0]]


def where(
    model: ArmModel,
    causes: Mapping[str, tuple[FittedHypothesis, float]],
    outside: float,
    regime: Regime,
    residual: np.ndarray,
    typical: np.ndarray,
    shifts: np.ndarray,
    frame_gap: np.ndarray,
    depends_on: Sequence[str],
    rules: Rules = DEFAULT,
) -> Where:
    """Shares.

    Args:
        model: the simulation.
        causes: key → (cause, probability that it is at work, alone or with something else).
        outside: probability of what the catalogue lacks and no cause stands in for: a torque, or, where torques are
            unknown and do what they like, something that the camera sees.
        regime: the problem's.
        residual: (T, K) residual torque without any cause, N·m.
        typical: (K,) N·m.
        shifts: (P,) rms of what observation effects move each tracked keypoint by, in noise sds.
        frame_gap: (T,) nats, NaN where nothing was seen.
        depends_on: variables.
    """
    body = model.body
    energy = ((residual / typical) ** 2).mean(0)
    everywhere = energy / energy.sum() if energy.sum() > 0 else np.full(len(energy), 1 / len(energy))
    tracked = list(model.observation.tracked_names)
    seen_at = (
        shifts / shifts.sum() if len(shifts) and shifts.sum() > 0 else np.full(len(shifts), 1 / max(len(shifts), 1))
    )
    dynamics, observation = (outside, 0.0) if regime.knows_torque else (0.0, outside)
    joints, keypoints, read = dynamics * everywhere, observation * seen_at, 0.0
    for cause, probability in causes.values():
        for effect in cause.effects:
            share = probability / len(cause.effects)
            moves = not effect.sensor
            dynamics, observation = dynamics + share * moves, observation + share * (not moves)
            read += share * (effect.sensor == "encoders")
            if moves or effect.sensor == "encoders":
                mine = joints_of(effect, body)
                joints = joints + share * (np.isin(np.arange(len(joints)), mine) / len(mine) if mine else everywhere)
            else:
                names = [name for name in effect.where if name in tracked]
                keypoints = keypoints + share * (
                    np.isin(tracked, names) / len(names) if names else seen_at if len(tracked) else 0.0
                )
    return Where(
        side=_normal({"dynamics": dynamics, "observation": observation}),
        joints=_normal(dict(zip(body.joint_names, joints.tolist(), strict=True))),
        keypoints=_normal(dict(zip(tracked, (keypoints * (keypoints.sum() > read)).tolist(), strict=True))),
        intervals=acting(causes) or intervals(model.time.numpy(), frame_gap, rules),
        depends_on=tuple(depends_on),
    )


def _normal(shares: dict[str, float]) -> dict[str, float]:
    total = sum(shares.values())
    return {name: (value / total if total > 0 else 0.0) for name, value in shares.items()}


def acting(causes: Mapping[str, tuple[FittedHypothesis, float]]) -> tuple[Interval, ...]:
    """When the most probable cause is at work, where it lasts for a while; its probability for a share."""
    cause, probability = max(causes.values(), key=lambda pair: pair[1])
    known = cause.values
    return tuple(
        Interval(moment - half, moment + half, probability)
        for effect in cause.effects
        if any(p.located for p in effect.parameters(cause.model.scale))
        for moment, half in [(known[f"{effect.key}.moment"], known[f"{effect.key}.duration"] / 2)]
    )


def intervals(time: np.ndarray, frame_gap: np.ndarray, rules: Rules = DEFAULT) -> tuple[Interval, ...]:
    """The fewest stretches that hold most of the gap; none where that is a large part of the recording."""
    seen = np.isfinite(frame_gap)
    t, gap = time[seen], np.maximum(frame_gap[seen], 0.0)
    if gap.sum() <= 0 or len(t) < 3:
        return ()
    width = max(round(rules.outcome.gap_smoothing / np.median(np.diff(t))), 1)
    level = np.convolve(gap, np.ones(width) / width, mode="same")
    order = np.argsort(-level)
    mass = np.cumsum(gap[order]) / gap.sum()
    inside = np.zeros(len(t), bool)
    inside[order[: int(np.searchsorted(mass, rules.outcome.interval_mass)) + 1]] = True
    if inside.mean() > rules.outcome.max_interval_share:
        return ()
    edges = np.flatnonzero(np.diff(np.r_[0, inside.astype(int), 0]))
    found = [
        Interval(float(t[a]), float(t[b - 1]), float(gap[a:b].sum() / gap.sum()))
        for a, b in zip(edges[::2], edges[1::2], strict=True)
    ]
    return tuple(sorted((i for i in found if i.share > 0.05), key=lambda i: -i.share))
