import math

import numpy as np
import pytest
import torch

from invdyn.models.bodies.body import planar_body
from invdyn.models.bodies.link import Link
from invdyn.models.dynamics.integrators import INTEGRATORS, euler, rk4, semi_implicit
from invdyn.models.dynamics.planar import planar_dynamics

F64 = torch.float64
ORDER = {"euler": 1, "semi_implicit": 1, "rk4": 4}
EVERY = pytest.mark.parametrize("name", INTEGRATORS)


class FreeSwing:
    """A chain of K links that falls from rest, without torque, over `seconds`."""

    def __init__(self, K):
        links = [Link(f"link{k}", f"joint{k}", f"tip{k}", length=0.4, mass=1.0 + 0.3 * k) for k in range(K)]
        self.p = planar_body("swing", links).parameters()
        self.dynamics = planar_dynamics(K)
        # away from the vertical by half a radian, and each joint bent a little
        self.start = torch.linspace(-1.0, 0.2, K, dtype=F64), torch.zeros(K, dtype=F64)

    def acceleration(self, q, qd, _):
        return self.dynamics.forward(q, qd, torch.zeros_like(q), self.p)

    def energy(self, q, qd):
        return self.dynamics.kinetic_energy(q, qd, self.p) + self.dynamics.potential_energy(q, self.p)

    def run(self, name, steps, seconds, substeps=1):
        """Return the last state and the energies (steps + 1,)."""
        q, qd = self.start
        states = [(q, qd)]
        for _ in range(steps):
            states.append(INTEGRATORS[name](self.acceleration, *states[-1], seconds / steps, substeps))
        return torch.cat(states[-1]), self.energy(*map(torch.stack, zip(*states, strict=True))).numpy()


@pytest.fixture(scope="module", params=[1, 2, 3])
def swing(request):
    chain = FreeSwing(request.param)
    chain.exact = chain.run("rk4", 320, 0.2)[0]
    return chain


def slope(steps, errors):
    return -np.polyfit(np.log(steps), np.log(errors), 1)[0]


@pytest.mark.quick("1-*", "2-rk4", "2-semi_implicit")
@EVERY
def test_errors_of_state_and_energy_fall_at_the_integrators_order(swing, name):
    steps = [80, 160, 320] if ORDER[name] == 1 else [20, 40, 80]
    states, energies = [], []
    for n in steps:
        state, energy = swing.run(name, n, 0.2)
        states.append((state - swing.exact).norm().item())
        energies.append(abs(energy - energy[0]).max())
    assert slope(steps, states) == pytest.approx(ORDER[name], rel=0.1)
    assert slope(steps, energies) == pytest.approx(ORDER[name], rel=0.1)


def test_energy_over_many_swings():
    pendulum = FreeSwing(1)
    drift = {}
    for name in INTEGRATORS:
        _, energy = pendulum.run(name, 1500, 30.0)
        error = abs(energy - energy[0])
        drift[name] = error[:150].max(), error[-150:].max()
    assert drift["euler"][1] > 3 * drift["euler"][0]
    # symplectic: no worse after twenty swings than in the first
    assert drift["semi_implicit"][1] == pytest.approx(drift["semi_implicit"][0], rel=0.05)
    assert drift["rk4"][1] < 1e-3 * drift["semi_implicit"][1]


@EVERY
def test_substeps_are_smaller_steps(name):
    chain = FreeSwing(2)
    few, _ = chain.run(name, 10, 0.3, substeps=4)
    many, _ = chain.run(name, 40, 0.3)
    torch.testing.assert_close(few, many, rtol=1e-12, atol=1e-12)


def test_euler_takes_both_derivatives_at_the_old_state():
    q, qd = torch.tensor([1.0], dtype=F64), torch.tensor([2.0], dtype=F64)
    q1, qd1 = euler(lambda q, qd, s: -3 * q, q, qd, 0.1)
    torch.testing.assert_close(q1, torch.tensor([1.2], dtype=F64))
    torch.testing.assert_close(qd1, torch.tensor([1.7], dtype=F64))


def test_semi_implicit_moves_with_the_new_velocity():
    q, qd = torch.tensor([1.0], dtype=F64), torch.tensor([2.0], dtype=F64)
    q1, qd1 = semi_implicit(lambda q, qd, s: -3 * q, q, qd, 0.1)
    torch.testing.assert_close(qd1, torch.tensor([1.7], dtype=F64))
    torch.testing.assert_close(q1, torch.tensor([1.17], dtype=F64))


@pytest.mark.parametrize("substeps", [1, 3])
def test_the_fraction_runs_over_the_whole_step(substeps):
    zero, dt = torch.zeros(1, dtype=F64), 0.4
    # θ̈ = 6 s + 12 s², with s = t/dt: rk4 integrates velocities of degree 3, and so angles, exactly
    q, qd = rk4(lambda q, qd, s: zero + 6 * s + 12 * s**2, zero, zero, dt, substeps)
    torch.testing.assert_close(qd, zero + (3 + 4) * dt)
    if substeps == 1:
        torch.testing.assert_close(q, zero + (1 + 1) * dt**2, rtol=1e-12, atol=0)
    seen = []
    for name in ("euler", "semi_implicit"):
        INTEGRATORS[name](lambda q, qd, s: seen.append(s) or zero, zero, zero, dt, substeps)
    assert seen == [i / substeps for i in range(substeps)] * 2


@EVERY
def test_each_row_may_have_its_own_step(name):
    def spring(q, qd, _):
        return -4 * q

    rng = torch.Generator().manual_seed(0)
    q, qd = torch.randn(2, 3, 2, generator=rng, dtype=F64)
    dt = torch.tensor([[0.1], [0.02], [0.3]], dtype=F64)
    together = INTEGRATORS[name](spring, q, qd, dt, 2)
    for row in range(3):
        alone = INTEGRATORS[name](spring, q[row], qd[row], dt[row].item(), 2)
        torch.testing.assert_close(together[0][row], alone[0], rtol=1e-14, atol=1e-14)
        torch.testing.assert_close(together[1][row], alone[1], rtol=1e-14, atol=1e-14)


@EVERY
def test_steps_are_differentiable_and_keep_float32(name):
    chain = FreeSwing(2)
    tau = torch.tensor([0.3, -0.2], dtype=F64, requires_grad=True)
    q, qd = (x.clone().requires_grad_() for x in chain.start)
    dt = torch.tensor(0.05, dtype=F64, requires_grad=True)

    def step(q, qd, tau, dt):
        def acceleration(q, qd, s):
            return chain.dynamics.forward(q, qd, tau * (1 + s), chain.p)

        return INTEGRATORS[name](acceleration, q, qd, dt, 2)

    assert torch.autograd.gradcheck(step, (q, qd, tau, dt))
    chain.p = chain.p.to(torch.float32)
    result = step(*(x.detach().to(torch.float32) for x in (q, qd, tau, dt)))
    assert all(x.dtype == torch.float32 for x in result)


@EVERY
@pytest.mark.parametrize("substeps", [0, -1, 1.5, None])
def test_substeps_are_a_whole_number(name, substeps):
    zero = torch.zeros(1)
    with pytest.raises(ValueError, match="substeps must be a whole number"):
        INTEGRATORS[name](lambda q, qd, s: zero, zero, zero, 0.1, substeps)


def test_a_frame_of_30_a_second_is_far_too_coarse_for_euler_but_not_for_rk4():
    chain = FreeSwing(2)
    exact = chain.run("rk4", 300, 0.5)[0]
    error = {name: (chain.run(name, 15, 0.5)[0] - exact)[:2].abs().max().item() for name in INTEGRATORS}
    assert error["euler"] > math.radians(5)
    assert error["rk4"] < math.radians(0.05)
