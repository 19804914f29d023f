"""Friction against closed forms, written out here in numpy."""

import numpy as np
import pytest
import torch
from rod import F64, INERTIA, driven, rod, rolled, torque_of

from invdyn.models.effects import (
    CoulombFriction,
    DriftingFriction,
    LoadFriction,
    QuadraticDrag,
    StribeckFriction,
    ViscousFriction,
)


def test_viscous_friction_decays_exponentially(having):
    _, qd = rolled(having(rod(), ViscousFriction("hinge"), damping=0.2), [0.0], [3.0])
    time = 0.005 * np.arange(101)
    assert qd[:, 0] == pytest.approx(3.0 * np.exp(-0.2 / INERTIA * time), rel=1e-6)


def test_coulomb_friction_stops_a_rod_for_good(having):
    """ω = ω₀ − τ t / I until it stops, at t = I ω₀/τ; half the kinetic energy has then turned to τ θ."""
    q, qd = rolled(having(rod(), CoulombFriction("hinge"), torque=0.5), [0.0], [3.0])
    time = 0.005 * np.arange(101)
    expected = np.maximum(3.0 - 0.5 / INERTIA * time, 0.0)
    assert qd[:, 0] == pytest.approx(expected, abs=1e-9)
    assert q[-1, 0] == pytest.approx(INERTIA * 3.0**2 / 2 / 0.5, rel=1e-9)
    assert abs(qd[-1, 0]) < 1e-6


@pytest.mark.parametrize("step", [0.005, 0.03])
def test_coulomb_friction_holds_what_it_can(step, having):
    """Level, a rod needs m g l/2 = 2.207 N·m: it stays under more friction than that, and falls under less."""
    model = rod(gravity=(0.0, -9.81), step=step)
    q, _ = rolled(having(model, CoulombFriction("hinge"), torque=2.3), [0.0], [0.0])
    assert np.abs(q).max() < 1e-9
    q, _ = rolled(having(model, CoulombFriction("hinge"), torque=2.1), [0.0], [0.0], rows=5)
    fallen = -(1.5 * 9.81 * 0.15 - 2.1) / INERTIA * (4 * step) ** 2 / 2
    assert q[-1, 0] == pytest.approx(fallen, rel=0.02)


def test_friction_holds_two_joints_at_once(arm, having, states):
    ideal = arm(2, command=None)
    model = ideal.with_effects(CoulombFriction("joint0"), CoulombFriction("joint1"))
    names = [f"effect.coulomb_friction.joint{k}.torque" for k in range(2)]
    model = model.replace(**{name: torch.tensor([20.0], dtype=F64) for name in names})
    q, qd = rolled(model, [0.3, 0.4], [0.0, 0.0])
    assert np.abs(q - q[0]).max() < 1e-9
    _, qd = rolled(model, [0.3, 0.4], [0.5, -0.4])
    assert np.abs(qd[-1]).max() < 1e-3


@pytest.mark.parametrize("held", [True, False])
@pytest.mark.parametrize("effects", [[CoulombFriction("joint1")], [StribeckFriction("joint0"), LoadFriction("joint1")]])
def test_the_acceleration_under_friction_is_that_of_the_dynamics(effects, held, arm, states):
    """Sliding, stopping and held alike: θ̈ is what the dynamics give for the torque with the friction in it."""
    model = arm(2).with_effects(*effects)
    given = {"torque": 0.3, "coulomb": 0.2, "static": 0.4, "velocity": 0.5, "coefficient": 0.1}
    levels = {name: given[name.rsplit(".", 1)[1]] for name in model.parameters if name.startswith("effect.")}
    model = model.replace(**{name: torch.tensor([level], dtype=F64) for name, level in levels.items()})
    _, q, qd = model.split(states(model, 200))
    qd = qd * torch.logspace(-5, 0, 200, dtype=F64).unsqueeze(-1)
    body, torque, own = model.body_parameters(), 0.5 * torch.randn(200, 2, dtype=F64), torch.tensor([0.01, 0.02])
    here = model.mechanics.now(driven(model, torque, step=0.01), q, qd, 0.0)
    friction, _, under = model.effects.friction(model.parameters, here, torque, own, held)
    assert ((friction != 0).sum(0) > 100).sum() == len(effects)
    torch.testing.assert_close(under, model.dynamics.forward(q, qd, torque + friction, body, own), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("step", [0.0137, 0.03, 0.1])
def test_a_rod_turns_around_within_a_step(step, having):
    """Thrown against a constant torque it stops at t* and comes back: both parts are parabolas, whatever the step."""
    level, push = 0.3, -1.1
    command = torch.full((int(0.8 / step) + 2, 1), push, dtype=F64)
    model = having(rod(rows=len(command), step=step, command=command), CoulombFriction("hinge"), torque=level)
    q, qd = rolled(model, [0.0], [6.0])
    time = step * np.arange(len(command))
    stop = 6.0 * INERTIA / (level - push)
    exact = np.where(time < stop, 6.0 + (push - level) / INERTIA * time, (push + level) / INERTIA * (time - stop))
    there, back = (push - level) / INERTIA, (push + level) / INERTIA
    place = np.where(time < stop, 6.0 * time + there * time**2 / 2, 3.0 * stop + back * (time - stop) ** 2 / 2)
    assert stop < time[-2]
    assert qd[:, 0] == pytest.approx(exact, abs=1e-9)
    assert q[:, 0] == pytest.approx(place, abs=1e-9)


def test_friction_about_a_stop_follows_its_level():
    """The mean of both signs has the slopes of the exact answer, in the level and in the speed."""
    level = torch.tensor([0.3], dtype=F64, requires_grad=True)
    speed = torch.tensor([0.2], dtype=F64, requires_grad=True)
    command = torch.full((3, 1), -1.1, dtype=F64)
    model = rod(rows=3, step=0.05, command=command).with_effects(CoulombFriction("hinge"))
    model = model.in_substeps(model.substeps, 1)

    def after(level, speed):
        there = model.replace(**{"effect.coulomb_friction.hinge.torque": level})
        return there.transition_mean(torch.cat([torch.zeros(2, dtype=F64), speed]), 1)[-1]

    assert torch.autograd.gradcheck(after, (level, speed))
    assert after(level, speed).item() == pytest.approx(-0.8 / INERTIA * (0.05 - 0.2 * INERTIA / 1.4))


def test_friction_of_two_kinds_adds_up(arm, states):
    ideal = arm(2)
    both = ideal.with_effects(CoulombFriction("joint1"), LoadFriction("joint1"))
    both = both.replace(**{"effect.coulomb_friction.joint1.torque": torch.tensor([0.2], dtype=F64)})
    x = states(ideal, 20)
    x[:, -1] = 4.0 * torch.sign(x[:, -1])
    torch.testing.assert_close(torque_of(both, ideal, x)[:, 1], -0.2 * torch.sign(x[:, -1]))


def test_stribeck_friction(arm, having, states):
    ideal = arm(2)
    model = having(ideal, StribeckFriction("joint0"), coulomb=0.1, static=0.3, velocity=2.0)
    x = states(ideal, 30)
    x[:, -2] = torch.linspace(2.0, 8.0, 30)
    speed = x[:, -2].numpy()
    expected = -(0.1 + 0.2 * np.exp(-((speed / 2.0) ** 2))) * np.sign(speed)
    assert torque_of(model, ideal, x)[:, 0].numpy() == pytest.approx(expected)


def test_load_friction_of_a_level_rod(having):
    """Held up by its motor, u = m g l/2, the gear carries u on one side and the load on the other: 2 u."""
    ideal = rod(gravity=(0.0, -9.81))
    model = having(ideal, LoadFriction("hinge"), coefficient=0.1)
    hold = 1.5 * 9.81 * 0.15
    for speed, motor, load in ((3.0, hold, 2 * hold), (-3.0, hold, 2 * hold), (3.0, 0.0, hold), (3.0, -hold, 0.0)):
        q, qd = torch.zeros(1, dtype=F64), torch.tensor([speed], dtype=F64)
        given = torch.tensor([motor], dtype=F64)
        torque, _ = model.mechanics.with_friction(*model.mechanics.smooth(driven(model, given), q, qd, 0.0))
        assert (torque - given).item() == pytest.approx(-0.1 * load * np.sign(speed), abs=1e-12)


@pytest.mark.parametrize(
    ("kind", "values"),
    [(StribeckFriction, {"coulomb": 0.1, "static": 0.6, "velocity": 4.0}), (LoadFriction, {"coefficient": 0.2})],
)
def test_friction_that_changes_while_it_slides_is_of_second_order(kind, values, having):
    model = having(rod(rows=2, step=0.04, gravity=(0.0, -9.81)), kind("hinge"), **values)
    after = []
    for steps in (4, 8, 256):
        model = model.in_substeps(model.substeps, steps)
        after.append(np.concatenate(rolled(model, [0.5], [6.0]))[[1, 3]])
    coarse, fine = (np.abs(end - after[-1]).max() for end in after[:2])
    assert coarse / fine == pytest.approx(4, rel=0.15)


def test_quadratic_drag(having):
    """ω = ω₀ / (1 + c ω₀ t / I)."""
    _, qd = rolled(having(rod(), QuadraticDrag("hinge"), drag=0.05), [0.0], [-6.0])
    time = 0.005 * np.arange(101)
    assert qd[:, 0] == pytest.approx(-6.0 / (1 + 0.05 * 6.0 / INERTIA * time), rel=1e-6)


def test_drifting_friction(having):
    """Log-speed falls by the integral of the damping; where that would be negative there is none."""
    model = rod()
    time = 0.005 * np.arange(101)
    _, qd = rolled(having(model, DriftingFriction("hinge"), damping=0.05, slope=0.4), [0.0], [3.0])
    assert np.log(qd[:, 0] / 3.0) == pytest.approx(-(0.05 * time + 0.2 * time**2) / INERTIA, rel=1e-5, abs=1e-9)
    _, qd = rolled(having(model, DriftingFriction("hinge"), damping=0.05, slope=-0.4), [0.0], [3.0])
    assert np.ptp(qd[30:]) == 0.0


@pytest.mark.parametrize(("fps", "slow", "fast"), [(30, 6, 12), (100, 2, 4), (200, 1, 2), (400, 1, 1)])
def test_sub_steps_are_as_short_as_the_friction_needs(fps, slow, fast):
    """Under load friction half as long as under Coulomb's, and the shorter ones where both act."""
    model = rod(step=1 / fps)
    coulomb, load = CoulombFriction("hinge"), LoadFriction("hinge")
    assert model.with_effects(coulomb).substeps_taken == max(slow, model.substeps)
    assert model.with_effects(load).substeps_taken == max(fast, model.substeps)
    assert model.with_effects(coulomb, load).substeps_taken == max(fast, model.substeps)
