"""Dynamics in space: derivatives, batches, dtypes, energy, and what programs may leave out."""

import dataclasses
import math
import pickle

import pytest
import torch
from chains import assert_close as close
from trees import F64, mobile_arm, paper_arm, random_state, random_tree

from invdyn.models.bodies.body import Body
from invdyn.models.bodies.joints import Joint
from invdyn.models.bodies.link import Link
from invdyn.models.bodies.scalars import BodyError
from invdyn.models.bodies.tree_parameters import TreeParameters
from invdyn.models.dynamics.interface import jvp
from invdyn.models.dynamics.spatial.dynamics import SpatialDynamics


def learned(p):
    return TreeParameters(*(value.clone().requires_grad_() for value in p))


@pytest.mark.parametrize("method", ["forward", "inverse"])
def test_derivatives_of_motion_and_of_every_number_of_the_body(method):
    tree = random_tree(3, 3)
    dynamics, p = SpatialDynamics(tree), learned(tree.parameters())
    state = [x.requires_grad_() for x in random_state(3, 0)]

    def of(*given):
        return getattr(dynamics, method)(*given[:3], TreeParameters(*given[3:]))

    assert torch.autograd.gradcheck(of, (*state, *p))


def test_derivatives_of_places():
    tree = random_tree(4, 7)
    dynamics, p = SpatialDynamics(tree), learned(tree.parameters())
    q = random_state(4, 0)[0].requires_grad_()
    assert torch.autograd.gradcheck(lambda q, *p: dynamics.keypoints(q, TreeParameters(*p)), (q, *p))
    found = torch.autograd.functional.jacobian(lambda q: dynamics.keypoints(q, p), q)
    close(dynamics.jacobian(q, p).detach(), found, 1e-12)


def test_the_jacobian_of_energy_is_force():
    tree = mobile_arm()
    dynamics, p = SpatialDynamics(tree), tree.parameters()
    q, qd, _ = random_state(tree.num_joints, 1)
    potential = torch.autograd.functional.jacobian(lambda q: dynamics.potential_energy(q, p), q)
    close(dynamics.gravity_load(q, p), potential, 1e-12)
    momentum = torch.autograd.functional.jacobian(lambda qd: dynamics.kinetic_energy(q, qd, p), qd)
    close(dynamics.inertia_matrix(q, p) @ qd, momentum, 1e-12)


def test_response_is_what_a_torque_adds():
    tree = mobile_arm()
    dynamics, p = SpatialDynamics(tree), tree.parameters()
    q, qd, tau = random_state(tree.num_joints, 2)
    own = torch.full((tree.num_joints,), 0.3, dtype=F64)
    for rotors in (None, own):
        added = dynamics.forward(q, qd, tau, p, rotors) - dynamics.forward(q, qd, torch.zeros_like(tau), p, rotors)
        close(dynamics.response(q, tau, p, rotors), added, 1e-10)


def test_numbers_that_the_tree_calls_zero_have_their_derivatives():
    # com, products of inertia and gravity of this arm are mostly 0, and left out of its programs
    tree = paper_arm()
    dynamics, p, (q, qd, tau) = SpatialDynamics(tree), tree.parameters(), random_state(4, 5)
    dynamics.forward(q, qd, tau, p)
    mine = learned(p)
    dynamics.forward(q, qd, tau, mine).sum().backward()
    for name in ("com", "inertia", "gravity", "position"):
        value, slope = getattr(p, name), getattr(mine, name).grad
        step = torch.zeros_like(value)
        step[..., 1] = 1e-6
        up, down = (dynamics.forward(q, qd, tau, p._replace(**{name: value + sign * step})).sum() for sign in (1, -1))
        assert abs(slope[..., 1].sum()) > 1e-3
        torch.testing.assert_close(slope[..., 1].sum(), (up - down) / 2e-6, rtol=1e-6, atol=1e-6)


def test_parameters_that_disagree_with_the_trees_zeros_are_believed():
    plain, state = paper_arm(), random_state(4, 0)
    coms = [(0.4, 0.1, -0.2), (0.3, 0.0, 0.1)]
    links = [dataclasses.replace(link, com=com) for link, com in zip(plain.links, coms, strict=True)]
    crooked = Body("crooked", links, (1.0, 2.0, -9.0))
    dynamics, p = SpatialDynamics(plain), crooked.parameters()
    dynamics.forward(*state, plain.parameters())
    close(dynamics.forward(*state, p), SpatialDynamics(crooked).forward(*state, p), 1e-12)
    close(dynamics.forward(*state, plain.parameters()), SpatialDynamics(plain).forward(*state, plain.parameters()), 0)


def test_many_bodies_with_many_states_each():
    tree = mobile_arm()
    dynamics, p = SpatialDynamics(tree), tree.parameters()
    factors = torch.tensor([0.5, 1.0, 2.0], dtype=F64)
    many = p._replace(mass=p.mass * factors[:, None, None], com=p.com * factors[:, None, None, None])
    q, qd, tau = random_state(tree.num_joints, 3, batch=(3, 7))
    together = dynamics.forward(q, qd, tau, many)
    assert together.shape == (3, 7, tree.num_joints)
    for k, factor in enumerate(factors):
        alone = p._replace(mass=p.mass * factor, com=p.com * factor)
        close(together[k], dynamics.forward(q[k], qd[k], tau[k], alone), 1e-12)


def test_single_precision_stays_and_is_as_good_as_it_can_be():
    tree = mobile_arm()
    dynamics, p = SpatialDynamics(tree), tree.parameters()
    state = random_state(tree.num_joints, 4, batch=(100,))
    single = dynamics.forward(*(x.float() for x in state), tree.parameters(torch.float32))
    assert single.dtype == torch.float32
    close(single.double(), dynamics.forward(*state, p), 1e-4)  # D's condition is a few hundred


def test_energy_is_kept_to_the_order_of_the_integrator():
    tree = mobile_arm()
    dynamics, p, K = SpatialDynamics(tree), tree.parameters(), tree.num_joints
    q, qd, _ = random_state(K, 6)
    rest = torch.zeros_like(q)

    def drift(steps, duration=0.8):
        x, dt = torch.cat([q, qd]), duration / steps

        def rate(x):
            return torch.cat([x[K:], dynamics.forward(x[:K], x[K:], rest, p)])

        def energy(x):
            return dynamics.kinetic_energy(x[:K], x[K:], p) + dynamics.potential_energy(x[:K], p)

        before = energy(x)
        for _ in range(steps):
            k1 = rate(x)
            k2 = rate(x + dt / 2 * k1)
            k3 = rate(x + dt / 2 * k2)
            k4 = rate(x + dt * k3)
            x = x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return abs(energy(x) - before).item()

    ratio = drift(20) / drift(40)
    assert 11 < ratio < 45  # 2⁴ = 16 of the method of Runge and Kutta, 2⁵ where the leading term is even in time


def test_zeros_are_left_out():
    # a scout's program of this arm, its numbers as constants, took 573 operations; SymPy's took 846
    assert SpatialDynamics(paper_arm()).operations("forward") < 300


@pytest.mark.parametrize(
    ("link", "said"),
    [
        (Link("l", Joint("j")), "nothing resists a torque at 'j'"),
        (Link("l", Joint("j"), mass=1.0, com=(0, 0, 0.3)), "nothing resists a torque at 'j'"),
        (Link("l", Joint("j", "slide"), inertia=(1, 1, 1, 0, 0, 0)), "nothing resists a torque at 'j'"),
        (Link("l", Joint("j", "ball"), length=0.3, tip="t", mass=1.0), "nothing resists a torque at 'j_roll'"),
    ],
)
def test_a_coordinate_that_nothing_resists(link, said):
    with pytest.raises(BodyError, match=said) as caught:
        SpatialDynamics(Body("b", [link]))
    assert "\n" not in str(caught.value)
    SpatialDynamics(Body("b", [link]), rotors=True)


def test_a_copy_for_another_process_is_as_good():
    """Whatever was traced and compiled before; copies of one tree share what they trace."""
    tree = paper_arm()
    dynamics, p, state = SpatialDynamics(tree, compile_after=0), tree.parameters(), random_state(4, 3, batch=(9,))
    expected = dynamics.forward(*state, p)
    one, other = (pickle.loads(pickle.dumps(dynamics)) for _ in range(2))
    assert one is other
    assert torch.equal(one.forward(*state, p), expected)


def test_wrong_shapes_are_refused():
    tree = paper_arm()
    q = torch.zeros(3, dtype=F64)
    with pytest.raises(ValueError, match=r"q of shape \(\.\.\., 4\)"):
        SpatialDynamics(tree).keypoints(q, tree.parameters())


@pytest.mark.parametrize("after", [0, math.inf])
@pytest.mark.parametrize("method", ["site_velocities", "site_accelerations"])
def test_motion_of_sites_first_thing_on_a_fresh_instance(method, after):
    if not after:
        pytest.importorskip("llvmlite")
    tree, order = random_tree(6, 1), 2 if method == "site_accelerations" else 1
    dynamics, p, state = SpatialDynamics(tree, compile_after=after), tree.parameters(), random_state(6, 9, batch=(5,))
    with torch.no_grad():
        found = getattr(dynamics, method)(*state[: order + 1], p)
    slow, (q, qd, qdd), step = SpatialDynamics(tree), state, 1e-4
    before, at, after = (slow.keypoints(q + t * qd + t * t / 2 * qdd, p) for t in (-step, 0, step))
    expected = (after - before) / (2 * step) if order == 1 else (after - 2 * at + before) / step**2
    close(found, expected, 1e-4)
    # what was kept within a derivative serves outside it
    close(dynamics.jacobian(q, p), slow.jacobian(q, p), 1e-12)


def test_a_tangent_is_kept_without_gradients():
    pytest.importorskip("llvmlite")
    tree = paper_arm()
    dynamics, p, (q, qd, _) = SpatialDynamics(tree, compile_after=0), tree.parameters(), random_state(4, 9)
    dynamics.keypoints(q, p)
    with torch.no_grad():
        pushed = jvp(lambda q: dynamics.keypoints(q, p), (q,), (qd,))
    close(pushed, SpatialDynamics(tree).site_velocities(q, qd, p), 1e-12)
