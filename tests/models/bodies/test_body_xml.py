"""A robot's file is data: another kind is told what to do, and nothing in it reads elsewhere or without bounds."""

import os
import re

import numpy as np
import pytest

from invdyn.models import Body, BodyError
from invdyn.models.bodies.body_xml import DEEPEST, MOST_BYTES

CORNER = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
"""A tetrahedron of 1/6 m³."""


def load(text, path):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return Body.load(path)


@pytest.mark.parametrize(
    ("name", "text", "advice"),
    [
        ("arm.sdf", '<?xml version="1.0"?><sdf version="1.9"/>', "SDF is not read; write the arm as URDF or MJCF"),
        ("arm.osim", "<OpenSimDocument/>", "expected a <Model>"),
        ("arm.urdf.xacro", '<robot name="a"><xacro:include filename="x"/></robot>', "expand it first: xacro"),
        ("arm.dae", "<COLLADA/>", "a mesh, not a robot"),
        ("arm.xml", "<html/>", "expected URDF, with <robot> around it, got <html>"),
    ],
)
def test_another_kind_of_file_is_told_what_to_do(name, text, advice, tmp_path):
    with pytest.raises(BodyError, match=advice) as refusal:
        load(text, tmp_path / name)
    assert str(refusal.value).startswith(str(tmp_path / name))
    assert "\n" not in str(refusal.value)


def bomb():
    rows = "".join(f'<!ENTITY e{i} "{f"&e{i - 1};" * 10}">' for i in range(1, 9))
    return f'<!DOCTYPE r [<!ENTITY e0 "x">{rows}]><robot name="&e8;"/>'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (bomb(), "declares the entity 'e0'"),
        ('<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/hostname">]><robot name="&x;"/>', "declares the entity 'x'"),
        ("<robot>" + "<a>" * DEEPEST + "</a>" * DEEPEST + "</robot>", "elements within each other"),
        ("<robot>" + "<a>" * 200_000, "elements within each other"),
        ('<?xml version="1.0" encoding="no-such"?><robot/>', "broken XML"),
        ("<robot><", "broken XML"),
        ("x = " + "[" * 5000, "nested too deep"),
        ("x = " + "9" * 5000, "integer too long"),
    ],
    ids=["entities", "a file as entity", "deep", "very deep", "encoding", "cut", "deep TOML", "digits"],
)
def test_a_file_without_bounds_is_one_line(text, message, tmp_path):
    with pytest.raises(BodyError, match=message) as refusal:
        load(text, tmp_path / "arm.xml")
    assert "\n" not in str(refusal.value)
    for name in ("arm.xml", "arm.toml"):
        (tmp_path / name).write_text(text)
        with pytest.raises(BodyError, match=message) as refusal:
            Body.load(tmp_path / name)
        assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("loaded", [Body.load, Body.from_toml])
def test_an_endless_file_ends(loaded):
    with pytest.raises(BodyError, match=f"at most {MOST_BYTES / 2**20:g} MiB"):
        loaded("/dev/zero")


def test_a_robots_file_is_known_by_its_content_wherever_it_is_read(tmp_path):
    (tmp_path / "arm.toml").write_text(chain(2))
    (tmp_path / "arm.xml").write_text('dimensions = 3\n[[links]]\nname = "l"\njoint = "j"\nmass = 1.0')
    assert Body.load(tmp_path / "arm.toml") == Body.load(tmp_path / "arm.toml")
    assert not Body.load(tmp_path / "arm.xml").is_chain


def mjcf(more="", assets="", geom='<geom type="mesh" mesh="tri"/>'):
    return f"""<mujoco>{assets}<worldbody><body name="a"><joint name="j" axis="0 0 1"/>{geom}
      <inertial pos="0.1 0 0" mass="1" diaginertia="0.01 0.01 0.01"/><site name="tip" pos="0.3 0 0"/></body>
      </worldbody>{more}</mujoco>"""


def mesh(file, compiler=""):
    return f'{compiler}<asset><mesh name="tri" file="{file}"/></asset>'


WHERE = {
    "parts/corner.obj": "",
    "corner.obj": '<compiler meshdir="parts"/>',
    "C/else/corner.obj": '<compiler assetdir="parts" strippath="true"/>',
}


@pytest.mark.parametrize(("file", "compiler"), WHERE.items(), ids=WHERE)
def test_meshes_and_includes_in_the_folder_are_read(file, compiler, tmp_path):
    """Without an inertial element the mesh gives the mass, at MuJoCo's 1000 kg/m³."""
    pytest.importorskip("mujoco")
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "corner.obj").write_text(CORNER)
    shared = f'<mujocoinclude>{compiler}<asset><mesh file="{file}"/></asset></mujocoinclude>'
    (tmp_path / "parts" / "shared.xml").write_text(shared)
    text = """<mujoco><include file="parts/shared.xml"/><worldbody><body name="a"><joint name="j" axis="0 0 1"/>
      <geom type="mesh" mesh="corner"/><site name="tip" pos="0.5 0.5 0"/></body></worldbody></mujoco>"""
    (link,) = load(text, tmp_path / "arm.xml").links
    assert link.mass == pytest.approx(1000 / 6, rel=1e-6)
    assert (link.length, link.com) == pytest.approx((2**-0.5, 2**0.5 / 4))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (" " * 2**20, "at most 16 MiB in its included files"),
        ("<a/>" * 30_000, "at most 50000 elements in its included"),
    ],
)
def test_included_files_have_one_limit_together(content, message, tmp_path):
    pytest.importorskip("mujoco")
    for k in range(20):
        (tmp_path / f"p{k}.xml").write_text(f"<mujocoinclude>{content}</mujocoinclude>")
    includes = "".join(f'<include file="p{k}.xml"/>' for k in range(20))
    with pytest.raises(BodyError, match=message):
        load(f"<mujoco>{includes}<worldbody/></mujoco>", tmp_path / "arm.xml")


def chain(count):
    """A URDF of so many links, one after the other."""
    heavy = '<inertial><mass value="1"/><inertia ixx="0.001" iyy="0.001" izz="0.001"/></inertial>'
    links = "".join(f'<link name="l{k}">{heavy}</link>' for k in range(count + 1))
    joints = "".join(
        f'<joint name="j{k}" type="continuous"><parent link="l{k}"/><child link="l{k + 1}"/><axis xyz="0 0 1"/>'
        '<origin xyz="0.1 0 0"/></joint>'
        for k in range(count)
    )
    return (
        f'<robot name="long">{links}{joints}<link name="end"/><joint name="e" type="fixed"><parent link="l{count}"/>'
        '<child link="end"/><origin xyz="0.1 0 0"/></joint></robot>'
    )


def test_more_links_than_any_arm_has_are_refused(tmp_path):
    assert load(chain(30), tmp_path / "arm.urdf").num_joints == 30
    with pytest.raises(BodyError, match="at most 100 links, got 101"):
        load(chain(101), tmp_path / "arm.urdf")
    scene = mjcf().replace("</worldbody>", "<body/>" * 1001 + "</worldbody>")
    with pytest.raises(BodyError, match="at most 1000 bodies, got 1002"):
        load(scene, tmp_path / "arm.xml")


OUTSIDE = "outside its own folder"
FILES = {
    "a mesh above": (mjcf(assets=mesh("../tri.obj")), OUTSIDE),
    "a mesh by its whole path": (mjcf(assets=mesh("/etc/hostname")), OUTSIDE),
    "a folder of meshes above": (mjcf(assets=mesh("tri.obj", '<compiler meshdir="../.."/>')), OUTSIDE),
    "a link to a device": (mjcf(assets=mesh("endless.obj")), OUTSIDE),
    "a loop of links": (mjcf(assets=mesh("loop.obj")), "no file"),
    "a pipe": (mjcf(assets=mesh("pipe.obj")), "no file"),
    "a folder": (mjcf(assets=mesh("folder")), "no file"),
    "no mesh": (mjcf(assets=mesh("none.obj")), "no file"),
    "a mesh that grows by itself": (
        mjcf(assets='<asset><mesh name="tri" builtin="sphere" params="30"/></asset>'),
        "built-in",
    ),
    "an include above": (mjcf('<include file="../more.xml"/>'), OUTSIDE),
    "an include of a device": (mjcf('<include file="/dev/zero"/>'), OUTSIDE),
    "an include of itself": (mjcf('<include file="arm.xml"/>'), "twice"),
    "an include without a name": (mjcf("<include/>"), "no file"),
    "a billion copies": (
        mjcf(geom='<replicate count="1000000000"><geom size="1"/></replicate>'),
        "<replicate> is not read",
    ),
    "another model": (mjcf(geom='<attach model="m" prefix="p"/>'), "<attach> is not read"),
    "cloth": (mjcf(geom='<flexcomp name="f" count="9999 9999 1"/>'), "<flexcomp> is not read"),
}


@pytest.mark.parametrize(("text", "message"), FILES.values(), ids=FILES)
def test_files_from_elsewhere_and_endless_ones_are_one_line(text, message, tmp_path):
    folder = tmp_path / "robot"
    (folder / "folder").mkdir(parents=True)
    (folder / "endless.obj").symlink_to("/dev/zero")
    (folder / "loop.obj").symlink_to("loop.obj")
    os.mkfifo(folder / "pipe.obj")
    (tmp_path / "tri.obj").write_text(CORNER)
    (tmp_path / "more.xml").write_text("<mujocoinclude/>")
    with pytest.raises(BodyError, match=message) as refusal:
        load(text, folder / "arm.xml")
    assert "\n" not in str(refusal.value)


def test_what_asks_for_memory_and_is_no_body_is_dropped(tmp_path):
    """A height field of 10¹² points, an arena of a terabyte, textures, histories: none of it is built."""
    pytest.importorskip("mujoco")
    assets = """<size memory="1000G"/><asset><hfield name="h" nrow="1000000" ncol="1000000" size="1 1 1 1"/>
      <texture name="t" builtin="flat" width="100000" height="100000"/><material name="m" texture="t"/></asset>"""
    more = '<actuator><motor name="engine" joint="j" nsample="1000000000" delay="0.02"/></actuator>'
    geom = '<camera name="c" resolution="99999 99999"/><geom material="m" size="0.1" contype="0" conaffinity="0"/>'
    text = mjcf(more, assets, geom).replace("<worldbody>", '<worldbody><geom type="hfield" hfield="h"/>')
    with pytest.warns(UserWarning, match=r"leaves out delays \(engine\)$"):
        body = load(text, tmp_path / "arm.xml")
    assert body.links[0].mass == 1.0


VALUES = [
    "",
    "nan",
    "inf",
    "-1",
    "1e308",
    "-1e308",
    "1e400",
    "1e-320",
    "0",
    "9" * 5000,
    "a",
    "0 0",
    "1e155 1e155 1e155",
]
VALUES += ["1 2 3 4 5 6 7", "true", "&#0;", "${x}", "{}", "%s", "é" * 300]


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("kind", ["URDF", "MJCF"])
def test_a_damaged_file_is_a_body_or_one_line(kind, tmp_path, monkeypatch):
    """150 files with one to three values, elements or letters changed: never another error, and no file beside it."""
    pytest.importorskip("mujoco")
    monkeypatch.chdir(tmp_path)
    whole = chain(2) if kind == "URDF" else mjcf(geom='<geom type="capsule" size="0.1" fromto="0 0 0 0.3 0 0"/>')
    rng = np.random.default_rng(5)
    bodies, lines = 0, []
    for _ in range(150):
        text = whole
        for _ in range(rng.integers(1, 4)):
            value = rng.choice(list(re.finditer('="([^"]*)"', text)))
            element = rng.choice(list(re.finditer("<[^>]+/>", text)) or [value])
            letter = rng.integers(len(text))
            text = [
                text[: value.start(1)] + str(rng.choice(VALUES)) + text[value.end(1) :],
                text[: element.start()] + text[element.end() :],
                text[: element.start()] + 2 * element.group() + text[element.end() :],
                text[:letter] + str(rng.choice(["\0", "<", ">", "&", "\x80", "X"])) + text[letter + 1 :],
            ][rng.choice(4, p=[0.6, 0.15, 0.15, 0.1])]
        try:
            load(text, tmp_path / "arm.xml").parameters()
            bodies += 1
        except BodyError as refusal:
            lines.append(str(refusal))
    assert not [line for line in lines if "\n" in line]
    assert 5 < bodies < 120  # the changes are neither all harmless nor all fatal
    assert [path.name for path in tmp_path.iterdir()] == ["arm.xml"]
