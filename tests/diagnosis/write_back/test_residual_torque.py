"""A torque that no catalogue has is closed on a log that nobody has fitted: by process, table and callback."""

import mujoco
import numpy as np
import pytest
from robot_xml import robot

from invdyn.diagnosis import residual_torque
from invdyn.diagnosis.write_back.residual_torque import _fitted
from invdyn.models import Body
from invdyn.recordings import InputError, Recording

pytestmark = pytest.mark.filterwarnings("ignore:.*clockwise")
RATE, NOISE = 100, 2e-4


@pytest.fixture(scope="module")
def model():
    return mujoco.MjModel.from_xml_string(robot())


@pytest.fixture(scope="module")
def body(model):
    with pytest.warns(UserWarning, match="clockwise"):
        return Body.load(model, filmed=False)


def lacking(q, qd):
    """N m at the elbow: a bump in the angle, and a drag that is no polynomial."""
    return 0.25 * np.exp(-0.5 * ((q - 0.1) / 0.2) ** 2) - 0.1 * np.sin(3 * qd)


def play(model, seed, seconds, added=None):
    """Controls (T, 2) and angles (T, 2) as the file counts, with what ``added`` puts into the data before each step."""
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    time = np.arange(round(seconds * RATE)) / RATE
    rate = 2 * np.pi * np.array([[0.4, 0.9], [0.6, 1.3]])
    control = np.sin(time[:, None, None] * rate + rng.uniform(0, 6.28, (2, 2))).sum(-1) * [2.0, 0.08]
    angle = np.empty((len(time), 2))
    for row, given in enumerate(control):
        angle[row] = data.qpos
        data.ctrl[:] = given
        for _ in range(round(1 / RATE / model.opt.timestep)):
            if added is not None:
                added(model, data)
            mujoco.mj_step(model, data)
    return time, control, angle


def real(model, data):
    data.qfrc_applied[1] = lacking(data.qpos[1], data.qvel[1])


def recorded(model, body, seed, seconds, added=real):
    time, control, angle = play(model, seed, seconds, added)
    sign, zero = (np.array([getattr(own, key) for own in body.joint_parts]) for key in ("sign", "zero"))
    seen = zero + sign * (angle + NOISE * np.random.default_rng(seed).standard_normal(angle.shape))
    torque = sign * control * model.actuator_gear[:, 0]
    names = body.joint_names
    return Recording(time, np.empty((len(time), 0, 2)), (), angles=seen, torques=torque, joint_names=names)


@pytest.fixture(scope="module")
def found(model, body):
    return residual_torque(recorded(model, body, 0, 12.0), body)


def test_it_is_the_torque_that_is_missing_and_at_its_joint_alone(found, model):
    _, _, angle = play(model, 1, 6.0, real)
    q, qd = angle[:, 1], np.gradient(angle[:, 1], 1 / RATE)
    true = lacking(q, qd)
    mean, sd = found.joints["elbow"](q, qd)
    assert np.sqrt(((mean - true) ** 2).mean()) < 0.5 * np.sqrt((true**2).mean())
    assert (np.abs(mean - true) < 1.645 * sd).mean() > 0.9
    assert found.joints["shoulder"].size == 0


def test_the_engine_with_its_callback_follows_a_log_that_nobody_has_fitted(found, model):
    *_, truth = play(model, 1, 6.0, real)
    off = [np.sqrt(((play(model, 1, 6.0, each)[2] - truth) ** 2).mean()) for each in (None, found.control(model))]
    assert off[1] < 0.5 * off[0]


def test_the_table_says_first_that_it_is_no_cause_and_has_the_callbacks_numbers(found, model, tmp_path):
    found.to_csv(tmp_path / "residual.csv", points=5)
    lines = (tmp_path / "residual.csv").read_text().splitlines()
    assert lines[0].startswith("# no cause")
    assert lines[1] == "joint,q,qd,torque,sd"
    data, callback = mujoco.MjData(model), found.control(model)
    rows = [line.split(",") for line in lines[2:]]
    assert len(rows) == 2 * 25
    for name, *numbers in rows[-25:]:
        q, qd, torque, sd = map(float, numbers)
        data.qpos[1], data.qvel[1] = q, qd
        callback(model, data)
        assert name == "elbow"
        assert data.qfrc_applied[1] == pytest.approx(torque, abs=1e-5)
        assert sd > 0


def test_far_from_the_log_it_returns_to_zero_and_its_band_to_its_size(found):
    elbow = found.joints["elbow"]
    mean, sd = elbow(40.0, 0.0)
    assert abs(mean) < 1e-6
    assert sd == pytest.approx(np.hypot(elbow.size, elbow.error))


def test_a_simulation_that_lacks_nothing_has_none(model, body):
    clean = residual_torque(recorded(model, body, 2, 12.0, None), body)
    assert all(each.size == 0 for each in clean.joints.values())


def test_of_few_rows_it_is_the_exact_gaussian_process():
    """All rows are points: mean cᵀ (C + I/ρ)⁻¹ y, variance s² (1 − cᵀ (C + I/ρ)⁻¹ c) besides the errors'."""
    rng = np.random.default_rng(1)
    x = rng.standard_normal((90, 2))
    y = np.sin(x[:, 0]) + 0.1 * rng.standard_normal(90)
    own, at = _fitted(x, y), rng.standard_normal((7, 2))

    def kernel(one, other):
        return np.exp(-0.5 * (((one[:, None] - other) / own.lengths) ** 2).sum(-1))

    whole, near = kernel(x, x) + (own.error / own.size) ** 2 * np.eye(90), kernel(at, x)
    mean, sd = own(*at.T)
    np.testing.assert_allclose(mean, near @ np.linalg.solve(whole, y), atol=1e-3)
    left = own.size**2 * (1 - (near * np.linalg.solve(whole, near.T).T).sum(-1))
    np.testing.assert_allclose(sd**2, left + own.error**2, rtol=1e-3)


def test_a_joint_that_misses_exactly_nothing_has_none():
    angles = np.random.default_rng(0).standard_normal((200, 2))
    assert _fitted(angles, np.zeros(200)).size == 0


def test_unknown_torques_are_refused(model, body):
    log = recorded(model, body, 0, 1.0)
    names = log.joint_names
    unknown = Recording(log.time, log.keypoints, (), angles=log.angles, joint_names=names)
    with pytest.raises(InputError, match="expected recordings with the torques"):
        residual_torque(unknown, body)
