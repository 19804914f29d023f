"""Bodies out of URDF: the same numbers as in the file, meshes or not."""

import pytest

from invdyn.models import Body, BodyError

pytest.importorskip("mujoco")

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


def read(text, tmp_path):
    (tmp_path / "arm.urdf").write_text(text, encoding="utf-8")
    return Body.load(tmp_path / "arm.urdf")


def test_the_numbers_of_the_file(tmp_path):
    with pytest.warns(UserWarning, match=r"leaves out damping \(shoulder\); dry friction \(shoulder\); limits"):
        body = read(ROBOT, tmp_path)
    assert body.joint_names == ("shoulder", "elbow")
    assert body.keypoint_names == ("elbow", "tool")
    upper, fore = body.links
    assert (upper.length, upper.mass, upper.com, upper.inertia) == pytest.approx((0.3, 1.2, 0.1, 0.02))
    assert (fore.length, fore.mass, fore.com, fore.inertia) == pytest.approx((0.25, 0.6, 0.08, 0.01))
    assert body.gravity == pytest.approx((0.0, -9.81))
    assert body.base == pytest.approx((0.0, 1.0))


def test_what_is_no_robot_is_refused(tmp_path):
    with pytest.raises(BodyError, match="broken XML"):
        read(ROBOT.replace("</robot>", ""), tmp_path)
    with pytest.raises(BodyError, match="<robot> around it, got <mujoco>"):
        read("<mujoco/>", tmp_path)
    with pytest.raises(BodyError, match="slide"):
        read(ROBOT.replace("continuous", "prismatic"), tmp_path)
    with pytest.raises(BodyError, match="MuJoCo cannot read it"):
        read(ROBOT.replace('child link="fore"', 'child link="nobody"'), tmp_path)
    with pytest.raises(FileNotFoundError):
        Body.load(tmp_path / "none.urdf")
