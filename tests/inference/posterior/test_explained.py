"""An answer that does not explain its recording says so first, with the row where it begins."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
import torch

from invdyn.inference import infer
from invdyn.inference.filters.filtering import SMCOptions
from invdyn.inference.task import prepare
from invdyn.inputs import load_body
from invdyn.models import Link, OrnsteinUhlenbeck, dynamics_for, planar_body
from invdyn.models.bodies.joint_parts import JointParts, Motor
from invdyn.recordings import InputError, Recording, load
from invdyn.summary import summary_text

TIME = np.arange(90) / 30


def arm(**more):
    links = [("upper_arm", "shoulder", "elbow", 0.3, 2.0), ("forearm", "elbow", "wrist", 0.26, 1.5)]
    chain = [Link(name, joint, tip=tip, length=length, mass=mass, **more) for name, joint, tip, length, mass in links]
    return planar_body("arm", chain, gravity=(0.0, -9.81))


def swing(lengths=(0.3, 0.26), speed=1.0, noise=0.002, seed=0):
    raised = -1.2 + 0.6 * np.sin(3.0 * speed * TIME)
    bent = raised + 0.8 + 0.5 * np.sin(4.0 * speed * TIME + 1.0)
    steps = [
        np.asarray(length)[..., None] * np.stack([np.cos(a), np.sin(a)], -1)
        for length, a in zip(lengths, (raised, bent), strict=True)
    ]
    points = np.cumsum(np.stack(steps, 1), 1)
    points = points + noise * np.random.default_rng(seed).standard_normal(points.shape)
    return Recording(TIME, points, ("elbow", "wrist"), name="swing")


ONE = {"torque": OrnsteinUhlenbeck()}
"""One process of torques: of the default's several, each is fitted, and none is what these tests ask about."""


def doubts(recording, body, **options):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        task = prepare(recording, body, options=SMCOptions(), seed=0, **ONE, **options)
    found = task.record.get("in_doubt", [])
    said = [str(each.message) for each in caught]
    assert said[len(said) - len(found) :] == found
    return found


def test_a_right_recording_is_explained():
    assert doubts(swing(), arm()) == []


def test_links_that_change_their_lengths_from_a_row_on():
    """The forearm turns out of the plane after a second and a half."""
    shorter = np.where(TIME > 1.5, 0.1, 0.26)
    first, *_ = doubts(swing((0.3, shorter)), arm())
    assert first.startswith("not explained: from row ")
    row = int(first.split("row ")[1].split()[0])
    assert 40 <= row <= 50
    assert "wrist is off what this body can do" in first
    assert "leaves the plane" in first


def test_torques_that_no_limb_has():
    """A person's arm that swings seven times as fast has fifty times the torque; a rough prior follows it."""
    (line,) = [each for each in doubts(swing(speed=7.5, noise=1e-4), arm()) if "torque" in each]
    assert "no limb of this size is known to exceed" in line
    assert " N·m" in line


def test_torques_that_a_motor_does_not_give():
    parts = JointParts(motor=Motor(low=-2.0, high=2.0))
    lines = doubts(swing(), arm(parts=parts))
    assert any("the torque of shoulder reaches" in line and "its motor gives -2 to 2 N·m" in line for line in lines)
    assert doubts(swing(), arm(parts=JointParts(motor=Motor(low=-30.0, high=30.0)))) == []


def test_it_is_said_before_anything_else():
    with pytest.warns(UserWarning, match="not explained: from row"):
        idata = infer(swing((0.3, np.where(TIME > 1.5, 0.1, 0.26))), arm(), method="laplace", num_filters=2, **ONE)
    assert summary_text(idata).startswith("not explained: from row ")


def test_pixels_on_a_body_of_another_unit_are_refused(with_human_arm):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the real one has places that are written again
        recording = load("human-arm")
    with pytest.raises(InputError, match=r"lie .* px apart .* scale the keypoints to the body's unit"):
        infer(recording, load_body("human_arm_on_table"))
    with pytest.raises(InputError, match="check --units"):
        infer(replace(swing(), keypoints=1000 * swing().keypoints), arm())


def test_what_is_made_in_python_is_repaired_too():
    recording = swing()
    points = recording.keypoints.copy()
    points[40:50] = [[-0.25, 0.3], [-0.4, 0.1]]  # somebody else's
    points[60:62] = -9.0
    wrong = replace(recording, keypoints=points)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        task = prepare(wrong, arm(), options=SMCOptions(), seed=0, **ONE)
    said = "\n".join(str(each.message) for each in caught)
    assert "elbow is at (-9, -9) in 2 of 90 rows: taken to be missing" in said
    assert "keypoints jump together" in said
    assert np.isnan(task.problem.observations[40:50].numpy()).all()
    assert "in_doubt" not in task.record


def test_a_torque_that_is_stated_to_be_zero_and_is_not():
    """An arm that is moved; its shoulder holds some 5 N·m."""
    (line,) = [each for each in doubts(swing(), arm(), passive=True) if "shoulder has a torque" in each]
    assert "where none is stated" in line
    assert not any("is stated" in each for each in doubts(swing(), arm()))


def test_an_arm_that_swings_freely_has_none():
    dynamics, numbers = dynamics_for(arm()), arm().parameters()
    state = torch.tensor([[-0.6, 0.4], [0.0, 0.0]], dtype=torch.float64)
    none, step, angles = torch.zeros(2, dtype=torch.float64), 1 / 1200, []
    for _ in range(60):
        angles.append(state[0])
        for _ in range(40):
            q, v = state
            middle = q + step / 2 * v, v + step / 2 * dynamics.forward(q, v, none, numbers)
            state = state + step * torch.stack([middle[1], dynamics.forward(*middle, none, numbers)])
    points = dynamics.keypoints(torch.stack(angles), numbers).numpy()
    points = points + 0.005 * np.random.default_rng(0).standard_normal(points.shape)
    recording = Recording(TIME[:60], points, ("elbow", "wrist"))
    assert doubts(recording, arm(), passive=True) == []
