"""Pixels against numpy's projection; what lasts against the covariance of its process; clocks and poses.

The other projection is the readers', which a test of its own holds to OpenCV.
"""

import numpy as np
import pytest
import torch
from scenes import ring
from scipy.spatial.transform import Rotation

from invdyn.inference.posterior.cameras import pinhole
from invdyn.inference.smoothing.gauss_newton import gauss_newton
from invdyn.inference.smoothing.linearisation import slopes_along
from invdyn.inference.smoothing.posterior_linearisation import posterior_linearisation
from invdyn.models import ArmModel, Body, Encoders, Joint, Keypoints, Link, Observation, Pixels, Sensor
from invdyn.models.observation.missing import observed_log_prob
from invdyn.models.observation.pixels import ROTATION_TIME
from invdyn.models.observation.sensor import SensorWithStates
from invdyn.recordings.cameras.projection import project

F64 = torch.float64
STEPS, DT = 5, 0.02
TIME = DT * np.arange(STEPS)
AHEAD = [0.3, -0.2, 0.1, 0.4]
HANGING = ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0))


def arm():
    own = {"inertia": (0.003, 0.012, 0.012, 0.0, 0.0, 0.0), "rotation": HANGING}
    upper = Link("upper", Joint("shoulder", "universal"), length=0.3, tip="elbow", mass=2.0, **own)
    fore = Link("fore", Joint("elbow", "universal"), parent="upper", length=0.25, tip="wrist", mass=1.0)
    return Body("arm", [upper, fore])


CALIBRATION = ring(3)


def sensor(**options):
    cameras = list(CALIBRATION)
    size = torch.tensor([camera.size for camera in cameras], dtype=F64)
    return Pixels(pinhole(CALIBRATION), CALIBRATION.names, size, ("elbow", "wrist"), **options)


def model_of(*others, family="student_t", **options):
    observation = Observation(sensor(**options), *others, family=family)
    return ArmModel(arm(), TIME, observation, parameters={"initial.angle": AHEAD, "initial.angle_scale": 0.3})


def some_states(model, count=4):
    torch.manual_seed(0)
    return model.initial().expand((count,)).sample()


def projected(model, states, cameras=CALIBRATION):
    """Pixels (N, C, P, 2) of the sites in states, by numpy."""
    points = model.dynamics.keypoints(model.split(states)[1], model.body_parameters()).numpy()
    return np.stack([project(camera, points) for camera in cameras], 1)


def test_rows_are_pixels_with_what_lasts_added():
    model = model_of(Encoders())
    assert isinstance(model.observation.pixels, Sensor)
    assert isinstance(model.observation.pixels, SensorWithStates)
    x = some_states(model)
    memory = model.layout.parted(model.split(x)[0])[2].numpy().reshape(-1, 3, 2, 2)
    row = model.emission(x, 2)
    seen = model.observation.of(model.observation.pixels, row.base_dist.loc)
    np.testing.assert_allclose(seen, projected(model, x) + memory, rtol=0, atol=1e-9)
    assert np.abs(memory).max() > 1  # px, or nothing was added
    encoders = model.observation.of(model.observation.encoders, row.base_dist.loc)
    torch.testing.assert_close(encoders, model.split(x)[1])


def test_a_keypoint_that_one_camera_sees_counts_and_a_missing_one_does_not():
    model = model_of(lasting=False)
    x = some_states(model)
    y = torch.full((model.observation_dim,), torch.nan, dtype=F64)
    row = model.emission(x[0], 0)
    assert observed_log_prob(row, y) == 0
    y[4:6] = row.base_dist.loc[4:6] + 3.0  # the elbow in the second camera
    scale, df = model.parameters["emission.pixel_scale"][1, 0], model.parameters["emission.df"]
    noise = torch.distributions.StudentT(df, 0.0, scale)
    expected = 2 * noise.log_prob(torch.tensor(3.0, dtype=F64))[0]
    torch.testing.assert_close(observed_log_prob(row, y), expected)


def test_what_a_camera_cannot_see_is_about_anywhere_in_its_picture():
    model = model_of()
    camera = model.observation.pixels.cameras
    behind = camera._replace(translation=camera.translation - 2 * camera.translation.new_tensor([[0, 0, 3.0]] * 3))
    blind = model.observed_by(Observation(sensor().__class__(**{**vars(sensor()), "cameras": behind})))
    x = some_states(model).requires_grad_()
    row = blind.emission(x, 0)
    middle = torch.tensor(CALIBRATION.cameras[0].size, dtype=F64) / 2
    torch.testing.assert_close(row.mean, middle.repeat(4, 6))
    assert (row.variance >= middle.max() ** 2).all()
    row.log_prob(row.mean + 7).sum().backward()
    assert torch.isfinite(x.grad).all()


def test_what_lasts_keeps_its_variance_and_forgets_at_its_own_pace():
    """Mean and covariance after steps of any length are those of exp(−|t|/ℓ)."""
    pixels, p = sensor(), {"emission.bias_time": torch.tensor([0.4], dtype=F64)}
    p["emission.bias_scale"] = torch.arange(1.0, 7.0, dtype=F64).reshape(3, 2)
    sd = pixels.initial_sd(p)
    assert sd.tolist() == [1, 1, 2, 2, 3, 3, 4, 4, 5, 5, 6, 6]
    factor, variance = torch.ones(12, dtype=F64), sd**2
    for step in (0.01, 0.5, 1e-9, 0.2):
        dt = torch.tensor([step], dtype=F64)
        mean, spread = pixels.next_mean(factor, dt, p), pixels.transition_sd(dt, p)
        variance = (mean / factor) ** 2 * variance + spread**2
        factor = mean
        torch.testing.assert_close(variance, sd**2)  # stationary
    torch.testing.assert_close(factor, torch.full((12,), float(np.exp(-(0.71 + 1e-9) / 0.4)), dtype=F64))
    single = {name: value.float() for name, value in p.items()}
    spread = pixels.transition_sd(torch.tensor([1e-9]), single)
    torch.testing.assert_close(spread, sd.float() * (2e-9 / 0.4) ** 0.5)  # in single precision, too: β √(2 δ/ℓ)


def test_states_of_the_model_go_on_as_the_sensor_says():
    model = model_of()
    x = some_states(model)
    own = slice(model.torque_size, model.torque_size + 12)
    before, after = x[:, own], model.transition(x, 2)
    pace = float(np.exp(-DT / model.parameters["emission.bias_time"].item()))
    torch.testing.assert_close(after.mean[:, own], pace * before)
    expected = model.parameters["emission.bias_scale"][0, 0] * (1 - pace**2) ** 0.5
    torch.testing.assert_close(after.stddev[:, own], expected.expand(4, 12))
    bare = model_of(lasting=False)
    assert bare.state_dim == model.state_dim - 12
    others = torch.cat([x[:, :4], x[:, 16:]], -1)
    moved = torch.cat([after.mean[:, :4], after.mean[:, 16:]], -1)
    torch.testing.assert_close(bare.transition_mean(others, 2), moved)


def test_a_clock_that_runs_ahead_shows_an_earlier_moment():
    """Against the model's own integration backwards; of third order are (20 ms)³/6 of a jerk near 10³ m/s³, 1 mm."""
    offset = 0.02
    model = model_of(timed=True, lasting=False)
    model = model.replace(**{"camera.offset": torch.tensor([0.0, offset, -offset], dtype=F64)})
    x = some_states(model)
    q, qd = model.split(x)[1:]
    seen = model.observation.of(model.observation.pixels, model.emission(x, 2).base_dist.loc).numpy()
    np.testing.assert_allclose(seen[:, 0], projected(model, x)[:, 0], rtol=0, atol=1e-9)
    for camera, sign in ((1, -1), (2, 1)):
        p, rest = model.body_parameters(), x[:, :4]
        there, rate = q, qd
        for _ in range(20):  # midpoint steps of 1 ms
            h = sign * offset / 20
            middle = there + h / 2 * rate, rate + h / 2 * model.dynamics.forward(there, rate, rest, p)
            there, rate = there + h * middle[1], rate + h * model.dynamics.forward(*middle, rest, p)
        expected = projected(model, torch.cat([rest, there, rate], -1))[:, camera]
        moved = np.abs(expected - projected(model, x)[:, camera])
        assert moved.max() > 5  # px, so that a clock without effect would be noticed
        np.testing.assert_allclose(seen[:, camera], expected, rtol=0, atol=0.05 * moved.max())


def test_a_pose_that_is_off_is_another_camera():
    model = model_of(posed=True, lasting=False)
    turn, shift = 0.05 * torch.randn(3, 3, dtype=F64), 0.1 * torch.randn(3, 3, dtype=F64)
    model = model.replace(**{"camera.turn": turn, "camera.shift": shift})
    x = some_states(model)
    cameras = []
    for camera, by, to in zip(CALIBRATION, turn.numpy(), shift.numpy(), strict=True):
        about = Rotation.from_rotvec(by).as_matrix()
        pose = about @ camera.rotation, about @ camera.translation + to
        cameras.append(type(camera)(camera.name, camera.matrix, camera.distortion, *pose, camera.size))
    seen = model.observation.of(model.observation.pixels, model.emission(x, 0).base_dist.loc)
    np.testing.assert_allclose(seen, projected(model, x, cameras), rtol=0, atol=1e-9)
    many = {name: value.expand(2, 1, *value.shape) for name, value in model.parameters.items()}
    torch.testing.assert_close(
        model.replace(**many).emission(x.expand(2, 4, -1), 0).base_dist.loc[1], model.emission(x, 0).base_dist.loc
    )


@pytest.mark.parametrize("lasting", [True, False])
def test_turns_that_are_states_are_cameras_turned_about_their_places(lasting):
    model = model_of(rotation_uncertain=True, lasting=lasting)
    x = some_states(model)
    memory = model.layout.parted(model.split(x)[0])[2]
    assert memory.shape[-1] == 9 + 12 * lasting
    turn = memory[:, -9:].unflatten(-1, (3, 3)).numpy()
    assert 0.003 < turn.std() < 0.03  # rad, .01
    seen = model.observation.of(model.observation.pixels, model.emission(x, 0).base_dist.loc).numpy()
    if lasting:
        seen = seen - memory[:, :12].unflatten(-1, (3, 2, 2)).numpy()
    for k, state in enumerate(x):
        cameras = []
        for camera, by in zip(CALIBRATION, turn[k], strict=True):
            about = Rotation.from_rotvec(by).as_matrix()
            pose = about @ camera.rotation, about @ camera.translation
            cameras.append(type(camera)(camera.name, camera.matrix, camera.distortion, *pose, camera.size))
        np.testing.assert_allclose(seen[k], projected(model, state[None], cameras)[0], rtol=0, atol=1e-9)
    after = model.transition(x, 2)
    own = slice(model.torque_size + 12 * lasting, model.torque_size + 12 * lasting + 9)
    torch.testing.assert_close(after.mean[:, own], x[:, own], rtol=DT / ROTATION_TIME, atol=0)  # they stay
    assert (after.stddev[:, own] > 0).all()
    assert (after.stddev[:, own] < 0.003 * model.parameters["camera.turn_scale"][0]).all()
    assert model.independent_sensor_states == ((list(range(4, 16)), list(range(12))) if lasting else None)


class Plain(ArmModel):
    independent_sensor_states = None


@pytest.mark.parametrize("rotation_uncertain", [False, True])
def test_slopes_of_independent_states_are_those_of_one_nudge_each(rotation_uncertain):
    model = model_of(Encoders(), rotation_uncertain=rotation_uncertain)
    assert model.independent_sensor_states == (list(range(4, 16)), list(range(12)))
    torch.manual_seed(1)
    path, y = model.simulate()
    plain = Plain.__new__(Plain)
    vars(plain).update(vars(model))
    for ours, theirs in zip(slopes_along(model, path), slopes_along(plain, path), strict=True):
        torch.testing.assert_close(ours, theirs, rtol=0, atol=1e-6)
    fits = []
    for each in (model, plain):
        # What lasts is linear: a fit over its spread is the fit without it, but that cubature points lie elsewhere.
        mode = gauss_newton(each, y, start=path)
        fits.append(posterior_linearisation(each, y, mode, 1))
    torch.testing.assert_close(fits[0].path, fits[1].path, rtol=0, atol=0.02)
    assert fits[0].log_evidence.item() == pytest.approx(fits[1].log_evidence.item(), abs=0.05)


def test_confidence_widens_each_view_by_its_own():
    rng = np.random.default_rng(0)
    confidence = rng.uniform(size=(STEPS, 3, 2))
    model = model_of(confidence=confidence, lasting=False, family="gaussian")
    slope = torch.full((6,), 1.5, dtype=F64)
    model = model.replace(**{"emission.pixel_confidence_slope": slope, "emission.pixel_confidence_drop": 0 * slope})
    sd = model.emission(some_states(model), 3).stddev[0].reshape(3, 2, 2)
    rank = (confidence <= confidence[3]).mean(0)  # of each view and keypoint among its own
    expected = 2.0 * np.exp(1.5 * (1 - rank))
    np.testing.assert_allclose(sd, np.repeat(expected[..., None], 2, -1), rtol=1e-12)


def test_what_does_not_fit_is_refused():
    with pytest.raises(ValueError, match="expected keypoints among elbow, wrist, got 'hand'"):
        sensor().__class__(**{**vars(sensor()), "sites": ("hand",)}).bound(arm())
    with pytest.raises(ValueError, match="expected a name for each of 3 cameras"):
        Pixels(pinhole(CALIBRATION), ("left",), torch.ones(3, 2), ("elbow",))
    with pytest.raises(ValueError, match="a name of its own"):
        Observation(sensor(), sensor())
    assert Observation(Keypoints([0]), sensor()).pixels is not None
