"""What motors make of a command, against a simulation of it in a thousand steps a row."""

from itertools import pairwise

import numpy as np
import pytest
import torch
from scipy.integrate import cumulative_trapezoid

from invdyn.diagnosis.problem.unknowns import bounds
from invdyn.models import ArmModel
from invdyn.models.effects import (
    ActuatorDeadzone,
    ActuatorDelay,
    ActuatorGain,
    ActuatorLag,
    ActuatorSaturation,
    ClockRate,
    Command,
)
from invdyn.models.torques import OrnsteinUhlenbeck

F64 = torch.float64
ROWS, FINE = 12, 1000
TIME = 0.01 * np.arange(ROWS) + 0.004 * np.sin(np.arange(ROWS))  # uneven
GIVEN = np.random.default_rng(3).normal(size=(ROWS, 2))


@pytest.fixture
def motors(arm, having):
    def make(effect, **values):
        ideal = ArmModel(arm(2).body, TIME, command=GIVEN)
        return having(ideal, effect, **values).motors

    return make


def held(t):
    """The command at times t, (N,) → (N, 2); the first row's before the first."""
    return GIVEN[np.clip(np.searchsorted(TIME, t, side="right") - 1, 0, ROWS - 1)]


def moments(torque_at):
    """Mean and slope of the straight line with the same impulse and first moment as u(t) in each row but the last."""
    mean, slope = [], []
    for start, stop in pairwise(TIME):
        s = (np.arange(FINE) + 0.5) / FINE
        u = torque_at(start + s * (stop - start))
        mean.append(u.mean(0))
        slope.append(12 * ((s[:, None] - 0.5) * u).mean(0))
    return np.array(mean), np.array(slope)


@pytest.mark.parametrize("delay", [0.0, 0.003, 0.01, 0.0271])
def test_a_delay_is_the_command_later(delay, motors):
    found = motors(ActuatorDelay("joint1"), delay=delay)
    mean, slope = moments(lambda t: np.stack([held(t)[:, 0], held(t - delay)[:, 1]], -1))
    assert found.mean[:-1].numpy() == pytest.approx(mean, abs=5e-3)
    assert found.slope[:-1].numpy() == pytest.approx(slope, abs=2e-2)
    assert found.mean[:, 0].numpy() == pytest.approx(GIVEN[:, 0], abs=1e-12)
    alike = motors(ActuatorDelay(), delay=delay)
    torch.testing.assert_close(alike.mean[:, 1], found.mean[:, 1])
    assert (alike.mean[:, 0] != found.mean[:, 0]).any() == (delay > 0)


@pytest.mark.parametrize("rate", [1.0, 1.25, 0.9])
def test_another_clock_than_the_frames_has_the_command_at_true_time(rate, motors):
    """Rows last 1 / rate as long as they say, and begin as much earlier or later as they have come from the first."""
    found = motors(ClockRate("frames"), rate=rate)
    mean, slope = moments(lambda t: held(TIME[0] + (t - TIME[0]) / rate))
    assert found.mean[:-1].numpy() == pytest.approx(mean, abs=5e-3)
    assert found.slope[:-1].numpy() == pytest.approx(slope, abs=2e-2)
    torch.testing.assert_close(motors(ClockRate(), rate=rate).mean, torch.as_tensor(GIVEN))


@pytest.mark.parametrize("constant", [1e-5, 0.004, 0.03])
def test_a_lag_solves_its_equation(constant, motors):
    """By the convolution with e^{−t/T}/T, on a grid that is fine beside T and the rows."""
    found = motors(ActuatorLag(), time_constant=constant)
    t = np.linspace(TIME[0], TIME[-1], 110 * FINE + 1)
    u = held(t)
    growth = np.exp((t - t[0]) / max(constant, 0.001))[:, None]  # a lag of 10 µs has settled at once
    if constant < 0.001:
        filtered = u
    else:
        filtered = (u[0] + cumulative_trapezoid(u * growth / constant, t, axis=0, initial=0.0)) / growth
    mean, slope = moments(lambda at: np.stack([np.interp(at, t, column) for column in filtered.T], -1))
    assert found.mean[:-1].numpy() == pytest.approx(mean, abs=6e-3)
    assert found.slope[:-1].numpy() == pytest.approx(slope, abs=3e-2)


def test_a_lag_on_a_step_has_settled_by_two_thirds_after_one_time_constant():
    time = torch.arange(200, dtype=F64) * 1e-3
    step = (time >= 0.05).double().unsqueeze(-1)
    lagged = Command.held(time, step).lagged(torch.tensor([0.02], dtype=F64))
    assert (lagged.mean + lagged.slope / 2)[69, 0].item() == pytest.approx(1 - np.exp(-1), abs=1e-4)


def test_gain_saturation_and_deadzone_of_each_row(motors):
    first = np.arange(2) == 0
    for effect, values, expected in (
        (ActuatorGain("joint0"), {"gain": 0.2}, np.where(first, 1.2 * GIVEN, GIVEN)),
        (ActuatorGain(), {"gain": -0.1}, 0.9 * GIVEN),
        (ActuatorGain("joint0", "geared"), {"gain": 49.0}, np.where(first, 50.0 * GIVEN, GIVEN)),
        (ActuatorGain("geared"), {"gain": 9.0}, 10.0 * GIVEN),
        (ActuatorSaturation("joint0"), {"limit": 0.5}, np.where(first, np.clip(GIVEN, -0.5, 0.5), GIVEN)),
        (ActuatorDeadzone("joint0"), {"width": 0.3}, np.where(first, GIVEN - np.clip(GIVEN, -0.3, 0.3), GIVEN)),
    ):
        found = motors(effect, **values)
        assert found.mean.numpy() == pytest.approx(expected)
        assert found.slope.abs().max().item() == 0.0


def test_one_after_the_other(arm):
    """A gain after a lag keeps the lagged line's slope."""
    model = arm(2).with_effects(ActuatorLag("joint0"), ActuatorGain("joint0"))
    values = {"actuator_lag.joint0.time_constant": 0.02, "actuator_gain.joint0.gain": 0.5}
    model = model.replace(**{f"effect.{key}": torch.tensor([value], dtype=F64) for key, value in values.items()})
    lag = arm(2).with_effects(ActuatorLag("joint0"))
    lag = lag.replace(**{"effect.actuator_lag.joint0.time_constant": torch.tensor([0.02], dtype=F64)})
    torch.testing.assert_close(model.motors.mean[:, 0], 1.5 * lag.motors.mean[:, 0])
    torch.testing.assert_close(model.motors.slope[:, 0], 1.5 * lag.motors.slope[:, 0])


CHAIN = (
    ActuatorDeadzone("joint0"),
    ActuatorLag("joint0"),
    ActuatorSaturation("joint0"),
    ActuatorGain("joint0"),
    ActuatorDelay("joint0"),
)
VALUES = {
    "actuator_deadzone.joint0.width": 0.2,
    "actuator_lag.joint0.time_constant": 0.004,
    "actuator_saturation.joint0.limit": 0.6,
    "actuator_gain.joint0.gain": 0.3,
    "actuator_delay.joint0.delay": 0.003,
}


@pytest.mark.parametrize("backwards", [False, True])
def test_motors_are_a_chain_in_any_order_of_arguments(backwards, arm):
    """A limit cuts a lag's exponential within the row, which a row's straight line does not show."""
    model = ArmModel(arm(2).body, TIME, command=GIVEN).with_effects(*CHAIN[:: -1 if backwards else 1])
    sets = {key: torch.tensor([value, 0.5 * value], dtype=F64).reshape(2, 1, 1) for key, value in VALUES.items()}
    both = model.replace(**{f"effect.{key}": value for key, value in sets.items()}).motors
    for row, share in enumerate((1.0, 0.5)):
        width, constant, limit, gain, delay = (share * value for value in VALUES.values())
        t = np.linspace(TIME[0], TIME[-1], 110 * FINE + 1)
        u = held(t)[:, 0]
        u = u - np.clip(u, -width, width)
        lagged, decay = [u[0]], np.exp(-(t[1] - t[0]) / constant)
        for now in u[:-1]:
            lagged.append(now + (lagged[-1] - now) * decay)
        made = (1 + gain) * np.clip(lagged, -limit, limit)
        mean, slope = moments(lambda at, made=made, delay=delay, t=t: np.interp(at - delay, t, made)[:, None])
        # Of a limit's corner within an eighth of a row a line is left.
        assert both.mean[row, :-1, 0].numpy() == pytest.approx(mean[:, 0], abs=5e-3)
        assert both.slope[row, :-1, 0].numpy() == pytest.approx(slope[:, 0], abs=3e-2)
    assert both.mean[:, :, 1].numpy() == pytest.approx(np.stack([GIVEN[:, 1]] * 2))


def test_rows_that_are_split_are_the_same_lines():
    command = Command.held(torch.as_tensor(TIME), torch.as_tensor(GIVEN)).lagged(torch.tensor([0.004, 0.02]).double())
    finer = command.split(5)
    again = finer.onto(command.time)
    torch.testing.assert_close(again.mean, command.mean)
    torch.testing.assert_close(again.slope, command.slope)
    edges = finer.mean[4::5] + finer.slope[4::5] / 2
    torch.testing.assert_close(edges, command.mean + command.slope / 2)


@pytest.mark.parametrize(("effect", "name"), [(ActuatorDelay("joint1"), "delay"), (ActuatorLag(), "time_constant")])
def test_commands_before_a_recording_act_on(effect, name, arm, having):
    """Its sd stays while a dead time lasts, and falls with a lag's time constant; at each recording's beginning.

    The variance of an Ornstein–Uhlenbeck torque, step by step, against its closed form.
    """
    late, decay, step, sd = 0.055, 2000.0, 0.01, torch.tensor([0.4, 0.7], dtype=F64)
    torque = OrnsteinUhlenbeck(decay=decay, underway=True)
    model = having(arm(2, rows=40, step=step, torque=torque), effect, **{name: late})
    model = model.replace(**{"torque.initial_scale": sd, "torque.scale": 0.0 * sd})
    model = model.restarted_at([20], torch.zeros(1, 2, dtype=F64))
    keep, variance, found = np.exp(-2 * decay * step), sd**2, []
    for t in range(1, 40):
        variance = sd**2 if t == 20 else keep * variance + model.late(t) ** 2
        found.append(variance.sqrt().numpy())
        at_once = model.transition(torch.zeros(6, dtype=F64), t).base_dist.scale[:2]
        torch.testing.assert_close(at_once, sd if t == 20 else model.late(t))
    torch.testing.assert_close(model.late(torch.arange(1, 40))[6], model.late(7))
    # Decay within a row is nearly whole, so that the sd is that of what acts during the row before.
    begun = step * np.r_[np.arange(19), 0, np.arange(19)]
    share = (begun < late) if name == "delay" else np.exp(-begun / late)
    share[19] = 1.0
    expected = share[:, None] * sd.numpy() * ([1, 1] if name == "time_constant" else [0, 1])
    expected[19] = sd
    np.testing.assert_allclose(found, expected, atol=1e-6)
    # A camera that starts later than the commands: what was told before its first row is known.
    told = model.driven_by(model.time[0] - 1.0 + step * torch.arange(140), torch.zeros(140, 2, dtype=F64))
    told = told.restarted_at([20], torch.zeros(1, 2, dtype=F64))
    assert told.late(torch.arange(1, 20)).abs().max() < 1e-6
    torch.testing.assert_close(told.late(torch.arange(21, 40)), model.late(torch.arange(21, 40)))
    knows = having(arm(2), effect, **{name: late})
    assert knows.late(3) is None
    assert arm(2, torque=torque).late(3) is None


def test_the_grid_of_a_limit_follows_the_command(arm):
    model = arm(2)
    (limit,) = ActuatorSaturation("joint1").bound(model.body).parameters(model.scale)
    sizes = model.command[:, 1].abs()
    assert all(sizes.min() <= value <= sizes.max() for value in limit.grid)


def test_one_joint_needs_no_actuator_of_all(arm):
    one, two = ([effect.where for effect in ActuatorLag.everywhere(arm(n).body, ())] for n in (1, 2))
    assert one == [("joint0",)]
    assert two == [(), ("joint0",), ("joint1",)]


def test_a_gear_that_was_left_out_is_a_form_of_gain_everywhere(arm):
    body = arm(2).body
    found = [effect.bound(body) for effect in ActuatorGain.everywhere(body, ()) if effect.form]
    assert [effect.key for effect in found] == [
        "actuator_gain.geared",
        "actuator_gain.joint0.geared",
        "actuator_gain.joint1.geared",
    ]
    assert [effect.place for effect in found] == [(), (0,), (1,)]
    (gain,) = found[1].parameters(arm(2).scale)
    assert (bounds(gain)[0], bounds(gain)[1]) == (1.0, 120.0)
    with pytest.raises(ValueError, match="expected 1 name"):
        ActuatorLag("joint0", "joint1")
