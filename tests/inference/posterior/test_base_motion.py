"""Whether a base moves, by its own track; and whether it is where the body's file says."""

import re
import warnings
from dataclasses import replace

import numpy as np
import pytest
from carried import Carried, person

from invdyn.inference import infer, infer_kinematics, pooled
from invdyn.inference.posterior.base_motion import base_motion, hold_base
from invdyn.inference.posterior.initialise import arm_problem
from invdyn.models import Body, OrnsteinUhlenbeck
from invdyn.recordings import InputError, Recording

TIME = np.arange(90) / 30


def moves(track, noise=0.003, seed=0):
    return base_motion(TIME, track + noise * np.random.default_rng(seed).standard_normal(track.shape))


def test_a_base_at_rest_does_not_move():
    """Whatever the seed: white noise alone, and noise with outliers."""
    still = np.zeros((90, 2))
    wild = still.copy()
    wild[[20, 60]] = 0.4
    found = [moves(track, seed=seed) for seed in range(10) for track in (still, wild)]
    assert not any(each.moves for each in found)
    assert max(each.gain for each in found) < 5
    assert np.median([each.noise for each in found]) == pytest.approx(0.003, rel=0.2)


def test_a_walking_base_moves_and_its_acceleration_is_found():
    w = 4 * np.pi
    track = np.stack([1.3 * TIME, 0.03 * np.cos(w * TIME)], -1)
    found = moves(track)
    assert found.moves
    true = -0.03 * w**2 * np.cos(w * TIME)
    rms = np.sqrt(np.mean(true**2))
    assert found.acceleration == pytest.approx(rms, rel=0.2)
    assert np.sqrt(np.mean((found.path[:, 5] - true) ** 2)) < 0.3 * rms
    gaps = track.copy()
    gaps[30:36] = np.nan
    assert moves(gaps).moves


def test_a_slow_drift_within_the_noise_is_no_motion():
    drift = 0.002 * np.stack([np.sin(TIME), np.cos(TIME)], -1)
    assert not moves(drift).moves
    assert moves(50 * drift).moves  # a place that is left far behind is one, however slowly


def arm_on(base, dimensions=2, swing=0.8, seed=0, noise=0.002, shift=None):
    """Keypoints of an arm whose shoulder is at ``base`` (T, d)."""
    body = person(dimensions)
    rng = np.random.default_rng(seed)
    K = body.num_joints
    middle = [-1.0, -1.0] if dimensions == 2 else [-1.0, 0.2, 0.6, 0.4]
    q = middle + swing * np.sin(2 * np.pi * (0.4 + 0.2 * np.arange(K)) * TIME[:, None] + np.arange(K))
    points = Carried(body).points(base, q)
    points = points + noise * rng.standard_normal(points.shape) + (0.0 if shift is None else np.asarray(shift))
    return body, Recording(TIME, points, (body.base_keypoint, *body.keypoint_names), name="arm")


@pytest.mark.parametrize("dimensions", [2, 3])
def test_what_moves_gets_a_model_that_moves(dimensions):
    still = np.zeros((90, dimensions))
    walk = still.copy()
    walk[:, :2] = np.stack([1.3 * TIME, 0.03 * np.cos(4 * np.pi * TIME)], -1)
    body, at_rest = arm_on(still, dimensions, shift=[5.0, 2.0, 1.0][:dimensions])
    plain = arm_problem(at_rest, body, moving_base=True)
    assert plain.model.base is None
    assert "is at rest" in plain.base
    expected = at_rest.with_keypoints(body.keypoint_names).moved(-np.median(at_rest.keypoints[:, 0], 0))
    np.testing.assert_allclose(plain.model.observation.points(plain.observations), expected.keypoints)
    _, walking = arm_on(walk, dimensions)
    problem = arm_problem(walking, body, moving_base=True)
    assert problem.model.base is not None
    assert "moves, so its motion is part of the model" in problem.base
    path = problem.model.initial_paths(problem.observations)[0]
    sites = problem.model.sites(path).numpy()
    shown = problem.model.observation.points(problem.observations).numpy()
    assert np.sqrt(np.mean((sites - shown) ** 2)) < 0.01
    if dimensions == 2:  # who does not ask for it keeps a base at rest
        assert arm_problem(walking, body).model.base is None


def test_a_tracks_lasting_error_is_no_motion():
    """A filtered track of a base at rest is smooth, and wanders by millimetres."""
    rng = np.random.default_rng(4)
    smooth = np.apply_along_axis(np.convolve, 0, rng.standard_normal((90, 2)), np.hanning(17) / 3, "same")
    body, filtered = arm_on(0.002 * smooth, noise=1e-5)
    held = hold_base(filtered, body)
    assert held.motion is None
    assert "taken to be at rest: its track wanders by" in held.line


@pytest.mark.parametrize("seen", [0, 5])
def test_a_base_that_few_rows_show_is_put_where_the_bodys_is(seen):
    body, recording = arm_on(np.zeros((90, 2)), shift=[0.4, 0.3])
    points = recording.keypoints.copy()
    points[seen:, 0] = np.nan
    few = replace(recording, keypoints=points)
    if not seen:
        with pytest.raises(InputError, match="not about the base"):
            hold_base(few, body)
        return
    held = hold_base(few, body)
    assert f"is seen in {seen} rows" in held.line
    np.testing.assert_allclose(np.nanmedian(held.recording.keypoints[:, 0], 0), body.base, atol=1e-9)


def test_a_site_at_the_first_joint_tells_of_the_base_as_well():
    body, walking = arm_on(np.stack([1.3 * TIME, 0.03 * np.cos(4 * np.pi * TIME), 0 * TIME], -1), 3)
    upper, fore = body.links
    sited = Body("sited", [replace(upper, sites={"acromion": (0.0, 0.0, 0.0)}), fore], body.gravity)
    named = Recording(TIME, walking.keypoints, ("acromion", "elbow", "wrist"))
    problem = arm_problem(named, sited, moving_base=True)
    assert problem.model.base is not None
    assert problem.model.observation.tracked_names == ("elbow", "wrist")


@pytest.mark.parametrize("dimensions", [2, 3])
@pytest.mark.parametrize("off", [0.1, 0.2])
def test_a_base_elsewhere_than_the_file_says_is_refused(dimensions, off):
    """In one line, with its place."""
    body, recording = arm_on(np.zeros((90, dimensions)), dimensions, shift=[off, 0.0, 0.0][:dimensions])
    untracked = recording.with_keypoints(body.keypoint_names)
    with pytest.raises(InputError, match="expected keypoints in the body's frame") as refused:
        infer(untracked, body)
    line = str(refused.value)
    assert "\n" not in line
    place = re.search(r"elbow turns about \((-?[\d.e-]+)", line)
    assert place is not None
    assert float(place[1]) == pytest.approx(off, abs=0.005)
    assert hold_base(untracked.moved([-off, *[0.0] * (dimensions - 1)]), body).line.startswith("base: not tracked")


def test_a_wrong_length_is_not_taken_for_a_base_elsewhere():
    body, recording = arm_on(np.zeros((90, 2)))
    longer = body.with_values(length=[0.35, 0.34])
    assert hold_base(recording.with_keypoints(body.keypoint_names), longer).motion is None


def falling():
    body = person()
    time = np.arange(36) / 60
    q, b = Carried(body).falling(time, np.array([0.3, 0.6]), np.array([1.0, -2.0]))
    points = Carried(body).points(b, q)
    points = points + 0.002 * np.random.default_rng(3).standard_normal(points.shape)
    return body, Recording(time, points, ("shoulder", "elbow", "wrist"))


@pytest.mark.parametrize(
    "method",
    ["laplace", pytest.param("smc", marks=pytest.mark.long), pytest.param("differentiate", marks=pytest.mark.long)],
)
def test_an_arm_that_falls_freely_needs_no_torque(method):
    """MuJoCo lets it fall; as on a base at rest its shoulder would hold .3 of 3.6 kg m against gravity."""
    body, recording = falling()
    found = infer(recording, body, method=method, num_filters=8, num_particles=50, seed=1, torque=OrnsteinUhlenbeck())
    torque = pooled(found)["torque"].transpose("sample", "time", "joint").values
    low, middle, high = np.quantile(torque, [0.05, 0.5, 0.95], axis=0)
    if method != "differentiate":  # which gives one path, and has no figure for the ends of it
        assert np.sqrt(np.mean(middle**2)) < 0.15
        assert ((low <= 0) & (high >= 0)).mean() > 0.8
        assert found["posterior"]["base_acceleration"].mean(("chain", "draw", "time")).values == pytest.approx(
            [0.0, -9.81], abs=0.4
        )
        assert found["posterior"]["base_position"].attrs["units"] == "m"
    else:
        assert np.nanmedian(np.abs(middle)) < 1.5
    assert "moves" in found.attrs["base"]


@pytest.mark.long
def test_particle_filters_agree_with_the_gaussian_smoother():
    """Their evidence, of a model whose arm alone is not linear, and their torques."""
    body, walking = arm_on(np.stack([1.3 * TIME, 0.03 * np.cos(4 * np.pi * TIME)], -1)[:90])
    short = walking.select(0, 30)
    found = {
        m: infer(short, body, method=m, num_filters=16, num_particles=60, seed=0, torque=OrnsteinUhlenbeck())
        for m in ("laplace", "smc")
    }
    one, other = (found[m].attrs["log_evidence"] for m in ("laplace", "smc"))
    assert one == pytest.approx(other, abs=2.0)
    means = [pooled(each)["torque"].mean("sample").values for each in found.values()]
    spread = pooled(found["laplace"])["torque"].std("sample").values
    assert np.sqrt(np.mean(((means[0] - means[1]) / spread) ** 2)) < 0.5


def test_a_kinematic_model_takes_the_bases_motion_away():
    walk = np.stack([1.3 * TIME, 0.03 * np.cos(4 * np.pi * TIME)], -1)
    body, walking = arm_on(walk)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = infer_kinematics(walking.select(0, 40), body, method="laplace", seed=0)
    elbow = found["posterior"]["position"].sel(keypoint="elbow").mean(("chain", "draw")).values
    assert np.linalg.norm(elbow, axis=-1) == pytest.approx(0.3, abs=1e-4)
