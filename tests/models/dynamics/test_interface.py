"""The two implementations of the dynamics against one another, for every way to batch, and what they refuse."""

import pytest
import torch
from chains import BOTH, JOINTS, METHODS, call, random_case

from invdyn.models.bodies.body import planar_body
from invdyn.models.bodies.link import Link
from invdyn.models.bodies.planar import BodyParameters
from invdyn.models.dynamics.planar import PlanarDynamics, planar_dynamics
from invdyn.models.dynamics.registry import dynamics_for
from invdyn.models.dynamics.symbolic import SymbolicDynamics


@JOINTS
@pytest.mark.parametrize("method", METHODS)
def test_traced_and_symbolic_agree_for_every_way_to_batch(K, method):
    traced, symbolic = planar_dynamics(K), SymbolicDynamics(K)
    for batch, body_batch in [
        ((), ()),
        ((7,), ()),
        ((), (3,)),
        ((3, 7), (3, 1)),
        ((2, 1, 7), (3, 1)),
        ((0,), ()),
    ]:
        p, q, qd, tau = random_case(K, 5, batch, body_batch)
        state = {"q": q, "qd": qd, "tau": tau}
        ours, theirs = call(traced, method, state, p), call(symbolic, method, state, p)
        full = torch.broadcast_shapes(batch, body_batch)
        tail = {"inertia_matrix": (K, K), "keypoints": (K, 2), "kinetic_energy": (), "potential_energy": ()}
        assert ours.shape == theirs.shape == (*full, *tail.get(method, (K,)))
        torch.testing.assert_close(ours, theirs, rtol=1e-10, atol=1e-10)


@JOINTS
@BOTH
def test_a_response_is_what_a_torque_adds_to_the_acceleration(K, kind):
    dynamics = kind(K)
    p, q, qd, tau = random_case(K, 8, (5,), ())
    for own in (None, torch.linspace(0.1, 0.4, K, dtype=q.dtype)):
        without = dynamics.forward(q, qd, torch.zeros_like(tau), p, own)
        added = dynamics.forward(q, qd, tau, p, own) - without
        torch.testing.assert_close(dynamics.response(q, tau, p, own), added, rtol=1e-9, atol=1e-9)
        assert dynamics.response(q, tau[0], p, own).shape == (5, K)


@BOTH
def test_a_learned_body_is_differentiated_each_time_it_is_asked(kind):
    """Whether it was asked without gradients before or with them."""
    dynamics = kind(2)
    p, q, qd, tau = random_case(2, 9, (5,), ())
    mass = p.mass.clone().requires_grad_()
    learned = p._replace(mass=mass)
    with torch.no_grad():
        dynamics.forward(q, qd, tau, learned)
    first, second = (torch.autograd.grad(dynamics.forward(q, qd, tau, learned).sum(), mass)[0] for _ in range(2))
    assert (first != 0).all()
    torch.testing.assert_close(first, second, rtol=0, atol=0)


@BOTH
def test_joint_quantities_of_different_batch_shapes_broadcast(kind):
    dynamics = kind(2)
    p, q, qd, tau = random_case(2, 6, (3, 5), (3, 1))
    mixed = dynamics.forward(q[:, :1], qd[0], tau[0, 0], p)
    full = dynamics.forward(*torch.broadcast_tensors(q[:, :1], qd[0], tau[0, 0]), p)
    assert mixed.shape == (3, 5, 2)
    torch.testing.assert_close(mixed, full, rtol=1e-12, atol=1e-12)


def test_a_batch_of_bodies_is_each_body_by_itself():
    dynamics = planar_dynamics(3)
    p, q, qd, tau = random_case(3, 7, (4, 6), (4, 1))
    together = dynamics.forward(q, qd, tau, p)
    for m in range(4):
        alone = dynamics.forward(q[m], qd[m], tau[m], BodyParameters(*(value[m, 0] for value in p)))
        torch.testing.assert_close(together[m], alone, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("K", [5, 9])
def test_long_chains_invert(K):
    dynamics = planar_dynamics(K)
    p, q, qd, tau = random_case(K, 8, (6,))
    torch.testing.assert_close(dynamics.inverse(q, qd, dynamics.forward(q, qd, tau, p), p), tau, rtol=1e-8, atol=1e-8)
    D, load = dynamics.inertia_matrix(q, p), dynamics.coriolis(q, qd, p) + dynamics.gravity_load(q, p)
    expected = torch.linalg.solve(D, tau - load)
    torch.testing.assert_close(dynamics.forward(q, qd, tau, p), expected, rtol=1e-8, atol=1e-8)


def test_the_choice():
    arm = planar_body("arm", [Link("upper", "shoulder", "elbow", 0.3, 1.0)])
    assert dynamics_for(arm) is planar_dynamics(1)
    assert isinstance(dynamics_for(arm, "symbolic"), SymbolicDynamics)
    with pytest.raises(ValueError, match="expected dynamics among traced, symbolic, got 'fast'"):
        dynamics_for(arm, "fast")
    for wrong in (0, -1, 2.5, "two"):
        with pytest.raises(ValueError, match="joints"):
            PlanarDynamics(wrong)
    with pytest.raises(ValueError, match="expected 1 to 4 joints"):
        SymbolicDynamics(5)


@BOTH
def test_a_state_of_another_number_of_joints_is_refused(kind):
    p, q, _, tau = random_case(2, 9)
    with pytest.raises(ValueError, match=r"expected qd of shape \(\.\.\., 2\).*got \(3,\)"):
        kind(2).forward(q, torch.zeros(3), tau, p)
    with pytest.raises(ValueError, match=r"expected q of shape \(\.\.\., 3\)"):
        kind(3).keypoints(q, p)
    with pytest.raises(ValueError, match="got"):
        kind(2).inertia_matrix(torch.tensor(1.0), p)
