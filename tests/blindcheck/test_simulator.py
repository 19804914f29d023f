"""Reality without effects is invdyn's own ideal body, by another engine."""

import sys
from dataclasses import replace

import numpy as np
import pytest
import torch

from invdyn.blindcheck.effects import EFFECTS as INJECTED
from invdyn.blindcheck.motion import LEAD, random_body, random_plan, replay, simulated
from invdyn.blindcheck.simulator import World
from invdyn.models.dynamics.integrators import rk4
from invdyn.models.dynamics.planar import planar_dynamics

pytest.importorskip("mujoco")
MECHANISMS = {name: effect.install for name, effect in INJECTED.items() if effect.install is not None}


def ideal(body, trajectory, row, rows):
    """Angles after each of so many rows from `row` on, by invdyn's dynamics under the trajectory's commands."""
    dynamics, p = planar_dynamics(body.num_joints), body.parameters()
    per_row = (len(trajectory.time) - 1) // (len(trajectory.command) - 1)
    q, qd = (torch.tensor(state[row * per_row]) for state in (trajectory.q, trajectory.qd))
    dt = trajectory.command_time[1] - trajectory.command_time[0]
    path = []
    for u in torch.tensor(trajectory.command[row : row + rows]):
        q, qd = rk4(lambda a, b, _, u=u: dynamics.forward(a, b, u, p), q, qd, dt, int(dt / 2e-3) + 1)
        path.append(q)
    return torch.stack(path), per_row


@pytest.mark.parametrize(
    ("joints", "horizontal", "passive"), [(1, False, False), (2, False, False), (3, False, True), (2, True, False)]
)
def test_no_effect_is_the_ideal_body(joints, horizontal, passive):
    rng = np.random.default_rng([1, joints])
    body = random_body(rng, joints, horizontal)
    plan = replace(random_plan(rng, body, passive), duration=3.0)
    real = simulated(World(body), World(body), plan)
    rows = int(0.3 * plan.command_rate)  # pieces: an arm that stands up magnifies round-off, a replay with it
    for row in range(0, len(real.command) - rows, 3 * rows):
        path, per_row = ideal(body, real, row, rows)
        after = slice((row + 1) * per_row, (row + rows) * per_row + 1, per_row)
        tips = planar_dynamics(joints).keypoints(path, body.parameters()).numpy()
        reach = sum(link.length for link in body.links)
        assert np.abs(tips - real.points[after, 1:]).max() < 1e-5 * reach  # noise is 1e-3 and more


def test_halving_the_step_moves_nothing(monkeypatch):
    rng = np.random.default_rng(4)
    body = random_body(rng, 2, False)
    plan = random_plan(rng, body, True)
    whole = simulated(World(body), World(body), plan)
    monkeypatch.setattr("invdyn.blindcheck.simulator.MAX_STEP", 2.5e-4)
    half = simulated(World(body), World(body), plan)
    rows = len(whole.command) - 1
    ours, theirs = (each.points[:: (len(each.time) - 1) // rows] for each in (whole, half))
    assert len(half.time) > 1.8 * len(whole.time)
    assert np.abs(ours - theirs).max() < 1e-6


def test_a_command_acts_from_its_row_to_the_next():
    body = random_body(np.random.default_rng(0), 1, True)
    command_time = np.arange(4) * 0.01
    pulse = np.array([0.0, 1.0, 0.0, 0.0])
    real = World(body).run(command_time, lambda row, t, q, qd: pulse[[row]], [0.3], [0.0])
    inertia = World(body).inertia(np.zeros(1))[0, 0]
    assert np.abs(real.qd[real.time <= 0.01 + 1e-12]).max() < 1e-12
    np.testing.assert_allclose(real.qd[real.time >= 0.02 - 1e-12], 0.01 / inertia, rtol=1e-9)


def test_a_replay_starts_again_from_the_true_state():
    rng = np.random.default_rng(5)
    body = random_body(rng, 2, False)
    real = simulated(World(body), World(body), random_plan(rng, body, False))
    heavier = World(body.with_values(mass=[2 * link.mass for link in body.links]))
    again = replay(heavier, real, 0.1)
    off = np.abs(again.q - real.q).max(axis=1)
    window = round(0.1 / (real.time[1] - real.time[0]))
    assert off[::window].max() < 1e-12
    assert off[window - 1 :: window].min() > 0
    assert real.time[0] <= -LEAD


def test_a_run_that_diverges_is_nan_and_no_more(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    body = random_body(np.random.default_rng(0), 2, False)
    time = np.arange(100) * 0.01
    real = World(body).run(time, lambda row, t, q, qd: 1e4 * np.ones(2), [0.0, 0.0], [0.0, 0.0])
    assert np.isfinite(real.q[0]).all()
    assert np.isnan(real.q[-1]).all()
    assert not list(tmp_path.iterdir())  # no log of MuJoCo's
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("lost", "share", "possible"),
    [("mass", 0.9, True), ("mass", 1.0, False), ("mass", 1.1, False), ("inertia", 1.0, True), ("inertia", 1.1, False)],
)
def test_a_link_without_a_mass_is_no_body(lost, share, possible):
    body = random_body(np.random.default_rng(0), 2, False)
    off = dict.fromkeys(("mass", "com", "inertia"), 0.0) | {lost: -share * body.links[1].nominal(lost)}
    world = World(body)
    MECHANISMS["inertial_error"](world, 1, **off)
    assert world.possible is possible


def test_without_mujoco_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ImportError, match=r"invdyn\[robots\]"):
        World(random_body(np.random.default_rng(0), 1, False))
