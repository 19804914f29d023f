"""The report: every kind of diagnosis makes a whole, escaped, deterministic page, with words for all it says."""

import base64
import json
import re
from dataclasses import replace

import numpy as np
import pytest
import torch
from reported import (
    HOSTILE,
    KINDS,
    Page,
    ambiguous,
    diagnosis,
    empty,
    friction,
    hidden,
    hostile,
    latency,
    none,
    outside,
    seen,
    three,
    tracks,
    two,
)

from invdyn.diagnosis.assessment.result import (
    Cause,
    Estimate,
    Finding,
    Interval,
    Part,
    Shrinkage,
    Visibility,
)
from invdyn.diagnosis.decision import RULE
from invdyn.diagnosis.report import render, words, write_report
from invdyn.diagnosis.report.drawing import Plot, path, thinned, ticks
from invdyn.diagnosis.report.numbers import decimals, estimate, fixed, handy, percent, plain, plus_minus
from invdyn.diagnosis.report.replay import FRAMES
from invdyn.diagnosis.report.report import _visible
from invdyn.diagnosis.report.sentences import details, kind, left, verdict
from invdyn.models import Body, Link, planar_dynamics
from invdyn.models.effects.catalogue import EFFECTS
from invdyn.models.effects.scale import Scale


@pytest.mark.parametrize("name", KINDS)
def test_page_is_whole_alone_and_the_same_each_time(name):
    text = render(KINDS[name]())
    assert text == render(KINDS[name]())
    page = Page(text)
    assert len(set(page.ids)) == len(page.ids)
    assert page.addresses == ["data:,"]
    assert not re.search(r"https?://|@import|url\(", text)
    assert len(text.encode()) < 1_500_000
    assert [tag for tag, _ in page.tags].count("h1") == 1
    labels = [a.get("aria-label") for _, a in page.tags if a.get("role") == "img"]
    assert labels
    assert all(labels)
    assert set(page.scripts) <= {"script", "replay-data"}
    words = " ".join(page.words)
    assert not re.search(r"\bnan\b|\bNone\b|\binf\b", words)


@pytest.mark.parametrize("rows", [1, 300, 6000])
def test_replay_data_are_the_tracks(rows):
    d = diagnosis(tracks=tracks(rows=rows, missing=rows > 1))
    data = json.loads(Page(render(d)).scripts["replay-data"])
    stride = -(-rows // FRAMES)
    assert len(data["time"]) == -(-rows // stride) <= FRAMES
    for name, replay in (("nominal", d.tracks.nominal_replay), ("corrected", d.tracks.corrected_replay)):
        shown, truth = np.array(data[name], float) - data["base"], replay[::stride]
        scale = np.linalg.norm(shown[0, 0]) / np.linalg.norm(truth[0, 0])
        np.testing.assert_allclose(shown, truth * [scale, -scale], atol=1.01 + 0.002 * np.abs(shown).max())
    gone = np.isnan(d.tracks.observed[::stride])
    assert [[[v is None for v in point] for point in row] for row in data["observed"]] == gone.tolist()


def test_names_cannot_leave_their_place():
    page = Page(render(hostile()))
    assert [tag for tag, _ in page.tags].count("script") == 2
    assert not [tag for tag, _ in page.tags if tag == "img"]
    words = "".join(page.words)
    assert all(name in words for name in HOSTILE)


def test_only_the_pages_own_script_may_run():
    import hashlib

    page = Page(render(diagnosis()))
    (policy,) = (a["content"] for tag, a in page.tags if tag == "meta" and "http-equiv" in a)
    digest = base64.b64encode(hashlib.sha256(page.scripts["script"].encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}';" in policy
    assert policy.startswith("default-src 'none';")


@pytest.mark.parametrize(
    ("case", "answer", "says"),
    [
        (
            diagnosis,
            "cause",
            "leaves out viscous friction at the shoulder (97 % probable); adding it closes 96 % of the gap.",
        ),
        (two, "cause", "two effects: viscous friction at the shoulder and a payload on the forearm (81 % probable)"),
        (three, "cause", "three effects: "),
        (none, "none", "No gap: the simulation explains the recording down to its noise (probability of a gap 2 %)."),
        (empty, "not_enough_data", "Not enough data to say whether there is a gap: 3 rows"),
        (
            ambiguous,
            "ambiguous",
            "actuator delay at the shoulder or camera latency, which this recording cannot tell apart (together 95 % ",
        ),
        (
            outside,
            "outside",
            "There is a gap at the shoulder, and no effect in the catalogue explains it (93 % probable).",
        ),
        (hidden, "none", "the joint torques are unknown and could hide one"),
        (seen, "cause", "leaves out a keypoint offset at the wrist (90 % probable)"),
    ],
)
def test_verdict(case, answer, says):
    assert kind(case()) == answer
    sentence = verdict(case()).replace("\u00a0", " ")
    assert says in sentence
    assert sentence.count(". ") == 0


def test_where_something_is_left_what_explains_most_comes_first():
    """How far it closes the gap, how probable it is in part, and the rest in N·m, or that the rest is tolerated."""
    d = replace(outside(), causes=(replace(friction(probability=0.05), in_part=0.9),))
    limits = dict.fromkeys(d.gap.residual_torque_rms, 0.04)
    shrinkage = replace(d.shrinkage, gap_closed=0.97, residual_torque_rms_after=dict.fromkeys(limits, 0.05))
    d = replace(d, gap=replace(d.gap, tolerated_torque=limits), shrinkage=shrinkage)
    most = "There is a gap at the shoulder; most of it is viscous friction at the shoulder (90 % probable): "
    most += "adding it closes 97 % of the gap; "
    assert kind(d) == "outside"
    assert plainly(verdict(d)) == f"{most}no effect in the catalogue explains the rest, 0.050 N·m at the shoulder."
    small = replace(d, shrinkage=replace(shrinkage, residual_torque_rms_after=dict.fromkeys(limits, 0.03)))
    assert plainly(verdict(small)) == f"{most}the rest, 0.030 N·m at the shoulder, is less than is tolerated."
    assert "Of 9 rows 5 were looked at." in details(replace(d, method={"left out": "Of 9 rows 5 were looked at"}))
    stopped = replace(d, not_looked_at=7)
    assert "no effect that the search came to explains the rest" in verdict(stopped)
    assert "The search stopped at the budget; 7 candidates not looked at (--budget gives more)." in details(stopped)
    little = replace(d, shrinkage=replace(shrinkage, gap_closed=0.2))
    assert "; a part of it is viscous friction" in verdict(little)


def test_a_gap_that_does_not_matter_is_told_with_its_size():
    d = diagnosis()
    limits = {name: 10 * rms for name, rms in d.gap.residual_torque_rms.items()}
    d = replace(d, gap=replace(d.gap, detected=False, matters=False, tolerated_torque=limits))
    assert kind(d) == "none"
    assert plainly(verdict(d)).startswith("No gap that matters: what the simulation lacks, ")
    assert "where " in verdict(d)
    assert any(s.startswith("The little that there is looks most like viscous friction") for s in details(d))


def plainly(sentence):
    return sentence.replace("\u00a0", " ")


def test_rivals_are_said_to_change_the_recording_as_much_alike_as_they_do():
    """Only of those of which that is known."""
    d = ambiguous()
    (sentence,) = left(d)
    assert sentence.endswith("all remain probable: this recording cannot tell them apart.")
    keys = d.ambiguity_set[0]
    (sentence,) = left(replace(d, overlaps=((*keys, 0.973), ("payload", "armature.elbow", 0.1))))
    assert "(the changes that they predict are 97\u00a0% alike)" in sentence


def test_verdict_does_not_claim_what_was_not_reached():
    d = diagnosis(causes=(friction(probability=0.3), latency(0.2)))
    assert "at only 30\u00a0%" in verdict(d)
    assert "closes none of the gap" in verdict(replace(d, shrinkage=replace(d.shrinkage, gap_closed=-0.1)))
    assert "was not measured" in verdict(replace(d, shrinkage=Shrinkage(None, None, False, {})))
    assert kind(replace(d, causes=(Cause((), 0.9, 0.0, 0.1),))) == "unclear"


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


@pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (-3.7, 12.2), (1e-5, 3e-5), (-1e6, 4e6), (0.5, 0.50001)])
def test_ticks_are_round_and_inside(low, high):
    found = np.array(ticks(low, high, 5))
    assert 2 <= len(found) <= 8
    assert found.min() >= low - 1e-9 * abs(low)
    assert found.max() <= high + 1e-9 * abs(high)
    step = found[1] - found[0]
    assert round(step / 10.0 ** np.floor(np.log10(step) + 1e-9), 6) in (1.0, 2.0, 5.0)


def test_lines_break_where_nothing_is_known_and_keep_their_spikes():
    assert path(np.array([[0, 0], [1, 2], [np.nan, 1], [3, 3]])) == "M0 0 1 2M3 3h.1"
    x = np.arange(10_000.0)
    y = np.zeros(10_000)
    y[4321] = 5.0
    assert thinned(x, y)[1].max() == 5.0
    assert len(thinned(x, y)[0]) <= 800
    plot = Plot((0, 1), (0, 1), "<x>", "y").html('"><b>')
    assert "&lt;x&gt;" in plot
    assert '"><b>' not in plot


def test_every_effect_of_the_catalogue_has_words():
    for effect in EFFECTS.values():
        assert effect.phrase
        assert effect.meaning
        assert effect.shown_by
        assert all(effect.form_words[form] for form in effect.forms)


def test_a_form_of_ones_own_has_its_name_for_a_word(monkeypatch):
    """As effects may be added while a program runs."""
    monkeypatch.setattr(EFFECTS["clock_rate"], "forms", ("frames", "sundial"))
    assert words.key_words("clock_rate.sundial", two()).endswith(" sundial")


def test_what_cannot_be_seen_is_by_one_measure():
    """What `not_identifiable` counts as hidden is not said to show faintly."""
    found = replace(two(), visibility=(Visibility("payload", "dynamics", 0.99 * RULE.faint),))
    text = render(found)
    assert f"Under {RULE.faint:.1f} it cannot be seen" in text
    assert _visible(found)["faintly"] == []
    assert len(_visible(found)["no"]) == 1


def test_a_softer_form_is_said_to_be_one():
    """By a parameter that the ideal form lacks."""
    arm = Body("arm", [Link("l1", "j1", "p1", 0.3, 1.0), Link("l2", "j2", "p2", 0.3, 1.0)])
    scale = Scale(planar_dynamics(arm.num_joints), arm.parameters(), torch.arange(9.0))
    for each in EFFECTS.values():
        ideal = each.everywhere(arm, arm.keypoint_names)[0].bound(arm)
        for effect in (ideal, ideal.softened()):
            if effect is not None:
                ones = {p.name: (torch.ones(1), p.unit) for p in effect.parameters(scale)}
                shown = effect.described({name: one for name, (one, _) in ones.items()}) or ones
                named = {name: Estimate(1.0, 0.1, (0.9, 1.1), unit) for name, (_, unit) in shown.items()}
                told = words.meaning(Finding(effect.name, effect.side, {}, named))
                assert any(each in told for each in effect.form_words.values()) == effect.soft
    assert words.meaning(Finding("my_own", "dynamics", {}, {})) is None


@pytest.mark.parametrize(
    ("key", "says"),
    [
        ("", "no gap"),
        ("camera_roll", "camera roll"),
        ("coulomb_friction.elbow", "Coulomb friction at the elbow"),
        ("soft_tissue.elbow", "soft-tissue motion at keypoint elbow"),
        ("soft_tissue.elbow.sliding", "soft-tissue motion at keypoint elbow that slides as the joint turns"),
        ("clock_rate.frames", "a clock-rate error of the camera alone, while commands keep true time"),
        ("inertial_error.upper_arm", "an inertial error of the upper arm"),
        ("joint_coupling.shoulder.elbow", "joint coupling between the shoulder and the elbow"),
        ("armature.shoulder+camera_roll", "rotor inertia at the shoulder and camera roll"),
        ("my_own.j.2", "my own at j.2"),
    ],
)
def test_words_of_a_key(key, says):
    assert words.key_words(key, diagnosis()) == says


def test_unknown_torque_is_not_called_missing():
    text = render(seen())
    assert "Torque of the joints" in text
    assert "left unexplained" not in text
    assert "left unexplained" in render(diagnosis())


def test_the_torque_that_is_missing_is_that_of_the_joint_where_the_gap_lies():
    case = diagnosis()
    noisy = replace(case, gap=replace(case.gap, residual_torque_rms={"shoulder": 0.2, "elbow": 0.21}))
    after = {name: handy(value, "N·m") for name, value in case.shrinkage.residual_torque_rms_after.items()}
    said = f"left unexplained at the shoulder goes from {handy(0.2, 'N·m')} to {after['shoulder']}"
    assert said in render(noisy)
    nowhere = replace(noisy, where=replace(noisy.where, joints={}))
    said = f"left unexplained at the elbow goes from {handy(0.21, 'N·m')} to {after['elbow']}"
    assert said in render(nowhere)


def test_what_each_of_several_effects_closes_is_told():
    case = diagnosis()
    parts = {
        "viscous_friction.shoulder": Part(0.91, (0.88, 0.94)),
        "actuator_deadzone.elbow": Part(-0.02, (-0.05, 0.01)),
        "armature.elbow": Part(None, None),
    }
    page = render(replace(case, shrinkage=replace(case.shrinkage, by_effect=parts)))
    friction, deadzone = (words.key_words(name, case) for name in list(parts)[:2])
    told = f"Leaving out {friction} would cost {percent(0.91)} of the gap and {deadzone} {percent(-0.02)}."
    assert told in page
    assert f"Data held out from the fit do not confirm {deadzone}." in page
    assert f"{percent(-0.02)} ({percent(-0.05)} to {percent(0.01)})" in page
    alone = {"viscous_friction.shoulder": Part(0.91, (0.88, 0.94))}
    for fewer in (render(replace(case, shrinkage=replace(case.shrinkage, by_effect=alone))), render(case)):
        assert "Leaving out" not in fewer
        assert "do not confirm" not in fewer


def test_residuals_are_told_before_and_after():
    page, shown = Page(render(diagnosis())), diagnosis().tracks
    labels = [a.get("aria-label") for _, a in page.tags if a.get("role") == "img"]
    for j, name in enumerate(("shoulder", "elbow")):
        rms = [np.sqrt(np.nanmean(torque[:, j] ** 2)) for torque in (shown.residual_before, shown.residual_after)]
        before, after = (handy(each, "N·m") for each in rms)
        assert before != after
        assert f"Residual torque of {name} over time: {before} rms before, {after} after" in labels


def test_no_keypoints_and_no_lasting_intervals():
    t = tracks()
    empty = replace(t, observed=t.observed[:, :0], keypoint_names=())
    many = tuple(Interval(0.5 + i / 10, 0.55 + i / 10, 0.05) for i in range(20))
    where = replace(diagnosis().where, intervals=many, keypoints={})
    Page(render(diagnosis(tracks=empty, where=where)))


def test_written_whole(tmp_path):
    write_report(diagnosis(), tmp_path / "report.html")
    assert (tmp_path / "report.html").read_text(encoding="utf-8") == render(diagnosis())
    with pytest.raises(FileNotFoundError):
        write_report(diagnosis(), tmp_path / "absent" / "report.html")


def luminance(colour):
    """Relative luminance of #rrggbb (WCAG 2)."""
    channels = np.array([int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)])
    linear = np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


@pytest.mark.parametrize("scheme", [0, 1])
def test_contrast_of_light_and_dark(scheme):
    """4.5 for words, 3 for lines that must be seen (WCAG 2)."""
    style = re.search(r"<style>(.*?)</style>", render(diagnosis()), re.S)[1]
    block = re.findall(r":root \{(.*?)\}", style, re.S)[scheme]
    colours = dict(re.findall(r"--(\w+): (#[0-9a-f]{6})", block))

    def contrast(one, other):
        low, high = sorted(luminance(colours[name]) for name in (one, other))
        return (high + 0.05) / (low + 0.05)

    words = [("ink", ground) for ground in ("page", "card", "fill", "span")]
    words += [(ink, ground) for ink in ("soft", "accent") for ground in ("page", "card")]
    lines = [(line, ground) for line in ("before", "after", "seen") for ground in ("page", "card", "span")]
    assert {pair for pair in words if contrast(*pair) < 4.5} == set()
    assert {pair for pair in lines if contrast(*pair) < 3.0} == set()
