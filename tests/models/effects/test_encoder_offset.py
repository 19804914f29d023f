"""An encoder that counts from elsewhere: against MuJoCo with a servo that follows it, and as a diagnosis finds it."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from servo_in_mujoco import servo_log, servo_mjcf

from invdyn.diagnosis.diagnose import diagnose
from invdyn.diagnosis.report.sentences import details, verdict
from invdyn.models import ArmModel, Body, Encoders, Keypoints, Link, Observation, planar_body
from invdyn.models.effects import EFFECTS, CameraLatency, EncoderOffset
from invdyn.recordings import Recording
from invdyn.simulate import random_arm, record

OFF = 0.03  # rad
RIVALS = {"encoder_offset", "gravity_tilt", "joint_stiffness", "camera_roll"}  # that may look alike
BENCH = planar_body(
    "bench arm",
    [
        Link("upper_arm", joint="shoulder", tip="elbow", length=0.30, mass=1.5),
        Link("forearm", joint="elbow", tip="wrist", length=0.25, mass=1.0),
    ],
    gravity=(0.0, -9.81),
)


def shown(model, x, t=3):
    """What the encoders show, (..., K)."""
    return model.observation.of(model.observation.encoders, model.emission(x, t).mean)


def test_its_own_joint_reads_more_and_the_camera_sees_the_same(arm, states):
    ideal = arm(2, observation=Observation(Keypoints([0, 1]), Encoders()))
    model = ideal.with_effects(EncoderOffset("joint1"))
    model = model.replace(**{"effect.encoder_offset.joint1.offset": torch.tensor([OFF], dtype=torch.float64)})
    x, rows = states(ideal, 5), torch.arange(5)
    more = model.emission(x, rows).mean - ideal.emission(x, rows).mean
    expected = torch.zeros(5, 6, dtype=torch.float64)
    expected[:, -1] = OFF
    torch.testing.assert_close(more, expected, rtol=0, atol=1e-12)
    # without a servo nothing follows it
    torch.testing.assert_close(model.transition_mean(x, 3), ideal.transition_mean(x, 3), rtol=0, atol=0)


def test_it_adds_to_an_encoder_that_is_ahead(arm, states):
    ideal = arm(2, observation=Observation(Keypoints([0, 1]), Encoders()))
    late = {"effect.camera_latency.latency": torch.tensor([0.02], dtype=torch.float64)}
    off = {"effect.encoder_offset.joint0.offset": torch.tensor([OFF], dtype=torch.float64)}
    x = states(ideal, 5)
    one = ideal.with_effects(CameraLatency()).replace(**late)
    both = ideal.with_effects(EncoderOffset("joint0"), CameraLatency()).replace(**late, **off)
    expected = shown(one, x) + torch.tensor([OFF, 0.0], dtype=torch.float64)
    torch.testing.assert_close(shown(both, x), expected, rtol=0, atol=1e-12)
    assert (shown(one, x) - shown(ideal, x)).abs().max() > 1e-3


def target(time):
    return 0.4 * np.sin(4 * time) + 0.3 * np.sin(9 * time)


def servo_with_offset(path, rows: int, more: float = OFF, limits: str = "") -> tuple[Body, Recording]:
    """A robot whose servo follows an encoder that shows ``more``: MuJoCo's is told so much less, and the log has it."""
    file = servo_mjcf("RK4", 0.1, kp=8, kv=0.5).replace('kp="8"', f'kp="8" {limits}')
    path.write_text(file)
    body = Body.load(path)
    log = servo_log(file, body, lambda time: target(time) - more, rate=100, rows=rows)
    sign, servo = body.joint_parts[0].sign, body.joint_parts[0].servo
    off = sign * more  # as the body counts
    return body, Recording(
        log.time,
        log.keypoints,
        (),
        angles=log.angles + off,
        torques=log.torques + servo.gain * off,
        joint_names=log.joint_names,
    )


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:.*clockwise")
@pytest.mark.parametrize("limits", ["", 'forcerange="-1.2 .9"'])
def test_a_servo_that_follows_it_moves_as_in_mujoco(tmp_path, limits):
    body, log = servo_with_offset(tmp_path / "robot.xml", 100, 10 * OFF, limits)
    model = ArmModel(body, log.time, Observation(Encoders()), command=log.torques, substeps=10)
    missed = {}
    for off in (0.0, body.joint_parts[0].sign * 10 * OFF):
        played = model.with_effects(EncoderOffset("elbow"))
        played = played.replace(**{"effect.encoder_offset.elbow.offset": torch.tensor([off], dtype=torch.float64)})
        states = torch.zeros(len(log.time), played.state_dim, dtype=torch.float64)
        states[0, -2] = float(log.angles[0, 0]) - off
        for row in range(1, len(log.time)):
            states[row] = played.transition_mean(states[row - 1], row)
        missed[bool(off)] = np.abs(shown(played, states).numpy() - log.angles).max()
    assert missed[True] < 2e-3 < 0.02 < missed[False]


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:.*clockwise")
def test_a_servos_encoder_is_found(tmp_path):
    """With all of the catalogue beside it; friction, springs, and a gain are none of it."""
    body, log = servo_with_offset(tmp_path / "robot.xml", 300)
    found = diagnose(log, body, most=1)
    (finding,) = max(found.causes, key=lambda cause: cause.probability).effects
    assert finding.key == "encoder_offset.elbow"
    assert finding.parameters["offset"].mean == pytest.approx(body.joint_parts[0].sign * OFF, abs=0.004)


@pytest.mark.quick("elbow-False")
@pytest.mark.filterwarnings("ignore:.*the torques miss")  # by much
@pytest.mark.parametrize(("joint", "filmed"), [("shoulder", True), ("shoulder", False), ("elbow", False)])
def test_of_encoders_alone_the_first_one_may_be_tilted_gravity(joint, filmed):
    arm = random_arm(BENCH, duration=2.0, fps=50, noise=0.002, commanded=True, encoder_noise=1e-3)
    value = {f"effect.encoder_offset.{joint}.offset": torch.tensor([3 * OFF], dtype=torch.float64)}
    whole = record(arm.with_effects(EncoderOffset(joint)).replace(**value))[0]
    nothing = np.empty((len(whole.time), 0, 2))
    log = whole if filmed else replace(whole, keypoints=nothing, keypoint_names=())
    found = diagnose(log, BENCH, most=1, without=[name for name in EFFECTS if name not in RIVALS])
    best = max(found.causes, key=lambda cause: cause.probability)
    alike = {key for group in found.ambiguity_set for key in group}
    if filmed or joint == "elbow":
        assert [finding.key for finding in best.effects] == [f"encoder_offset.{joint}"]
        assert best.effects[0].parameters["offset"].mean == pytest.approx(3 * OFF, abs=0.004)
        assert found.where.side["observation"] > 0.9
        assert found.where.joints[joint] > 0.9
        assert not any(found.where.keypoints.values())
        assert f"an encoder offset at the {joint}" in verdict(found)
        assert f"at the {joint}" in details(found)[0]
    else:
        assert alike == {"encoder_offset.shoulder", "gravity_tilt"}
