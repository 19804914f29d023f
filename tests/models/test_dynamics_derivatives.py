"""Precision and derivatives of the dynamics."""

import pytest
import torch
from chains import BOTH, F64, JOINTS, METHODS, assert_close, call, random_case

from invdyn.models.bodies.planar import BodyParameters


@JOINTS
@BOTH
@pytest.mark.parametrize("method", METHODS)
def test_float32_stays_float32_and_is_right_to_its_precision(kind, K, method):
    dynamics = kind(K)
    p, q, qd, tau = random_case(K, 11, (50,), dtype=torch.float32)
    state = {"q": q, "qd": qd, "tau": tau}
    exact = call(dynamics, method, {name: value.double() for name, value in state.items()}, p.to(F64))
    result = call(dynamics, method, state, p)
    assert result.dtype == torch.float32
    # rounding of relative size ε, magnified in θ̈ by the condition of D
    bound = 30 * torch.finfo(torch.float32).eps
    if method in ("forward", "response"):
        bound *= torch.linalg.cond(dynamics.inertia_matrix(q.double(), p.to(F64))).max().item()
    assert_close(result, exact, bound, least_scale=1.0)


def gradient_inputs(K, seed):
    p, q, qd, tau = random_case(K, seed, batch=(2,))
    return [x.detach().requires_grad_() for x in (q, qd, tau, *p)]


@JOINTS
@BOTH
def test_gradcheck_in_state_torque_and_every_body_parameter(kind, K):
    dynamics, inputs = kind(K), gradient_inputs(K, 12)
    for method in METHODS:

        def function(q, qd, tau, *p, method=method):
            return call(dynamics, method, {"q": q, "qd": qd, "tau": tau}, BodyParameters(*p))

        assert torch.autograd.gradcheck(function, inputs)


@pytest.mark.parametrize("K", [1, 2, 3])
@BOTH
def test_second_derivatives_of_forward(kind, K):
    dynamics, inputs = kind(K), gradient_inputs(K, 13)

    def function(q, qd, tau, *p):
        return dynamics.forward(q, qd, tau, BodyParameters(*p))

    assert torch.autograd.gradgradcheck(function, inputs)


@BOTH
def test_vmap_and_jacrev_work(kind):
    dynamics = kind(3)
    p, q, qd, tau = random_case(3, 14, (4,))

    def forward(q, qd, tau):
        return dynamics.forward(q, qd, tau, p)

    mapped = torch.func.vmap(forward)(q, qd, tau)
    jacobian = torch.func.vmap(torch.func.jacrev(forward, argnums=2))(q, qd, tau)
    torch.testing.assert_close(mapped, forward(q, qd, tau))
    # ∂θ̈/∂τ = D⁻¹
    torch.testing.assert_close(jacobian, torch.linalg.inv(dynamics.inertia_matrix(q, p)), rtol=1e-8, atol=1e-8)
