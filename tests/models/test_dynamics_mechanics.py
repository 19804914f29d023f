"""What mechanics says of every chain: energies, powers, and limbs at rest."""

import math

import torch
from chains import F64, random_case
from hypothesis import given, settings
from hypothesis import strategies as st

from invdyn.models.bodies.planar import BodyParameters
from invdyn.models.dynamics.planar import planar_dynamics

cases = given(K=st.integers(1, 4), seed=st.integers(0, 10**6))


@cases
@settings(max_examples=40)
def test_inertia_is_symmetric_positive_definite_and_gives_the_kinetic_energy(K, seed):
    p, q, qd, _ = random_case(K, seed)
    dynamics = planar_dynamics(K)
    D = dynamics.inertia_matrix(q, p)
    assert torch.equal(D, D.T)
    assert torch.linalg.eigvalsh(D).min() > 0
    torch.testing.assert_close(dynamics.kinetic_energy(q, qd, p), qd @ D @ qd / 2, rtol=1e-9, atol=1e-12)


@cases
@settings(max_examples=40)
def test_coriolis_torque_is_quadratic_in_velocity_and_does_not_depend_on_gravity(K, seed):
    p, q, qd, _ = random_case(K, seed)
    dynamics = planar_dynamics(K)
    h = dynamics.coriolis(q, qd, p)
    torch.testing.assert_close(dynamics.coriolis(q, -2.5 * qd, p), 6.25 * h, rtol=1e-9, atol=1e-9)
    assert torch.equal(dynamics.coriolis(q, torch.zeros_like(qd), p), torch.zeros_like(h))
    assert torch.equal(dynamics.coriolis(q, qd, p._replace(gravity=-p.gravity)), h)


@cases
@settings(max_examples=40)
def test_forward_undoes_inverse(K, seed):
    p, q, qd, qdd = random_case(K, seed)
    dynamics = planar_dynamics(K)
    back = dynamics.forward(q, qd, dynamics.inverse(q, qd, qdd, p), p)
    condition = torch.linalg.cond(dynamics.inertia_matrix(q, p)).item()
    assert (back - qdd).abs().max() < 1e-13 * condition * 100


@cases
@settings(max_examples=40)
def test_gravity_load_is_the_gradient_of_potential_energy(K, seed):
    p, q, _, _ = random_case(K, seed)
    dynamics = planar_dynamics(K)
    gradient = torch.func.grad(lambda q: dynamics.potential_energy(q, p))(q)
    torch.testing.assert_close(dynamics.gravity_load(q, p), gradient, rtol=1e-9, atol=1e-9)


@cases
@settings(max_examples=40)
def test_power_of_the_torques_is_the_rate_of_energy(K, seed):
    p, q, qd, tau = random_case(K, seed)
    dynamics = planar_dynamics(K)
    qdd = dynamics.forward(q, qd, tau, p)
    state = q.clone().requires_grad_(), qd.clone().requires_grad_()
    energy = dynamics.kinetic_energy(*state, p) + dynamics.potential_energy(state[0], p)
    by_angle, by_velocity = torch.autograd.grad(energy, state)
    rate = by_angle @ qd + by_velocity @ qdd
    scale = (tau.abs() * qd.abs()).sum() + dynamics.kinetic_energy(q, qd, p)
    assert abs(rate - dynamics.power(qd, tau).sum()) < 1e-11 * scale * 100


def test_keypoints_are_denavit_hartenberg():
    p = BodyParameters(
        *(torch.tensor(x) for x in ([2.0, 1.0], [1.0, 1.0], [1.0, 0.5], [0.1, 0.1], [0.0, 0.0], [3.0, 4.0]))
    )
    tips = planar_dynamics(2).keypoints(torch.tensor([0.0, math.pi / 2]), p)  # counter-clockwise is positive
    torch.testing.assert_close(tips, torch.tensor([[5.0, 4.0], [5.0, 5.0]]))


def test_a_hanging_limb_is_at_rest_and_swings_back():
    p = random_case(2, 15)[0]._replace(gravity=torch.tensor([0.0, -9.81], dtype=F64))
    p = p._replace(com=p.com.abs())
    hanging, still = torch.tensor([-math.pi / 2, 0.0], dtype=F64), torch.zeros(2, dtype=F64)
    dynamics = planar_dynamics(2)
    assert dynamics.gravity_load(hanging, p).abs().max() < 1e-14 * 100
    pushed = hanging + torch.tensor([0.1, 0.0], dtype=F64)
    assert dynamics.forward(pushed, still, still, p)[0] < 0
