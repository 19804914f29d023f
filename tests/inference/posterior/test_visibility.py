"""What keypoints cannot tell of a pose is named, and stays within its prior."""

import numpy as np
import pytest
import torch
from scenes import looking, ring

from invdyn.inference import METHODS, SMCOptions, arm_problem
from invdyn.inference.posterior.cameras import pinhole
from invdyn.inference.posterior.visibility import unseen_lines, visibility
from invdyn.models import ArmModel, Body, Encoders, Joint, Keypoints, Link, Observation, Pixels, dynamics_for
from invdyn.recordings import Recording
from invdyn.recordings.cameras import Calibration
from invdyn.summary import summary_text

NOISE = 0.005


def arm(last="hinge"):
    """A ball shoulder, and an elbow that bends about z; or a wrist that turns too."""
    inertia = (0.002, 0.015, 0.015, 0, 0, 0)
    links = [
        Link("upper", Joint("shoulder", "ball"), length=0.3, tip="elbow", mass=2.0, inertia=inertia),
        Link("fore", Joint("elbow"), parent="upper", length=0.25, tip="wrist", mass=1.0, inertia=inertia),
    ]
    if last == "roll":
        axis = (1.0, 0.0, 0.0)
        links.append(
            Link("hand", Joint("pronation", axis=axis), parent="fore", mass=0.3, com=(0.05, 0, 0), inertia=inertia)
        )
    return Body("arm", links)


def model(tree, *sensors, steps=1):
    return ArmModel(tree, 0.03 * np.arange(max(steps, 2)), Observation(*(sensors or [Keypoints(["elbow", "wrist"])])),
                    parameters={"emission.keypoint_scale": NOISE} if not sensors else {})  # fmt: skip


def pose(*values):
    return torch.tensor([values, values], dtype=torch.float64)


@pytest.mark.parametrize(("bend", "smallest"), [(60.0, 0.25), (10.0, 0.25), (0.0, 0.0)])
def test_the_smallest_singular_value_is_the_twist_of_the_arm(bend, smallest):
    """Twisting the upper arm moves the wrist by .25 sin(bend), and nothing else does so: the value is at most that."""
    own = model(arm())
    values, unseen = visibility(own, torch.zeros(2, 6), pose(0.2, 0.3, 0.1, np.deg2rad(bend)))
    assert values.max() <= smallest * np.sin(np.deg2rad(bend)) + 1e-12
    assert (values.max() > 0.4 * smallest * np.sin(np.deg2rad(bend))) == (bend > 0)
    assert unseen.tolist() == [[False, False, bend == 0, False]] * 2


def test_a_row_without_its_wrist_tells_less():
    rows = torch.zeros(2, 6)
    rows[1, 3:] = torch.nan
    _, unseen = visibility(model(arm()), rows, pose(0.2, 0.3, 0.1, 1.0))
    assert unseen.tolist() == [[False] * 4, [False, False, True, True]]


def test_encoders_tell_every_joint():
    values, unseen = visibility(model(arm("roll"), Encoders()), torch.zeros(2, 5), pose(0.2, 0.3, 0.1, 1.0, 0.0))
    assert not unseen.any()
    assert not values.any()  # of sites, as its name says


def before(*cameras, tree=None, sites=("elbow", "wrist")):
    sizes = torch.tensor([camera.size for camera in cameras], dtype=torch.float64)
    pixels = Pixels(pinhole(Calibration(cameras, metric=True)), tuple(each.name for each in cameras), sizes, sites)
    return model(tree or arm(), pixels)


@pytest.mark.parametrize("bend", [1.0, 0.0])
def test_pixels_of_two_cameras_tell_what_points_do(bend):
    at = pose(0.2, 0.3, 0.1, bend)
    by_points = visibility(model(arm()), torch.zeros(2, 6), at)
    by_pixels = visibility(before(*ring(2)), torch.zeros(2, 8), at)
    np.testing.assert_allclose(by_pixels[0], by_points[0], rtol=0, atol=1e-12)
    assert by_pixels[1].tolist() == by_points[1].tolist() == [[False, False, bend == 0, False]] * 2


def test_pixels_that_are_missing_tell_nothing():
    rows = torch.zeros(2, 8)
    rows[1, [2, 3, 6, 7]] = torch.nan  # the wrist, in both cameras
    _, unseen = visibility(before(*ring(2)), rows, pose(0.2, 0.3, 0.1, 1.0))
    assert unseen.tolist() == [[False] * 4, [False, False, True, True]]


def test_what_lasts_of_a_trackers_error_hides_what_it_drowns():
    own = before(*ring(2))
    drowned = own.replace(**{"emission.bias_scale": 1e5 * torch.ones_like(own.parameters["emission.bias_scale"])})
    at = pose(0.2, 0.3, 0.1, 1.0)
    assert not visibility(own, torch.zeros(2, 8), at)[1].any()
    assert visibility(drowned, torch.zeros(2, 8), at)[1].all()


def test_one_camera_does_not_see_what_moves_along_its_line_of_sight():
    """From 3 m it sees a tip that points at it move sideways, but not where the line touches the tip's circle."""
    hinge = Body("hinge", [Link("a", Joint("j"), length=0.3, tip="wrist", mass=1.0)])
    own = before(looking("level", (3.0, 0.0, 0.0), (0.0, 0.0, 0.0)), tree=hinge, sites=("wrist",))
    at = torch.tensor([[0.0], [np.arccos(0.3 / 3.0)]], dtype=torch.float64)
    _, unseen = visibility(own, torch.zeros(2, 2), at)
    assert unseen.tolist() == [[False], [True]]


def test_it_says_how_often():
    unseen = np.zeros((10, 3), dtype=bool)
    unseen[:, 1], unseen[:3, 2] = True, True
    always, at_times = unseen_lines(unseen, ("a", "b", "c"))
    assert always.startswith("b: no keypoint tells it: what is said")
    assert at_times == "c: no keypoint tells it in 30% of the rows: there the prior speaks"


def test_a_last_links_own_twist_is_named_and_bounded():
    tree, time = arm("roll"), 0.03 * np.arange(20)
    q = np.array([0.2, 0.3, 0.1, 1.0, 0.0]) + 0.3 * np.sin(np.outer(time, [3.0, 4.0, 5.0, 6.0, 0.0]))
    points = dynamics_for(tree).keypoints(torch.as_tensor(q), tree.parameters()).numpy()
    points = points + NOISE * np.random.default_rng(0).normal(size=points.shape)
    recording = Recording(time=time, keypoints=points, keypoint_names=("elbow", "wrist"))
    problem = arm_problem(recording, tree, parameters={"emission.keypoint_scale": NOISE}, substeps=1)
    idata = METHODS["laplace"](problem, options=SMCOptions(num_filters=20, num_draws=10))
    assert idata["constant_data"]["unseen"].sum("time").values.tolist() == [0, 0, 0, 0, 20]
    assert idata.attrs["unseen"].startswith("pronation: no keypoint tells it")
    assert "pronation: no keypoint tells it" in summary_text(idata)
    torque = idata["posterior"]["torque"].sel(joint="pronation")
    prior = problem.model.torque.stationary(problem.model.dt[1:2], problem.model.parameters)[-1].item()
    assert float(torque.std(("chain", "draw")).mean()) == pytest.approx(prior, rel=0.25)  # 200 draws, 20 rows
    assert np.isfinite(idata["posterior"]["angle"]).all()
