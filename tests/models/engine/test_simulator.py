"""Batches of steps: MuJoCo's own, one by one, and the same bits on any number of threads."""

import legs
import mujoco
import numpy as np
import pytest

from invdyn.models.bodies.scalars import BodyError
from invdyn.models.engine.simulator import Simulator, unique_steps

TORQUES = int(mujoco.mjtState.mjSTATE_QFRC_APPLIED)


def near_the_floor(count, seed=0):
    """States of the leg about which its foot touches, and torques of ten steps."""
    rng = np.random.default_rng(seed)
    physics = np.array([-0.11, -0.6, 1.2, 0, 0, 0]) + rng.normal(size=(count, 6)) * [0.01, 0.05, 0.05, 0.5, 2, 2]
    return physics, np.concatenate([np.zeros((count, 10, 1)), rng.normal(size=(count, 10, 2)) * 5], -1)


def test_steps_are_mujocos_own():
    model = mujoco.MjModel.from_xml_string(legs.leg_file("hop"))
    physics, torques = near_the_floor(40)
    ends, _ = Simulator(model, TORQUES).run(physics, torques, 0.001)
    touched = 0
    for begin, own, end in zip(physics, torques, ends, strict=True):
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = begin[:3], begin[3:]
        for torque in own:
            data.qfrc_applied[:] = torque
            mujoco.mj_step(model, data)
            touched += data.ncon > 0
        assert end == pytest.approx(np.concatenate([data.qpos, data.qvel]), abs=1e-9)
    assert touched > 100


def test_threads_and_neighbours_do_not_change_a_bit():
    physics, torques = near_the_floor(300)
    results = []
    for threads in (1, 2, 3):
        simulator = Simulator(mujoco.MjModel.from_xml_string(legs.leg_file("hop")), TORQUES, threads)
        simulator.run(*near_the_floor(50, seed=1), 0.001)  # what threads did before must not matter
        results.append(simulator.run(physics, torques, 0.001)[0])
    assert np.array_equal(results[0], results[1])
    assert np.array_equal(results[0], results[2])
    alone = simulator.run(physics[-1:], torques[-1:], 0.001)[0]
    assert np.array_equal(alone, results[0][-1:])


def test_what_runs_away_is_no_number_and_others_go_on():
    model = mujoco.MjModel.from_xml_string(legs.leg_file("hop"))
    physics, torques = near_the_floor(3)
    torques[1, :, 2] = 1e14
    physics[2, 0] = np.nan
    ends, _ = Simulator(model, TORQUES).run(physics, torques, 0.001)
    assert np.isfinite(ends[0]).all()
    assert np.isnan(ends[1:]).all()
    again, _ = Simulator(model, TORQUES).run(physics[:1], torques[:1], 0.001)
    assert np.array_equal(again, ends[:1])


def test_rows_of_several_lengths():
    which, steps = unique_steps(np.array([0.01, 0.01, 0.02, 0.0102, 0.01 + 1e-12]), 0.004)
    assert which.tolist() == [0, 0, 2, 1, 0]
    assert [count for _, count in steps] == [3, 3, 5]
    assert [length * count for length, count in steps] == pytest.approx([0.01, 0.0102, 0.02])
    assert all(length <= 0.004 for length, _ in steps)


def test_times_in_another_unit_are_refused_in_one_line():
    with pytest.raises(BodyError, match=r"at most 2000 of MuJoCo's steps from a row to the next, got 5000 in 10 s"):
        unique_steps(np.array([10.0, 10.0]), 0.002)
