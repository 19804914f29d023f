"""Inverse kinematics of trees: the right points, the plainest of the aliases, through gaps and strays."""

import math

import numpy as np
import pytest
import torch
from trees import mobile_arm, panda, paper_arm, random_tree

from invdyn.models import Body, Encoders, Joint, Keypoints, Link, Observation, dynamics_for
from invdyn.models.inverse_kinematics import beyond
from invdyn.models.kinematics import AGILITY, joint_angle_candidates

STEP, NOISE = 0.02, 0.002
STEADY = AGILITY.index(4.0)


def ball_and_hinge():
    links = [
        Link("upper", Joint("s", "ball"), length=0.3, tip="elbow", mass=2, inertia=(0.002, 0.015, 0.015, 0, 0, 0)),
        Link("fore", Joint("e"), parent="upper", length=0.25, tip="wrist", mass=1.0),
    ]
    return Body("ball and hinge", links)


def swing(tree, steps=80, seed=1):
    """Coordinates (T, K) of a motion through each joint's own sine."""
    rng, time = np.random.default_rng(seed), STEP * np.arange(steps)[:, None]
    K = tree.num_joints
    return 0.4 * rng.normal(size=K) + 0.7 * np.sin(time * rng.uniform(1, 3, K) + rng.uniform(0, 6, K))


def points_of(tree, q):
    return dynamics_for(tree).keypoints(torch.as_tensor(q), tree.parameters())


def found(tree, rows, *sensors):
    observation = Observation(*(sensors or [Keypoints(range(len(tree.keypoint_names)))])).bound(tree)
    levers = dynamics_for(tree).levers(tree.parameters()).numpy()
    time = STEP * np.arange(len(rows))
    return joint_angle_candidates(tree, time, rows, observation, tree.parameters(), 1.5 * NOISE / levers)


def noisy(points, seed=0):
    rng = np.random.default_rng(seed)
    return points.flatten(-2) + NOISE * torch.as_tensor(rng.normal(size=points.flatten(-2).shape))


@pytest.mark.parametrize(
    "tree", [paper_arm(), ball_and_hinge(), panda(), mobile_arm(), random_tree(5, 5)], ids=lambda tree: tree.name
)
def test_the_points_are_those_that_were_seen(tree):
    points = points_of(tree, swing(tree))
    paths = found(tree, noisy(points))
    assert paths.shape == (len(AGILITY), 80, tree.num_joints)
    off = min(np.sqrt((points_of(tree, path) - points).square().mean().item()) for path in paths)
    assert off < 1.2 * NOISE  # of seven coordinates that one point tells of, nothing is averaged away


def test_of_the_aliases_the_plainest_is_taken():
    """Yaw + π and π − pitch turn the link over: the elbow's yaw and pitch change sign, and all points are the same."""
    arm = paper_arm()
    q = swing(arm)
    assert beyond(arm, q[0]) == 0
    alias = np.stack([q[:, 0] + math.pi, math.pi - q[:, 1], -q[:, 2], -q[:, 3]], -1)
    points = points_of(arm, q)
    assert torch.allclose(points, points_of(arm, alias))
    assert beyond(arm, alias[0]) == 1
    off = found(arm, noisy(points))[STEADY] - q
    # A point off by σ turns a link of 1 m by σ rad, and a forearm that hangs on it by more.
    assert np.abs(off).max() < 15 * NOISE


def test_the_same_rotation_of_a_ball_is_one_too():
    tree = ball_and_hinge()
    pose = np.array([0.3, 0.4, -0.2, 0.9])
    alias = np.array([0.3 + math.pi, math.pi - 0.4, -0.2 + math.pi, 0.9])
    assert torch.allclose(points_of(tree, pose), points_of(tree, alias))
    assert (beyond(tree, pose), beyond(tree, alias)) == (0, 1)


def test_gaps_are_bridged_and_strays_left_out():
    arm = paper_arm()
    q = swing(arm)
    rows = noisy(points_of(arm, q))
    rows[20:24] = torch.nan
    rows[40, :3] += 0.8
    rows[:3, 3:] = torch.nan
    off = found(arm, rows)[STEADY] - q
    assert np.abs(np.delete(off, [*range(18, 26), *range(4)], axis=0)).max() < 0.1


def test_encoders_count_turns_and_keypoints_do_the_rest():
    arm = paper_arm()
    q = swing(arm) + np.array([4 * math.pi, 0.0, 0.0, 0.0])
    rows = torch.cat([noisy(points_of(arm, q)), torch.as_tensor(q)], -1)
    rows[:, 6 + 1 :] = torch.nan  # the first joint's yaw alone is encoded
    off = found(arm, rows, Keypoints([0, 1]), Encoders())[STEADY] - q
    assert np.abs(off - off.mean(0)).max() < 0.1
    assert abs(off.mean(0)[0]) < 0.05


def test_nothing_seen_tells_nothing():
    assert found(paper_arm(), torch.full((5, 6), torch.nan)) is None
