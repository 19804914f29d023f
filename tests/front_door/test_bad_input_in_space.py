"""Anything wrong with a body in space, or its recording, ends with one clear line, exit code 2, nothing written."""

import pytest

ARM = """
name = "arm"
dimensions = 3
gravity = [0.0, 0.0, -9.81]
[[links]]
name = "upper"
joint = "shoulder"
type = "universal"
rpy = [1.5707963267948966, 0.0, 0.0]
mass = 1.0
com = [0.1, 0.0, 0.0]
inertia = [0.001, 0.01, 0.01, 0.0, 0.0, 0.0]
sites = {elbow = [0.3, 0.0, 0.0]}
[[links]]
name = "fore"
joint = "elbow"
axis = [0.0, 1.0, 0.0]
origin = [0.3, 0.0, 0.0]
mass = 0.5
com = [0.1, 0.0, 0.0]
inertia = [0.0005, 0.005, 0.005, 0.0, 0.0, 0.0]
sites = {wrist = [0.25, 0.0, 0.0]}
"""
RPY, AXIS = "rpy = [1.5707963267948966, 0.0, 0.0]", "axis = [0.0, 1.0, 0.0]"
UPPER = "inertia = [0.001, 0.01, 0.01, 0.0, 0.0, 0.0]"
FORE = "mass = 0.5\ncom = [0.1, 0.0, 0.0]\ninertia = [0.0005, 0.005, 0.005, 0.0, 0.0, 0.0]"
BODIES = {  # what stands in the body file, what comes instead, what is said
    "a circle": ('name = "upper"', 'name = "upper"\nparent = "fore"', "hang on each other in a circle"),
    "an unknown parent": ('name = "fore"', 'name = "fore"\nparent = "uper"', "hangs on 'uper', which is no link"),
    "a massless end": (FORE, "mass = 0.0", "nothing resists a torque at 'elbow'"),
    "the triangle inequality": (UPPER, UPPER.replace("0.001", "0.5"), "exceeds the sum of the two others"),
    "a product too large": (UPPER, UPPER.replace("0.0, 0.0, 0.0]", "0.02, 0.0, 0.0]"), "principal moments"),
    "three moments": (UPPER, "inertia = [0.001, 0.01, 0.01]", "inertia in kg·m²: expected 6 numbers"),
    "left-handed axes": (RPY, "axes = [[1, 0, 0], [0, 1, 0], [0, 0, -1]]", "expected right-handed axes"),
    "axes askew": (RPY, "axes = [[1, 0, 0], [0.6, 0.8, 0], [0, 0, 1]]", "at right angles to each other"),
    "a quaternion": (RPY, "quaternion = [1.0, 1.0, 0.0, 0.0]", "expected length 1, got length 1.414"),
    "degrees": (RPY, "rpy = [90.0, 0.0, 0.0]", "are these degrees?"),
    "two rotations": (RPY, RPY + "\nquaternion = [1.0, 0.0, 0.0, 0.0]", "expected one of rpy, quaternion, axes"),
    "a long axis": (AXIS, "axis = [0.0, 1.0, 1.0]", "joint 'elbow': axis: expected length 1"),
    "an unknown joint": ('type = "universal"', 'type = "cardan"', "expected a type of hinge, slide"),
    "an unknown chart": ('type = "universal"', 'type = "universal"\nchart = "zz"', "expected 2 letters of x, y and z"),
    "a site twice": ("{wrist", "{elbow", "names of their own for all sites, got 'elbow' twice"),
    "a joint twice": ('joint = "elbow"', 'joint = "shoulder"', "for all joints, got 'shoulder' twice"),
    "a tip without length": (AXIS, AXIS + '\ntip = "hand"', "expected length and tip together"),
    "gravity in the plane": ("[0.0, 0.0, -9.81]", "[0.0, -9.81]", "gravity in m/s²: expected 3 numbers"),
    "four dimensions": ("dimensions = 3", "dimensions = 4", "expected dimensions = 2 (the default) or 3, got 4"),
    "no dimensions": ("dimensions = 3\n", "", "unknown key"),
    "nothing that moves": (ARM[ARM.index("[[links]]") :], '[[links]]\nname = "a"\njoint = "b"\ntype = "fixed"',
                           "expected a joint that moves"),
    "a site without height": ("[0.25, 0.0, 0.0]", "[0.25, 0.0]", "site 'wrist' in m: expected 3 numbers"),
    "a driven joint": (AXIS, AXIS + "\ndriven = true", "driven"),
}  # fmt: skip
ROBOTS = {
    "a loop": (
        '<robot name="r"><link name="a"/><link name="b"/><joint name="i" type="continuous"><parent link="a"/>'
        '<child link="b"/></joint><joint name="j" type="continuous"><parent link="b"/><child link="a"/></joint>'
        "</robot>",
        "the joints form a loop",
    ),
    "a massless end": (
        '<robot name="r"><link name="a"/><link name="b"/><joint name="i" type="prismatic"><parent link="a"/>'
        '<child link="b"/></joint></robot>',
        "nothing resists a torque at 'i'",
    ),
    "a massless body": (
        '<mujoco><worldbody><body name="a"><joint type="slide"/></body></worldbody></mujoco>',
        "mass and inertia of moving bodies",
    ),
    "no joint": ('<mujoco><worldbody><body><geom size=".1"/></body></worldbody></mujoco>', "got one without"),
    "a missing mesh": (
        '<mujoco><asset><mesh file="arm.stl"/></asset><worldbody><body><joint type="slide"/>'
        '<geom type="mesh" mesh="arm"/></body></worldbody></mujoco>',
        "names 'arm.stl', which is no file",
    ),
}
HEADER = "time,elbow_x,elbow_y,elbow_z,wrist_x,wrist_y,wrist_z\n"
ROWS = "".join(f"{0.03 * n:.2f},0.3,0,{0.01 * n:.2f},0.55,0,{0.02 * n:.2f}\n" for n in range(9))
FLAT = "time,elbow_x,elbow_y\n0,0.3,0\n0.03,0.3,0\n0.06,0.3,0.1\n"
RECORDINGS = {  # the recording, options, what is said
    "two coordinates": (FLAT, (), "give elbow_z and the like too"),
    "two of three": (FLAT.replace("_y", "_z"), (), "elbow"),
    "another joint's encoder": (
        HEADER.strip() + ",shoulder_angle\n" + ROWS.replace("\n", ",0.1\n"),
        (),
        "shoulder_yaw",
    ),
    "lengths to be learned": (
        HEADER + ROWS,
        (
            "--learn",
            "lengths",
        ),
        "has no links of a length that could be learned",
    ),
    "a unit": (HEADER + ROWS, ("--units", "mm"), "apart (median), but the body's link is"),
}


@pytest.fixture
def refused(tmp_path, monkeypatch, run, contents):
    """Function that makes a call and checks the refusal: one line, exit code 2, the folder as it was."""
    monkeypatch.chdir(tmp_path)

    def refused(*arguments, said):
        before = contents(tmp_path)
        outcome = run(*arguments)
        assert outcome.exit_code == 2, outcome.output
        assert not outcome.stdout
        (line,) = outcome.stderr.splitlines()
        assert line.startswith("error: ")
        assert said in line
        assert contents(tmp_path) == before

    return refused


@pytest.mark.parametrize(("good", "bad", "said"), BODIES.values(), ids=BODIES)
def test_bad_bodies_in_space(good, bad, said, tmp_path, refused):
    assert good in ARM
    (tmp_path / "arm.toml").write_text(ARM.replace(good, bad, 1))
    refused("simulate", "--body", "arm.toml", "--out", "rec.csv", "--duration", "0.2", said=said)


@pytest.mark.parametrize(("text", "said"), ROBOTS.values(), ids=ROBOTS)
def test_bad_robots(text, said, tmp_path, refused):
    pytest.importorskip("mujoco")
    (tmp_path / "arm.xml").write_text(text)
    refused("simulate", "--body", "arm.xml", "--out", "rec.csv", "--duration", "0.2", said=said)


@pytest.mark.parametrize(("text", "options", "said"), RECORDINGS.values(), ids=RECORDINGS)
def test_bad_recordings_of_bodies_in_space(text, options, said, tmp_path, refused):
    (tmp_path / "arm.toml").write_text(ARM)
    (tmp_path / "rec.csv").write_text(text)
    refused("infer", "rec.csv", "--body", "arm.toml", "--out", "p.nc", *options, said=said)


def test_space_for_a_robot_whose_file_has_no_sites_at_its_joints(tmp_path, refused):
    pytest.importorskip("mujoco")
    hinge = '<joint name="{}" axis="0 -1 0"/><geom size=".1"/>'.format
    fore = f'<body pos="0 0 -1">{hinge("elbow")}<site name="wrist" pos="0 0 -1"/></body>'
    upper = f"<body>{hinge('shoulder')}{fore}</body>"
    (tmp_path / "arm.xml").write_text(f"<mujoco><worldbody>{upper}</worldbody></mujoco>")
    (tmp_path / "rec.csv").write_text(HEADER + "".join(f"{0.03 * n:.2f},1,{n},2,0,{n},3\n" for n in range(3)))
    refused("infer", "rec.csv", "--body", "arm.xml", "--out", "p.nc", said="name the file's axes that point right")


def test_space_for_a_body_in_the_plane(tmp_path, refused, folder):
    (tmp_path / "rec.csv").write_text(HEADER + "".join(f"{0.03 * n:.2f},1,{n},2,0,{n},3\n" for n in range(3)))
    refused(
        "infer", "rec.csv", "--body", "arm.toml", "--out", "p.nc", said="name the file's axes that point right and up"
    )
