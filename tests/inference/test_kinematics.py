"""Kinematics of a recording: lengths and motion found, what was hidden predicted, no torque claimed."""

import numpy as np
import pytest
import torch
from scenes import ring
from trees import paper_arm

from invdyn.inference import infer_kinematics, learned_lengths, load_posterior, pooled, save_posterior
from invdyn.models import KinematicModel, Link, planar_body
from invdyn.recordings import InputError, Recording, Truth
from invdyn.recordings.cameras import Views, filmed

TIPS = ("elbow_tip", "wrist")
NOISE = 0.02
SMALL = {"num_filters": 8, "num_particles": 40, "num_draws": 8}


def walk(seed=0, steps=60):
    """Recording, truth, and the wrist and elbow as they were, of the arm walking by chance, every ninth row hidden."""
    model = KinematicModel(
        paper_arm(),
        np.arange(steps) / 30,
        parameters={
            "walk.scale": 2.0,
            "emission.keypoint_scale": NOISE,
            "initial.angle": [0.3, -0.2, 0.5, 0.4],
            "initial.angle_scale": 0.1,
            "initial.velocity_scale": 0.5,
        },
    )
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        states, rows = model.simulate()
    _, angle, velocity = (part.numpy() for part in model.split(states))
    points = rows.numpy().reshape(steps, 2, 3)
    seen = points.copy()
    seen[4::9] = np.nan
    time = model.time.numpy()
    truth = Truth(time, angle, velocity, np.zeros_like(angle), paper_arm().joint_names)
    return Recording(time=time, keypoints=seen, keypoint_names=TIPS), truth, points


def covered(draws, truth):
    low, high = np.quantile(draws, [0.05, 0.95], axis=0)
    return ((low <= truth) & (truth <= high)).mean()


@pytest.mark.filterwarnings("ignore:.*passes a pitch of 80:UserWarning")  # it does, and a walk knows no torques
def test_lengths_and_hidden_rows_of_a_tree(tmp_path):
    recording, truth, points = walk()
    idata = infer_kinematics(recording, paper_arm(), learn_lengths=True, method="laplace", truth=truth, **SMALL)
    lengths = learned_lengths(idata)
    assert set(lengths) == {"upper_arm", "forearm"}
    for length, sd in lengths.values():
        # 53 rows of three coordinates of NOISE each tell a length to about NOISE / √53.
        assert 0.5 < sd * np.sqrt(53) / NOISE < 3
        assert abs(length - 1) < 4 * sd
    draws = pooled(idata, group="posterior_predictive")["position"].transpose("sample", "time", ...).values
    assert draws.shape[1:] == points.shape
    assert covered(draws[:, 4::9], points[4::9]) > 0.75  # of 42 coordinates, .9 by three standard errors
    assert 0.8 < covered(pooled(idata)["angle"].transpose("sample", ...).values, truth.angle) < 1
    assert "torque" not in idata["posterior"]
    save_posterior(idata, tmp_path / "x.nc")
    assert load_posterior(tmp_path / "x.nc")["posterior"].equals(idata["posterior"])


@pytest.mark.quick("1")
@pytest.mark.parametrize("order", [1, 2])
def test_particles_and_linearised_model_agree(order):
    recording, _, _ = walk(1, 30)
    known = {"walk.scale": (0.5, 2.0)[order - 1], "emission.keypoint_scale": NOISE}
    both = [
        infer_kinematics(recording, paper_arm(), order=order, method=method, settings=known, **SMALL)
        for method in ("smc", "laplace")
    ]
    smc, laplace = both
    assert smc.attrs["outer_ess"] > 7  # of 8
    assert abs(smc.attrs["log_evidence"] - laplace.attrs["log_evidence"]) < 0.5
    means = [each["posterior"]["angle"].mean(("chain", "draw")) for each in both]
    assert float(np.abs(means[0] - means[1]).max()) < 0.05


def test_a_chain_in_the_plane_too():
    arm = planar_body(
        "arm", [Link("a", "s", "elbow", length=0.5, mass=1.0), Link("b", "e", "wrist", length=0.5, mass=1.0)]
    )
    model = KinematicModel(arm.with_values(length=[0.4, 0.3]), np.arange(40) / 30, parameters={
        "walk.scale": 2.0, "emission.keypoint_scale": 0.005, "initial.velocity_scale": 0.5, "initial.angle_scale": 0.3,
    })  # fmt: skip
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        _, rows = model.simulate()
    recording = Recording(
        time=model.time.numpy(), keypoints=rows.numpy().reshape(40, 2, 2), keypoint_names=("elbow", "wrist")
    )
    lengths = learned_lengths(infer_kinematics(recording, arm, learn_lengths=True, method="laplace", **SMALL))
    assert [abs(length - true) < 4 * sd for (length, sd), true in zip(lengths.values(), (0.4, 0.3), strict=True)] == [
        True
    ] * 2


def test_what_cannot_be_is_said():
    recording, _, _ = walk(steps=12)
    with pytest.raises(InputError, match="smc, laplace, got 'nuts'"):
        infer_kinematics(recording, paper_arm(), method="nuts")
    with pytest.raises(InputError, match=r"settings: no parameter torque\.scale"):
        infer_kinematics(recording, paper_arm(), settings={"torque.scale": 1.0})
    with pytest.raises(InputError, match="order 1 or 2"):
        infer_kinematics(recording, paper_arm(), order=4)
    film = filmed(Views(ring(2), recording.time, np.full((12, 2, 2, 2), 100.0), np.ones((12, 2, 2)), TIPS))
    with pytest.raises(InputError, match="is a film, and a kinematic model knows no cameras"):
        infer_kinematics(film, paper_arm())
