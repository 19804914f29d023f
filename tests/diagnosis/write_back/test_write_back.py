"""A corrected copy is the user's file with other numbers, and MuJoCo's own roll-out with it follows the log."""

from dataclasses import replace
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
from in_space import ARM
from reported import diagnosis
from robot_xml import Older, play, robot

from invdyn.diagnosis.assessment.result import Cause, Change, Estimate, Finding, Learned
from invdyn.diagnosis.write_back import mjcf, mjcf_writer, toml, urdf
from invdyn.diagnosis.write_back.changes import ZERO_ELSEWHERE, FileChange, correction
from invdyn.diagnosis.write_back.rollout import commands, rollout
from invdyn.diagnosis.write_back.write_back import write_back
from invdyn.models import Body, load_body

pytestmark = pytest.mark.filterwarnings("ignore:.*clockwise")


def finding(effect: str, where: dict[str, str], side: str = "dynamics", **parameters: float) -> Finding:
    estimates = {n: Estimate(v, 0.01, (v - 0.02, v + 0.02), "u") for n, v in parameters.items()}
    return Finding(effect, side, where, estimates)


def cause(*findings: Finding) -> Cause:
    return Cause(findings, 0.9, 0.0, 0.0)


@pytest.fixture
def file(tmp_path):
    """The robot's file; degrees, so that a rest angle has to be converted."""
    path = tmp_path / "robot.xml"
    path.write_text(robot(degrees=True))
    return path


def changed(path, *findings):
    """The compiled original and copy, the copy's text, and what was left out."""
    body = Body.load(path)
    asked = correction(cause(*findings), body)
    text, unsaid = mjcf.rewritten(path.read_bytes(), str(path), body, asked.changes)
    copy = path.with_name("copy.xml")
    copy.write_bytes(text)
    models = [mujoco.MjModel.from_xml_path(str(each)) for each in (path, copy)]
    return *models, text.decode(), asked.unsaid | unsaid


TILT = 0.04


@pytest.mark.parametrize("option", ['<option timestep="0.002" gravity="0 0 -9.81"/>', ""])
def test_tilted_gravity_is_written_where_the_effect_has_it(file, option):
    """Counter-clockwise in the plane of x and z; MuJoCo's own gravity is so without an option."""
    file.write_text(file.read_text().replace('<option timestep="0.002" gravity="0 0 -9.81"/>', option))
    tilt = finding("gravity_tilt", {}, angle=TILT)
    _old, new, text, unsaid = changed(file, tilt)
    assert not unsaid
    assert new.opt.gravity == pytest.approx([9.81 * np.sin(TILT), 0.0, -9.81 * np.cos(TILT)], abs=1e-6)
    assert new.opt.timestep == 0.002
    assert f"gravity_x of the whole from 0 to {9.81 * np.sin(TILT):.4g} m/s²" in text
    x, _ = correction(cause(tilt), Body.load(file)).changes
    # an angle's interval of ± .02
    assert x.interval_90 == pytest.approx((9.81 * np.sin(TILT - 0.02), 9.81 * np.sin(TILT + 0.02)))


def test_gravity_of_a_tree_turns_about_two_axes(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM)
    tree = load_body(tmp_path / "arm.xml")
    asked = correction(cause(finding("gravity_tilt", {}, about_x=TILT, about_y=0.0)), tree)
    text, unsaid = mjcf.rewritten(ARM.encode(), str(tmp_path / "arm.xml"), tree, asked.changes)
    assert not unsaid
    (tmp_path / "arm.xml").write_bytes(text)
    size = np.linalg.norm(tree.gravity)
    turned = load_body(tmp_path / "arm.xml").gravity
    assert turned == pytest.approx([0.0, size * np.sin(TILT), -size * np.cos(TILT)], abs=1e-5)


def test_gravity_of_an_included_file_is_named(file):
    """Another option may stand there."""
    file.with_name("rest.xml").write_text("<mujocoinclude><option timestep='0.001'/></mujocoinclude>")
    option, include = '<option timestep="0.002" gravity="0 0 -9.81"/>', '<include file="rest.xml"/>'
    file.write_text(file.read_text().replace(option, include))
    *_, text, unsaid = changed(file, finding("gravity_tilt", {}, angle=TILT))
    assert unsaid == dict.fromkeys(("gravity_x", "gravity_y"), mjcf_writer.INCLUDED)
    assert text == file.read_text()


@pytest.mark.parametrize("given", ["", "gravity = [0, -9.81]  # mine\n"])
def test_toml_has_gravity_and_urdf_no_word_for_it(tmp_path, given):
    path = tmp_path / "arm.toml"
    path.write_text(f'name = "arm"\n{given}[[links]]\nname = "a"\njoint = "j"\ntip = "t"\nlength = 1.0\nmass = 2.0\n')
    body = Body.load(path)
    asked = correction(cause(finding("gravity_tilt", {}, angle=TILT)), body)
    text, unsaid = toml.rewritten(path.read_bytes(), body, asked.changes)
    assert not unsaid
    path.write_bytes(text)
    assert Body.load(path).gravity == pytest.approx((9.81 * np.sin(TILT), -9.81 * np.cos(TILT)))
    new, unsaid = urdf.rewritten(b'<robot name="r"><link name="a"/></robot>', asked.changes)
    assert new == b'<robot name="r"><link name="a"/></robot>'
    assert unsaid == dict.fromkeys(("gravity_x", "gravity_y"), urdf.ELSEWHERE["gravity"])
    several = given.replace("[0,", "[0,\n") if given else "gravity = [\n0, -9.81]\n"
    left = toml.rewritten((several + 'links = [{name = "a"}]\n').encode(), body, asked.changes)[1]
    assert set(left) == {"gravity_x", "gravity_y"}


@pytest.mark.filterwarnings("ignore:.*leaves out limits")
@pytest.mark.parametrize("way", [1, -1])
def test_an_encoders_offset_is_the_joints_reference(tmp_path, way):
    """The joint reads .04 more where it was; its stops and its spring's rest stay where they were in the world."""
    given = f'axis="0 {way} 0" range="-90 45" limited="true" ref="5"'
    path = tmp_path / "robot.xml"
    path.write_text(robot(degrees=True).replace('name="elbow" axis="0 1 0"', f'name="elbow" {given}'))
    assert 'ref="5"' in path.read_text()
    old, new, _text, unsaid = changed(path, finding("encoder_offset", {"joint": "elbow"}, "observation", offset=0.04))
    assert not unsaid
    off, (here, there), elbow = -way * 0.04, map(mujoco.MjData, (old, new)), 1
    angle = np.array([0.3, -0.2])
    for model, data, more in ((old, here, 0.0), (new, there, off)):
        data.qpos[:] = angle + np.array([0.0, more])
        mujoco.mj_forward(model, data)
    np.testing.assert_allclose(there.xpos, here.xpos, atol=1e-6)
    np.testing.assert_allclose(there.qfrc_passive, here.qfrc_passive, atol=1e-6)
    np.testing.assert_allclose(new.jnt_range[elbow] - old.jnt_range[elbow], off, atol=1e-6)
    assert np.ptp(new.jnt_range[elbow]) == pytest.approx(np.radians(135))
    body = Body.load(path)
    asked = correction(cause(finding("encoder_offset", {"joint": "elbow"}, "observation", offset=0.04)), body)
    assert urdf.rewritten(b'<robot name="r"><link name="a"/></robot>', asked.changes)[1] == {
        "encoder zero of elbow": ZERO_ELSEWHERE
    }


def test_joints_numbers_add_to_the_files(file):
    elbow = {"joint": "elbow"}
    old, new, text, unsaid = changed(
        file,
        finding("viscous_friction", elbow, damping=0.25),
        finding("coulomb_friction", elbow, torque=0.05),
        finding("armature", {"joint": "shoulder"}, inertia=0.03),
        finding("joint_stiffness", elbow, stiffness=0.4, rest_angle=-0.1),
    )
    assert not unsaid
    assert new.dof_damping[1] == pytest.approx(old.dof_damping[1] + 0.25)
    assert new.dof_frictionloss[1] == pytest.approx(0.05)
    assert new.dof_armature[0] == pytest.approx(0.05)
    assert new.jnt_stiffness[1] == pytest.approx(1.2)
    # the hinge is clockwise: q = −θ; both springs' torques at q are those of the one
    q = 0.7
    assert -1.2 * (q - new.qpos_spring[1]) == pytest.approx(-0.8 * (q - 0.4) - 0.4 * (q - 0.1))
    assert "from 0.1 to 0.35 u, 90 % interval 0.33 to 0.37" in text


def test_of_stribeck_friction_what_it_has_in_motion_is_written(file):
    stribeck = finding("stribeck_friction", {"joint": "elbow"}, coulomb=0.05, static=0.08, velocity=0.1)
    _old, new, _text, unsaid = changed(file, stribeck)
    assert new.dof_frictionloss[1] == pytest.approx(0.05)
    assert set(unsaid) == {"stribeck_friction.elbow"}


def test_all_else_stays_as_it_was_written(file):
    _, _, text, _ = changed(file, finding("viscous_friction", {"joint": "elbow"}, damping=0.25))
    before, after = file.read_text().splitlines(), text.splitlines()
    other = [line for line in after if line not in before]
    assert len(other) == 2
    assert other[0].strip().startswith("<!-- invdyn: damping of elbow")
    assert [line for line in before if line not in after] == [next(x for x in before if '"elbow" axis' in x)]


def test_motors_and_links(file):
    _old, new, _text, unsaid = changed(
        file,
        finding("actuator_gain", {"joint": "elbow"}, gain=-0.2),
        finding("actuator_saturation", {"joint": "shoulder"}, limit=3.0),
        finding("actuator_delay", {"joint": "elbow"}, delay=0.014),
        finding("inertial_error", {"link": "fore"}, mass=0.2, com=0.01, inertia=0.001),
    )
    assert not unsaid
    assert new.actuator_gear[1, 0] == pytest.approx(8.0)
    assert new.actuator_forcerange[0].tolist() == [-3.0, 3.0]
    assert new.actuator_delay[1] == pytest.approx(0.014)
    fore = 2
    assert new.body_mass[fore] == pytest.approx(1.0)
    assert new.body_ipos[fore] == pytest.approx([0, 0, -0.13])
    # about the hinge, which is y: .005 + .001, the others in proportion
    assert sorted(new.body_inertia[fore]) == pytest.approx(sorted(np.array([0.005, 0.005, 0.0002]) * 1.2))


def test_a_delay_that_this_version_of_mujoco_lacks_is_said(file):
    model, body = Older(mujoco.MjModel.from_xml_path(str(file))), Body.load(file)
    late = correction(cause(finding("actuator_delay", {"joint": "elbow"}, delay=0.014)), body)
    assert "has no delay" in mjcf.BodyNumbers(model, body).put(model, late.changes)


def test_a_servos_gain_is_its_kp(file):
    file.write_text(robot(servo=True))
    _old, new, _text, unsaid = changed(file, finding("actuator_gain", {}, gain=-0.2))
    assert not unsaid
    assert new.actuator_gainprm[0, 0] == pytest.approx(32.0)
    assert new.actuator_biasprm[0, :3] == pytest.approx([0.0, -32.0, -3.0])
    assert new.actuator_gear[:, 0].tolist() == [1.0, 8.0]
    file.write_text(robot(servo=True).replace('kv="3"', 'dampratio="1"'))
    *_, unsaid = changed(file, finding("actuator_gain", {"joint": "shoulder"}, gain=-0.2))
    assert unsaid == {"servo gain of shoulder": mjcf_writer.SERVO}


def learned(place: str, quantity: str, before: float, after: float) -> Learned:
    return Learned(place, quantity, Change(before, Estimate(after, 0.01, (after - 0.02, after + 0.02), "u")))


def test_what_was_learned_of_links_is_written_and_an_effect_adds_to_it(file):
    body = Body.load(file)
    error = finding("inertial_error", {"link": "fore"}, mass=0.2, com=0.01, inertia=0.001)
    told = (
        learned("upper", "mass", 1.2, 1.26),
        learned("fore", "mass", 0.8, 0.85),
        learned("fore", "length", 0.25, 0.26),
    )
    asked = correction(Cause((error,), 0.9, 0.0, 0.0, learned=tuple(told)), body)
    assert set(asked.unsaid) == {"length of fore"}
    (both,) = [c for c in asked.changes if (c.place, c.quantity) == ("fore", "mass")]
    # ± .02 of the effect's, and 1.645 sds of .01 of what was learned
    assert both.interval_90 == pytest.approx((1.05 - np.hypot(0.02, 0.01645), 1.05 + np.hypot(0.02, 0.01645)))
    text, unsaid = mjcf.rewritten(file.read_bytes(), str(file), body, asked.changes)
    assert not unsaid
    new = mujoco.MjModel.from_xml_string(text.decode())
    assert new.body("upper").mass == pytest.approx(1.26)
    assert new.body("fore").mass == pytest.approx(1.05)
    assert new.body("fore").ipos == pytest.approx([0, 0, -0.13])


def test_a_tree_of_which_coordinates_and_moments_were_learned(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM)
    tree = load_body(tmp_path / "arm.xml")
    told = (
        learned("fore", "com_z", 0.0, 0.01),
        learned("fore", "inertia_xx", 5e-4, 6e-4),
        learned("fore", "inertia_xy", 0, 1e-4),
    )
    asked = correction(Cause((), 0.0, 0.0, 0.0, learned=told), tree)
    text, unsaid = mjcf.rewritten(ARM.encode(), str(tmp_path / "arm.xml"), tree, asked.changes)
    assert not unsaid
    (tmp_path / "arm.xml").write_bytes(text)
    new = load_body(tmp_path / "arm.xml").parameters()
    assert new.com[2].tolist() == pytest.approx([0.11, 0.0, 0.01])
    assert new.inertia[2].tolist() == pytest.approx([6e-4, 4e-3, 4e-3, 1e-4, 0.0, 0.0], abs=1e-9)
    assert new.mass[2].item() == pytest.approx(0.7)
    broken = correction(Cause((), 0.0, 0.0, 0.0, learned=(learned("fore", "inertia_xx", 5e-4, 9e-3),)), tree)
    unsaid = mjcf.rewritten(ARM.encode(), str(tmp_path / "arm.xml"), tree, broken.changes)[1]
    assert unsaid == {"inertia_xx of fore": "no body has such moments of inertia"}


@pytest.mark.filterwarnings("ignore:.*leaves out")
def test_an_actuator_of_a_tendon_is_not_that_of_the_joint_with_its_number(file):
    """MuJoCo numbers tendons from 0, too."""
    cable = '<tendon><fixed name="cable"><joint joint="elbow" coef="1"/></fixed></tendon>'
    pulled = (
        robot().replace("</mujoco>", f"{cable}</mujoco>").replace("</actuator>", '<motor tendon="cable"/></actuator>')
    )
    file.write_text(pulled)
    _old, new, _text, unsaid = changed(file, finding("actuator_gain", {"joint": "shoulder"}, gain=-0.2))
    assert not unsaid
    assert new.actuator_gear[:, 0].tolist() == [0.8, 10.0, 1.0]
    given = commands(new, Body.load(file), play(robot(), 0.1))
    assert given.control[:, 0].any()
    assert not given.applied.any()


def test_a_payload_is_at_the_tip(file):
    old, new, _, unsaid = changed(file, finding("payload", {}, mass=0.3))
    assert not unsaid
    assert new.body_mass.sum() == pytest.approx(old.body_mass.sum() + 0.3, abs=1e-6)
    data = mujoco.MjData(new)
    mujoco.mj_forward(new, data)
    assert data.body("payload").xpos == pytest.approx(data.site("tip").xpos, abs=1e-7)


def test_what_a_file_cannot_say_is_named(file):
    _old, _new, text, unsaid = changed(
        file, finding("backlash", {"joint": "elbow"}, gap=0.1), finding("camera_roll", {}, "observation", angle=0.1)
    )
    assert set(unsaid) == {"backlash.elbow", "camera_roll"}
    assert text == file.read_text()


@pytest.mark.parametrize("servo", [False, True])
def test_mujocos_own_rollout_tells_the_true_file_from_the_nominal(tmp_path, servo):
    nominal, true = tmp_path / "robot.xml", tmp_path / "true.xml"
    nominal.write_text(robot(servo=servo))
    true.write_text(robot(servo=servo).replace('damping="0.1"', 'damping="0.35"'))
    body, log = Body.load(nominal), play(true.read_text(), servo=servo)
    given = commands(mujoco.MjModel.from_xml_path(str(nominal)), body, log)
    before, after = (rollout(str(p), body, log.time, log.angles, given) for p in (nominal, true))
    # encoders of .2 mrad give a start that is off by as much, and its velocity by some mrad/s
    assert after.total < 5e-3
    assert before.angle_rms["elbow"] > 10 * after.angle_rms["elbow"]
    assert before.windows == after.windows == 4


def test_toml_says_it_too(tmp_path):
    path = tmp_path / "arm.toml"
    path.write_text(
        '# mine\n[[links]]\nname = "a"\njoint = "j"\ntip = "t"\nlength = 1.0\nmass = 2.0  # weighed\n'
        'damping = 0.1\n\n[[links]]\nname = "b"\njoint = "t"\ntip = "u"\nlength = 0.5\nmass = 1.0\n\n[uncertainty]\n'
        "mass = 0.05\n"
    )
    body = Body.load(path)
    found = cause(
        finding("viscous_friction", {"joint": "j"}, damping=0.2), finding("armature", {"joint": "t"}, inertia=0.01)
    )
    text, unsaid = toml.rewritten(path.read_bytes(), body, correction(found, body).changes)
    assert not unsaid
    path.write_bytes(text)
    first, second = Body.load(path).links
    assert first.parts.damping == pytest.approx(0.3)
    assert second.parts.armature == pytest.approx(0.01)
    assert b"# mine" in text
    assert b"2.0  # weighed" in text


def test_toml_of_a_tree_whose_outer_link_comes_first(tmp_path):
    path = tmp_path / "arm.toml"
    link = '[[links]]\nname = "{}"\njoint = "{}"\nparent = "{}"\nmass = 1.0\ncom = [0.1, 0.0, 0.0]\n'
    link += "inertia = [0.01, 0.01, 0.01, 0.0, 0.0, 0.0]\n"
    path.write_text("dimensions = 3\n" + link.format("outer", "bend", "inner") + link.format("inner", "pan", "world"))
    body = load_body(path)
    found = cause(finding("viscous_friction", {"joint": "bend"}, damping=0.2))
    text, unsaid = toml.rewritten(path.read_bytes(), body, correction(found, body).changes)
    assert not unsaid
    path.write_bytes(text)
    damped = {link.joint.name: link.parts for link in load_body(path).links}
    assert damped["bend"].damping == pytest.approx(0.2)
    assert damped["pan"] is None


def test_urdf_says_what_it_can():
    text = b'<robot name="r"><joint name="j" type="revolute"><limit effort="5"/></joint></robot>'
    changes = [
        FileChange("j", "damping", 0.0, 0.2, (0.1, 0.3), "N·m·s/rad", "viscous_friction.j"),
        FileChange("j", "motor limit", 5.0, 3.0, (2.9, 3.1), "N·m", "actuator_saturation.j"),
        FileChange("j", "armature", 0.0, 0.1, (0.0, 0.2), "kg·m²", "armature.j"),
    ]
    new, unsaid = urdf.rewritten(text, changes)
    assert b'<dynamics damping="0.2"/>' in new
    assert b'effort="3"' in new
    assert unsaid == {"armature of j": "URDF has no word for it"}


def test_urdf_says_masses_and_moments_of_a_link_by_itself():
    moments = '<inertia ixx="0.01" iyy="0.02" izz="0.01" ixy="0"/>'
    links = [
        f'<link name="{n}"><inertial><mass value="{m}"/>{moments}</inertial></link>' for n, m in (("a", 1.5), ("b", 1))
    ]
    text = f'<robot name="r">{"".join(links)}</robot>'
    mass = FileChange("a", "mass", 1.5, 1.6, (1.55, 1.65), "kg", "learned")
    inertia = FileChange("a", "inertia", 0.02, 0.03, (0.02, 0.04), "kg·m²", "learned")
    new, unsaid = urdf.rewritten(text.encode(), [mass, inertia])
    assert not unsaid
    first, second = ElementTree.fromstring(new).findall("link/inertial")
    assert first.find("mass").attrib == {"value": "1.6"}
    assert {name: float(value) for name, value in first.find("inertia").attrib.items()} == pytest.approx(
        {"ixx": 0.015, "iyy": 0.03, "izz": 0.015, "ixy": 0.0}
    )
    assert second.find("mass").attrib == {"value": "1"}
    # a centre of mass that moved, or a mass that has another link's in it, is left to the user, whole
    moved = FileChange("a", "com_x", 0.0, 0.1, (0.0, 0.2), "m", "learned")
    for changes in ([mass, moved], [replace(mass, before=2.0)]):
        new, unsaid = urdf.rewritten(text.encode(), changes)
        assert new == text.encode()
        assert set(unsaid.values()) == {urdf.BY_HAND}
        assert len(unsaid) == len(changes)


def test_less_damping_than_a_joint_has_is_its_servos(file):
    """kv of 3 and damping of .3: 2.6 less is kv of .7 and none of the joint's."""
    file.write_text(robot(servo=True))
    _old, new, _text, unsaid = changed(file, finding("viscous_friction", {"joint": "shoulder"}, damping=-2.6))
    assert not unsaid
    assert new.actuator_biasprm[0, 2] == pytest.approx(-0.7)
    assert new.dof_damping[0] == 0.0


@pytest.mark.parametrize("searched", [0.25, None])
def test_a_copy_that_replays_worse_by_the_regression_follows_the_search(file, searched):
    """The true damping is .25 more; the regression says 3 more. Without an answer of the search there is no file."""
    shoulder = {"joint": "shoulder"}
    true = robot(degrees=True).replace('damping="0.3"', 'damping="0.55"')
    body, log, out = Body.load(file), play(true), file.with_name("out.xml")
    causes = () if searched is None else (cause(finding("viscous_friction", shoulder, damping=searched)),)
    wrong = cause(finding("viscous_friction", shoulder, damping=3.0))
    found = replace(diagnosis(), causes=causes, regressed=wrong)
    written = write_back(found, file, body, out, log, True)
    assert written.regressed is None
    if searched is None:
        assert not written.written.changes
        assert sorted(path.name for path in file.parent.iterdir()) == [file.name]
        return
    assert [change["to"] for change in written.written.changes] == pytest.approx([0.55])
    number = mujoco.MjModel.from_xml_path(str(out)).joint("shoulder").dofadr[0]
    assert mujoco.MjModel.from_xml_path(str(out)).dof_damping[number] == pytest.approx(0.55)
    right = replace(found, regressed=causes[0], causes=(wrong,))
    assert write_back(right, file, body, out, log, True).regressed is causes[0]
