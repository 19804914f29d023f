"""State-space models that conformance tests run over, and what those tests share.

Each torque process, integrator, emission and number of joints occurs, and each pair of torque process and
integrator, in the list of cases below.
"""

import itertools

import numpy as np
import oracles
import pytest
import torch
from scenes import ring

from invdyn.inference.posterior.cameras import pinhole
from invdyn.models import (
    INTEGRATORS,
    TORQUE_PROCESSES,
    ArmModel,
    Body,
    Encoders,
    Joint,
    Keypoints,
    Link,
    Observation,
    OrnsteinUhlenbeck,
    Pixels,
    planar_body,
)

F32, F64 = torch.float32, torch.float64
STEPS = 6
TIME = np.array([0.0, 0.03, 0.06, 0.1, 0.12, 0.15])


def body(joints):
    lengths = (0.4, 0.3, 0.25)
    links = [Link(f"link{k}", f"joint{k}", f"tip{k}", length=lengths[k], mass=1.2 - 0.3 * k) for k in range(joints)]
    return planar_body("arm", links, base=(0.1, -0.2))


def emissions(joints):
    """By name; the last has one tip less than there are links, where that is possible."""
    tips = range(joints)
    confidence = np.random.default_rng(0).uniform(size=(STEPS, joints))
    return {
        "keypoints": Observation(Keypoints(tips)),
        "encoders": Observation(Encoders()),
        "both": Observation(Keypoints(tips), Encoders()),
        "student": Observation(Keypoints(tips), Encoders(), family="student_t"),
        "multivariate t": Observation(Keypoints(tips), Encoders(), family="multivariate_t"),
        "confidence": Observation(Keypoints(tips, confidence=confidence)),
        "last tip": Observation(Keypoints([joints - 1], confidence=confidence[:, -1:]), family="student_t"),
    }


def arm(torque, integrator, emission, joints, command=False):
    kind = TORQUE_PROCESSES[torque]
    moved = np.random.default_rng(1).normal(size=(STEPS, joints)) if command else None
    return ArmModel(
        body(joints),
        TIME,
        emissions(joints)[emission],
        torque=kind(),
        command=moved,
        integrator=integrator,
        substeps=1 + joints % 2,
    )


def pixels():
    """A rod before two cameras, one of them with a clock and a pose of its own, and what lasts in both."""
    calibration = ring(2)
    size = torch.tensor([camera.size for camera in calibration], dtype=F64)
    seen = Pixels(pinhole(calibration), calibration.names, size, ("tip",), timed=True, posed=True)
    link = Link("rod", Joint("pivot", "universal"), length=0.4, tip="tip", mass=1.0)
    own = {"initial.angle_scale": 0.3, "camera.offset": [0.0, 0.01], "camera.turn": [[0.0] * 3, [0.02, 0.0, -0.01]]}
    return ArmModel(Body("rod", [link]), TIME, Observation(seen, family="student_t"), parameters=own)


def cases():
    found = {"linear": lambda: oracles.random_chain(2).model(STEPS)}
    names, joints = itertools.cycle(emissions(1)), itertools.cycle([1, 2, 3, 2, 1, 3, 3])
    for torque, integrator in itertools.product(TORQUE_PROCESSES, INTEGRATORS):
        what = (torque, integrator, next(names), next(joints))
        command = len(found) % 3 == 0
        title = "-".join(map(str, what)) + ("-command" if command else "")
        found[title] = lambda what=what, command=command: arm(*what, command)
    found["printed"] = lambda: ArmModel(body(2), TIME, torque=OrnsteinUhlenbeck("printed"), integrator="euler")
    found["pixels"] = pixels
    return found


CASES = cases()
EVERY = pytest.mark.parametrize("case", CASES)
SOME = pytest.mark.parametrize("case", list(CASES)[::4])


def gappy(observations):
    """Missing: a whole row, and single entries."""
    observations = observations.clone()
    observations[2] = torch.nan
    observations[0, -1] = observations[4, 0] = torch.nan
    return observations


def states(model, *batch):
    """A few states that are not far from where the model starts, (*batch, D)."""
    return model.initial().expand(torch.Size(batch)).sample()


def sets(model, count=3):
    """The model with parameters (S, 1, own shape), and the S models of them."""
    factors = 1 + 0.05 * torch.arange(count, dtype=model.dtype)
    stacked = {name: value * factors.reshape(count, 1, *[1] * value.ndim) for name, value in model.parameters.items()}
    loop = [model.replace(**{name: value * factor for name, value in model.parameters.items()}) for factor in factors]
    return model.replace(**stacked), loop
