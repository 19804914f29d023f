"""Functionals of whole torque paths: against closed forms, of each draw by itself, with units and a truth."""

import numpy as np
import pytest

from invdyn.inference import functional_table, functionals, infer
from invdyn.inference.posterior.functionals import path_functionals
from invdyn.models import Link, OrnsteinUhlenbeck, planar_body
from invdyn.recordings import InputError, Recording, Truth

ARM = planar_body("rod", [Link("rod", "hinge", "tip", length=0.5, mass=1.0)])
TIME = np.linspace(0.0, 2.0, 201)


def test_a_sine_has_the_functionals_of_a_sine():
    torque, velocity = -3 * np.sin(np.pi * TIME / 2)[:, None], np.full((201, 1), 0.5)
    found = {name: value.item() for name, value in path_functionals(TIME, torque, velocity).items()}
    assert found["peak"] == pytest.approx(-3)
    assert found["peak_time"] == pytest.approx(1.0)
    assert found["impulse"] == pytest.approx(-12 / np.pi, rel=1e-4)
    assert abs(found["peak_rate"]) == pytest.approx(3 * np.pi / 2, rel=1e-4)
    assert found["work"] == pytest.approx(-6 / np.pi, rel=1e-4)
    assert found["mean_power"] == pytest.approx(-3 / np.pi, rel=1e-4)


def test_times_need_not_be_even():
    time = np.array([0.0, 0.1, 0.5])
    torque = np.array([[0.0], [1.0], [2.0]])
    found = path_functionals(time, torque, np.ones((3, 1)))
    assert found["peak_rate"].item() == pytest.approx(10.0)
    assert found["impulse"].item() == pytest.approx(0.05 + 0.6)


def test_each_path_and_joint_has_its_own():
    rng = np.random.default_rng(0)
    torque, velocity = rng.standard_normal((2, 4, 3, 201, 2))
    found = path_functionals(TIME, torque, velocity)
    one = path_functionals(TIME, torque[1, 2], velocity[1, 2])
    for name, values in found.items():
        assert values.shape == (4, 3, 2)
        np.testing.assert_allclose(values[1, 2], one[name])
    assert (np.abs(found["peak"]) == np.abs(torque).max(-2)).all()


@pytest.fixture(scope="module")
def posterior():
    time = np.arange(40) / 30
    angle = -1.5 + 0.4 * np.sin(3 * time)[:, None]
    velocity = 1.2 * np.cos(3 * time)[:, None]
    acceleration = -3.6 * np.sin(3 * time)[:, None]
    torque = acceleration / 12 + 9.81 * 0.25 * np.cos(angle)  # a rod about its end: m l² / 3
    rng = np.random.default_rng(0)
    points = 0.5 * np.stack([np.cos(angle), np.sin(angle)], -1) + 0.001 * rng.standard_normal((40, 1, 2))
    truth = Truth(time, angle, velocity, torque, ("hinge",))
    recording = Recording(time, points, ("tip",))
    return infer(recording, ARM, method="laplace", torque=OrnsteinUhlenbeck(), truth=truth, num_filters=40)


def test_a_posterior_has_them_with_units_and_a_truth(posterior):
    drawn = functionals(posterior)
    assert dict(drawn.sizes) == {
        "chain": posterior["posterior"].sizes["chain"],
        "draw": posterior["posterior"].sizes["draw"],
        "joint": 1,
    }
    assert {name: values.attrs["units"] for name, values in drawn.items()} == {
        "peak": "N·m",
        "peak_time": "s",
        "impulse": "N·m·s",
        "peak_rate": "N·m/s",
        "work": "J",
        "mean_power": "W",
    }
    table = functional_table(posterior).set_index("functional")
    assert list(table.columns) == ["joint", "unit", "median", "q05", "q95", "truth"]
    assert ((table["q05"] <= table["median"]) & (table["median"] <= table["q95"])).all()
    for name in ("impulse", "work", "mean_power"):
        row = table.loc[name]
        assert abs(row["median"] - row["truth"]) < 3 * (row["q95"] - row["q05"])
    kinetic = posterior["posterior"]["torque"].transpose("chain", "draw", "time", "joint").values
    np.testing.assert_allclose(np.abs(drawn["peak"]), np.abs(kinetic).max(2))


def test_a_truth_that_misses_rows_is_none(posterior):
    partly = posterior.copy()
    torque = partly["constant_data"]["truth_torque"].copy()
    torque[{"time": 3}] = np.nan
    partly["constant_data"]["truth_torque"] = torque
    assert functional_table(partly)["truth"].isna().all()


def test_without_torques_there_are_none(posterior):
    kinematic = posterior.copy()
    del kinematic["posterior"]["torque"]
    with pytest.raises(InputError, match="a kinematic posterior has no torques"):
        functionals(kinematic)
