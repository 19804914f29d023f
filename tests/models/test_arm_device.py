"""All that a row needs lies where the parameters are: on "meta", which mixes with no other, for an accelerator."""

import numpy as np
import pytest
import torch

from invdyn.models import ArmModel, Encoders, Keypoints, Link, Matern32, Observation, planar_body
from invdyn.models.effects import ActuatorLag, ViscousFriction

ROWS = 8


@pytest.fixture
def arm():
    links = [Link("upper", "shoulder", "elbow", 0.4, 1.0), Link("fore", "elbow", "wrist", 0.3, 0.6, com=0.1)]
    confidence = np.linspace(0.1, 1, 2 * ROWS).reshape(ROWS, 2)
    return ArmModel(
        planar_body("arm", links),
        0.02 * np.arange(ROWS),
        Observation(Keypoints([0, 1], confidence=confidence), Encoders()),
        torque=Matern32(),
        command=np.ones((ROWS, 2)),
    )


def test_every_distribution_of_a_row(arm):
    for model in (arm, arm.with_effects(ViscousFriction("elbow"), ActuatorLag("elbow"))):
        far = model.to(dtype=torch.float32, device="meta")
        assert (far.time.device, far.command.device, far.dt.device) == (torch.device("meta"),) * 3
        state = torch.empty(2, 3, far.state_dim, device="meta")
        step, seen = far.transition(state, 4), far.emission(state, 4)
        assert step.loc.device == step.scale_tril.device == torch.device("meta")
        assert seen.base_dist.scale.device == torch.device("meta")
        assert far.initial().loc.device == torch.device("meta")


def test_the_model_that_was_moved_stays_where_it_was(arm):
    arm.to(device="meta")
    assert arm.time.device.type == arm.observation.data()[0].device.type == arm.command.device.type == "cpu"
    assert arm.to(dtype=torch.float32).time is arm.time
