"""The layout of the posterior, its weights, its tables and its files."""

import json
import os
from dataclasses import replace

import arviz as az
import numpy as np
import pytest
import torch

from invdyn.inference import (
    FilterResult,
    Problem,
    arm_problem,
    load_posterior,
    outer_weights,
    pooled,
    save_posterior,
)
from invdyn.inference.posterior.posterior import combine, stored_dtype, to_inference_data
from invdyn.models import Link, planar_body
from invdyn.models.observation.missing import observed_log_prob
from invdyn.recordings import InputError, Recording, Truth

M, R, T, K = 4, 5, 12, 2
TIME = 0.02 * np.arange(T)
LOG_EVIDENCE = torch.tensor([-3.0, -2.0, -2.0, -9.0], dtype=torch.float64)
JOINTS = ("shoulder", "elbow")


def make(*, encoders=True, command=True, truth=True, length_unit="m"):
    """A problem, paths and a filter's numbers, without any inference."""
    rng = np.random.default_rng(0)
    body = planar_body("arm", [Link(f"l{k}", JOINTS[k], ("elbow", "wrist")[k], length=0.3, mass=1.0) for k in range(K)])
    keypoints = rng.normal(size=(T, 2, 2))
    keypoints[3, 1] = np.nan
    recording = Recording(
        time=TIME,
        keypoints=keypoints,
        keypoint_names=("wrist", "elbow"),  # not the body's order
        angles=rng.normal(size=(T, K)) if encoders else None,
        torques=rng.normal(size=(T, K)) if command else None,
        joint_names=JOINTS if encoders or command else (),
        name="rec",
        length_unit=length_unit,
    )
    # the truth is known in another order of joints
    known = Truth(TIME, *(rng.normal(size=(3, T, K))), ("elbow", "shoulder")) if truth else None
    problem = arm_problem(recording, body, truth=known, parameters={"emission.keypoint_scale": [0.01, 0.02]})
    paths = torch.as_tensor(rng.normal(size=(M, R, T, problem.model.state_dim)))
    result = FilterResult(
        log_evidence=LOG_EVIDENCE,
        log_evidence_increment=torch.as_tensor(rng.normal(size=(T, M))),
        ess=torch.as_tensor(rng.uniform(1, 50, size=(T, M))),
        resampled=torch.as_tensor(rng.uniform(size=(T, M)) < 0.5),
        states=torch.empty(0),
        log_weights=torch.empty(0),
        log_twist=None,
        ancestors=torch.empty(0),
    )
    idata = to_inference_data(problem, paths, result, method="smc", seed=7, settings={"num_filters": M, "a": [1]})
    return problem, paths, result, idata


@pytest.fixture(scope="module")
def everything():
    return make()


def test_values_names_and_dims(everything):
    problem, paths, result, idata = everything
    posterior = idata["posterior"]
    paths = paths.flatten(0, 1).numpy()[chosen(paths, idata)].reshape(M, R, T, -1)
    command = problem.model.command.numpy()
    shape = {"chain": M, "draw": R, "time": T, "joint": K}
    for name in ("torque", "angle", "velocity", "residual_torque"):
        assert dict(zip(posterior[name].dims, posterior[name].shape, strict=True)) == shape
    assert np.array_equal(posterior["residual_torque"], paths[..., :2])
    assert posterior["torque"].values == pytest.approx(paths[..., :2] + command)
    assert np.array_equal(posterior["angle"], paths[..., 2:4])
    assert np.array_equal(posterior["velocity"], paths[..., 4:])
    assert posterior["joint"].values.tolist() == list(JOINTS)
    assert np.array_equal(posterior["time"], TIME)
    # tips by name, noise-free
    angle = paths[..., 2:4]
    elbow = 0.3 * np.stack([np.cos(angle[..., 0]), np.sin(angle[..., 0])], -1)
    both = angle.sum(-1)
    wrist = elbow + 0.3 * np.stack([np.cos(both), np.sin(both)], -1)
    position = posterior["position"]
    assert position.dims == ("chain", "draw", "time", "keypoint", "space")
    assert position.sel(keypoint="elbow").values == pytest.approx(elbow)
    assert position.sel(keypoint="wrist").values == pytest.approx(wrist)
    predictive = idata["posterior_predictive"]["position"]
    for name, tip, sd in (("wrist", wrist, 0.01), ("elbow", elbow, 0.02)):
        noise = predictive.sel(keypoint=name).values - tip
        # 480 residuals
        assert noise.std() == pytest.approx(sd, rel=0.15)
        assert abs(noise.mean()) < 4.5 * sd / np.sqrt(noise.size)
    assert idata["posterior_predictive"]["angle"].dims == ("chain", "draw", "time", "joint")
    stats = idata["sample_stats"]
    assert np.array_equal(stats["ess"], result.ess.numpy().T)
    assert np.array_equal(stats["resampled"], result.resampled.numpy().T)
    assert stats["resampled"].dtype == bool
    assert np.array_equal(stats["log_evidence"], LOG_EVIDENCE.numpy())
    assert np.exp(stats["log_weight"]).sum() == pytest.approx(1)


def test_observations_constants_and_truth(everything):
    problem, _, _, idata = everything
    observed, recording = idata["observed_data"], problem.recording
    for i, name in enumerate(recording.keypoint_names):
        expected = recording.keypoints[:, i]
        assert np.array_equal(observed["position"].sel(keypoint=name), expected, equal_nan=True)
    assert np.array_equal(observed["angle"], recording.angles)
    constants = idata["constant_data"]
    assert np.array_equal(constants["command"], recording.torques)
    assert constants["length"].values.tolist() == [0.3, 0.3]
    truth = problem.truth
    for name in ("torque", "angle", "velocity"):
        for joint in JOINTS:
            expected = getattr(truth, name)[:, truth.joint_names.index(joint)]
            assert np.array_equal(constants[f"truth_{name}"].sel(joint=joint), expected)


@pytest.mark.parametrize("unit", ["m", "body length"])
def test_every_variable_has_a_unit(unit):
    idata = make(length_unit=unit)[-1]
    found = {}
    for group in idata.groups():
        for name, variable in idata[group].data_vars.items():
            found[name] = variable.attrs["units"]
        if "time" in idata[group].coords:
            assert idata[group]["time"].attrs["units"] == "s"
    si = unit == "m"
    expected = {
        "torque": "N·m" if si else "kg·(body length)²/s²",
        "angle": "rad",
        "velocity": "rad/s",
        "position": unit,
        "residual_torque": "N·m" if si else "kg·(body length)²/s²",
        "command": "N·m" if si else "kg·(body length)²/s²",
        "truth_torque": "N·m" if si else "kg·(body length)²/s²",
        "truth_angle": "rad",
        "truth_velocity": "rad/s",
        "log_evidence": "nat",
        "log_weight": "nat",
        "length": unit,
        "com": unit,
        "base": unit,
        "mass": "kg",
        "inertia": "kg·m²" if si else "kg·(body length)²",
        "gravity": "m/s²" if si else "body length/s²",
    }
    assert {name: found[name] for name in expected if name in found} == {
        name: value for name, value in expected.items() if name in found
    }
    assert found["resampled"] == "1"


def test_attributes(everything):
    idata = everything[-1]
    outer = outer_weights(LOG_EVIDENCE)
    assert idata.attrs["outer_ess"] == pytest.approx(outer.ess)
    assert idata.attrs["log_evidence"] == pytest.approx(outer.log_evidence)
    assert idata.attrs["method"] == "smc"
    assert idata.attrs["seed"] == 7
    assert idata.attrs["length_unit"] == "m"
    assert json.loads(idata.attrs["settings"]) == {"num_filters": M, "a": [1]}
    assert idata.attrs["invdyn_version"]


def test_what_is_not_there_is_left_out():
    idata = make(encoders=False, command=False, truth=False)[-1]
    assert "residual_torque" not in idata["posterior"]
    assert "command" not in idata["constant_data"]
    assert not [name for name in idata["constant_data"].data_vars if name.startswith("truth")]
    assert "angle" not in idata["observed_data"]
    assert "angle" not in idata["posterior_predictive"]


# -- weights -----------------------------------------------------------------------------------------
def chosen(paths, idata):
    """Number of the path (M·R) that each draw of the posterior is."""
    given = paths.flatten(0, 1).numpy()[..., :2]
    drawn = idata["posterior"]["residual_torque"].values.reshape(M * R, T, 2)
    return np.array([next(k for k, path in enumerate(given) if np.array_equal(path, draw)) for draw in drawn])


def test_draws_come_by_their_chains_weight(everything):
    _, paths, _, idata = everything
    index = chosen(paths, idata)
    weights = np.exp(LOG_EVIDENCE.numpy()) / np.exp(LOG_EVIDENCE.numpy()).sum()
    count = np.bincount(index // R, minlength=M)
    # systematic: within one of the expected number
    assert (np.abs(count - M * R * weights) < 1).all()
    # each chain's own draws in turn, none left out while others come twice
    for chain in range(M):
        times = np.bincount(index[index // R == chain] % R, minlength=R)
        assert times.max() - times.min() <= 1
    # in order: copies of one trajectory stand next to one another
    assert (np.diff(index) >= 0).all()


def test_groups_of_draws_are_resampled_together(everything):
    problem, paths, _, idata = everything
    tips = idata["posterior"]["position"].sel(keypoint="wrist")
    noise = idata["posterior_predictive"]["position"].sel(keypoint="wrist") - tips
    assert np.abs(noise).max() < 6 * 0.01
    again = paths.flatten(0, 1)[chosen(paths, idata)].reshape(M, R, T, -1)
    emission = problem.model.emission(again, torch.arange(T))
    expected = observed_log_prob(emission, problem.observations)
    seen = ~torch.isnan(problem.observations).all(-1)
    assert idata["log_likelihood"]["y"].values == pytest.approx(expected[..., seen].numpy())


def test_arviz_sees_that_one_filter_has_all_the_weight():
    """Its trajectories are copies, and no effective sample is made of copies."""
    problem, paths, result, _ = make()
    lucky = replace(result, log_evidence=torch.tensor([0.0, -90.0, -90.0, -90.0], dtype=torch.float64))
    idata = to_inference_data(problem, paths, lucky, method="smc", seed=7, settings={})
    assert len(np.unique(chosen(paths, idata))) == R
    assert float(az.rhat(idata)["angle"].min()) > 1.1


def test_equal_chains_stay_as_they_are(everything):
    problem, paths, _, _ = everything
    idata = to_inference_data(problem, paths, method="nuts", seed=7, settings={})
    assert np.array_equal(chosen(paths, idata), np.arange(M * R))


def test_pooled_draws_are_those_of_all_chains(everything):
    idata = everything[-1]
    data = pooled(idata)
    assert data["torque"].dims == ("sample", "time", "joint")
    assert np.array_equal(data["torque"], idata["posterior"]["torque"].values.reshape(M * R, T, K))
    predictive = pooled(idata, "posterior_predictive")
    assert np.array_equal(predictive["angle"], idata["posterior_predictive"]["angle"].values.reshape(M * R, T, K))


def test_parts_are_combined_by_their_evidence():
    """Two parts of two filters each: a part's draws weigh as its filters do together."""
    problem, paths, result, _ = make()
    evidence = torch.tensor([0.0, -1.0, -2.0, -2.0], dtype=torch.float64)

    def part(chains):
        own = {
            "log_evidence": evidence[chains],
            **{name: getattr(result, name)[:, chains] for name in ("log_evidence_increment", "ess", "resampled")},
        }
        return to_inference_data(problem, paths[chains], replace(result, **own), method="smc", seed=1, settings={})

    parts = [part(slice(0, 2)), part(slice(2, 4))]
    assert all(len(each.groups()) == len({*each.groups()}) for each in parts)
    idata = combine(parts, seed=3)
    assert not any(group in each.groups() for each in parts for group in ("posterior", "log_likelihood"))
    share = float(evidence[:2].exp().sum() / evidence.exp().sum())
    first = (chosen(paths, idata) < 2 * R).sum()
    assert abs(first - share * M * R) < 1
    assert idata.attrs["log_evidence"] == pytest.approx(float(evidence.exp().mean().log()))


def test_a_part_of_a_long_posterior_is_as_precise_as_the_whole():
    assert stored_dtype(64, 4, 10_000, 6) == stored_dtype(1, 4, 10_000, 6) == torch.float32
    assert stored_dtype(64, 4, 100, 6) == torch.float64


@pytest.mark.parametrize("doubt", ["", "its bound is low"])
def test_parts_of_a_method_without_filters_hand_on_their_doubts(doubt):
    problem, paths, _, _ = make()

    def part(chains, reason):
        own = {"usable": int(not reason), "doubt": reason}
        return to_inference_data(
            problem, paths[chains], method="svi", seed=1, settings={}, log_evidence=-1.0, bound=True, diagnostics=own
        )

    found = combine([part(slice(0, 2), ""), part(slice(2, 4), doubt)], seed=3)["sample_stats"].attrs
    assert found["usable"] == int(not doubt)
    assert found["doubt"] == doubt


def test_an_older_file_is_weighed_when_it_is_read(everything, tmp_path):
    idata = make()[-1]
    del idata.attrs["draws"]
    idata["sample_stats"] = idata["sample_stats"].rename(filter="chain")
    old = az.InferenceData(**{group: idata[group] for group in idata.groups() if group != "log_likelihood"})
    old.attrs.update(idata.attrs)
    save_posterior(old, tmp_path / "old.nc")
    once, again = (load_posterior(tmp_path / "old.nc") for _ in range(2))
    assert once["posterior"].equals(again["posterior"])
    assert not once["posterior"].equals(idata["posterior"])


# -- files ---------------------------------------------------------------------------------------------
def test_netcdf_round_trip(everything, tmp_path):
    idata = everything[-1]
    save_posterior(idata, tmp_path / "posterior.nc")
    again = load_posterior(tmp_path / "posterior.nc")
    assert set(again.groups()) == set(idata.groups())
    for group in idata.groups():
        for name, variable in idata[group].data_vars.items():
            back = again[group][name]
            assert back.dims == variable.dims
            assert np.array_equal(back.values, variable.values, equal_nan=variable.dtype.kind == "f"), name
            assert back.attrs["units"] == variable.attrs["units"]
        for name, coordinate in idata[group].coords.items():
            assert again[group][name].values.tolist() == coordinate.values.tolist()
    for name, value in idata.attrs.items():
        assert again.attrs[name] == value, name
    # loaded whole: the file can go
    os.remove(tmp_path / "posterior.nc")
    assert np.isfinite(again["posterior"]["torque"].values).all()
    assert pooled(again)["torque"].identical(pooled(again)["torque"])
    assert os.listdir(tmp_path) == []


@pytest.mark.quick("0.5", "0.99")
@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.99])
def test_a_truncated_file_is_an_input_error(everything, tmp_path, share):
    path = tmp_path / "posterior.nc"
    save_posterior(everything[-1], path)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(InputError, match=r"posterior\.nc") as error:
        load_posterior(path)
    assert "\n" not in str(error.value)


def test_other_files_are_input_errors(everything, tmp_path):
    text = tmp_path / "text.nc"
    text.write_text("time,elbow_x\n0,1\n")
    with pytest.raises(InputError, match=r"text\.nc"):
        load_posterior(text)
    other = tmp_path / "other.nc"
    az.from_dict({"mu": np.zeros((2, 3))}).to_netcdf(str(other), engine="h5netcdf")
    with pytest.raises(InputError, match=r"no posterior of invdyn.*sample_stats, observed_data, constant_data"):
        load_posterior(other)
    with pytest.raises(FileNotFoundError):
        load_posterior(tmp_path / "none.nc")


def test_a_place_that_cannot_be_written_leaves_nothing(everything, tmp_path):
    with pytest.raises(OSError, match="none"):
        save_posterior(everything[-1], tmp_path / "none" / "posterior.nc")
    assert os.listdir(tmp_path) == []
    assert isinstance(everything[0], Problem)
