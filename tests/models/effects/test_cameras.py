"""What the camera sees, against closed forms along a known motion."""

import math

import numpy as np
import pytest
import torch
from scipy.stats import multivariate_normal
from variants import nonideal

from invdyn.diagnosis.catalogue import CATALOGUE
from invdyn.models import Keypoints, Observation
from invdyn.models.effects import (
    CameraLatency,
    CameraRoll,
    CameraScale,
    CameraYaw,
    ClockRate,
    CoulombFriction,
    KeypointOffset,
    LensDistortion,
    RollingShutter,
    SoftTissue,
    TimestampJitter,
    VaryingNoise,
)

F64 = torch.float64


def tips(model, x, t=5):
    """Mean and standard deviation of the tips, (..., 2, 2)."""
    emission = model.emission(x, t).base_dist
    return tuple(value[..., :4].reshape(*value.shape[:-1], 2, 2).numpy() for value in (emission.loc, emission.scale))


def later(model, x, seconds, t=5, *, held=False):
    """The tips after so many seconds of the model's own motion from row ``t`` on, its command ``held`` or not."""
    return model.dynamics.keypoints(moved(model, x, seconds, t, held=held)[0], model.body_parameters()).numpy()


def moved(model, x, seconds, t=5, *, since=0.0, held=False):
    """Angles and velocities then, from ``since`` s after the row on."""
    steps = 256
    z, q, qd = model.split(x)
    body = model.body_parameters()
    h = seconds / steps
    for i in range(steps):
        now = model.time[t] + since + (i + 0.5) * h
        row = t if held else int(torch.searchsorted(model.time, now, right=True)) - 1
        torque = z[..., :2] + model.motors.mean[row]
        middle = q + h / 2 * qd
        half = qd + h / 2 * model.dynamics.forward(q, qd, torque, body)
        qd = qd + h * model.dynamics.forward(middle, half, torque, body)
        q = q + h * half
    return q, qd


@pytest.fixture
def seen(arm, having, states):
    """(what an effect makes of the tips, its noise, the true tips, the states, the ideal arm)."""

    def look(effect, **values):
        ideal = arm(2)
        x = states(ideal, 6)
        return *tips(having(ideal, effect, **values), x), tips(ideal, x)[0], x, ideal

    return look


def test_an_offset_turns_with_its_link(seen):
    found, _, true, x, _ = seen(KeypointOffset("tip1"), along=0.02, across=-0.01)
    phi = x[:, 2:4].sum(-1).numpy()
    turn = np.stack([np.cos(phi), np.sin(phi)], -1), np.stack([-np.sin(phi), np.cos(phi)], -1)
    assert found[:, 1] == pytest.approx(true[:, 1] + 0.02 * turn[0] - 0.01 * turn[1])
    assert found[:, 0] == pytest.approx(true[:, 0])


def test_scale_roll_and_lens(seen):
    found, _, true, _, _ = seen(CameraScale(), scale=1.05)
    assert found == pytest.approx(1.05 * true)
    found, _, true, _, _ = seen(CameraRoll(), angle=0.3)
    x, y = true[..., 0], true[..., 1]
    c, s = math.cos(0.3), math.sin(0.3)
    assert found == pytest.approx(np.stack([c * x - s * y, s * x + c * y], -1))
    found, _, true, _, _ = seen(LensDistortion(), k1=-0.3)
    assert found == pytest.approx(true * (1 - 0.3 * (true**2).sum(-1, keepdims=True)))


def test_yaw_is_a_pinhole_camera(seen):
    """The plane's points in space, turned about the vertical, through a pinhole at D, on a plane through the origin."""
    found, _, true, _, _ = seen(CameraYaw(), angle=0.2, distance=1.5)
    x, y = true[..., 0], true[..., 1]
    space = np.stack([x * math.cos(0.2), y, 1.5 + x * math.sin(0.2)], -1)  # the last: depth from the camera
    assert found == pytest.approx(1.5 * space[..., :2] / space[..., 2:])


@pytest.mark.parametrize(
    ("kind", "values"),
    [
        (CameraScale, {"scale": 1.05}),
        (CameraRoll, {"angle": 0.3}),
        (CameraYaw, {"angle": 0.2, "distance": 1.5}),
        (LensDistortion, {"k1": -0.3}),
    ],
)
def test_optics_about_any_centre(kind, values, arm, having, states):
    """As about the origin, of an arm whose base is moved against it."""
    centre = np.array([0.1, -0.25])
    ideal = arm(2)
    x = states(ideal, 6)
    soft = nonideal(kind())
    found, _ = tips(having(ideal, soft, **values, centre_x=centre[0], centre_y=centre[1]), x)
    moved = ideal.replace(**{"body.base": ideal.parameters["body.base"] - torch.as_tensor(centre)})
    expected, _ = tips(having(moved, kind(), **values), x)
    assert found == pytest.approx(expected + centre)
    centred = CATALOGUE.of(soft).start(soft, values)
    assert tips(having(ideal, soft, **centred), x)[0] == pytest.approx(tips(having(ideal, kind(), **values), x)[0])


def test_under_latency_a_state_is_that_of_the_picture(arm, having, states):
    """The camera shows it, the motors move it on by what they did before, and the encoders show what came after."""
    ideal = arm(2)
    x = states(ideal, 6)
    x[:, :2] = 0.0
    for latency, off in ((0.004, 5e-3), (0.008, 5e-3), (0.03, 0.02)):
        model = having(ideal, CameraLatency(), latency=latency)
        found, plain = model.emission(x, 5).mean, ideal.emission(x, 5).mean
        assert torch.equal(found[:, :4], plain[:, :4])
        now, _ = moved(ideal, x, latency, since=-latency)
        # A delayed command is a straight line within each row, which is nearly what it was.
        assert (found[:, 4:] - now).abs().max() < off * (plain[:, 4:] - now).abs().max()
        next_one = torch.cat(moved(ideal, x, 0.01, since=-latency), -1)
        step, on_time = (m.transition(x, 6).mean[:, 2:] for m in (model, ideal))
        assert (step - next_one).abs().max() < 0.02 * (on_time - next_one).abs().max()


def test_soft_tissue_lags_the_acceleration(seen):
    found, _, true, x, ideal = seen(SoftTissue("tip1"), kappa=1e-3)
    h = 1e-4
    bent = (later(ideal, x, h) - 2 * true + later(ideal, x, -h)) / h**2  # the command jumps at the row
    assert found[:, 1] - true[:, 1] == pytest.approx(-1e-3 * bent[:, 1], rel=2e-3, abs=2e-5)
    assert found[:, 0] == pytest.approx(true[:, 0])


def test_skin_slides_as_the_joint_at_the_tip_turns(seen):
    values = {"along_per_rad": 0.02, "across_per_rad": -0.01, "along": 0.003, "across": 0.001}
    for tip, joint in ((0, 1), (1, 1)):
        found, _, true, x, ideal = seen(SoftTissue(f"tip{tip}", "sliding"), **values)
        q = ideal.split(x)[1].numpy()
        heading, angle = q[:, : tip + 1].sum(-1), q[:, joint]
        u = np.stack([np.cos(heading), np.sin(heading)], -1)
        shift = (0.003 + 0.02 * angle)[:, None] * u + (0.001 - 0.01 * angle)[:, None] * u[:, ::-1] * [-1, 1]
        true[:, tip] += shift
        assert found == pytest.approx(true)


@pytest.mark.parametrize(("readout", "rest"), [(0.02, 2e-4), (0.06, 2e-2)])
def test_a_rolling_shutter_sees_a_point_when_its_row_is_read(seen, readout, rest):
    """p' = p(t + ρ y'), checked by reading the motion at that very moment."""
    found, _, true, x, ideal = seen(RollingShutter(), readout=readout)
    for n in range(len(x)):
        for k in range(2):
            then = later(ideal, x[n], readout * found[n, k, 1])[k]
            assert np.abs(found[n, k] - then).max() < rest * np.abs(found[n, k] - true[n, k]).max() + 1e-6


@pytest.mark.parametrize("timing", [CameraLatency(), RollingShutter()])
def test_timing_beside_many_values_of_another_effect(arm, states, timing):
    """Sets (S, 1, 1) of a friction's torque beside one latency: each set as by itself."""
    friction = CoulombFriction("joint0")
    model, name = arm(2).with_effects(timing, friction), "effect.coulomb_friction.joint0.torque"
    known = {n: torch.full((1,), 0.02, dtype=F64) for n in model.parameters if n.startswith(f"effect.{timing.name}")}
    x, rows, torques = states(model, 4), torch.arange(4, 8), (0.05, 0.1, 0.3)
    many = model.replace(**known, **{name: torch.tensor(torques, dtype=F64).reshape(-1, 1, 1)})
    each = [model.replace(**known, **{name: torch.full((1,), t, dtype=F64)}).emission(x, rows).mean for t in torques]
    torch.testing.assert_close(many.emission(x, rows).mean, torch.stack(each))


def test_jitter_is_a_mixture_that_widens_along_the_motion(arm, having, states):
    h, rate, sd = 1e-5, 0.3, 0.004
    ideal = arm(2)
    model, x = having(ideal, TimestampJitter(), rate=rate, sd=sd), states(ideal, 5)
    velocity = (later(ideal, x, h, held=True) - later(ideal, x, -h, held=True)) / (2 * h)
    wide = 3e-5
    acceleration = (later(ideal, x, wide) + later(ideal, x, -wide) - 2 * later(ideal, x, 0.0)) / wide**2
    own = ideal.parameters["emission.keypoint_scale"].numpy()[:, None]
    plain = ideal.emission(x, 5)
    y = plain.mean + 0.01
    residual = (y - plain.mean)[..., :4].unflatten(-1, (2, 2)).numpy()
    delta = sd / rate**0.5
    gained = []
    for each, v, a in zip(residual, velocity, acceleration, strict=True):
        alone = np.diag(np.repeat(own.ravel() ** 2, 2))
        beside = np.diag((0.75**0.5 * delta**2 * a).ravel() ** 2)
        mistimed = alone + beside + delta**2 * np.outer(v, v)  # both keypoints by the same time
        on_time, late = (multivariate_normal(np.zeros(4), c).logpdf(each.ravel()) for c in (alone, mistimed))
        gained.append(np.logaddexp(np.log(1 - rate) + on_time, np.log(rate) + late) - on_time)
    assert (model.emission(x, 5).log_prob(y) - plain.log_prob(y)).numpy() == pytest.approx(gained, rel=1e-4)


def test_blur_widens_the_noise(seen):
    h = 1e-5
    found, sd, true, x, ideal = seen(VaryingNoise(), slope=0.7)
    velocity = (later(ideal, x, h, held=True) - later(ideal, x, -h, held=True)) / (2 * h)
    own = ideal.parameters["emission.keypoint_scale"].numpy()[:, None]
    speed = np.linalg.norm(velocity, axis=-1, keepdims=True)
    assert found == pytest.approx(true)
    assert sd == pytest.approx(np.broadcast_to(own * (1 + 0.7 * speed), sd.shape), rel=1e-5)


def test_noise_may_grow_with_the_speed_of_the_joints(seen):
    """Of all keypoints alike, whatever their own speed."""
    found, sd, true, x, ideal = seen(VaryingNoise("joints"), slope=0.3)
    own = ideal.parameters["emission.keypoint_scale"].numpy()[:, None]
    speed = np.linalg.norm(x[..., -ideal.body.num_joints :].numpy(), axis=-1)[..., None, None]
    assert found == pytest.approx(true)
    assert sd == pytest.approx(np.broadcast_to(own * (1 + 0.3 * speed), sd.shape), rel=1e-5)


def test_noise_of_a_single_joint_has_one_law(arm):
    """Its speed is the keypoint's."""
    forms = [[effect.form for effect in VaryingNoise.everywhere(arm(n).body, ())] for n in (1, 2)]
    assert forms == [[None, "confidence"], [None, "confidence", "joints"]]


def test_noise_grows_as_the_tracker_gets_unsure(arm, having, states):
    """Of tips that are tracked; where nobody says how sure it was, nothing changes."""
    confidence = np.full((12, 2), 0.9)
    confidence[5] = 0.4, np.nan
    ideal = arm(2, observation=Observation(Keypoints([1, 0], confidence=confidence)))
    x = states(ideal, 6)
    (points, sd), (same, own) = (
        tips(model, x) for model in (having(ideal, VaryingNoise("confidence"), slope=3.0), ideal)
    )
    assert points == pytest.approx(same)
    assert sd / own == pytest.approx(np.broadcast_to([[1 + 3.0 * 0.6], [1.0]], sd.shape))
    assert tips(having(ideal, VaryingNoise("confidence"), slope=3.0), x, 4)[1] / tips(ideal, x, 4)[1] == pytest.approx(
        1.3
    )
    plain = arm(2, observation=Observation(Keypoints([0, 1])))
    assert tips(having(plain, VaryingNoise("confidence"), slope=3.0), x)[1] == pytest.approx(tips(plain, x)[1])


def test_a_fast_clock_shortens_the_steps(arm, having, states):
    """True time = stated time / rate, for the state and for the torque process alike."""
    ideal = arm(2)
    model = having(ideal, ClockRate(), rate=1.25)
    fast = arm(2, step=0.008)
    x = states(ideal, 6)
    torch.testing.assert_close(model.transition_mean(x, 4), fast.transition_mean(x, 4))
    torch.testing.assert_close(model.transition(x, 4).base_dist.scale, fast.transition(x, 4).base_dist.scale)
    assert model.emission(x, 4).mean == pytest.approx(ideal.emission(x, 4).mean)


def test_markers_then_timing_then_optics(arm, states):
    """An offset is scaled with the picture, in whatever order they are named."""
    ideal = arm(2)
    values = {"keypoint_offset.tip1.along": 0.02, "camera_scale.scale": 1.1}
    found = []
    for effects in ((CameraScale(), KeypointOffset("tip1")), (KeypointOffset("tip1"), CameraScale())):
        model = ideal.with_effects(*effects)
        found.append(model.replace(**{f"effect.{k}": torch.tensor([v], dtype=F64) for k, v in values.items()}))
    x = states(ideal, 6)
    (first, _), (second, _), (true, _) = (tips(model, x) for model in (*found, ideal))
    assert first == pytest.approx(second)
    phi = x[:, 2:4].sum(-1).numpy()
    assert first[:, 1] == pytest.approx(1.1 * (true[:, 1] + 0.02 * np.stack([np.cos(phi), np.sin(phi)], -1)))
