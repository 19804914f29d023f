"""Relations that hold of a diagnosis whatever the right answer is: the same arm seen or written down in another way.

Metamorphic testing: Chen, Cheung & Yiu 1998. One recording of an arm whose elbow rubs is diagnosed with the few effects
that turn, mirror and scale with the arm; what is said of it is compared with what is said of its image. A search ends
where it gains no more than its tolerance, from starts that are rounded otherwise: that stays under `TOLERANCE`.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from pendulum import ARM, recording_of

from invdyn.diagnosis import diagnose
from invdyn.models import Body, load_body, planar_body
from invdyn.models.effects import EFFECTS
from invdyn.recordings import InputError, Recording, load, write_keypoint_csv

ONLY = ("viscous_friction", "joint_stiffness")
OTHERS = tuple(name for name in EFFECTS if name not in ONLY)
TOLERANCE = 1e-2
"""Of a probability, and of a parameter in its own sd."""
UNIX = 1.7e9


@dataclass(frozen=True)
class Said:
    """Causes by name with their probabilities, and the best one's parameters, (mean, sd) each."""

    probability: dict[str, float]
    parameters: dict[str, tuple[float, float]]


@cache
def rubbing() -> Recording:
    return recording_of(EFFECTS["viscous_friction"]("elbow"), ARM, rows=50, damping=0.05)


def said(recording, body: Body = ARM, **options) -> Said:
    """What a diagnosis says, by names."""
    causes = diagnose(recording, body, without=OTHERS, **options).to_json()["causes"]

    def name(effect: dict) -> str:
        return f"{effect['effect']}.{effect['joint']}"

    best = {
        f"{name(effect)}.{key}": (value["mean"], value["sd"])
        for effect in causes[0]["effects"]
        for key, value in effect["parameters"].items()
    }
    probability = {" + ".join(map(name, each["effects"])): each["probability"] for each in causes}
    return Said(probability, best)


@cache
def plainly() -> Said:
    found = said(rubbing())
    assert max(found.probability, key=found.probability.__getitem__) == "viscous_friction.elbow"
    return found


def assert_same(found: Said, expected: Said, factor: float = 1.0, tolerance: float = TOLERANCE) -> None:
    """The same causes as likely, and the same numbers, in a unit that is ``factor`` times smaller."""
    likely = {name for name, value in expected.probability.items() if value > tolerance}
    for name in likely | {name for name, value in found.probability.items() if value > tolerance}:
        mine, other = found.probability.get(name, 0.0), expected.probability.get(name, 0.0)
        assert mine == pytest.approx(other, abs=tolerance), name
    assert found.parameters.keys() == expected.parameters.keys()
    for name, (mean, sd) in expected.parameters.items():
        mine, its = found.parameters[name]
        assert mine == pytest.approx(factor * mean, abs=tolerance * factor * sd), name
        assert its == pytest.approx(factor * sd, rel=10 * tolerance), name


def with_encoders(recording: Recording) -> Recording:
    """The recording with the angles that its keypoints show, so that they are given in both ways."""
    links = np.diff(np.concatenate([np.zeros_like(recording.keypoints[:, :1]), recording.keypoints], 1), axis=1)
    absolute = np.unwrap(np.arctan2(links[..., 1], links[..., 0]), axis=0)
    return replace(recording, angles=np.diff(absolute, axis=1, prepend=0.0))


def rotated(points: np.ndarray, by: float) -> np.ndarray:
    c, s = np.cos(by), np.sin(by)
    return points @ np.array([[c, s], [-s, c]])


def test_rows_in_another_order_are_refused(tmp_path):
    order = np.random.default_rng(0).permutation(rubbing().num_frames)
    with pytest.raises(InputError, match="runs backwards"):
        rubbing().at(order)
    write_keypoint_csv(rubbing(), tmp_path / "log.csv")
    header, *rows = (tmp_path / "log.csv").read_text().splitlines()
    (tmp_path / "log.csv").write_text("\n".join([header, *(rows[k] for k in order)]) + "\n")
    with pytest.raises(InputError, match="runs backwards"):
        load(tmp_path / "log.csv", joints=ARM.joint_names)


@pytest.mark.long
def test_seconds_since_1970_change_nothing():
    """float64 has .2 µs of them, so that rows come a little early or late."""
    shifted = replace(rubbing(), time=rubbing().time + UNIX)
    assert_same(said(shifted), plainly())


@pytest.mark.long
def test_gravity_and_recording_that_turn_together_change_nothing():
    by = 0.7
    log = with_encoders(rubbing())
    turned = replace(log, keypoints=rotated(log.keypoints, by), angles=np.add(log.angles, [by, 0.0]))
    body = replace(ARM, gravity=tuple(rotated(np.array(ARM.gravity), by)))
    assert_same(said(turned, body), said(log))


@pytest.mark.long
def test_an_arm_twice_as_long_under_twice_the_gravity_has_four_times_the_torques():
    """Times stay, √(L/g); masses stay, so that inertias and torques grow with the square of lengths."""
    large = planar_body(
        "arm",
        [replace(link, length=2 * link.length) for link in ARM.links],
        gravity=tuple(2 * np.array(ARM.gravity)),
    )
    log = rubbing()
    assert_same(said(replace(log, keypoints=2 * log.keypoints, torques=4 * log.torques), large), plainly(), factor=4.0)


@pytest.mark.slow
def test_a_mirror_image_has_the_same_friction():
    log = with_encoders(rubbing())
    mirrored = replace(
        log,
        keypoints=log.keypoints * [-1, 1],
        angles=np.array([np.pi, 0.0]) - log.angles,
        torques=-log.torques,
    )
    assert_same(said(mirrored), said(log))


@pytest.mark.long
def test_the_order_of_keypoints_and_of_joints_does_not_matter():
    log = with_encoders(rubbing())
    other = replace(
        log,
        keypoints=log.keypoints[:, ::-1],
        keypoint_names=log.keypoint_names[::-1],
        angles=log.angles[:, ::-1],
        torques=log.torques[:, ::-1],
        joint_names=log.joint_names[::-1],
    )
    assert_same(said(other), said(log), tolerance=1e-9)


@pytest.mark.long
def test_names_are_only_names():
    names = {"shoulder": "j1", "elbow": "j2", "wrist": "end"}
    links = [
        replace(link, name=f"l{k}", joint=names[link.joint.name], tip=names[link.tip])
        for k, link in enumerate(ARM.links)
    ]
    log = replace(rubbing(), keypoint_names=("j2", "end"), joint_names=("j1", "j2"))
    found = said(log, planar_body("other", links, gravity=ARM.gravity))

    def renamed(each: dict) -> dict:
        return {key.replace("j1", "shoulder").replace("j2", "elbow"): value for key, value in each.items()}

    assert_same(Said(renamed(found.probability), renamed(found.parameters)), plainly(), tolerance=1e-9)


@pytest.mark.long
@pytest.mark.parametrize(("unit", "length", "time"), [("ms", 1.0, 1e3), ("mm", 1e3, 1.0)])
def test_units_of_a_file_are_only_units(tmp_path, unit, length, time):
    log = rubbing()
    changed = replace(log, time=time * log.time, keypoints=length * log.keypoints)
    write_keypoint_csv(changed, tmp_path / "log.csv")
    read = load(tmp_path / "log.csv", keypoints=ARM.keypoint_names, joints=ARM.joint_names, units=unit)
    write_keypoint_csv(log, tmp_path / "si.csv")
    plain = load(tmp_path / "si.csv", keypoints=ARM.keypoint_names, joints=ARM.joint_names)
    assert_same(said(read), said(plain))


@pytest.mark.slow
def test_two_workers_say_what_one_says():
    assert said(rubbing(), workers=2) == plainly()


MJCF = """<mujoco><worldbody><body name="upper_arm"><joint name="shoulder" axis="0 -1 0"/>
<inertial pos=".15 0 0" mass="1.5" diaginertia="1e-5 .01125 .01125"/>
<body name="forearm" pos=".3 0 0"><joint name="elbow" axis="0 -1 0"/>
<inertial pos=".125 0 0" mass="1" diaginertia="1e-5 .0052083333333 .0052083333333"/>
<site name="wrist" pos=".25 0 0"/></body></body></worldbody></mujoco>"""
URDF = """<robot name="arm"><link name="base"/>
<link name="upper_arm"><inertial><origin xyz=".15 0 0"/><mass value="1.5"/>
<inertia ixx="1e-5" iyy=".01125" izz=".01125" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="forearm"><inertial><origin xyz=".125 0 0"/><mass value="1"/>
<inertia ixx="1e-5" iyy=".0052083333333" izz=".0052083333333" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="wrist"/>
<joint name="shoulder" type="continuous"><parent link="base"/><child link="upper_arm"/><axis xyz="0 -1 0"/></joint>
<joint name="elbow" type="continuous"><parent link="upper_arm"/><child link="forearm"/><origin xyz=".3 0 0"/>
<axis xyz="0 -1 0"/></joint>
<joint name="tip" type="fixed"><parent link="forearm"/><child link="wrist"/><origin xyz=".25 0 0"/></joint></robot>"""


@pytest.mark.long
@pytest.mark.parametrize("suffix", ["toml", "xml", "urdf"])
def test_a_body_is_the_same_in_all_files(tmp_path, suffix):
    path = tmp_path / f"arm.{suffix}"
    if suffix == "toml":
        ARM.to_toml(path)
    else:
        path.write_text(MJCF if suffix == "xml" else URDF)
    assert_same(said(rubbing(), load_body(path)), plainly())


@pytest.mark.long
def test_columns_of_single_precision_are_enough():
    log = rubbing()
    short = replace(log, **{name: getattr(log, name).astype(np.float32) for name in ("time", "keypoints", "torques")})
    assert_same(said(short), plainly())


@pytest.mark.long
def test_a_recording_in_two_files_says_what_one_says():
    """The second file begins in a state, and after commands, that nothing tells: less is known, and the same."""
    log, middle = rubbing(), rubbing().num_frames // 2
    found, whole = said([log.select(0, middle), log.select(middle)]), plainly()
    (name,) = whole.parameters
    mean, sd = whole.parameters[name]
    mine, its = found.parameters[name]
    assert abs(mine - mean) < 2 * its  # of one truth, and of nearly the same data
    assert sd < its < 4 * sd
    assert max(found.probability, key=found.probability.__getitem__) == "viscous_friction.elbow"
