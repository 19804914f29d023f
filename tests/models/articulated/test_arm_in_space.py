"""The same arm as a planar chain and as a tree in space: one model, two dynamics, the same answer."""

import numpy as np
import pyro
import pytest
import torch

from invdyn.models import (
    ArmModel,
    Body,
    Encoders,
    Joint,
    Keypoints,
    Learned,
    Link,
    Observation,
    planar_body,
)
from invdyn.models.bodies.scalars import prior
from invdyn.models.effects import Armature, CoulombFriction, ExternalPush, JointStiffness, Payload, ViscousFriction

F64 = torch.float64
ARM = planar_body("arm", [Link("upper", "shoulder", "elbow", 0.4, 1.0), Link("fore", "elbow", "wrist", 0.3, 0.6)])
TIME = 0.02 * np.arange(12)
GIVEN = {"initial.angle": [-1.4, 0.3], "initial.angle_scale": 0.3, "initial.velocity_scale": 2.0}


def model_of(body, **options):
    sensors = Observation(Keypoints(["elbow", "wrist"]), Encoders())
    return ArmModel(body, TIME, sensors, parameters=GIVEN, command=np.ones((12, 2)), **options)


@pytest.fixture
def both():
    return model_of(ARM), model_of(ARM.in_space())


def test_scales_are_the_same(both):
    for name in ("torque", "inertia", "speed", "reach"):
        one, other = (getattr(model.scale, name) for model in both)
        assert other == pytest.approx(one, rel=1e-12)


@pytest.mark.parametrize(
    "effects",
    [
        (),
        (ViscousFriction("elbow"), Armature("shoulder"), JointStiffness("elbow")),
        (CoulombFriction("elbow"),),
        (Payload(),),
    ],
    ids=["ideal", "smooth", "dry", "loaded"],
)
def test_rows_are_the_same(effects, both):
    """Effects at joints, and a load, do in space what they do in the plane."""
    values = {"damping": 0.1, "inertia": 0.02, "stiffness": 0.5, "torque": 0.2, "mass": 0.3}
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
    with pytest.raises(ValueError, match="external_push: expected a chain in the plane, got 'arm'"):
        both[1].with_effects(ExternalPush(ARM.keypoint_names[-1]))


def stick_arm(**upper):
    return Body(
        "sticks",
        [
            Link("upper", Joint("shoulder", "universal"), **{"length": 0.4, "tip": "elbow", "mass": 1.0} | upper),
            Link("fore", Joint("elbow"), parent="upper", mass=0.6, com=(0.1, 0, 0), sites={"wrist": (0.3, 0, 0)}),
        ],
    )


def test_learned_scalars_of_a_tree_are_parameters():
    tree = stick_arm(length=Learned(0.4), mass=Learned(1.0))
    assert tree.learned == {"mass": (0,), "sites": (0,)}
    model, store = ArmModel(tree, TIME), pyro.get_param_store()
    model.sampled()
    assert set(store) == {"upper.mass", "upper.length"}
    store["upper.length"], store["upper.mass"] = torch.tensor(0.5, dtype=F64), torch.tensor(3.0, dtype=F64)
    found, expected = model.sampled().body_parameters(), stick_arm(length=0.5, mass=3.0).parameters()
    for name, ours, theirs in zip(found._fields, found, expected, strict=True):
        torch.testing.assert_close(ours.detach(), theirs, rtol=0, atol=1e-15, msg=name)
    (found.inertia.sum() + found.position.sum()).backward()
    assert all(store._params[name].grad.abs() > 0 for name in store)


def test_a_body_is_kept_for_all_rows_unless_it_is_learned(both):
    """One that is learned may change in place, and each backward pass wants it anew."""
    for model in both:
        with torch.no_grad():
            assert model.body_parameters() is model.body_parameters()
        mass = model.parameters["body.mass"].clone().requires_grad_()
        learning, state = model.replace(**{"body.mass": mass}), torch.ones(model.state_dim, dtype=F64)
        for _ in range(2):
            learning.transition_mean(state, 1).sum().backward()
        with torch.no_grad():
            before = learning.transition_mean(state, 1)
            mass += 1.0
            assert not torch.equal(learning.transition_mean(state, 1), before)


def test_what_a_stick_leaves_out_follows_given_numbers():
    tree = stick_arm()
    model = ArmModel(tree, TIME, parameters={"body.mass": [2.0, 0.6]})
    expected = stick_arm(mass=2.0).parameters()
    assert torch.equal(model.body_parameters().inertia, expected.inertia)
    assert not torch.equal(expected.inertia, tree.parameters().inertia)
    said = stick_arm(com=(0.1, 0.0, 0.0), inertia=(0.0, 0.01, 0.01, 0.0, 0.0, 0.0))
    own = ArmModel(said, TIME, parameters={"body.mass": [2.0, 0.6]}).body_parameters()
    assert torch.equal(own.inertia, said.parameters().inertia)
    assert torch.equal(own.com, said.parameters().com)


def test_given_numbers_stay_beside_drawn_ones():
    com = [[0.2, 0.0, 0.0], [0.15, 0.01, 0.0]]
    tree = stick_arm(mass=prior(1.0, 0.1), com=(0.2, prior(0.1, 0.05), 0.0))
    model = ArmModel(tree, TIME, parameters={"body.com": com, "body.gravity": [0.0, 0.0, -1.6]})
    sampled = model.sampled()
    p = sampled.body_parameters()
    assert p.com[1].tolist() == com[1]
    assert p.com[0, [0, 2]].tolist() == [0.2, 0.0]
    assert p.com[0, 1] != 0.0
    assert p.gravity.tolist() == [0.0, 0.0, -1.6]
    assert p.mass[0] != 1.0
    torch.testing.assert_close(p.inertia[0, 1], p.mass[0] * 0.4**2 / 12, rtol=1e-12, atol=0)


def test_many_sticks_at_once():
    tree = stick_arm()
    p = tree.parameters()
    factors = torch.tensor([0.5, 2.0], dtype=F64)
    many = tree.completed(
        p._replace(sites=p.sites * factors[:, None, None, None], mass=p.mass * factors[:, None, None])
    )
    for k, factor in enumerate(factors.tolist()):
        alone = stick_arm(length=0.4 * factor, mass=factor).parameters()
        torch.testing.assert_close(many.position[k, 0], alone.position, rtol=0, atol=1e-15)
        torch.testing.assert_close(many.inertia[k, 0, 0], alone.inertia[0], rtol=0, atol=1e-15)
