"""What encoders read of a trajectory: its angles, from where each encoder counts."""

from collections.abc import Mapping

import numpy as np

from invdyn.blindcheck.simulator import Trajectory


def readings(trajectory: Trajectory, when: np.ndarray, present: Mapping) -> np.ndarray:
    """Angles (T, K), rad, without noise, at times `when` (T,) s; `present` is effect → (place, parameters)."""
    angles = np.stack([np.interp(when, trajectory.time, column) for column in trajectory.q.T], axis=-1)
    if "encoder_offset" in present:
        joint, parameters = present["encoder_offset"]
        angles[:, joint] += parameters["offset"]
    return angles
