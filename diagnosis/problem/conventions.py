"""Encoders against keypoints: a mistake in a file that no effect is to be blamed for.

Keypoints say which way a joint turns, and from where its angle counts. What torques say of signs and zeros is looked at
before a diagnosis begins (:mod:`..check.before`).

Shapes: T rows, K joints.
"""

import math
import warnings

import numpy as np
from torch import Tensor

from invdyn.diagnosis.rules import Rules
from invdyn.models import ArmModel, Body
from invdyn.recordings import InputError


def refuse(message: str, force: bool) -> str:
    """Raise InputError for a mistake in a recording, or, by ``force``, warn of it; gives the message."""
    if not force:
        raise InputError(f"{message}; --force (force=True in Python) continues")
    warnings.warn(f"{message}; continued, by --force", stacklevel=3)
    return message


def check_conventions(name: str, model: ArmModel, observations: Tensor, rules: Rules, force: bool = False) -> None:
    """Refuse the sign or zero of a joint that no robot and camera have at once; see :func:`refuse`.

    Of ``observations`` (T, O), the model's, encoders (T, K) are compared with the directions of links that the camera
    sees, keypoints (T, P, 2). Only links of a chain in the plane have a direction; of another body nothing is checked.
    """
    observation, body = model.observation, model.body
    if observation.encoders is None or not (isinstance(body, Body) and body.is_chain):
        return
    angle = observation.of(observation.encoders, observations).numpy()
    points = observation.points(observations).numpy()
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
