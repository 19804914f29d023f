"""A person's limbs, against de Leva's table and another author's sums."""

import numpy as np
import pytest
import torch

from invdyn.models import Body, BodyError, dynamics_for
from invdyn.models.bodies.person import HEIGHT, LIMBS, TABLE, person


def test_lengths_and_masses_are_the_tables_at_its_own_heights():
    arm = person(1.741, 73.0, "m", "arm_and_hand")
    assert [link.nominal("length") for link in arm.links] == pytest.approx([0.2817, 0.2689, 0.0862])
    assert [link.nominal("mass") for link in arm.links] == pytest.approx([1.9783, 1.1826, 0.4453], abs=1e-4)
    assert [link.nominal("com") for link in arm.links] == pytest.approx([0.1626, 0.1230, 0.0681], abs=1e-4)
    assert arm.links[0].nominal("inertia") == pytest.approx(1.9783 * (0.269 * 0.2817) ** 2, rel=1e-4)


@pytest.mark.parametrize("sex", TABLE)
@pytest.mark.parametrize(("limb", "end", "whole"), [("arm", "hand", "arm_and_hand"), ("leg", "foot", None)])
def test_what_lies_beyond_the_last_link_moves_with_it(sex, limb, end, whole):
    found = person(1.7, 65.0, sex, limb)
    table = TABLE[sex]
    shares = [table[name].mass for name, _, _ in LIMBS[limb]] + [table[end].mass]
    assert sum(link.nominal("mass") for link in found.links) == pytest.approx(65 * sum(shares) / 100)
    if whole is not None:  # straight, both have the same inertia about the shoulder, and the same load
        both = [person(1.7, 65.0, sex, each) for each in (limb, whole)]
        for quantity in ("typical_inertia", "typical_load"):
            one, other = (getattr(dynamics_for(each), quantity)(each.parameters())[0].item() for each in both)
            assert one == pytest.approx(other)


def test_an_arm_weighs_what_is_known():
    """Winter (2009): an arm is 5.0 % of the body, and its centre of mass lies .53 of its length from the shoulder."""
    arm = person(1.75, 70.0, "m", "arm_and_hand")
    masses = [link.nominal("mass") for link in arm.links]
    assert sum(masses) / 70 == pytest.approx(0.050, rel=0.03)
    starts = [0.0, arm.links[0].nominal("length")]
    starts.append(starts[1] + arm.links[1].nominal("length"))
    centre = sum(m * (s + link.nominal("com")) for m, s, link in zip(masses, starts, arm.links, strict=True))
    assert centre / sum(masses) / (starts[2]) == pytest.approx(0.53, rel=0.05)


def test_it_is_uncertain_and_its_lengths_are_learned(tmp_path):
    arm = person(HEIGHT["f"], 61.9, "f")
    assert arm.with_uncertainty().has_priors
    assert arm.learned["length"] == (0, 1)
    assert arm.keypoint_names == ("elbow", "wrist")
    arm.to_toml(tmp_path / "arm.toml")
    assert type(arm).load(tmp_path / "arm.toml") == arm


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"height": 175}, "height from 0.4 to 2.8 m, got 175: check the unit"),
        ({"mass": 0.07}, "mass from 2 to 650 kg"),
        ({"mass": float("nan")}, "mass from 2 to 650 kg"),
        ({"sex": "x"}, "sex as f or m"),
        ({"limb": "tail"}, "a limb among arm, arm_and_hand, leg"),
    ],
)
def test_what_no_person_has_is_refused(given, message):
    with pytest.raises(BodyError, match=message):
        person(**{"height": 1.75, "mass": 70.0, "sex": "f", **given})


FILE = """
[[links]]
name = "upper_arm"
joint = "shoulder"
tip = "elbow"
length = 0.3
mass = 2.0

[[links]]
name = "forearm"
joint = "elbow"
tip = "wrist"
length = 0.26
mass = 1.5
com = 0.12
inertia = 0.009
"""


def test_a_load_in_the_hand_is_a_point_mass(tmp_path):
    """As a third link without length would have it: the same inertia matrix, and weight, in every pose."""
    (tmp_path / "bare.toml").write_text(FILE)
    (tmp_path / "loaded.toml").write_text(FILE + "load = {mass = 2.0, at = 0.25}\n")
    bare, full = (Body.load(tmp_path / f"{name}.toml") for name in ("bare", "loaded"))
    q = torch.tensor([[-1.2, 0.7], [0.4, 1.9]], dtype=torch.float64)
    both = [dynamics_for(each) for each in (bare, full)]
    more = [
        getattr(both[1], quantity)(q, full.parameters()) - getattr(both[0], quantity)(q, bare.parameters())
        for quantity in ("inertia_matrix", "gravity_load")
    ]
    first, second = q[:, 0], q.sum(-1)
    point = [torch.stack([0.3 * f(first) + 0.25 * f(second), 0.25 * f(second)], -1) for f in (torch.cos, torch.sin)]
    jacobian = torch.stack([-point[1], point[0]], -2)
    torch.testing.assert_close(more[0], 2.0 * jacobian.mT @ jacobian)
    torch.testing.assert_close(more[1], 2.0 * 9.81 * jacobian[:, 1])


def test_a_load_in_space_is_one_too(tmp_path):
    text = 'dimensions = 3\n[[links]]\nname = "arm"\njoint = "shoulder"\ntype = "ball"\nmass = 2.0\n'
    text += "com = [0.1, 0.0, 0.02]\ninertia = [0.01, 0.02, 0.02, 0.0, 0.0, 0.0]\n"
    (tmp_path / "arm.toml").write_text(
        text + "load = {mass = 1.0, at = [0.3, 0.0, -0.1]}\nsites = {hand = [0.3, 0.0, 0.0]}\n"
    )
    (link,) = Body.load(tmp_path / "arm.toml").links
    assert link.mass == 3.0
    assert link.com == pytest.approx([0.5 / 3, 0.0, -0.02])
    off = np.array([0.2, 0.0, -0.12])  # of one from the other: reduced mass 2/3 kg
    added = 2 / 3 * (off @ off * np.eye(3) - np.outer(off, off))
    assert link.inertia == pytest.approx(
        np.array([0.01, 0.02, 0.02, 0, 0, 0]) + added[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    )


def test_a_persons_hand_carries_a_load():
    bare, full = (person(1.7, 65.0, "f", load=load) for load in (0.0, 3.0))
    assert full.links[1].nominal("mass") - bare.links[1].nominal("mass") == pytest.approx(3.0)
    hand = full.links[1].nominal("length") + 0.7474 * 0.078 * 1.7 / 1.735
    moments = [link.nominal("mass") * link.nominal("com") for link in (bare.links[1], full.links[1])]
    assert moments[1] - moments[0] == pytest.approx(3.0 * hand)


@pytest.mark.parametrize(
    ("load", "message"),
    [
        ("2.0", "expected {mass = kg, at = m along the link}"),
        ("{mass = 2.0}", "expected {mass = kg"),
        ("{mas = 2.0, at = 0.1}", "mas"),
        ("{mass = -2.0, at = 0.1}", "expected a positive mass"),
        ("{mass = 2.0, at = [0.1, 0.0, 0.0]}", "expected at as one number along a stick"),
        ("{mass = 2.0, at = 0.1}\ninertia = {start = 0.1}", "expected numbers as the link's own"),
    ],
)
def test_a_load_that_is_none_is_refused(load, message, tmp_path):
    text = FILE.replace("inertia = 0.009\n", "") if "start" in load else FILE
    (tmp_path / "arm.toml").write_text(f"{text}load = {load}\n")
    with pytest.raises(BodyError, match=message):
        Body.load(tmp_path / "arm.toml")
