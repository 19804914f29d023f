"""Signs and zeros of joints: mistakes in a file that no effect is to be blamed for.

Keypoints say which way a joint turns, and so do torques (:mod:`.torque_regression`). Where those that were given miss
by far what the motion asks for, and with one sign of one joint or of all, or a zero a quarter of a turn off, they are
near it, that is what is wrong (:mod:`.mistakes`). `invdyn check` looks for smaller and other mistakes, too.

Shapes: T rows, K joints.
"""

import math
import warnings

import numpy as np
from torch import Tensor

from invdyn.diagnosis.problem.mistakes import fixed, left_by, zero
from invdyn.diagnosis.problem.torque_fit import TorqueFit
from invdyn.diagnosis.problem.torque_regression import smoothings
from invdyn.diagnosis.rules import Rules
from invdyn.models import ArmModel, Body
from invdyn.recordings import InputError

SIGNS = ("torque sign", "direction", "angle sign")


def refuse(message: str, force: bool) -> str:
    """Raise InputError for a mistake in a recording, or, by ``force``, warn of it; gives the message."""
    if not force:
        raise InputError(f"{message}; --force continues")
    warnings.warn(f"{message}; continued, by --force", stacklevel=3)
    return message


def check_conventions(
    name: str, model: ArmModel, observations: Tensor, angle: Tensor, rules: Rules, force: bool = False
) -> None:
    """Refuse the sign or zero of a joint that no robot and camera have at once; see :func:`refuse`.

    ``observations`` (T, O) are the model's, ``angle`` (T, K) a path through them where no encoders are.
    """
    observation = model.observation
    if observation.encoders is not None:
        angle = observation.of(observation.encoders, observations)
        if isinstance(model.body, Body) and model.body.is_chain:  # links of a plane have a direction there
            _check_keypoints(
                name, model, model.body, observation.points(observations).numpy(), angle.numpy(), rules, force
            )
    if model.command is not None and bool(model.command.any()) and bool(model.body_parameters().gravity.any()):
        _check_torques(name, model, model.command.numpy(), angle.numpy(), rules, force)


def _check_keypoints(
    name: str, model: ArmModel, body: Body, points: np.ndarray, angle: np.ndarray, rules: Rules, force: bool
) -> None:
    """Encoders (T, K) against the directions of links that the camera sees, keypoints (T, P, 2)."""
    seen = dict(zip(model.observation.tracked, points.swapaxes(0, 1), strict=True))
    seen[-1] = np.broadcast_to(np.array(body.base), (len(points), 2))
    max_offset, max_first = rules.check.max_encoder_offset, rules.check.max_first_offset
    reach = float(model.body_parameters().length.sum())
    for k, joint in enumerate(body.joint_names):
        if not {k - 1, k} <= seen.keys() or (k and k - 2 not in seen):
            continue
        along = seen[k] - seen[k - 1]
        heading = np.arctan2(along[:, 1], along[:, 0])
        if k:
            before = seen[k - 1] - seen[k - 2]
            heading = heading - np.arctan2(before[:, 1], before[:, 0])
        use = np.isfinite(heading + angle[:, k]) & (np.hypot(*along.T) > rules.check.min_link_length * reach)
        if use.sum() < rules.check.min_direction_rows:
            continue
        same, other = (np.exp(1j * (angle[use, k] - way * heading[use])).mean() for way in (1, -1))
        if abs(other) > rules.check.min_resultant > abs(same):
            refuse(
                f"{name}: the encoder of joint {joint!r} turns the other way than its keypoints: does the robot count "
                "it clockwise? Change the sign of its angles and torques",
                force,
            )
        if abs(same) > rules.check.min_resultant and abs(np.angle(same)) > (max_offset if k else max_first):
            refuse(
                f"{name}: the encoder of joint {joint!r} and its keypoints differ by "
                f"{math.degrees(np.angle(same)):.0f}° all along. Ours is zero where the link lies "
                f"{'along x' if k == 0 else 'along the one before'}: subtract the difference from its angles",
                force,
            )


def _check_torques(
    name: str, model: ArmModel, command: np.ndarray, angle: np.ndarray, rules: Rules, force: bool
) -> None:
    """Torques against what the motion (T, K) asks for under each of the mistakes that no effect looks like."""
    body, fit = model.body, TorqueFit(model.dynamics, model.body)
    motions = smoothings(body, model.time.numpy(), angle, command, rules=rules)
    if not motions:
        return
    motion = min(motions, key=lambda each: fit.explain(each).misfit)
    own = fit.explain(motion).misfit
    if own < rules.check.sure_misfit:
        return
    encoders, joints = model.observation.encoders is not None, body.num_joints
    by_target = () if motion.terms is None else motion.terms.by_target
    known = [each for each in fixed(joints, encoders, by_target) if each.kind in SIGNS]
    known += [zero(k, turn * math.pi / 2) for k in range(joints) for turn in (1, 2, -1) if encoders]
    best, mistake = min(((left_by(e, fit, motion), e) for e in known), key=lambda each: each[0])
    righted = mistake.right(motion)
    if best > rules.check.sure_remaining * own or best > rules.check.sure_misfit or righted is None:
        return
    if fit.explain(righted).missed(mistake.joints) > rules.check.max_joint_misfit:
        return
    names = " and ".join(repr(body.joint_names[k]) for k in mistake.joints)
    refuse(
        f"{name}: at joint {names} {mistake.words}, it seems. As they are, the torques differ from those of the "
        f"motion by {100 * own:.0f} % of their size; corrected, by {100 * best:.0f} %. Correct the file; "
        "`invdyn check` says more",
        force,
    )
