"""Trees: files, tables of Denavit and Hartenberg, charts, priors, and what is refused."""

import dataclasses
import math
import re

import numpy as np
import pyro
import pyro.distributions as dist
import pytest
import torch
from chains import assert_close as close
from trees import F64, mobile_arm, panda, paper_arm, parameters_in_space, random_state, random_tree

from invdyn.models.bodies.body import Body, load_body
from invdyn.models.bodies.dh import Inertial, Row, from_dh
from invdyn.models.bodies.joints import Joint
from invdyn.models.bodies.link import Link
from invdyn.models.bodies.scalars import BodyError, Learned, prior
from invdyn.models.dynamics.spatial.dynamics import SpatialDynamics

PLANAR = """
name = "flat"
[[links]]
name = "upper_arm"
joint = "shoulder"
tip = "elbow"
length = 0.3
mass = 1.5
"""


@pytest.mark.parametrize("tree", [paper_arm(), panda(), mobile_arm(), random_tree(9, 5)], ids=lambda t: t.name)
def test_files_are_read_back_as_they_were(tree, tmp_path):
    tree.to_toml(tmp_path / "body.toml")
    again = load_body(tmp_path / "body.toml")
    assert again == tree
    for ours, theirs in zip(tree.parameters(), again.parameters(), strict=True):
        assert torch.equal(ours, theirs)


def test_priors_and_learned_scalars_are_read_back(tmp_path):
    link = Link(
        "rod", Joint("pivot"), mass=prior(1.5, 0.1), length=Learned(0.4), tip="end", com=(0.1, prior(-0.1, 0.02), 0)
    )
    Body("b", [link]).to_toml(tmp_path / "b.toml")
    read = load_body(tmp_path / "b.toml")
    assert read.has_priors
    assert read.links[0].length == Learned(0.4)
    assert read.links[0].com[1].stddev.item() == pytest.approx(0.02)
    with pytest.raises(BodyError, match="log-normal priors"):
        Body("b", [dataclasses.replace(link, mass=dist.Gamma(2.0, 1.0))]).to_toml(tmp_path / "c.toml")


def test_planar_files_stay_planar(tmp_path):
    (tmp_path / "flat.toml").write_text(PLANAR)
    body = load_body(tmp_path / "flat.toml")
    assert body.is_chain
    assert body.dimensions == 2
    tree, p = body.in_space(), parameters_in_space(body.parameters())
    assert (tree.joint_names, tree.keypoint_names) == (("shoulder",), ("elbow",))
    assert all(torch.equal(x, y) for x, y in zip(tree.parameters()[3:], p[3:], strict=True))


def test_sticks_follow_their_lengths():
    tree = Body(
        "arm",
        [
            Link("upper", Joint("shoulder", "ball"), length=Learned(0.3), tip="elbow", mass=2.0),
            Link("fore", Joint("bend"), parent="upper", length=0.25, tip="wrist", mass=1.0),
        ],
    )
    pyro.clear_param_store()
    p = tree.sample("arm.")
    assert "arm.upper.length" in pyro.get_param_store()
    close(p.position.detach(), [[0, 0, 0], [0.3, 0, 0]], 1e-12)
    close(p.sites.detach(), [[0.3, 0, 0], [0.25, 0, 0]], 1e-12)
    rod = 2 * 0.3**2 / 12
    close(p.inertia[0].detach(), [0, rod, rod, 0, 0, 0], 1e-12)
    pyro.get_param_store()["arm.upper.length"] = torch.tensor(0.5, dtype=F64)
    q = torch.zeros(4, dtype=F64)
    close(SpatialDynamics(tree).keypoints(q, tree.sample("arm.")).detach(), [[0.5, 0, 0], [0.75, 0, 0]], 1e-12)


def test_sampled_numbers_gain_the_plates_dimensions():
    link = Link("rod", Joint("pivot"), mass=prior(1.5, 0.1), com=(0.2, dist.Normal(0.0, 0.1), 0.0))
    with pyro.plate("bodies", 5), pyro.poutine.trace() as traced:
        p = Body("b", [link]).sample()
    assert {"rod.mass", "rod.com_y"} <= set(traced.trace.nodes)
    assert p.mass.shape == (5, 1)
    assert p.com.shape == (5, 1, 3)
    assert p.inertia.shape == (1, 6)


def test_names_of_coordinates():
    tree = Body(
        "b",
        [
            Link("a", Joint("root", "free"), mass=1.0, inertia=(1, 1, 1, 0, 0, 0)),
            Link("b", Joint("wrist", "ball", chart="zxz"), parent="a", mass=1.0, inertia=(1, 1, 1, 0, 0, 0)),
        ],
    )
    assert tree.joint_names[:6] == ("root_x", "root_y", "root_z", "root_yaw", "root_pitch", "root_roll")
    assert tree.joint_names[6:] == ("wrist_turn1", "wrist_turn2", "wrist_turn3")


def test_the_pandas_last_joint_with_all_joints_at_zero():
    # all joints at 0: straight up, d1 + d3 + d5, and back down by nothing; a7 to the front
    q = torch.zeros(7, dtype=F64)
    close(SpatialDynamics(panda()).keypoints(q, panda().parameters())[0], [0.088, 0, 0.333 + 0.316 + 0.384], 1e-12)


@pytest.mark.parametrize("kinds", [("hinge",) * 4, ("hinge", "slide", "hinge", "slide")])
def test_both_conventions_of_denavit_and_hartenberg(kinds):
    rng = np.random.default_rng(3)
    # the same arm: in the modified convention, a and α of a row stand one row later
    rows = [(*rng.uniform(-1, 1, 4).tolist(), kind) for kind in kinds]
    last = [(a, alpha, 0.0, 0.0) for a, alpha, *_ in rows]
    modified = [
        (*(last[k - 1][:2] if k else (0.0, 0.0)), d, theta, kind) for k, (_, _, d, theta, kind) in enumerate(rows)
    ]
    weightless = [Inertial(0.0)] * 4
    standard = from_dh("s", [Row(*row) for row in rows], weightless, "standard")
    other = from_dh("m", [Row(*row) for row in modified], weightless, "modified")
    q = random_state(4, 0)[0]
    found = []
    for k, (row, value) in enumerate(zip(rows, q.tolist(), strict=True)):
        a, alpha, d, theta = row[:4]
        theta, d = (theta + value, d) if kinds[k] == "hinge" else (theta, d + value)
        c, s, ca, sa = math.cos(theta), math.sin(theta), math.cos(alpha), math.sin(alpha)
        # the matrix as text books print it
        found.append(np.array([[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]))
    place = np.linalg.multi_dot(found)[:3, 3]
    close(SpatialDynamics(standard, rotors=True).keypoints(q, standard.parameters())[0], place, 1e-12)
    # the modified one ends at the last joint: its last a and α are no row any more
    end = np.linalg.multi_dot([*found[:3], found[3] @ np.linalg.inv(_last(*rows[3][:2]))])[:3, 3]
    close(SpatialDynamics(other, rotors=True).keypoints(q, other.parameters())[0], end, 1e-12)


def _last(a, alpha):
    c, s = math.cos(alpha), math.sin(alpha)
    return np.array([[1, 0, 0, a], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1]])


MADE = {
    "hangs on 'lower', which is no link": {"parent": "lower"},
    "length 1, got length 2": {"joint": {"axis": (0, 0, 2)}},
    "expected a type of hinge": {"joint": {"type": "revolute"}},
    "no two equal in a row, got 'zzy'": {"joint": {"type": "ball", "chart": "zzy"}},
    "a hinge joint's chart: expected none": {"joint": {"chart": "zyx"}},
    "mass in kg: expected no negative number, got -1": {"mass": -1.0},
    "mass in kg: expected 1e-09 or more, got 1e-12; is the unit right?": {"mass": 1e-12},
    "length in m: expected 1e-06 or more, got 1e-09; is the unit right?": {"length": 1e-9, "tip": "t"},
    "inertia in kg·m²: expected 1e-21 or more, got 1e-30": {"inertia": (1e-30, 1, 1, 0, 0, 0)},
    "mass in kg: expected a positive number, got 0": {"mass": Learned(0.0)},
    "length in m: expected up to 30, as of any arm, got 300": {"length": 300.0, "tip": "t"},
    "com in m: expected up to 30, as of any arm, got -150": {"com": (-150.0, 0, 0)},
    "site 'wrist' in m: expected up to 30, as of any arm, got 250": {"sites": {"wrist": (250.0, 0, 0)}},
    "inertia in kg·m²: expected moments as of mass within 30 m, up to 900, got 4000": {"inertia": (1, 1, 4e3, 0, 0, 0)},
    "com in m: expected 3 numbers": {"com": (0.1, 0.2)},
    "com in m: expected a finite number": {"com": (0.1, math.nan, 0)},
    "inertia in kg·m²: expected 6 numbers": {"inertia": (1, 1, 1)},
    "got left-handed ones": {"rotation": ((1, 0, 0), (0, 1, 0), (0, 0, -1))},
    "expected axes at right angles": {"rotation": ((1, 0.1, 0), (0, 0.995, 0), (0, 0, 1))},
    "exceeds the sum of the two others": {"joint": {"type": "ball"}, "inertia": (1, 1, 3, 0, 0, 0)},
    "principal moments of inertia ≥ 0": {"joint": {"type": "ball"}, "inertia": (1, 1, 1, 2, 0, 0)},
    "expected length and tip together": {"length": 0.3},
    "prior allows negative values": {"mass": dist.Normal(1.0, 0.1)},
    "reference, as x, y and z axes: expected right-handed axes": {
        "joint": {"reference": ((1, 0, 0), (0, 1, 0), (0, 0, -1))}
    },
    "reference: expected three rows of three numbers, got 5": {"joint": {"reference": 5}},
    "reference: expected 3 numbers, got [1, 0]": {"joint": {"reference": ((1, 0), (0, 1), (0, 0))}},
    "rotation: expected three rows of three numbers": {"rotation": "xyz"},
    "name of a site: expected a text that is not blank, got ['t']": {"length": 0.1, "tip": ["t"]},
    "fixed, got ['hinge']": {"joint": {"type": ["hinge"]}},
    "only fixed ones": {"joint": {"type": "fixed"}},
}


def test_a_base_may_stand_anywhere_and_a_joint_only_within_reach():
    base = Link("a", Joint("j"), mass=1.0, origin=(300.0, 0, 0), inertia=(1, 1, 1, 0, 0, 0))
    Body("b", [base])
    with pytest.raises(BodyError, match=r"origin in m: expected up to 30,.* got 300; is the unit right"):
        Link("l", Joint("k"), parent="a", mass=1.0, origin=(300.0, 0, 0))


@pytest.mark.parametrize("said", MADE)
def test_what_a_link_cannot_be_is_said_in_one_line(said):
    given = {"name": "l", "mass": 1.0} | MADE[said]
    with pytest.raises(BodyError, match=re.escape(said)) as caught:
        Body("b", [Link(**given | {"joint": Joint("j", **given.get("joint", {}))})])
    assert "\n" not in str(caught.value)


def test_inertia_is_asked_for_no_more_than_plays_a_part():
    # about one direction: its moment alone; without turns: nothing
    Body("b", [Link("l", Joint("j"), mass=1.0, inertia=(0, 0, 3, 0, 0, 0))])
    Body("b", [Link("l", Joint("j", "slide"), mass=1.0, inertia=(0, 0, 3, 0, 0, 0))])
    tilted = Joint("j", axis=(math.sqrt(0.5), math.sqrt(0.5), 0.0))
    with pytest.raises(BodyError, match="moment of inertia about its hinge"):
        Body("b", [Link("l", tilted, mass=1.0, inertia=(1, 1, 1, -2, 0, 0))])


def test_circles_and_names_used_twice():
    one, two = Link("a", Joint("j"), parent="b", mass=1.0), Link("b", Joint("k"), parent="a", mass=1.0)
    with pytest.raises(BodyError, match="hang on each other in a circle: 'a' on 'b', 'b' on 'a'"):
        Body("t", [one, two])
    for twice in ({"name": "b"}, {"joint": Joint("k")}, {"tip": "s", "length": 0.1}):
        first = dataclasses.replace(one, parent="world", **twice)
        with pytest.raises(BodyError, match=r"got '[bks]' twice"):
            Body("t", [first, dataclasses.replace(two, parent=first.name, sites={"s": (0, 0, 0)})])


WRITTEN = {
    "quaternion .w, x, y, z.: expected length 1, got length 1.41": "quaternion = [1, 1, 0, 0]",
    "expected one of rpy, quaternion, axes, got rpy and quaternion": "rpy = [0, 0, 0]\nquaternion = [1, 0, 0, 0]",
    "got left-handed ones": "axes = [[1, 0, 0], [0, 1, 0], [0, 0, -1]]",
    "unknown key 'lenght'": "lenght = 0.3",
    "name of a site: expected a text that is not blank, got ..t..": 'length = 0.1\ntip = ["t"]',
    "expected sites as a table": "sites = [[0.1, 0, 0]]",
    "unknown key 'driven'": "driven = 1",
    "gravity in m/s²: expected 3 numbers": "",
    "expected dimensions = 2 .the default. or 3": "",
}


@pytest.mark.parametrize("said", WRITTEN)
def test_what_a_file_cannot_say_is_said_in_one_line_with_its_name(said, tmp_path):
    dimensions, gravity = (
        ("4" if "dimensions" in said else "3"),
        ("[0, -9.81]" if "gravity" in said else "[0, 0, -9.81]"),
    )
    link = f'[[links]]\nname = "l"\njoint = "j"\nmass = 1.0\n{WRITTEN[said]}'
    text = f"dimensions = {dimensions}\ngravity = {gravity}\n{link}"
    (tmp_path / "body.toml").write_text(text)
    with pytest.raises(BodyError, match=said) as caught:
        load_body(tmp_path / "body.toml")
    assert str(caught.value).startswith(str(tmp_path / "body.toml"))
    assert "\n" not in str(caught.value)
