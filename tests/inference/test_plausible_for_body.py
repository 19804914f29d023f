"""A recording against a body: what is compared, and which lengths are only guessed."""

from dataclasses import replace

import numpy as np
import pytest
from robot_log import ARM, robot_log

from invdyn.inference.plausible_for_body import check_fits, put_right
from invdyn.inputs import load_body
from invdyn.models import dynamics_for, person
from invdyn.recordings import InputError, Recording, parse_units


@pytest.fixture(scope="module")
def film():
    log = robot_log(2.0).at(slice(None, None, 8))
    return replace(log, angles=None, torques=None, joint_names=())


def test_lengths_that_the_body_states_are_compared_and_guessed_ones_less_so(film):
    twice = film.scaled(2.0, "m")
    check_fits(film, ARM)
    with pytest.raises(InputError, match=r"base and elbow lie 0.6 m apart .*, but the body's link is 0.3 m"):
        check_fits(twice, ARM)
    check_fits(twice, ARM, guessed=True)
    check_fits(twice, replace(ARM, uncertainty={"length": 0.3}))


@pytest.mark.parametrize(
    ("factor", "words"), [(1e3, "look like ms"), (1 / 0.016, "look like frame numbers"), (1 / 600, "moves too fast")]
)
def test_a_recording_made_in_python_is_refused_as_a_file_is(film, factor, words):
    wrong = replace(film, time=np.round(film.time * factor, 9), name="mine")
    with pytest.raises(InputError, match=f"^mine: .*{words}.*--units s"):
        put_right(wrong, ARM)
    assert put_right(replace(wrong, units=parse_units("s")), ARM).time is not None  # who says so is believed


def test_degrees_taken_for_radians_are_refused_at_the_same_door():
    log = robot_log(1.0, camera=False)
    put_right(log, ARM)
    with pytest.raises(InputError, match="look like degrees: pass --units deg"):
        put_right(replace(log, angles=np.degrees(log.angles)), ARM)


def test_a_base_that_moves_is_compared_without_its_motion(film):
    """Between rows a train goes farther than an arm; along the arm nothing is odd."""
    train = np.stack([60.0 * film.time, np.zeros_like(film.time)], -1)[:, None]
    points = np.concatenate([train, film.keypoints + train], axis=1)
    carried = replace(film, keypoints=points, keypoint_names=("shoulder", *film.keypoint_names))
    assert put_right(carried, ARM).keypoint_names == carried.keypoint_names


def test_exchanged_names_are_refused_whether_lengths_are_guessed_or_not(film):
    exchanged = replace(film, keypoints=film.keypoints[:, ::-1])
    for guessed in (False, True):
        with pytest.raises(InputError, match="keypoints 'elbow' and 'wrist' seem to be exchanged"):
            check_fits(exchanged, ARM, guessed)


@pytest.fixture
def reach():
    """Shoulder, elbow and wrist (120, 3, 2) m, a bend of 1.3 ± .4 rad, of an arm a tenth and more off the table's."""
    time = np.linspace(0, 2, 120)
    bend = np.stack([np.sin(3 * time) - 1.2, np.sin(3 * time) + 0.1 + 0.4 * np.cos(4 * time)], axis=-1)
    links = np.array([[0.31], [0.345]]) * np.stack([np.cos(bend), np.sin(bend)], axis=-1)
    points = np.concatenate([np.zeros((120, 1, 2)), links.cumsum(1)], axis=1)
    return time, points + 0.001 * np.random.default_rng(0).normal(size=points.shape)


def test_exchanged_names_show_by_lengths_that_change_where_a_table_knows_them_roughly(reach):
    put_right(Recording(*reach, ("shoulder", "elbow", "wrist")), person(1.75, 70.0, "m"))
    with pytest.raises(InputError, match="'elbow' and 'wrist' seem to be exchanged"):
        put_right(Recording(*reach, ("shoulder", "wrist", "elbow")), person(1.75, 70.0, "m"))


def test_a_warning_names_a_keypoint_that_never_changes_unless_it_is_the_base(reach):
    """Where others have noise. A base may be given as a place."""
    time, points = reach
    points[:, 0], points[:, 1] = 0.0, points[0, 1]
    with pytest.warns(UserWarning, match=r"^elbow_[xy] never changes, to the last digit.*if elbow was not seen"):
        put_right(Recording(time, points, ("shoulder", "elbow", "wrist")), person(1.75, 70.0, "m"))


def test_the_order_of_columns_does_not_matter(film):
    """A recording that is built in Python may name its keypoints from the hand on."""
    other = replace(film, keypoints=film.keypoints[:, ::-1], keypoint_names=film.keypoint_names[::-1])
    check_fits(other, ARM)
    with pytest.raises(InputError, match="'elbow' and 'wrist' seem to be exchanged"):
        check_fits(replace(other, keypoints=film.keypoints), ARM)


def test_the_same_in_space():
    body = load_body("paper_spatial_arm")
    time = np.arange(0, 3, 0.02)
    rng = np.random.default_rng(0)
    angles = np.sin(time[:, None] * rng.uniform(1, 3, body.num_joints) + rng.uniform(-1, 1, body.num_joints))
    dynamics = dynamics_for(body)
    points = np.asarray(dynamics.keypoints(body.parameters().gravity.new_tensor(angles), body.parameters()))
    right = Recording(time, points, body.keypoint_names)
    check_fits(right, body)
    with pytest.raises(InputError, match="'elbow' and 'wrist' seem to be exchanged"):
        check_fits(replace(right, keypoints=points[:, ::-1]), body)
    with pytest.raises(InputError, match=r"elbow lies .* m from the base .* pass --set base"):
        check_fits(replace(right, keypoints=points + 3.0), body)
    with pytest.raises(InputError, match=r"wrist lies 3.56 m from the base .* check --units"):
        check_fits(right.scaled(2.0, "m"), body)
    check_fits(right.scaled(2.0, "m"), body, guessed=True)


def test_encoders_alone_of_a_body_in_space_have_no_keypoints_to_place():
    """A robot's log has keypoints of shape (T, 0, 2), whatever the body's dimensions."""
    body = load_body("paper_spatial_arm")
    time = np.arange(0, 3, 0.02)
    angles = 0.3 * np.sin(time[:, None] + np.arange(body.num_joints))
    log = Recording(time, np.empty((len(time), 0, 2)), (), angles=angles, joint_names=body.joint_names)
    check_fits(log, body)
    with pytest.raises(InputError, match=r"too fast|deg"):
        check_fits(replace(log, angles=np.degrees(angles)), body)
