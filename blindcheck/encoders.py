"""What encoders read of a trajectory: its angles, from where each encoder counts."""

from collections.abc import Sequence

import numpy as np

from invdyn.blindcheck.camera import Effect
from invdyn.blindcheck.simulator import Trajectory


def readings(trajectory: Trajectory, when: np.ndarray, effects: Sequence[Effect]) -> np.ndarray:
    """Angles (T, K), rad, without noise, at times `when` (T,) s."""
    angles = np.stack([np.interp(when, trajectory.time, column) for column in trajectory.q.T], axis=-1)
    for name, joint, parameters in effects:
        if name == "encoder_offset":
            angles[:, joint] += parameters["offset"]
    return angles
