"""The same arm as a planar chain and as a tree in space: one model, two dynamics, the same answer."""

import numpy as np
import pytest
import torch

from invdyn.models import ArmModel, ArticulatedBody, Body, Encoders, Keypoints, Link, Observation
from invdyn.models.bodies.in_space import tree_of
from invdyn.models.effects import Armature, CoulombFriction, JointStiffness, Payload, ViscousFriction

F64 = torch.float64
ARM = Body("arm", [Link("upper", "shoulder", "elbow", 0.4, 1.0), Link("fore", "elbow", "wrist", 0.3, 0.6)])
TIME = 0.02 * np.arange(12)
GIVEN = {"initial.angle": [-1.4, 0.3], "initial.angle_scale": 0.3, "initial.velocity_scale": 2.0}


def model_of(body, **options):
    sensors = Observation(Keypoints(["elbow", "wrist"]), Encoders())
    return ArmModel(body, TIME, sensors, parameters=GIVEN, command=np.ones((12, 2)), **options)


@pytest.fixture
def both():
    assert isinstance(ARM, ArticulatedBody)
    assert isinstance(tree_of(ARM), ArticulatedBody)
    return model_of(ARM), model_of(tree_of(ARM))


def test_scales_are_the_same(both):
    for name in ("torque", "inertia", "speed", "reach"):
        one, other = (getattr(model.scale, name) for model in both)
        assert other == pytest.approx(one, rel=1e-12)


@pytest.mark.parametrize(
    "effects",
    [(), (ViscousFriction("elbow"), Armature("shoulder"), JointStiffness("elbow")), (CoulombFriction("elbow"),)],
    ids=["ideal", "smooth", "dry"],
)
def test_rows_are_the_same(effects, both):
    """Effects at joints know nothing of the plane."""
    values = {"damping": 0.1, "inertia": 0.02, "stiffness": 0.5, "torque": 0.2}
    planar, spatial = (model.with_effects(*effects) for model in both)
    named = {n: torch.tensor([values.get(n.rpartition(".")[2], 0.0)], dtype=F64) for n in planar.priors}
    planar, spatial = (model.replace(**named) for model in (planar, spatial))
    torch.manual_seed(0)
    x, rows = planar.initial().expand((11,)).sample(), torch.arange(1, 12)
    torch.testing.assert_close(spatial.transition_mean(x, rows), planar.transition_mean(x, rows), rtol=0, atol=1e-12)
    seen, plane = spatial.emission(x, rows).mean, planar.emission(x, rows).mean
    torch.testing.assert_close(seen[:, [0, 1, 3, 4, 6, 7]], plane, rtol=0, atol=1e-12)
    assert (seen[:, [2, 5]] == 0).all()


def test_an_effect_of_the_plane_is_refused_in_space(both):
    with pytest.raises(ValueError, match="payload: expected a chain in the plane, got 'arm'"):
        both[1].with_effects(Payload())
