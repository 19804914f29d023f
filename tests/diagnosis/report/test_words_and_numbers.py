"""A report's words for effects and places, and the digits that its numbers deserve."""

import pytest
import torch
from reported import diagnosis, two
from variants import nonideal

from invdyn.diagnosis.assessment.result import Estimate, Finding
from invdyn.diagnosis.catalogue import CATALOGUE
from invdyn.diagnosis.report import words
from invdyn.diagnosis.report.numbers import (
    changed,
    decimals,
    estimate,
    fixed,
    handies,
    handy,
    percent,
    plain,
    plus_minus,
)
from invdyn.models import Link, planar_body, planar_dynamics
from invdyn.models.effects.base import side_of
from invdyn.models.effects.scale import Scale


def test_numbers_have_the_digits_that_they_deserve():
    assert [decimals(s) for s in (0.0041, 0.012, 0.029, 0.0299, 3.0, 12.0, 120.0)] == [3, 3, 3, 2, 0, 0, -1]
    assert estimate(Estimate(0.28137, 0.0041, (0.2743, 0.2881), "N·m·s/rad")) == (
        "0.281\u00a0N·m·s/rad",
        "0.274 to 0.288\u00a0N·m·s/rad",
    )
    assert estimate(Estimate(-0.0203, 0.0012, (-0.0222, -0.0183), "s")) == ("−20.3\u00a0ms", "−22.2 to −18.3\u00a0ms")
    assert estimate(Estimate(0.1, 0.01, (0.08, 0.12), "rad"))[0] == "5.7°"
    assert estimate(Estimate(2e-7, 1e-8, (1.8e-7, 2.2e-7), "–"))[0] == "2.00 × 10⁻⁷"
    assert [fixed(v, 7) for v in (0.0, 3e-9, -2e-6)] == ["0", "0", "−2.0 × 10⁻⁶"]
    assert estimate(Estimate(0.5, 0.0, (0.5, 0.5), ""))[0] == "0.5000"
    assert plus_minus(0.3123, 0.0213, "N·m") == "0.312 ± 0.021\u00a0N·m"
    shares = (0.0, 0.0004, 0.004, 0.021, 0.97, 0.994, 0.9998, 1.0, float("nan"))
    assert [percent(p).replace("\u00a0", " ") for p in shares] == [
        "0 %", "< 0.1 %", "0.4 %", "2 %", "97 %", "99.4 %", "> 99.9 %", "100 %", "–",
    ]  # fmt: skip
    assert [fixed(-0.001, 2), fixed(1250.0, -2), plain(0.0123456), plain(0.0), handy(0.0412, "m")] == [
        "0.00", "1200", "0.0123", "0", "41\u00a0mm",
    ]  # fmt: skip


def test_every_effect_of_the_catalogue_has_words():
    for entry in CATALOGUE.values():
        assert entry.phrase
        assert entry.meaning
        assert entry.shown_by
        assert all(entry.forms[form] for form in entry.effect.forms)


def test_a_form_of_ones_own_has_its_name_for_a_word(monkeypatch):
    """As effects may be added while a program runs."""
    monkeypatch.setattr(CATALOGUE["clock_rate"].effect, "forms", ("frames", "sundial"))
    assert words.key_words("clock_rate.sundial", two()).endswith(" sundial")


def test_a_variant_is_said_to_be_one():
    """By a parameter that the ideal form lacks."""
    arm = planar_body("arm", [Link("l1", "j1", "p1", 0.3, 1.0), Link("l2", "j2", "p2", 0.3, 1.0)])
    scale = Scale(planar_dynamics(arm.num_joints), arm.parameters(), torch.arange(9.0))
    for entry in CATALOGUE.values():
        ideal = entry.effect.everywhere(arm, arm.keypoint_names)[0].bound(arm)
        for effect in (ideal, nonideal(ideal)):
            if effect is not None:
                ones = {p.name: (torch.ones(1), p.unit) for p in effect.parameters(scale)}
                shown = entry.reported(effect, {name: one for name, (one, _) in ones.items()}) or ones
                named = {name: Estimate(1.0, 0.1, (0.9, 1.1), unit) for name, (_, unit) in shown.items()}
                told = words.meaning(Finding(effect.name, side_of(effect), {}, named))
                assert any(each in told for each in entry.variant_words.values()) == bool(effect.variant)
    assert words.meaning(Finding("my_own", "dynamics", {}, {})) is None


@pytest.mark.parametrize(
    ("key", "says"),
    [
        ("", "no gap"),
        ("camera_roll", "camera roll"),
        ("coulomb_friction.elbow", "Coulomb friction at the elbow"),
        ("soft_tissue.elbow", "soft-tissue motion at keypoint elbow"),
        ("soft_tissue.elbow.sliding", "soft-tissue motion at keypoint elbow that slides as the joint turns"),
        ("clock_rate.frames", "a clock-rate error of the sensors alone, while commands keep true time"),
        ("inertial_error.upper_arm", "an inertial error of the upper arm"),
        ("joint_coupling.shoulder.elbow", "joint coupling between the shoulder and the elbow"),
        ("armature.shoulder+camera_roll", "rotor inertia at the shoulder and camera roll"),
        ("joint_limit.shoulder.lower", "a joint limit at the shoulder, lower side"),
        ("my_own.j.2", "my own at j.2"),
    ],
)
def test_words_of_a_key(key, says):
    assert words.key_words(key, diagnosis()) == says


def test_a_stop_is_told_with_its_side():
    limit = Finding("joint_limit", "dynamics", {"joint": "shoulder", "stop": "upper"}, {})
    assert words.finding_words(limit) == "a joint limit at the shoulder, upper side"


def test_numbers_that_differ_are_told_apart():
    """To as many digits as it takes; those that are the same stay short."""
    assert handies("N·m", 0.3512, 0.3498) == ["0.351 N·m", "0.350 N·m"]
    assert handies("N·m", 0.35, 0.35) == ["0.35 N·m"] * 2
    assert handies("N·m", 0.35, None) == ["0.35 N·m", "– N·m"]
    assert changed("rad", 0.4, 0.40012, (0.39998, 0.40026)) == ("0.4000", "0.4001 rad", "0.4000", "0.4003")
