"""Bodies out of MJCF move as MuJoCo moves them, and what is no planar chain of hinges is refused."""

import builtins
from dataclasses import replace

import numpy as np
import pytest
import torch

from invdyn.models import Body, BodyError, dynamics_for, load_body, planar_dynamics
from invdyn.models.bodies import body_mjcf

mujoco = pytest.importorskip("mujoco")

AXES = {"x": ("1 0 0", 0, 1.0), "y": ("0 1 0", 1, -1.0), "-y": ("0 -1 0", 1, 1.0), "z": ("0 0 1", 2, 1.0)}
# the axis, its number, and whether the hinge turns counter-clockwise (1) as the picture sees it
PLANE = {0: (1, 2), 1: (0, 2), 2: (0, 1)}


def arm(axis, turn=0.0, more="", gravity="0 0 -9.81", last='<site name="hand" pos="{tip}"/>'):
    """An arm of three links and a welded load; its reference pose is bent, and the base is turned about the axis."""
    first, second = PLANE[AXES[axis][1]]

    def at(a, b, off=0.0):
        place = np.full(3, off)
        place[[first, second]] = a, b
        return " ".join(map(str, place))

    def inertial(a, b, mass):
        return f'<inertial pos="{at(a, b, 0.01)}" mass="{mass}" diaginertia="0.011 0.012 0.013"/>'

    rotation = AXES[axis][0].replace("-", "") + f" {turn}"
    hinge = f'type="hinge" axis="{AXES[axis][0]}"'
    return f"""<mujoco model="arm"><compiler angle="radian"/><option gravity="{gravity}"/><worldbody>
    <body name="stand" pos="{at(0.1, 0.2)}" axisangle="{rotation}">
      <body name="upper"><joint name="shoulder" {hinge}/>{inertial(0.06, -0.12, 1.5)}
        <body name="fore" pos="{at(0.15, -0.3, 0.05)}"><joint name="elbow" {hinge}/>{inertial(0.1, 0.02, 0.8)}
          <body name="palm" pos="{at(0.25, 0.05)}"><joint name="wrist" {hinge} {more}/>{inertial(0.03, 0.06, 0.2)}
            {last.format(tip=at(0.06, 0.12))}
            <body name="load" pos="{at(0.05, 0.1)}"><inertial pos="0 0 0" mass="0.1" diaginertia="1e-4 1e-4 1e-4"/>
            </body>
          </body></body></body></body></worldbody></mujoco>"""


def read(text, tmp_path, suffix=".xml"):
    (tmp_path / f"arm{suffix}").write_text(text)
    return Body.load(tmp_path / f"arm{suffix}", dimensions=2)


@pytest.mark.parametrize("turn", [0.0, 0.7])
@pytest.mark.parametrize("axis", AXES)
@pytest.mark.filterwarnings("ignore:.*clockwise:UserWarning")
def test_the_body_moves_as_in_mujoco(axis, turn, tmp_path):
    text = arm(axis, turn)
    body = read(text, tmp_path)
    assert body.joint_names == ("shoulder", "elbow", "wrist")
    assert body.keypoint_names == ("elbow", "wrist", "hand")
    assert [link.name for link in body.links] == ["upper", "fore", "palm"]
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    parameters, dynamics = body.parameters(), planar_dynamics(3)
    sign, plane = AXES[axis][2], list(PLANE[AXES[axis][1]])
    for _ in range(5):
        data.qpos[:], data.qvel[:] = rng.uniform(-2, 2, 3), rng.uniform(-3, 3, 3)
        torque = rng.uniform(-2, 2, 3)
        data.qfrc_applied[:] = torque
        mujoco.mj_forward(model, data)
        points = np.concatenate([data.xanchor, data.site_xpos])[:, plane]
        np.testing.assert_allclose(points[0], body.base, atol=1e-12)
        steps = np.diff(points, axis=0)
        np.testing.assert_allclose(np.linalg.norm(steps, axis=1), parameters.length, rtol=1e-9)
        absolute = np.arctan2(steps[:, 1], steps[:, 0])
        angle = torch.tensor(np.diff(absolute, prepend=0.0))
        ours = dynamics.forward(angle, torch.tensor(sign * data.qvel), torch.tensor(sign * torque), parameters)
        np.testing.assert_allclose(ours.numpy(), sign * data.qacc, rtol=1e-8, atol=1e-8 * np.abs(data.qacc).max())


def exact(axis="z"):
    """Centres of mass on the line of the joints: nothing is left out, and the dynamics are the same to rounding."""
    return """<mujoco><worldbody><body name="a"><joint name="j1" axis="0 0 1"/>
      <inertial pos="0.1 0 0" mass="1" diaginertia="0.01 0.02 0.03"/>
      <body name="b" pos="0.3 0 0"><joint name="j2" axis="0 0 1"/>
      <inertial pos="0.1 0 0.2" mass="0.5" diaginertia="0.01 0.02 0.015"/>
      <geom type="capsule" size="0.02" fromto="0 0 0 0.25 0 0"/></body></body></worldbody></mujoco>"""


def test_a_centre_of_mass_on_the_line_is_exact(tmp_path):
    body = read(exact(), tmp_path)
    upper, fore = body.links
    assert (upper.length, upper.mass, upper.com, upper.inertia) == pytest.approx((0.3, 1.0, 0.1, 0.03))
    assert (fore.length, fore.mass, fore.com, fore.inertia) == pytest.approx((0.25, 0.5, 0.1, 0.015))
    assert fore.tip == "b_tip"
    assert body.gravity == (0.0, 0.0)  # it acts across the plane
    assert body.name == "arm"


def test_what_a_rigid_body_lacks_is_named(tmp_path):
    text = arm("x", more='limited="true" range="-1 1"').replace('pos="0.01 0.06 -0.12"', 'pos="0.01 0.06 -0.1"')
    with pytest.warns(UserWarning, match=r"leaves out .*centre of mass of upper.*limits \(wrist\)"):
        read(text, tmp_path)
    with pytest.warns(UserWarning, match="shoulder, elbow, wrist turn clockwise"):
        read(arm("y"), tmp_path)


def test_ends_without_a_site(tmp_path):
    welded = read(arm("x", last=""), tmp_path)
    assert welded.keypoint_names[-1] == "load"
    assert welded.links[-1].length == pytest.approx(np.hypot(0.05, 0.1))
    nothing = exact().replace('<geom type="capsule" size="0.02" fromto="0 0 0 0.25 0 0"/>', "")
    with pytest.warns(UserWarning, match="where b ends: its centre of mass stands for it"):
        assert read(nothing, tmp_path).keypoint_names[-1] == "b_com"


WRONG = {
    "a slide": ('name="j2"', 'name="j2" type="slide"', "'j2' is of type slide"),
    "another axis": ('name="j2" axis="0 0 1"', 'name="j2" axis="0 1 0"', r"'j2' turns about \(0, 1, 0\)"),
    "an axis askew": ('axis="0 0 1"', 'axis="0 1 1"', "about one axis, x, y or z"),
    "a branch": ("</body></body>", '</body><body name="c"><joint/><geom size=".1"/></body></body>', "branches at"),
    "two hinges": ('<joint name="j2" axis="0 0 1"/>', '<joint axis="0 0 1"/><joint axis="1 0 0"/>', "has 2"),
    "a ball": ('<joint name="j1" axis="0 0 1"/>', '<joint name="j1" type="ball"/>', "ball"),
    "broken": ("</mujoco>", "", "broken XML"),
    "unknown": ('mass="0.5"', 'weight="0.5"', "MuJoCo cannot read it"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_what_is_no_planar_chain_is_refused(name, tmp_path):
    good, bad, message = WRONG[name]
    assert good in exact()
    with pytest.raises(BodyError, match=message) as refusal:
        read(exact().replace(good, bad), tmp_path)
    assert "arm.xml" in str(refusal.value)


def test_a_body_without_joints_is_refused(tmp_path):
    with pytest.raises(BodyError, match="without joints"):
        read('<mujoco><worldbody><geom size="0.1"/></worldbody></mujoco>', tmp_path)
    with pytest.raises(FileNotFoundError):
        Body.load(tmp_path / "none.xml")


def test_without_mujoco_one_line_says_what_to_install(tmp_path, monkeypatch):
    def without(name, *rest, real=builtins.__import__):
        if name == "mujoco":
            raise ImportError(name)
        return real(name, *rest)

    (tmp_path / "arm.xml").write_text(exact())
    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(BodyError, match=r"pip install 'invdyn\[robots\]'"):
        Body.load(tmp_path / "arm.xml")


def test_every_kind_of_file_by_its_suffix(tmp_path):
    body = read(exact(), tmp_path)
    body.to_toml(tmp_path / "arm.toml")
    assert Body.load(tmp_path / "arm.toml") == body
    assert read(exact(), tmp_path, ".mjcf") == body


def test_all_that_a_rigid_body_lacks_is_named(tmp_path):
    joint = 'damping="0.1" stiffness="2" frictionloss="0.3" armature="0.01" range="-1 1" actuatorfrcrange="-4 4"'
    text = exact().replace('name="j2"', f'name="j2" {joint}').replace('<body name="b"', '<body name="b" gravcomp="1"')
    text = text.replace(
        "<worldbody>", '<option density="1.2" wind="3 0 0"/><worldbody><geom type="plane" size="1 1 1"/>'
    )
    text = text.replace(
        "</mujoco>",
        """<actuator><position name="hold" joint="j1" kp="20"/><velocity name="brake" joint="j2" kv="2"/>
        <motor name="strong" joint="j1" gear="30" forcelimited="true" forcerange="-5 5"
          ctrllimited="true" ctrlrange="-1 1"/>
        <general name="slow" joint="j2" dyntype="filter" dynprm="0.1" gainprm="2"/><motor name="rope" tendon="cord"/>
        <muscle name="biceps" joint="j2" lengthrange="0.1 0.3"/></actuator>
        <tendon><fixed name="cord"><joint joint="j1" coef="0.1"/></fixed></tendon>
        <equality><joint joint1="j2" joint2="j1" polycoef="0 0.7 0 0 0"/></equality>
        <extension><plugin plugin="mujoco.pid"/></extension></mujoco>""",
    )
    with pytest.warns(UserWarning, match="leaves out") as told:
        body = read(text, tmp_path)
    line = str(told[0].message)
    for words in (
        "limits (j2)",
        "gravity compensation (b)",
        "a fluid (density 1.2 kg/m³, viscosity 0 Pa·s)",
        "wind (3, 0, 0 m/s)",
        "position servos (hold)",
        "velocity servos (brake)",
        "muscles and other actuators with a law of their own (biceps)",
        "activation dynamics (slow, biceps)",
        "gears (strong)",
        "gains of motors (slow)",
        "force limits (strong)",
        "control limits (strong)",
        "actuators that act elsewhere than on a joint (rope)",
        "tendons (cord)",
        "equality constraints (j2 follows j1)",
        "contacts (b)",
        "plugins (mujoco.pid)",
    ):
        assert words in line, words
    # j2 has several actuators, and j1 two: none of them is played, and friction and springs are
    plain = read(exact(), tmp_path).links
    assert [replace(link, parts=None) for link in body.links] == [replace(link, parts=None) for link in plain]
    assert body.links[0].parts is None
    assert body.links[1].parts.motor is None
    assert body.links[1].parts.damping > 0
    assert body.links[1].parts.armature > 0


def test_contacts_are_those_that_mujoco_lets_happen(tmp_path):
    """Neighbours never touch; what is excluded, or has no bits in common, neither."""
    floor = exact().replace("<worldbody>", '<worldbody><geom name="floor" type="plane" size="1 1 1"/>')
    for text in (
        exact(),
        floor.replace("</mujoco>", '<contact><exclude body1="world" body2="b"/></contact></mujoco>'),
        floor.replace('name="floor"', 'name="floor" contype="0" conaffinity="0"'),
        floor.replace("<worldbody>", '<option><flag contact="disable"/></option><worldbody>'),
        floor.replace("<worldbody>", '<option><flag constraint="disable"/></option><worldbody>'),
    ):
        read(text, tmp_path)  # a warning would be an error
    with pytest.warns(UserWarning, match=r"leaves out contacts \(b\)"):
        read(floor, tmp_path)


def test_without_gravity_there_is_none(tmp_path):
    heavy = exact().replace("0 0 1", "0 1 0").replace('pos="0.1 0 0.2"', 'pos="0.1 0 0"')
    weightless = heavy.replace("<worldbody>", '<option><flag gravity="disable"/></option><worldbody>')
    with pytest.warns(UserWarning, match="clockwise"):
        assert read(heavy, tmp_path).gravity == (0.0, -9.81)
    with pytest.warns(UserWarning, match="clockwise"):
        assert read(weightless, tmp_path).gravity == (0.0, 0.0)


def test_defaults_and_their_classes(tmp_path):
    """Degrees, nested classes and several geoms: masses are density × volume of what each class makes of a geom."""
    text = """<mujoco><default><geom density="1500"/><default class="arm"><joint axis="0 0 1" damping="0.4"/>
      <geom type="cylinder" size="0.03" contype="0"/><default class="light"><geom density="400"/></default></default>
      </default><worldbody><body name="a" childclass="arm" euler="0 0 40"><joint name="j1"/>
      <geom fromto="0 0 0 0.4 0 0"/><body name="b" pos="0.4 0 0" euler="0 0 25"><joint name="j2" damping="0"/>
      <geom class="light" fromto="0 0 0 0.3 0 0"/><geom type="sphere" size="0.05" pos="0.3 0 0" mass="0.25"/>
      <site name="hand" pos="0.3 0 0"/></body></body></worldbody></mujoco>"""
    upper, fore = read(text, tmp_path).links
    assert (upper.parts.damping, fore.parts.damping) == (0.4, 0.0)
    volume = np.pi * 0.03**2
    assert upper.mass == pytest.approx(1500 * volume * 0.4)
    rod = 400 * volume * 0.3
    assert fore.mass == pytest.approx(rod + 0.25)
    assert fore.com == pytest.approx((rod * 0.15 + 0.25 * 0.3) / fore.mass)


def test_a_number_that_is_none_is_refused_and_a_name_like_it_is_not(tmp_path):
    read(exact().replace('<geom type="capsule"', '<geom name="old-nan" type="capsule"'), tmp_path)
    for none in ("nan", "-NaN", "1 nan 1"):
        with pytest.raises(BodyError, match=f'expected numbers, got friction="{none}" of <geom>'):
            read(exact().replace('<geom type="capsule"', f'<geom friction="{none}" type="capsule"'), tmp_path)


def test_warnings_of_mujoco_are_ours_and_leave_no_log(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    before = mujoco.get_mju_user_warning()
    (tmp_path / "arm.xml").write_text(exact().replace('<geom type="capsule"', '<geom type="capsule" solmix="nan"'))
    with pytest.warns(UserWarning, match="MuJoCo: .*NaN"):
        body_mjcf.of_compiled(tmp_path / "arm.xml", "arm")
    assert [path.name for path in tmp_path.iterdir()] == ["arm.xml"]
    assert mujoco.get_mju_user_warning() == before


def aside():
    return exact().replace('pos="0.1 0 0.2" mass="0.5"', 'pos="0.1 0.04 0.2" mass="0.5"')


def test_a_centre_of_mass_aside_is_kept_where_no_plane_is_filmed(tmp_path):
    """The chain in the plane drops it and says so; as a body in space the robot moves as MuJoCo's does."""
    (tmp_path / "arm.xml").write_text(aside())
    with pytest.warns(UserWarning, match="leaves out that the centre of mass of b is 0.04 m off the line"):
        assert load_body(tmp_path / "arm.xml").is_chain
    with pytest.warns(UserWarning, match="in space; in the plane .* centre of mass of b is 0.04 m off"):
        tree = load_body(tmp_path / "arm.xml", filmed=False)
    model = mujoco.MjModel.from_xml_string(aside())
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    data.qpos[:], data.qvel[:], data.qfrc_applied[:] = rng.uniform(-2, 2, (3, 2))
    mujoco.mj_forward(model, data)
    state = (torch.tensor(x) for x in (data.qpos, data.qvel, data.qfrc_applied))
    ours = dynamics_for(tree).forward(*state, tree.parameters())
    np.testing.assert_allclose(ours.numpy(), data.qacc, rtol=1e-8)
    (tmp_path / "line.xml").write_text(exact())
    assert load_body(tmp_path / "line.xml", filmed=False).is_chain


FLAGGED = """<mujoco><option timestep="0.002" integrator="RK4" {group}><flag {flags}/></option><worldbody><body>
<joint name="j" axis="0 -1 0" damping="0.3" frictionloss="0.4" stiffness="2" springref="0.5"/>
<inertial pos="0 0 -0.2" mass="1" diaginertia="0.01 0.01 0.01"/><site name="tip" pos="0 0 -0.4"/></body></worldbody>
<actuator><position name="servo" joint="j" kp="3" kv="0.1" group="2"/></actuator></mujoco>"""
DISABLED = {
    "friction": ('frictionloss="disable"', "", "dry friction"),
    "damping": ('damper="disable"', "", "damping"),
    "stiffness": ('spring="disable"', "", "springs"),
    "motor": ('actuation="disable"', "", "actuators (servo)"),
    "motor of a group": ("", 'actuatorgroupdisable="2"', "actuators (servo)"),
}


@pytest.mark.parametrize("what", DISABLED)
def test_what_a_file_switches_off_does_not_act_and_is_named(what, tmp_path):
    """What is left acts: accelerations are those of MuJoCo, which is without it, too."""
    flags, group, words = DISABLED[what]
    text = FLAGGED.format(flags=flags, group=group)
    (tmp_path / "arm.xml").write_text(text)
    with pytest.warns(UserWarning, match="what the file switches off") as said:
        body = load_body(tmp_path / "arm.xml", filmed=False)
    assert any(words in str(each.message) for each in said)
    (parts,) = body.joint_parts
    engine = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(engine)
    data.qpos[:], data.qvel[:] = 0.3, 50.0  # so fast that dry friction is all that it can be
    mujoco.mj_forward(engine, data)
    q, qd = parts.zero + parts.sign * data.qpos[0], parts.sign * data.qvel[0]
    torque = -parts.damping * qd - parts.friction * np.sign(qd) - parts.stiffness * (q - parts.rest)
    if (servo := parts.servo) is not None:
        torque += servo.gain * parts.zero + servo.bias - servo.stiffness * q - servo.damping * qd
    dynamics = dynamics_for(body)
    state = (torch.tensor([[value]], dtype=torch.float64) for value in (q, qd, torque))
    expected = parts.sign * data.qacc[0]
    assert dynamics.forward(*state, body.parameters()).item() == pytest.approx(expected, rel=1e-3)


def test_a_constant_force_of_a_motor_is_named(tmp_path):
    text = FLAGGED.format(flags="", group="").replace(
        '<position name="servo" joint="j" kp="3" kv="0.1" group="2"/>',
        '<general name="pusher" joint="j" gainprm="1" biastype="affine" biasprm="0.7 0 0"/>',
    )
    (tmp_path / "arm.xml").write_text(text)
    with pytest.warns(UserWarning, match=r"constant forces of motors \(pusher\)"):
        load_body(tmp_path / "arm.xml", filmed=False)


def test_a_delay_in_memory_is_named(tmp_path):
    """As of the file, whose delays MuJoCo's compiler is not given."""
    mujoco = pytest.importorskip("mujoco")
    text = exact().replace(
        "</mujoco>", '<actuator><motor name="late" joint="j1" delay=".01" nsample="8"/></actuator></mujoco>'
    )
    with pytest.warns(UserWarning, match=r"leaves out .*delays.* \(late\)"):
        Body.load(mujoco.MjSpec.from_string(text).compile())
