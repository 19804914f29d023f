"""Joint angles that a recording shows: what the keypoints say where there are no encoders."""

from dataclasses import replace

import numpy as np

from invdyn.inference.posterior.initialise import arm_problem
from invdyn.models import ArticulatedBody
from invdyn.recordings import Recording


def recorded_angles(recording: Recording, body: ArticulatedBody) -> np.ndarray:
    """Angles (T, K) rad that keypoints show, NaN in rows where nothing was seen. Raises InputError as a model does."""
    bound = arm_problem(replace(recording, torques=None, angles=None, joint_names=()), body, substeps=1)
    paths = bound.model.initial_paths(bound.observations)
    _, angle, _ = bound.model.split(paths[len(paths) // 2])
    seen = angle.clone()
    seen[bound.observations.isnan().all(-1)] = float("nan")
    return np.asarray(seen.numpy())
