"""The report: every kind of diagnosis makes a whole, escaped, deterministic page."""

import base64
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from reported import HOSTILE, KINDS, Page, diagnosis, hostile, none, seen, tracks, two

from invdyn.diagnosis.assessment.result import Interval, Visibility
from invdyn.diagnosis.report import render, write_report
from invdyn.diagnosis.report.drawing import Plot, path, thinned, ticks
from invdyn.diagnosis.report.figures import residuals
from invdyn.diagnosis.report.numbers import handy
from invdyn.diagnosis.report.report import by_visibility
from invdyn.diagnosis.rules import DEFAULT, FIXED


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
    data = json.loads(Page(text := render(d)).scripts["replay-data"])
    assert 'id="replay-corrected"' in text
    stride = -(-rows // FIXED.max_replay_frames)
    assert len(data["time"]) == -(-rows // stride) <= FIXED.max_replay_frames
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


def test_what_cannot_be_seen_is_by_one_measure():
    """What `not_identifiable` counts as hidden is not said to show faintly."""
    found = replace(two(), visibility=(Visibility("payload", "dynamics", 0.99 * DEFAULT.evidence.min_dprime),))
    text = render(found)
    assert f"Under {DEFAULT.evidence.min_dprime:.1f} the change cannot be seen" in text
    assert by_visibility(found)["faintly"] == []
    assert len(by_visibility(found)["no"]) == 1


def test_unknown_torque_is_not_called_missing():
    text = render(seen())
    assert "Torque of the joints" in text
    assert "left unexplained" not in text
    assert "left unexplained" in render(diagnosis())


def test_residuals_are_told_before_and_after():
    page, shown = Page(render(diagnosis())), diagnosis().tracks
    labels = [a.get("aria-label") for _, a in page.tags if a.get("role") == "img"]
    for j, name in enumerate(("shoulder", "elbow")):
        rms = [np.sqrt(np.nanmean(torque[:, j] ** 2)) for torque in (shown.residual_before, shown.residual_after)]
        before, after = (handy(each, "N·m") for each in rms)
        assert before != after
        assert f"Residual torque of {name} over time: {before} rms before, {after} after" in labels


def test_what_was_not_corrected_is_drawn_once():
    """The best cause is "no gap": before and after are the same."""
    d = none()
    same = replace(d.tracks, residual_after=d.tracks.residual_before, residual_after_sd=d.tracks.residual_before_sd)
    text = render(replace(d, tracks=replace(same, corrected_replay=same.nominal_replay)))
    labels = [a.get("aria-label") or "" for _, a in Page(text).tags]
    torques = [label for label in labels if label.startswith("Residual torque of shoulder")]
    assert len(torques) == 2  # over the motion and over time
    assert not any("after" in label for label in torques)
    assert "rms before" not in text
    assert "under the corrected one" not in text
    assert 'id="replay-nominal"' in text
    assert "replay-corrected" not in text
    assert "corrected" not in json.loads(Page(text).scripts["replay-data"])
    assert "Nothing in it was corrected." in text


def test_residuals_are_drawn_as_high_as_they_are():
    """Also where the first rows' bands are the prior's, a thousand times as wide as the residual."""
    d = diagnosis()
    wide = d.tracks.residual_before_sd.copy()
    wide[:3] = 1e3
    figures = [
        [each["figure"] for each in residuals(replace(d, tracks=replace(d.tracks, residual_before_sd=sd)))]
        for sd in (wide, d.tracks.residual_before_sd)
    ]
    ticks_of = [[re.findall(r"<i style[^>]*>([^<]*)</i>", figure) for figure in each] for each in figures]
    assert any(ticks_of[0])
    assert ticks_of[0] == ticks_of[1]


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
