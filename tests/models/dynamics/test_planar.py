"""Forward dynamics of planar chains as machine code: torch's bits, gradients where they are asked for, copies."""

import math
import pickle

import pytest
import torch

from invdyn.models.bodies.planar import BodyParameters
from invdyn.models.dynamics.planar import PlanarDynamics, planar_dynamics
from invdyn.models.dynamics.symbolic import SymbolicDynamics

pytest.importorskip("llvmlite")


def body(K, dtype=torch.float64, batch=()):
    """Parameters of a chain, or one for each of a batch."""
    numbers = (0.3 + torch.rand(*batch, K, dtype=dtype) for _ in range(4))
    return BodyParameters(*numbers, torch.tensor([0.3, -9.81], dtype=dtype), torch.zeros(2, dtype=dtype))


def state(K, *batch, dtype=torch.float64):
    return [torch.randn(*batch, K, dtype=dtype) for _ in range(3)]


def both(K):
    """As machine code from the first call, and by torch alone."""
    return PlanarDynamics(K, compile_after=0), PlanarDynamics(K, compile_after=math.inf)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("K", [1, 2, 3, 4])
def test_torchs_bits(K, dtype):
    fast, slow = both(K)
    p, own = body(K, dtype), torch.rand(K, dtype=dtype)
    for given in ((*state(K, 50, dtype=dtype), p), (*state(K, 50, dtype=dtype), p, own), (*state(K, dtype=dtype), p)):
        found, expected = fast.forward(*given), slow.forward(*given)
        assert found.dtype == dtype
        assert torch.equal(found, expected)


def test_each_body_with_particles_of_its_own_and_any_layout():
    fast, slow = both(2)
    p = body(2, batch=(5, 1))
    q, qd, tau = state(2, 5, 10)
    assert torch.equal(fast.forward(q, qd, tau, p), slow.forward(q, qd, tau, p))
    turned = [x.movedim(-1, 0).contiguous().movedim(0, -1) for x in (q, qd, tau)]
    assert torch.equal(fast.forward(*turned, p), slow.forward(q, qd, tau, p))
    assert torch.equal(fast.forward(q[:1], qd[0, 0], tau[0], p), slow.forward(q[:1], qd[0, 0], tau[0], p))
    assert fast.forward(*state(2, 0), body(2)).shape == (0, 2)


@pytest.mark.parametrize("K", [1, 3])
def test_machine_code_is_what_the_symbolic_equations_are(K):
    p, own, given = body(K), torch.rand(K, dtype=torch.float64), state(K, 20)
    expected = SymbolicDynamics(K).forward(*given, p, own)
    torch.testing.assert_close(both(K)[0].forward(*given, p, own), expected, rtol=1e-9, atol=1e-9)


def test_gradients_go_through_torch_and_another_body_is_another():
    fast, slow = both(2)
    q, qd, tau = state(2, 6)
    p, other = body(2), body(2)
    fast.forward(q, qd, tau, p)
    assert torch.equal(fast.forward(q, qd, tau, other), slow.forward(q, qd, tau, other))
    learned = p._replace(mass=p.mass.clone().requires_grad_())
    (slope,) = torch.autograd.grad(fast.forward(q, qd, tau, learned).sum(), learned.mass)
    (expected,) = torch.autograd.grad(slow.forward(q, qd, tau, learned).sum(), learned.mass)
    assert torch.equal(slope, expected)
    assert slope.abs().min() > 0
    with torch.no_grad():
        assert torch.equal(fast.forward(q, qd, tau, learned), fast.forward(q, qd, tau, p))


def test_models_of_a_process_share_one_and_copies_find_it():
    dynamics = planar_dynamics(3)
    assert planar_dynamics(3) is dynamics
    assert pickle.loads(pickle.dumps(dynamics)) is dynamics


@pytest.mark.parametrize("mixed", ["own inertia", "torque", "body"])
def test_mixed_types_are_torchs(mixed):
    """Machine code is of one type: it would read a float32's bytes as a float64's."""
    fast, slow = both(2)
    p, (q, qd, tau), own = body(2), state(2, 20), torch.rand(2, dtype=torch.float64)
    if mixed == "body":
        p = BodyParameters(*(value.float() for value in p))
    tau, own = tau.float() if mixed == "torque" else tau, own.float() if mixed == "own inertia" else own
    found, expected = fast.forward(q, qd, tau, p, own), slow.forward(q, qd, tau, p, own)
    assert found.dtype == expected.dtype == torch.float64
    assert torch.equal(found, expected)
