"""What the blind check's encoders read."""

import numpy as np
import pytest

from invdyn.blindcheck.camera import readings
from invdyn.blindcheck.cases import make_case
from invdyn.blindcheck.world import Trajectory

TIME = np.arange(1001) * 1e-3
Q = np.stack([np.sin(3 * TIME), np.cos(4 * TIME)], -1)
REAL = Trajectory(TIME, Q, np.gradient(Q, TIME, axis=0), np.zeros((1001, 3, 2)), np.cumsum(Q, 1), TIME[:1], Q[:1])


def test_one_encoder_shows_more_and_the_others_the_angles():
    when = np.array([0.0105, 0.4, 0.99])
    true = np.stack([np.sin(3 * when), np.cos(4 * when)], -1)
    np.testing.assert_allclose(readings(REAL, when, []), true, atol=1e-5)
    off = readings(REAL, when, [("encoder_offset", 1, {"offset": 0.05})])
    np.testing.assert_allclose(off, true + np.array([0.0, 0.05]), atol=1e-5)


@pytest.mark.quick("pinocchio")
@pytest.mark.parametrize("engine", ["mujoco", "pinocchio"])
def test_a_case_has_encoders_and_shows_it(engine):
    """Keypoints say where the arm is, so that the encoder of one joint reads the offset more, all along."""
    case = make_case(3, "commanded", "encoder_offset", engine)
    (entry,) = case.answer["effects"]
    assert entry["side"] == "observation"
    joint, off = case.answer["joints"].index(entry["joint"]), entry["parameters"]["offset"]["value"]
    assert np.radians(1) <= abs(off) < np.radians(8)
    recording, tips = case.recording, case.recording.keypoints[:, -len(case.answer["joints"]) :]
    seen = np.isfinite(tips).all((1, 2)) & np.isfinite(recording.angles).all(1)
    base = np.broadcast_to(np.array(case.answer["body"]["base"]), (len(tips), 1, 2))
    links = np.diff(np.concatenate([base, tips], 1), axis=1)[seen]
    headings = np.unwrap(np.arctan2(links[..., 1], links[..., 0]), axis=0)
    apart = recording.angles[seen] - np.diff(headings, axis=1, prepend=0.0)
    apart = np.angle(np.exp(1j * apart)).mean(0)  # pictures do not tell whole turns
    sd = 2 * case.answer["noise"]["keypoint_sd"] / np.linalg.norm(links, axis=-1).min() / np.sqrt(seen.sum())
    expected = np.zeros(len(case.answer["joints"]))
    expected[joint] = off
    assert np.abs(apart - expected).max() < 5 * sd + 1e-3
    assert entry["dprime"] > 30
