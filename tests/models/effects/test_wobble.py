"""Soft tissue that swings on by itself: against a fine integration, and what slow motion leaves of it."""

import numpy as np
import pytest
import torch
from rod import F64, rod
from scipy.integrate import solve_ivp
from variants import nonideal

from invdyn.models import ArmModel, Keypoints, Observation
from invdyn.models.effects import CoulombFriction, LinkFlexibility, SoftTissue
from invdyn.models.effects.hidden import tip_motion

LENGTH = 0.3


def along(model, q, qd, hidden):
    """Hidden states (T, 4) that follow given angles and velocities (T,) of the rod, from ``hidden`` on."""
    (follower,), body = model.effects.followers, model.body_parameters()
    p = {name: model.parameters[f"effect.{follower.key}.{name}"] for name in ("kappa", "damping_ratio")}
    found = [torch.tensor(hidden, dtype=F64)]
    for t in range(1, len(q)):
        ends = [tip_motion(torch.tensor(q[s : s + 1]), torch.tensor(qd[s : s + 1]), body) for s in (t - 1, t)]
        found.append(follower.follow(p, found[-1], *ends, model.dt[t]))
    return torch.stack(found).numpy()


def swinging(time, rate, size=0.6):
    """Angle, velocity and the tip's acceleration (2,) of a sine."""
    q, qd = size * np.sin(rate * time), size * rate * np.cos(rate * time)
    u, across = np.stack([np.cos(q), np.sin(q)]), np.stack([-np.sin(q), np.cos(q)])
    return q, qd, LENGTH * (-(rate**2) * q * across - qd**2 * u)


@pytest.mark.parametrize("ratio", [0.05, 0.5, 0.95])
def test_it_is_a_mass_on_a_spring(ratio, having):
    kappa, hidden = 1.7e-3, [0.004, -0.002, 0.05, 0.1]
    model = having(rod(rows=301), nonideal(SoftTissue("tip")), kappa=kappa, damping_ratio=ratio)
    time = model.time.numpy()

    def rate(t, x):
        a = swinging(t, 12.0)[2]
        return [*x[2:], *(-a - 2 * ratio / kappa**0.5 * x[2:] - x[:2] / kappa)]

    exact = solve_ivp(rate, (0, time[-1]), hidden, t_eval=time, rtol=1e-10, atol=1e-12).y.T
    found = along(model, *swinging(time, 12.0)[:2], hidden)
    assert found[:, :2] == pytest.approx(exact[:, :2], abs=2e-6)
    assert found[:, 2:] == pytest.approx(exact[:, 2:], abs=2e-4)


def test_rows_twice_as_far_apart_err_sixteen_times_as_much(having):
    places = {}
    for step in (0.02, 0.01, 0.002):
        swing = rod(rows=round(1.2 / step) + 1, step=step)
        model = having(swing, nonideal(SoftTissue("tip")), kappa=2e-3, damping_ratio=0.3)
        path = along(model, *swinging(model.time.numpy(), 9.0)[:2], [0.0] * 4)
        places[step] = path[:: round(0.02 / step), :2]
    coarse, fine = (np.abs(places[step] - places[0.002]).max() for step in (0.02, 0.01))
    assert np.log2(coarse / fine) == pytest.approx(4.0, abs=0.3)


def test_slow_motion_leaves_the_lag(having):
    """To first order in how much slower it is."""
    kappa, rate = 1e-4, 5.0
    model = having(rod(rows=401), nonideal(SoftTissue("tip")), kappa=kappa, damping_ratio=0.6)
    time = model.time.numpy()
    q, qd, a = swinging(time, rate)
    found = along(model, q, qd, [0.0] * 4)[100:, :2]
    lag = -kappa * a.T[100:]
    assert np.abs(found - lag).max() < 2 * 0.6 * rate * 2 * kappa**0.5 * np.abs(lag).max()


def test_the_camera_sees_it_and_the_arm_does_not_feel_it(arm, having, states):
    ideal = arm(2)
    model = having(ideal, nonideal(SoftTissue("tip0")), kappa=1e-3, damping_ratio=0.3)
    assert isinstance(model, ArmModel)
    assert model.state_dim == ideal.state_dim + 4
    x = states(model, 6)
    x[:, 2:6] = 0.01 * torch.randn(6, 4, dtype=F64, generator=torch.Generator().manual_seed(1))
    plain = torch.cat([x[:, :2], x[:, 6:]], -1)
    moved = model.transition_mean(x, 5)
    torch.testing.assert_close(torch.cat([moved[:, :2], moved[:, 6:]], -1), ideal.transition_mean(plain, 5))
    seen, true = model.emission(x, 5).mean, ideal.emission(plain, 5).mean
    torch.testing.assert_close(seen[:, :2] - true[:, :2], x[:, 2:4])
    torch.testing.assert_close(seen[:, 2:], true[:, 2:])


@pytest.mark.quick("0")
@pytest.mark.parametrize("tip", [0, 1])
def test_tissue_on_a_link_that_bends_is_thrown_by_the_bending_too(tip, arm, having):
    """δ = −κ p̈ where it swings fast, p what a bending arm's tip does; and the arm moves as without it."""
    step, rows, kappa, bends = 5e-4, 181, 1e-6, LinkFlexibility("link0")
    body = arm(2).body
    command = np.stack([0.5 * np.sin(9 * step * np.arange(rows)), np.zeros(rows)], -1)
    plain = ArmModel(body, step * np.arange(rows), Observation(Keypoints([0, 1])), command=command)
    bending = having(plain, bends, stiffness=8.0, damping=0.0)
    both = having(bending, nonideal(SoftTissue(f"tip{tip}")), kappa=kappa, damping_ratio=0.7)
    x, y = torch.zeros(bending.state_dim, dtype=F64), torch.zeros(both.state_dim, dtype=F64)
    tips, straight, swung = [], [], []
    for t in range(rows):
        if t:
            x, y = bending.transition_mean(x, t), both.transition_mean(y, t)
        tips.append(bending.emission(x, t).mean[2 * tip : 2 * tip + 2])
        straight.append(plain.dynamics.keypoints(x[4:6], plain.body_parameters())[tip])
        swung.append(y[4:8])
    torch.testing.assert_close(torch.cat([y[:4], y[8:]]), x)
    thrown, rigid = (-kappa * np.diff(torch.stack(p).numpy(), 2, axis=0)[60:] / step**2 for p in (tips, straight))
    found = torch.stack(swung).numpy()[61:-1, :2]
    assert np.abs(found - thrown).max() < 0.1 * np.abs(thrown).max()
    assert np.abs(found - rigid).max() > 0.5 * np.abs(thrown).max()


def test_it_goes_with_dry_friction_and_other_tissue_through_bristles_too(arm):
    wobbles = [nonideal(SoftTissue(tip)) for tip in ("tip1", "tip0")]
    assert arm(2).with_effects(wobbles[0], CoulombFriction("joint0")).state_dim == 10
    bristles = nonideal(nonideal(CoulombFriction("joint0")))
    model = arm(2).with_effects(*wobbles, bristles)
    assert model.state_dim == 15
    assert [(each.key, each.states) for each in model.effects.hidden] == [
        ("coulomb_friction.joint0", 1),
        ("soft_tissue.tip0", 4),
        ("soft_tissue.tip1", 4),
    ]
    assert nonideal(SoftTissue("tip0", "sliding")) is None
