"""Signs and zeros of joints: mistakes in a file that no effect is to be blamed for.

Keypoints say which way a joint turns, and so do torques: the body asks for

    τ = D(θ) θ̈ + C(θ, θ̇) + g(θ),        τ' = s τ under  θ' = s θ + c,  s = ±1,  c a multiple of 90°,

along a motion. Where the torques that were given miss that by far, and with one sign or zero of one joint (or one sign
of all) they are near it, that is what is wrong. θ̇ and θ̈ are those of local cubics (Savitzky & Golay 1964).

Shapes: T rows, K joints.
"""

import math
from collections.abc import Iterator

import numpy as np
import torch
from scipy.signal import savgol_filter
from torch import Tensor

from invdyn.models import ArmModel, Body
from invdyn.recordings import InputError

APART, ROLLED, ALIKE = math.radians(10), math.radians(20), 0.95
"""rad that encoders and keypoints may differ by all along; at the first joint, as a camera may be rolled; and the mean
resultant length of a constant difference."""
MISSED, NEAR = 0.3, 0.3
"""Of the torques' rms what is missed where something is wrong, and of that what is missed once it is put right."""
STEP, WINDOW = 0.01, 11
"""s between even rows, at least, and how many of them a local cubic has."""
LEVER = 0.02
"""Of the arm, that a link must be seen to be long for its direction to count."""


def check_conventions(name: str, model: ArmModel, observations: Tensor, angle: Tensor) -> None:
    """Raise InputError for the sign or zero of a joint that no robot and camera have at once.

    ``observations`` (T, O) are the model's, ``angle`` (T, K) a path through them where no encoders are.
    """
    observation = model.observation
    if observation.encoders is not None:
        angle = observation.of(observation.encoders, observations)
        if isinstance(model.body, Body):  # links of a plane have a direction there
            _check_keypoints(name, model, model.body, observation.points(observations).numpy(), angle.numpy())
    if model.command is not None and bool(model.command.any()) and bool(model.body_parameters().gravity.any()):
        _check_torques(name, model, model.command.numpy(), angle.numpy())


def _check_keypoints(name: str, model: ArmModel, body: Body, points: np.ndarray, angle: np.ndarray) -> None:
    """Encoders (T, K) against the directions of links that the camera sees, keypoints (T, P, 2)."""
    seen = dict(zip(model.observation.tracked, points.swapaxes(0, 1), strict=True))
    seen[-1] = np.broadcast_to(np.array(body.base), (len(points), 2))
    reach = float(model.body_parameters().length.sum())
    for k, joint in enumerate(body.joint_names):
        if not {k - 1, k} <= seen.keys() or (k and k - 2 not in seen):
            continue
        along = seen[k] - seen[k - 1]
        turned = np.arctan2(along[:, 1], along[:, 0])
        if k:
            before = seen[k - 1] - seen[k - 2]
            turned = turned - np.arctan2(before[:, 1], before[:, 0])
        use = np.isfinite(turned + angle[:, k]) & (np.hypot(*along.T) > LEVER * reach)
        if use.sum() < WINDOW:
            continue
        same, other = (np.exp(1j * (angle[use, k] - way * turned[use])).mean() for way in (1, -1))
        if abs(other) > ALIKE > abs(same):
            raise InputError(
                f"{name}: the encoder of joint {joint!r} turns the other way than its keypoints: does the robot count "
                "it clockwise? Change the sign of its angles and torques"
            )
        if abs(same) > ALIKE and abs(np.angle(same)) > (APART if k else ROLLED):
            raise InputError(
                f"{name}: the encoder of joint {joint!r} and its keypoints differ by "
                f"{math.degrees(np.angle(same)):.0f}° all along. Ours is zero where the link lies "
                f"{'along x' if k == 0 else 'along the one before'}: subtract the difference from its angles"
            )


def _mistakes(joints: int, encoders: bool) -> Iterator[tuple[str, list[int], int, int, float]]:
    """What may be wrong, in words; of which joints; signs of angle and torque; and the zero, rad."""
    groups = [[k] for k in range(joints)] + ([list(range(joints))] if joints > 1 else [])
    for group in groups:
        yield "the torques have the other sign", group, 1, -1, 0.0
        if encoders:
            yield "angles and torques are counted the other way (clockwise)", group, -1, -1, 0.0
            yield "the angles are counted the other way (clockwise), the torques are not", group, -1, 1, 0.0
    if encoders:
        for k in range(joints):
            for quarter in (1, 2, 3):
                turn = math.remainder(quarter * math.pi / 2, math.tau)
                yield f"the angles' zero is {math.degrees(turn):+.0f}° off", [k], 1, 1, turn


def _check_torques(name: str, model: ArmModel, command: np.ndarray, angle: np.ndarray) -> None:
    """Torques against what the motion (T, K) asks for under each of the mistakes."""
    time = model.time.numpy()
    use = np.isfinite(angle).all(1)
    step = max(STEP, float(np.median(np.diff(time[use]))))
    even = np.arange(time[use][0], time[use][-1], step)
    if len(even) < 2 * WINDOW:
        return
    width = max(round(step / np.median(np.diff(time))), 1)
    smooth = [np.convolve(u, np.ones(width) / width, "same") for u in command.T]
    given = np.stack([np.interp(even, time, u) for u in smooth], -1)
    rows = np.stack([np.interp(even, time[use], q) for q in angle[use].T], -1)
    motion = [savgol_filter(rows, WINDOW, 3, deriv=n, delta=step, axis=0) for n in range(3)]
    unit = np.sqrt((given**2).mean(0))
    unit = np.maximum(unit, 0.1 * unit.max())
    body = model.body_parameters()

    def missed(joints: list[int], way: int, pull: int, zero: float) -> float:
        signs, pulls, zeros = np.ones(len(unit)), np.ones(len(unit)), np.zeros(len(unit))
        signs[joints], pulls[joints], zeros[joints] = way, pull, zero
        q, qd, qdd = (torch.as_tensor(signs * each) for each in motion)
        asked = model.dynamics.inverse(q - torch.as_tensor(zeros), qd, qdd, body).numpy()
        return float(np.sqrt((((pulls * given - asked) / unit) ** 2).mean()))

    own = missed([], 1, 1, 0.0)
    if own < MISSED:
        return
    known = _mistakes(len(unit), model.observation.encoders is not None)
    tried = [(missed(at, way, pull, zero), words, at) for words, at, way, pull, zero in known]
    best, words, joints = min(tried, key=lambda each: each[0])
    if best > NEAR * own or best > MISSED:
        return
    names = " and ".join(repr(model.body.joint_names[k]) for k in joints)
    raise InputError(
        f"{name}: at joint {names} {words}, it seems. As they are, the torques differ from those of the motion by "
        f"{100 * own:.0f} % of their size; corrected, by {100 * best:.0f} %. Correct the file"
    )
