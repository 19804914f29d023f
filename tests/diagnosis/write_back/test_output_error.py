"""The output-error fit of an MJCF's numbers: parity with the written file, recovery, seeds, and what is refused."""

import copy
from pathlib import Path

import mujoco
import numpy as np
import pytest
from far_servos import FILE, NOISE, STATED, TRUE, log

from invdyn.diagnosis.rules import FIXED
from invdyn.diagnosis.write_back.changes import IMPEDANCE, Z_90, FileChange
from invdyn.diagnosis.write_back.engine_replays import Replays, windows
from invdyn.diagnosis.write_back.file_numbers import FileNumbers
from invdyn.diagnosis.write_back.output_error import OutputError, refined, split
from invdyn.diagnosis.write_back.write_back import rewritten
from invdyn.models import Body


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """The file as stated, and the body that it says."""
    path = tmp_path_factory.mktemp("arm") / "arm.xml"
    path.write_text(FILE.format(**STATED))
    return str(path), Body.load(path)


@pytest.fixture(scope="module")
def fit(arm):
    """The fit to 72 s of two logs: nine windows, of which three are held out."""
    path, body = arm
    return refined([log(body, 1850, 1), log(body, 1850, 2)], path, body, (), draws=24, seed=3)


def value(fit, place, quantity):
    """A change by its place and quantity."""
    return next(each for each in fit.changes if (each.place, each.quantity) == (place, quantity))


def test_a_model_of_numbers_is_the_compiled_copy_of_its_changes(arm):
    path, body = arm
    numbers = FileNumbers(path, body)
    rng = np.random.default_rng(0)
    z = numbers.mean + 0.3 * numbers.sd * rng.standard_normal(len(numbers.mean))
    new, unsaid = rewritten(Path(path).read_bytes(), path, body, numbers.changes(z, z[None]))
    assert not unsaid
    copy, built = mujoco.MjModel.from_xml_string(new.decode()), numbers.model(z)
    for name in ("dof_damping", "dof_frictionloss", "dof_armature", "dof_solimp", "actuator_gainprm"):
        np.testing.assert_allclose(getattr(built, name), getattr(copy, name), rtol=1e-5, err_msg=name)
    for name in ("actuator_biasprm", "body_mass", "body_ipos", "dof_invweight0"):
        np.testing.assert_allclose(getattr(built, name), getattr(copy, name), rtol=1e-5, atol=1e-9, err_msg=name)
    np.testing.assert_allclose(np.sort(built.body_inertia), np.sort(copy.body_inertia), rtol=1e-5)


def test_numbers_of_the_file_change_nothing(arm):
    numbers = FileNumbers(*arm)
    assert numbers.changes(numbers.mean, numbers.mean[None]) == ()


def test_a_damping_that_changes_is_moved_from_its_servo_into_the_joint(arm):
    """MuJoCo's Euler steps a joint's own damping implicitly."""
    numbers = FileNumbers(*arm)
    z = numbers.mean.copy()
    z[[n.quantity == "damping" and n.place == "shoulder" for n in numbers.numbers]] += np.log(1.5)
    drag = numbers.body.joint_parts[0].servo_damping
    changed = {(each.place, each.quantity): (each.before, each.after) for each in numbers.changes(z, z[None])}
    whole = changed["shoulder", "damping"][0] + drag
    assert drag > 0
    assert changed == {
        ("shoulder", "damping"): (whole - drag, pytest.approx(1.5 * whole)),
        ("shoulder", "servo damping"): (drag, 0.0),
    }


LIGHT = """<mujoco><option timestep="0.002"/><worldbody><body><joint name="finger" axis="0 -1 0" damping="0.6"
frictionloss="0.05" armature="0.03"/><geom type="capsule" fromto="0 0 0 0.05 0 0" size="0.005" mass="0.01"/></body>
</worldbody><actuator><position name="finger" joint="finger" kp="1000" kv="2.7"/></actuator></mujoco>"""


POLE = """<mujoco><option timestep="0.002"/><worldbody><body name="arm" pos="0 0 1"><joint name="shoulder"
axis="0 -1 0" damping="0.15" armature="0.002" frictionloss="0.05"/>
<inertial pos="0 0 -0.15" mass="0.8" diaginertia="0.006 0.006 0.0004"/>
<body name="pole" pos="0 0 -0.3"><joint name="elbow" axis="0 -1 0" damping="0.01"/><inertial pos="0 0 -0.2" mass="0.4"
diaginertia="0.004 0.004 0.0002"/><site name="tip" pos="0 0 -0.4"/></body></body></worldbody>
<actuator><motor name="m" joint="shoulder" {drive}/></actuator></mujoco>"""


def test_a_light_joint_rests_where_it_sticks_at_any_time_step(tmp_path):
    """In its servo the same damping shakes it loose at 2 ms, and it creeps to where the servo pulls."""
    path, rest = tmp_path / "finger.xml", []
    path.write_text(LIGHT)
    numbers = FileNumbers(str(path), Body.load(path))
    found = {"damping": np.log(1.2), "friction": np.log(0.3), "armature": np.log(1e-3), "servo gain": np.log(0.02)}
    found[IMPEDANCE] = np.log(3e-5)
    z = np.array([found.get(each.quantity, each.mean) for each in numbers.numbers])
    for step in (0.0005, 0.002):
        model = numbers.model(z)
        model.opt.timestep = step
        data = mujoco.MjData(model)
        data.ctrl[0] = 0.1
        mujoco.mj_step(model, data, round(2 / step))
        rest.append(data.qpos[0])
    assert rest[0] == pytest.approx(0.1 - 0.3 / 20, abs=0.005)
    assert rest[1] == pytest.approx(rest[0], abs=5e-4)


@pytest.mark.parametrize("more", [(), ("mass", "com", "inertia")])
def test_a_planar_link_and_what_a_regression_changes_besides_are_in_the_file(tmp_path, more):
    """A pole 20 % heavier at its own moments or with them, and friction that its joint without a motor has."""
    pole, path = POLE.format(drive=""), tmp_path / "pole.xml"
    path.write_text(pole)
    body = Body.load(path)
    filed = {"mass": 0.4, "com": 0.2, "inertia": 0.004}
    found = [FileChange("elbow", "friction", 0.0, 0.02, (0.01, 0.03), "N·m", "coulomb_friction.elbow")]
    found += [
        FileChange("pole", what, filed[what], 1.2 * filed[what], (0.0, 1.0), "", "inertial_error.pole") for what in more
    ]
    numbers = FileNumbers(str(path), body, found)
    z = numbers.mean
    changed = numbers.changes(z, z[None])
    assert {(c.place, c.quantity, round(c.after, 9)) for c in changed} == {
        (c.place, c.quantity, round(c.after, 9)) for c in found
    }
    new, unsaid = rewritten(pole.encode(), str(path), body, changed)
    assert not unsaid
    written, built = mujoco.MjModel.from_xml_string(new.decode()), numbers.model(z)
    for name in ("body_mass", "body_ipos", "body_inertia", "dof_frictionloss"):
        np.testing.assert_allclose(getattr(built, name), getattr(written, name), rtol=1e-6, atol=1e-12, err_msg=name)
    np.testing.assert_array_equal(numbers.filed.body_mass, mujoco.MjModel.from_xml_string(pole).body_mass)


def test_a_replay_of_the_true_file_is_off_by_noise_alone(arm, tmp_path):
    path = tmp_path / "true.xml"
    path.write_text(FILE.format(**TRUE))
    body = Body.load(path)
    numbers = FileNumbers(str(path), body)
    (first, *_) = windows(numbers, log(body, 450, 1))
    off = Replays(numbers).off([copy.copy(numbers.nominal)], first)[0]
    # what the smoother misses of a first velocity is gone in half a second
    assert (np.sqrt((off[25:] ** 2).mean(0)) < 1.2 * NOISE).all()


@pytest.mark.long
def test_held_out_windows_are_replayed_down_to_noise(fit):
    assert fit.is_better
    for joint in ("shoulder", "elbow"):
        assert fit.rms["refined"][joint] < min(3 * NOISE, 0.1 * fit.rms["file"][joint])
    assert fit.coverage >= 0.9


@pytest.mark.long
def test_gain_friction_and_its_softness_are_found(fit):
    for joint in ("shoulder", "elbow"):
        gain, friction = value(fit, joint, "servo gain"), value(fit, joint, "friction")
        # a gain and all masses share a factor, which the prior of masses alone says
        low, high = np.log(gain.interval_90)
        assert abs(np.log(gain.after * STATED["kp"] / TRUE["kp"])) < 2.6 * (high - low) / (2 * Z_90)
        assert friction.after / gain.after == pytest.approx(TRUE["friction"] / TRUE["kp"] * STATED["kp"], rel=0.1)
    soft = value(fit, "shoulder", IMPEDANCE)
    assert soft.before == pytest.approx(0.9)
    assert soft.after > 0.95  # what creeps less than that is under the floor of an error


@pytest.mark.slow
def test_windows_that_no_number_explains_count_little_and_widen_the_ensemble(arm):
    """Half of the windows slew: the others still say what the servo is, and the band holds what is left."""
    path, body = arm
    slewing = refined([log(body, 2450, seed, slew=3.0) for seed in (1, 2)], path, body, (), draws=24, seed=3)
    for joint in ("shoulder", "elbow"):
        gain, drag = value(slewing, joint, "servo gain"), value(slewing, joint, "damping")
        assert drag.after / gain.after == pytest.approx(1.1 / TRUE["kp"] * STATED["kp"], rel=0.05)
    assert slewing.coverage >= 0.9


def test_every_third_window_is_held_out():
    fitted, held_out = split(list(range(9)))
    assert (fitted, held_out) == ([0, 1, 3, 4, 6, 7], [2, 5, 8])
    fitted, held_out = split(list(range(200)))
    assert len(fitted) + len(held_out) == FIXED.max_refine_windows
    assert not {*fitted} & {*held_out}
    assert max(fitted + held_out) == 199


@pytest.mark.parametrize(("refined", "better"), [(0.01, True), (0.03, False), (0.2, False)])
def test_a_fit_is_better_than_the_file_and_the_regression_or_is_not_taken(arm, refined, better):
    rms = {"file": 0.1, "regression": 0.02, "refined": refined}
    off = {who: {"shoulder": each, "elbow": each} for who, each in rms.items()}
    assert OutputError(FileNumbers(*arm), (), np.zeros((1, 1)), off, 0.9, 6).is_better == better


@pytest.mark.long
def test_the_same_seed_and_any_number_of_threads_give_the_same_bits(arm):
    path, body = arm
    logs = [log(body, 1250, 5)]
    one, two = (refined(logs, path, body, (), draws=4, seed=3, workers=n) for n in (1, 2))
    np.testing.assert_array_equal(one.draws, two.draws)
    assert one.changes == two.changes


def test_a_fit_starts_from_the_gain_that_replays_best(arm):
    path, body = arm
    given = (FileChange("elbow", "servo gain", 1.0, 0.04, (0.03, 0.05), "1", "actuator_gain.elbow"),)
    numbers = FileNumbers(path, body, given)
    index = [each.quantity for each in numbers.numbers if each.place == "elbow"].index("servo gain")
    own = [each for each in numbers.numbers if each.place == "elbow"][index]
    assert np.exp(own.mean) == pytest.approx(0.04)
    assert np.exp(numbers.starts()[1:, numbers.numbers.index(own)]) == pytest.approx([1, 0.3, 0.1, 0.03, 0.01])


def test_too_short_a_log_is_not_fitted(arm):
    path, body = arm
    assert refined([log(body, 900, 1)], path, body, (), draws=4, seed=0) is None
