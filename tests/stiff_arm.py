"""A two-link arm whose dynamics are stiff: paths under them, found or linearised along."""

import numpy as np

from invdyn.models import ArmModel, Keypoints, Link, Observation, planar_body

LENGTHS = (0.35, 0.3)


def body(gravity=(0.0, -9.81)):
    links = [Link(f"link{k}", f"joint{k}", f"tip{k}", length=x, mass=1.5 - 0.5 * k) for k, x in enumerate(LENGTHS)]
    return planar_body("arm", links, gravity=gravity)


def arm(steps, noise, *, stiff=1e-3, dt=0.02, **options):
    parameters = {
        "noise.angle": stiff,
        "noise.velocity": 0.05,
        "initial.angle": [-1.2, 0.5],
        "initial.angle_scale": 0.4,
        "initial.velocity_scale": 1.0,
        "torque.scale": 3.0,
        **options.pop("parameters", {}),
    }
    observation = options.pop("observation", Observation(Keypoints([0, 1])))
    if observation.keypoints:
        parameters["emission.keypoint_scale"] = noise
    return ArmModel(body(), dt * np.arange(steps), observation, parameters=parameters, **options)
