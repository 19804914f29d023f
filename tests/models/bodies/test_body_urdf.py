"""Bodies out of URDF: the same numbers as in the file, meshes or not."""

import numpy as np
import pytest
import torch

from invdyn.models import Body, BodyError, dynamics_for, planar_dynamics

INERTIA = '<inertia ixx="{0}" iyy="{0}" izz="0.001" ixy="0" ixz="0" iyz="0"/>'
MESH = '<visual><geometry><mesh filename="package://robot/arm.stl"/></geometry></visual>'


def link(name, depth, mass, inertia, more=""):
    place = f'<origin xyz="0 0.01 {-depth}"/><mass value="{mass}"/>'
    return f'<link name="{name}"><inertial>{place}{INERTIA.format(inertia)}</inertial>{more}</link>'


def joint(name, kind, parent, child, height, more=""):
    ends = f'<parent link="{parent}"/><child link="{child}"/><origin xyz="0 0.02 {height}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}<axis xyz="0 -1 0"/>{more}</joint>'


LIMIT = '<limit lower="-1" upper="1" effort="10" velocity="1"/>'
ROBOT = "\n".join(
    [
        '<?xml version="1.0" encoding="utf-8"?><robot name="two">',
        link("base", 0, 5, 1.0),
        link("upper", 0.1, 1.2, 0.02, MESH + MESH.replace("visual", "collision")),
        link("fore", 0.08, 0.6, 0.01),
        '<link name="tool"/>',
        joint("shoulder", "revolute", "base", "upper", 1.0, LIMIT + '<dynamics damping="0.1" friction="0.2"/>'),
        joint("elbow", "continuous", "upper", "fore", -0.3),
        joint("grip", "fixed", "fore", "tool", -0.25),
        "</robot>",
    ]
)


def written(text, path):
    path.write_text(text, encoding="utf-8")
    return path


def read(text, tmp_path):
    return Body.load(written(text, tmp_path / "arm.urdf"), dimensions=2)


def still(robot):
    """Without what a rigid body lacks, so that nothing is warned of."""
    kept = robot.replace(LIMIT + '<dynamics damping="0.1" friction="0.2"/>', "").replace("revolute", "continuous")
    return kept.replace("0 0.01 -", "0 0 -")


def test_the_numbers_of_the_file(tmp_path):
    with pytest.warns(UserWarning, match=r"leaves out limits"):
        body = read(ROBOT, tmp_path)
    assert body.joint_names == ("shoulder", "elbow")
    assert body.keypoint_names == ("elbow", "tool")
    upper, fore = body.links
    assert (upper.length, upper.mass, upper.com, upper.inertia) == pytest.approx((0.3, 1.2, 0.1, 0.02))
    assert (fore.length, fore.mass, fore.com, fore.inertia) == pytest.approx((0.25, 0.6, 0.08, 0.01))
    assert body.gravity == pytest.approx((0.0, -9.81))
    assert body.base == pytest.approx((0.0, 1.0))


WRONG = {
    "broken": ("</robot>", "", "broken XML"),
    "a slide": ("continuous", "prismatic", "'shoulder' is of type slide"),
    "nobody": ('child link="fore"', 'child link="nobody"', "has 'nobody' as its child"),
    "two of a name": ('<link name="tool"/>', '<link name="fore"/>', "a name of its own for each link, got 'fore'"),
    "two roots": (
        '<link name="tool"/>',
        '<link name="tool"/><link name="other"/>',
        "one link that is no joint's child",
    ),
    "two parents": ('child link="tool"', 'child link="fore"', "'fore' is the child of two joints"),
    "a loop": ('parent link="base"', 'parent link="fore"', "loop"),
    "no axis": ("0 -1 0", "0 0 0", "axis without direction"),
    "two numbers": ('xyz="0 0.02 1.0"', 'xyz="0 1.0"', "expected 3 numbers as xyz, got '0 1.0'"),
    "no number": ('mass value="1.2"', 'mass value="${m}"', "expected 1 number as value"),
    "not finite": ('mass value="1.2"', 'mass value="inf"', "expected a finite number"),
    "a negative mass": ('mass value="1.2"', 'mass value="-1.2"', "no negative mass"),
    "no mass": ('<mass value="1.2"/>', "", "lacks a mass"),
    "numbers too large": ("0 0.02 -0.25", "0 0.02 -1e308", "a number up to"),
    "a centre far aside": ("0 0 -0.1", "1e160 0 -0.1", "a number up to"),
    "a centre far out": ("0 0 -0.1", "0 0 -1e160", "a number up to"),
    "a template": ('<link name="tool"/>', '<link name="tool"/><xacro:arm/>', "expand it first: xacro"),
}


@pytest.mark.parametrize(("good", "bad", "message"), WRONG.values(), ids=WRONG)
def test_what_is_no_planar_arm_is_refused(good, bad, message, tmp_path):
    assert good in still(ROBOT)
    with pytest.raises(BodyError, match=message) as refusal:
        read(still(ROBOT).replace(good, bad), tmp_path)
    assert "arm.urdf" in str(refusal.value)


def test_a_mass_comes_from_inertial_elements_alone(tmp_path):
    """A ball of 10 cm would be 4 kg of water; and a link that moves without mass is no link of a body."""
    ball = '<collision><geometry><sphere radius="0.1"/></geometry></collision>'
    with_shapes = read(still(ROBOT.replace('<link name="tool"/>', f'<link name="tool">{ball}</link>')), tmp_path)
    assert with_shapes == read(still(ROBOT), tmp_path)
    bare = ROBOT.replace(link("fore", 0.08, 0.6, 0.01), f'<link name="fore">{ball}</link>')
    with pytest.raises(BodyError, match="link 'fore' moves, but neither it nor what is fixed to it has a mass"):
        read(still(bare), tmp_path)
    carried = still(bare.replace('<link name="tool"/>', link("tool", 0.01, 0.2, 0.003)))
    assert read(carried, tmp_path).links[1].mass == 0.2


def test_a_turned_tensor_and_frame(tmp_path):
    """The moment about the hinge is nᵀ R I Rᵀ n, with the turns of joints and of the inertial element, both skew."""
    turn, own = (0.4, -0.7, 1.1), (-0.3, 0.9, 0.2)
    tensor = np.array([[0.030, 0.002, -0.001], [0.002, 0.024, 0.003], [-0.001, 0.003, 0.019]])
    words = [("ixx", 0, 0), ("ixy", 0, 1), ("ixz", 0, 2), ("iyy", 1, 1), ("iyz", 1, 2), ("izz", 2, 2)]
    inertia = " ".join(f'{word}="{tensor[i, j]}"' for word, i, j in words)

    def rpy(angles):
        return " ".join(map(str, angles))

    def turned(roll, pitch, yaw):
        c, s = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
        x = np.array([[1, 0, 0], [0, c[0], -s[0]], [0, s[0], c[0]]])
        y = np.array([[c[1], 0, s[1]], [0, 1, 0], [-s[1], 0, c[1]]])
        return np.array([[c[2], -s[2], 0], [s[2], c[2], 0], [0, 0, 1]]) @ y @ x

    axis = turned(*turn).T @ np.array([0.0, -1.0, 0.0])
    along = turned(*turn).T @ np.array([0.35, 0.0, 0.0])
    robot = f"""<robot name="skew"><link name="base"/><link name="tool"/><link name="arm"><inertial>
      <origin xyz="{rpy(along / 2)}" rpy="{rpy(own)}"/><mass value="0.9"/><inertia {inertia}/></inertial></link>
      <joint name="j" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="{rpy(3 * axis)}"/>
      <origin xyz="0 0 1" rpy="{rpy(turn)}"/></joint>
      <joint name="t" type="fixed"><parent link="arm"/><child link="tool"/><origin xyz="{rpy(along)}"/></joint>
      </robot>"""
    (arm,) = read(robot, tmp_path).links
    n = turned(*turn) @ turned(*own)
    moment = (n @ tensor @ n.T)[1, 1]
    assert (arm.length, arm.mass, arm.com) == pytest.approx((0.35, 0.9, 0.175))
    assert arm.inertia == pytest.approx(moment, rel=1e-12)
    assert abs(moment - tensor[1, 1]) > 0.003  # a reader that forgot a turn would be off by more than rounding


def test_the_same_arm_for_pinocchio(tmp_path):
    """Torques of an arm of two links with a load, an inertial frame turned."""
    pinocchio = pytest.importorskip("pinocchio")
    robot = still(ROBOT).replace('<link name="tool"/>', link("tool", 0.02, 0.3, 0.002)).replace("0.01 -", "0 -")
    robot = robot.replace('<origin xyz="0 0 -0.08"/>', '<origin xyz="0 0 -0.08" rpy="0.2 1.1 -0.4"/>')
    body = read(robot, tmp_path)
    model = pinocchio.buildModelFromUrdf(str(tmp_path / "arm.urdf"))
    data = model.createData()
    rng = np.random.default_rng(4)
    for _ in range(3):
        angle, speed, push = rng.uniform(-2, 2, (3, 2))
        # an arm that hangs down is the file's zero: θ₁ = q₁ − π/2
        ours = planar_dynamics(2).inverse(
            torch.tensor(angle - [np.pi / 2, 0]), torch.tensor(speed), torch.tensor(push), body.parameters()
        )
        # a continuous joint is (cos, sin) in Pinocchio
        place = pinocchio.integrate(model, pinocchio.neutral(model), angle)
        np.testing.assert_allclose(ours, pinocchio.rnea(model, data, place, speed, push), rtol=1e-9, atol=1e-9)


def test_a_tensor_needs_no_sense_across_the_plane(tmp_path):
    """Ixx + Izz < Iyy is no rigid body's, but a plane across y sees Iyy alone."""
    broken = still(ROBOT).replace('ixx="0.02"', 'ixx="1e-5"')
    assert read(broken, tmp_path).links[0].inertia == pytest.approx(0.02)


def test_what_a_rigid_body_lacks_is_named(tmp_path):
    more = LIMIT + '<mimic joint="shoulder" multiplier="0.5"/><safety_controller k_velocity="3"/>'
    elbow = ("upper", "fore", -0.3)
    text = still(ROBOT).replace(joint("elbow", "continuous", *elbow), joint("elbow", "revolute", *elbow, more))
    text = text.replace("</robot>", '<transmission name="t"/><gazebo><plugin filename="x.so"/></gazebo></robot>')
    with pytest.warns(UserWarning, match="leaves out") as told:
        read(text, tmp_path)
    (line,) = [str(each.message) for each in told]
    for words in (
        "limits (elbow)",
        "limits of speed (elbow)",
        "mimic, a joint that follows another (elbow follows shoulder)",
        "safety controllers (elbow)",
        "elements of other programs (<gazebo>, <transmission>)",
    ):
        assert words in line


def test_a_turning_base_is_the_odd_one(tmp_path):
    text = still(ROBOT).replace('<link name="base">', '<link name="ground"/><link name="base">')
    text = text.replace(
        "</robot>", joint("pan", "continuous", "ground", "base", 0.1).replace("0 -1 0", "0 0 1") + "</robot>"
    )
    with pytest.raises(BodyError, match=r"joint 'pan' turns about \(0, 0, 1\): make it a fixed one"):
        read(text, tmp_path)


def test_files_of_another_kind(tmp_path):
    with pytest.raises(BodyError, match="<robot> around it, got <svg>"):
        Body.load(written("<svg/>", tmp_path / "arm.urdf"))
    with pytest.raises(FileNotFoundError):
        Body.load(tmp_path / "none.urdf")


def test_a_last_link_without_an_end_has_it_at_its_centre_of_mass(tmp_path):
    """A single pendulum's file may mark no end: encoders do not need one."""
    text = still(ROBOT).replace('<link name="tool"/>', "")
    text = text.replace(joint("grip", "fixed", "fore", "tool", -0.25), "")
    with pytest.warns(UserWarning, match="leaves out where fore ends: its centre of mass stands for it"):
        body = read(text, tmp_path)
    assert body.keypoint_names == ("elbow", "fore_com")
    assert (body.links[1].length, body.links[1].com, body.links[1].inertia) == pytest.approx((0.08, 0.08, 0.01))
    with pytest.warns(UserWarning, match="where fore ends"):
        assert Body.load(tmp_path / "arm.urdf", filmed=False).is_chain


def test_a_pendulum_whose_only_frame_is_at_its_hinge_has_a_reach(tmp_path):
    """A length of 0 would make every speed infinite: 1 m stands for it, as in a body without sites."""
    lines = [link("base", 0, 5, 1.0), link("fore", 0.08, 0.6, 0.01), joint("elbow", "continuous", "base", "fore", 0)]
    text = "\n".join(['<robot name="one">', *lines, "</robot>"])
    body = Body.load(written(text.replace("0 0.02 0", "0 0 0"), tmp_path / "one.urdf"), dimensions=3)
    dynamics, numbers = dynamics_for(body), body.parameters()
    assert dynamics.levers(numbers).tolist() == [1.0]
    assert dynamics.reach(numbers) == 1.0
    several = torch.stack([numbers.gravity, 2 * numbers.gravity])  # no branch on a value: it can be traced
    assert torch.func.vmap(lambda g: dynamics.levers(numbers._replace(gravity=g)))(several).tolist() == [[1.0]] * 2
