"""Charts chosen from the data: a hanging arm whose yaw axis is vertical, and what must not be rotated."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from trees import paper_arm

from invdyn.inference import METHODS, SMCOptions, arm_problem, infer
from invdyn.inference.posterior.charts import chosen, frame_for, pitches, poles
from invdyn.models import Body, Joint, Link, dynamics_for
from invdyn.recordings import Recording
from invdyn.summary import summary_text

T, NOISE = 40, 0.005
TIME = 0.03 * np.arange(T)
ROD = (0.002, 0.015, 0.015, 0, 0, 0)


def hanging(tree, seed=0):
    """A recording of a two-link arm that hangs about its vertical, and swings: directions that no angles made."""
    swing = np.stack([0.35 * np.sin(4 * TIME), 0.3 * np.cos(5 * TIME)], -1)
    upper = np.concatenate([swing, -np.ones((T, 1))], -1)
    fore = np.concatenate([swing[:, ::-1] + 0.5, -np.ones((T, 1))], -1)
    upper, fore = (each / np.linalg.norm(each, axis=-1, keepdims=True) for each in (upper, fore))
    lengths = [link.length for link in tree.links]
    points = np.stack([lengths[0] * upper, lengths[0] * upper + lengths[1] * fore], 1)
    points += NOISE * np.random.default_rng(seed).normal(size=points.shape)
    return Recording(time=TIME, keypoints=points, keypoint_names=tree.keypoint_names)


def ball_and_hinge():
    links = [
        Link("upper", Joint("shoulder", "ball"), length=0.6, tip="elbow", mass=2.0, inertia=ROD),
        Link(
            "fore", Joint("elbow", axis=(0.0, 1.0, 0.0)), parent="upper", length=0.5, tip="wrist", mass=1.0, inertia=ROD
        ),
    ]
    return Body("ball and hinge", links)


@pytest.mark.parametrize("tree", [paper_arm(), ball_and_hinge()], ids=lambda tree: tree.name)
def test_a_hanging_arm_is_rotated_away_from_the_pole(tree):
    recording = hanging(tree)
    problem = arm_problem(recording, tree, parameters={"emission.keypoint_scale": NOISE}, substeps=1)
    assert problem.notes[0].startswith("shoulder: its motion comes to a pitch of")
    idata = METHODS["laplace"](problem, options=SMCOptions(num_filters=4, num_draws=4))
    angle = idata["posterior"]["angle"].mean(("chain", "draw")).values
    assert pitches(problem.model.body, angle)["shoulder"] < 45
    off = idata["posterior"]["position"].mean(("chain", "draw")).values - recording.keypoints
    assert np.sqrt((off**2).mean()) < 2 * NOISE  # tip space: the same points
    assert "shoulder: its motion comes to a pitch of" in summary_text(idata)


def test_coordinates_that_others_use_stay_and_the_pole_is_reported():
    tree = paper_arm()
    known = {"initial.angle": [0.0, np.pi / 2, 0.0, 0.0], "emission.keypoint_scale": NOISE}
    known |= {"torque.scale": 1.0, "torque.decay": 1.0}
    sizes = {"num_filters": 4, "num_draws": 4, "substeps": 1}
    with pytest.warns(UserWarning, match="shoulder: its motion passes a pitch of 80°") as caught:
        idata = infer(hanging(tree), tree, method="laplace", settings=known, **sizes)
    (reported,) = (str(each.message) for each in caught)
    assert reported in summary_text(idata).splitlines()
    # 4 ° off the vertical at least, so that no rotation was put in between
    assert idata["constant_data"]["rotation"].values == pytest.approx(np.tile(np.eye(3), (2, 1, 1)))


def test_a_joint_that_turns_everywhere_is_rotated_once_and_its_pole_is_reported():
    """Directions round three great circles: each axis is some direction's, within 35°, and no chart is good."""
    around = np.linspace(-np.pi, np.pi, 100)
    level = np.stack([around, 0 * around], -1)
    over = [np.stack([np.full(100, yaw), around], -1) for yaw in (0.0, np.pi / 2)]
    yaw, pitch = np.concatenate([level, *over]).T
    roll = np.zeros_like(yaw)
    path = np.stack([yaw, pitch, roll, roll], -1)
    tree = ball_and_hinge()
    rotated, said = chosen(tree, lambda _: path)  # what would be read off the rotated one is as steep
    assert len(said) == 1
    assert poles(rotated, path) == [line for line in poles(rotated, path) if line.startswith("shoulder: its motion")]
    assert len(poles(rotated, path)) == 1


def test_a_motion_far_from_the_pole_keeps_the_files_frame():
    tree = paper_arm()
    q = np.array([0.3, 0.2, 0.5, -0.4]) * np.sin(3 * TIME[:, None] + np.arange(4))
    assert chosen(tree, lambda _: q) == (tree, [])


def test_a_mechanism_stays_the_mechanism_it_is():
    """A hinge on a stick's end makes its twist count, and so does a weight beside its axis."""
    steep = np.tile([0.0, 1.5, 0.2], (5, 1))
    upper = Link("upper", Joint("shoulder", "universal"), length=0.6, tip="elbow", mass=2.0)
    fore = Link("fore", Joint("elbow"), parent="upper", length=0.5, tip="wrist", mass=1.0)
    for links in ([upper, fore], [replace(upper, com=(0.3, 0.02, 0.0), inertia=ROD), fore]):
        tree = Body("arm", links)
        assert chosen(tree, lambda _: steep) == (tree, [])


@pytest.mark.parametrize("chart", ["zyx", "xyz", "yzx"])
def test_the_frame_puts_the_pole_across_the_motion_and_zero_in_its_middle(chart):
    rng = np.random.default_rng(0)
    middle = np.array([0.2, -0.3, -0.9]) / np.linalg.norm([0.2, -0.3, -0.9])
    directions = middle + 0.4 * rng.normal(size=(50, 3)).clip(-1, 1)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    frame = frame_for(directions, chart)
    assert frame @ frame.T == pytest.approx(np.eye(3))
    assert np.linalg.det(frame) == pytest.approx(1)
    zero = frame[:, "xyz".index(chart[2])]
    pole = frame[:, "xyz".index(chart[0])]
    others = rng.normal(size=(500, 3))
    others /= np.linalg.norm(others, axis=1, keepdims=True)
    assert np.abs(directions @ pole).max() < np.abs(others @ directions.T).max(1).min() + 0.05
    assert zero @ directions.mean(0) > 0.9 * np.linalg.norm(directions.mean(0))


def test_a_turned_ball_is_the_same_ball():
    """The link's frame in the parent's is what it was, at other angles; so are its energies."""
    tree = ball_and_hinge()
    q = np.array([[0.4, 1.4, -0.3, 0.5]])
    rotated, _ = chosen(tree, lambda each: q if each is tree else None)
    frame = np.array(rotated.links[0].rotation)
    other = np.concatenate(
        [(Rotation.from_matrix(frame).inv() * Rotation.from_euler("ZYX", q[0, :3])).as_euler("ZYX"), q[0, 3:]]
    )
    one, two = (
        dynamics_for(body).keypoints(torch.as_tensor(pose), body.parameters())
        for body, pose in ((tree, q[0]), (rotated, other))
    )
    assert torch.allclose(one, two, atol=1e-12)
