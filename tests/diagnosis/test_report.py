"""The report: every kind of diagnosis makes a whole, escaped, deterministic page that works in a real browser."""

import base64
import json
import os
import re
import shutil
from dataclasses import replace
from html.parser import HTMLParser
from importlib.util import find_spec

import numpy as np
import pytest

from invdyn.diagnosis.report import render, words, write_report
from invdyn.diagnosis.report.drawing import Plot, path, thinned, ticks
from invdyn.diagnosis.report.numbers import decimals, estimate, fixed, handy, percent, plain, plus_minus
from invdyn.diagnosis.report.replay import FRAMES
from invdyn.diagnosis.report.sentences import kind, verdict
from invdyn.diagnosis.result import (
    Cause,
    Diagnosis,
    Estimate,
    Finding,
    Gap,
    Interval,
    Outside,
    Shrinkage,
    Tracks,
    Visibility,
    Where,
)
from invdyn.models.effects.catalogue import EFFECTS

JOINTS, LINKS, TIPS = ("shoulder", "elbow", "wrist"), ("upper_arm", "forearm", "hand"), ("elbow", "wrist", "fingertip")
HOSTILE = (
    "<script>window.hacked=1;alert(1)</script>",
    '"]}</script><script>window.hacked=1</script>',
    "'\"><img src=x onerror=window.hacked=1>\u2028{{ 7*7 }}&amp;",
)


def friction(joint="shoulder", probability=0.97, **other):
    damping = Estimate(0.28137, 0.0041, (0.2745, 0.2881), "N·m·s/rad")
    finding = Finding("viscous_friction", "dynamics", {"joint": joint, **other}, {"damping": damping})
    return Cause((finding,), probability, 1234.5, 0.2)


def latency(probability=0.4):
    parameters = {"latency": Estimate(0.0203, 0.0012, (0.0183, 0.0222), "s")}
    return Cause((Finding("camera_latency", "observation", {}, parameters),), probability, 1230.0, 0.1)


def tracks(joints=2, rows=300, seed=0, names=TIPS, missing=True):
    rng = np.random.default_rng(seed)
    time = 0.5 + np.arange(rows) / 100
    lengths = np.array([0.30, 0.26, 0.12])[:joints]
    phase = np.arange(joints)
    angle = 0.5 * np.sin(2.4 * time[:, None] + phase) + np.where(phase == 0, -1.2, 0.7)
    velocity = 1.2 * np.cos(2.4 * time[:, None] + phase)
    nominal_angle = angle + 0.08 * np.sin(5 * time[:, None]) * (time[:, None] % 0.5) / 0.5

    def tips(q):
        direction = np.cumsum(q, -1)
        return np.cumsum(lengths[:, None] * np.stack([np.cos(direction), np.sin(direction)], -1), -2)

    smoothed = tips(angle)
    observed = smoothed + 0.003 * rng.standard_normal(smoothed.shape)
    gap = 2.0 * np.exp(-0.5 * ((time - 1.8) / 0.2) ** 2) + 0.3 * rng.standard_normal(rows)
    before = -0.28 * velocity * np.where(phase == 0, 1.0, 0.05) + 0.02 * rng.standard_normal((rows, joints))
    after = 0.02 * rng.standard_normal((rows, joints))
    if missing:
        observed[20:40, -1] = np.nan
        gap[20:25] = np.nan
        before[5:9] = np.nan
        observed[-3:] = np.nan
    return Tracks(
        time, observed, names[:joints], np.zeros(2), np.sin(3 * time[:, None] + phase), angle, velocity,
        tips(nominal_angle), tips(angle + 0.004 * rng.standard_normal(angle.shape)), 0.5, smoothed,
        before, np.full_like(before, 0.03), after, np.full_like(after, 0.02), gap,
    )  # fmt: skip


def diagnosis(joints=2, causes=None, **changes):
    """Viscous friction of the shoulder, found."""
    names = JOINTS[:joints]
    causes = (friction(), latency(0.02)) if causes is None else causes
    shares = dict(zip(names, [0.97, 0.02, 0.01], strict=False))
    plain_case = Diagnosis(
        recording="bench_arm.csv",
        body="bench arm",
        seed=0,
        regime="commanded",
        gap=Gap(
            True, 0.9996, {"nominal": 5.21, "corrected": 6.94, "noise_floor": 6.98},
            {name: 0.31 / 4**i for i, name in enumerate(names)}, {"nominal": 0.041, "corrected": 0.0023},
        ),
        where=Where(
            {"dynamics": 0.98, "observation": 0.02}, shares, dict.fromkeys(TIPS[:joints], 0.01),
            (Interval(1.42, 2.1, 0.8),), ("velocity:shoulder",),
        ),
        causes=causes,
        ambiguity_set=(),
        separating_experiment=None,
        outside=Outside(0.004),
        not_identifiable=("payload.hand", "torque_ripple.elbow"),
        shrinkage=Shrinkage(0.96, (0.93, 0.99), True, dict.fromkeys(names, 0.012)),
        joint_names=names,
        link_names=LINKS[:joints],
        lengths=(0.30, 0.26, 0.12)[:joints],
        tracks=tracks(joints),
        screened=(("viscous_friction.shoulder", 210.4), ("coulomb_friction.shoulder", 160.2), ("camera_roll", -3.1)),
        visibility=(
            Visibility("viscous_friction.shoulder", "dynamics", 81.0),
            Visibility("keypoint_offset.elbow", "observation", 3.2),
            Visibility("payload.hand", "dynamics", 0.7),
        ),
        method={"candidates": "36 effects at 2 joints", "confirmation": "controlled SMC, 128 particles × 32 filters"},
    )  # fmt: skip
    return replace(plain_case, **changes)


def none():
    d = diagnosis(causes=(Cause((), 0.95, 10.0, 0.1), friction(probability=0.02)))
    return replace(d, gap=replace(d.gap, detected=False, probability=0.021), shrinkage=Shrinkage(None, None, False, {}))


def empty():
    """Not enough data: nothing was measured."""
    nothing = float("nan")
    return diagnosis(
        causes=(), gap=Gap(False, nothing, {}, {}, {}), where=Where({}, {}, {}, (), ()), outside=Outside(nothing),
        shrinkage=Shrinkage(None, None, False, {}), tracks=None,
        screened=(), visibility=(), not_identifiable=(), method={},
        not_enough_data="3 rows with an observation, a diagnosis needs 20 or more",
    )  # fmt: skip


def two():
    payload = Finding(
        "payload", "dynamics", {"link": "forearm"}, {"mass": Estimate(0.084, 0.006, (0.074, 0.094), "kg")}
    )
    return diagnosis(causes=(Cause((*friction().effects, payload), 0.81, 1300.0, 0.3), friction(probability=0.11)))


def three():
    tilt = Finding("gravity_tilt", "dynamics", {}, {"angle": Estimate(-0.105, 0.012, (-0.125, -0.085), "rad")})
    return diagnosis(3, causes=(Cause((*two().causes[0].effects, tilt), 0.66, 1300.0, 0.3),))


def ambiguous():
    delay = {"delay": Estimate(0.02, 0.001, (0.018, 0.022), "s")}
    cause = Cause((Finding("actuator_delay", "dynamics", {"joint": "shoulder"}, delay),), 0.55, 1230.3, 0.1)
    return diagnosis(
        causes=(cause, latency()),
        ambiguity_set=(("actuator_delay.shoulder", "camera_latency"),),
        separating_experiment="a recording with a clock that the camera and the motors share",
    )


def outside():
    return diagnosis(
        causes=(friction(probability=0.05),),
        outside=Outside(0.93, "0.31 sin 3θ₁ (shoulder)", {"sin 3θ₁": (0.31, 0.02, "N·m")}, 0.7),
    )


def hidden():
    return replace(none(), regime="unknown_torque", tracks=replace(tracks(), command=None))


def seen():
    """A gap on the observation side, torque unknown."""
    offset = {"along": Estimate(0.0121, 0.0009, (0.0106, 0.0136), "m")}
    cause = Cause((Finding("keypoint_offset", "observation", {"keypoint": "wrist"}, offset),), 0.9, 12.0, 0.1)
    where = Where(
        {"dynamics": 0.05, "observation": 0.95}, {"shoulder": 0.5, "elbow": 0.5}, {"elbow": 0.1, "wrist": 0.9}, (), ()
    )
    return diagnosis(causes=(cause,), where=where, regime="unknown_torque")


def hostile():
    bad = HOSTILE[:2]
    d = diagnosis(causes=(friction(bad[0], partner=bad[1]),))
    return replace(
        d, recording=HOSTILE[2], body=HOSTILE[0], joint_names=bad, link_names=HOSTILE[1:],
        method={HOSTILE[0]: HOSTILE[1]},
        where=Where(
            {"dynamics": 1.0}, dict.fromkeys(bad, 0.5), dict.fromkeys(HOSTILE[1:], 0.9), (), (f"velocity:{HOSTILE[2]}",)
        ),
        gap=replace(d.gap, residual_torque_rms=dict.fromkeys(bad, 0.3)),
        tracks=tracks(names=HOSTILE[1:]), not_identifiable=HOSTILE, separating_experiment=HOSTILE[1],
        ambiguity_set=((f"a.{bad[0]}", HOSTILE[2]),), screened=((HOSTILE[2], 1.0),),
        outside=Outside(0.01, HOSTILE[0], {HOSTILE[1]: (1.0, 0.1, HOSTILE[2])}, 0.1),
    )  # fmt: skip


def all_nan():
    t = tracks(3)
    measured = [name for name, v in vars(t).items() if isinstance(v, np.ndarray) and name not in ("time", "base")]
    arrays = {name: np.full_like(getattr(t, name), np.nan) for name in measured}
    return diagnosis(3, tracks=replace(t, **arrays))


KINDS = {
    "one joint": lambda: diagnosis(1),
    "two joints": diagnosis,
    "three joints": lambda: diagnosis(3),
    "no tracks": lambda: diagnosis(tracks=None),
    "one frame": lambda: diagnosis(tracks=tracks(rows=1, missing=False)),
    "many frames": lambda: diagnosis(3, tracks=tracks(3, 6000)),
    "not enough data": empty,
    "none": none,
    "two effects": two,
    "three effects": three,
    "ambiguous": ambiguous,
    "outside": outside,
    "unknown torque": hidden,
    "observation": seen,
    "hostile": hostile,
    "NaN": all_nan,
}


class Page(HTMLParser):
    """Tags that open and close in pairs, ids, text, scripts and addresses."""

    VOID = frozenset({"meta", "link", "input", "br", "img", "hr"})

    def __init__(self, text):
        super().__init__()
        self.stack, self.ids, self.tags, self.scripts, self.addresses, self.words = [], [], [], {}, [], []
        self.feed(text)
        self.close()
        assert not self.stack

    def handle_starttag(self, tag, attributes):
        attributes = dict(attributes)
        self.tags.append((tag, attributes))
        self.ids += [attributes["id"]] if "id" in attributes else []
        self.addresses += [v for k, v in attributes.items() if k in ("src", "href", "action", "data", "srcset")]
        assert not [k for k in attributes if k.startswith("on")]
        if tag not in self.VOID:
            self.stack.append((tag, attributes))

    def handle_startendtag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))  # <path/>, <circle/> inside SVG

    def handle_endtag(self, tag):
        assert self.stack.pop()[0] == tag

    def handle_data(self, text):
        if self.stack and self.stack[-1][0] == "script":
            key = self.stack[-1][1].get("id", "script")
            self.scripts[key] = self.scripts.get(key, "") + text
        elif self.stack and self.stack[-1][0] != "style":
            self.words.append(text)


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
    shown = np.array(data["nominal"], float) - data["base"]
    truth = d.tracks.nominal_replay[::stride]
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
    assert set(words.EFFECTS) == set(EFFECTS)


@pytest.mark.parametrize(
    ("key", "says"),
    [
        ("", "no gap"),
        ("camera_roll", "camera roll"),
        ("coulomb_friction.elbow", "Coulomb friction at the elbow"),
        ("soft_tissue.elbow", "soft-tissue motion at keypoint elbow"),
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


def test_no_keypoints_and_no_lasting_intervals():
    t = tracks()
    empty = replace(t, observed=t.observed[:, :0], keypoint_names=())
    many = tuple(Interval(0.5 + i / 10, 0.55 + i / 10, 0.05) for i in range(20))
    where = replace(diagnosis().where, intervals=many, keypoints={})
    Page(render(diagnosis(tracks=empty, where=where)))


def test_written_whole_with_its_line(tmp_path):
    write_report(diagnosis(), tmp_path / "report.html", generated="made <by> hand")
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "made &lt;by&gt; hand" in text
    assert text.replace('<p class="note">made &lt;by&gt; hand</p>', "").split() == render(diagnosis()).split()
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


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    """A headless Chromium; INVDYN_REQUIRE_BROWSER=1 makes its absence a failure."""
    chromium, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if not (chromium and driver and find_spec("selenium")):
        stop = pytest.fail if os.environ.get("INVDYN_REQUIRE_BROWSER") == "1" else pytest.skip
        stop("needs the programs chromium and chromedriver, and the package selenium")
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    flags = (
        "headless=new no-sandbox disable-gpu disable-quic no-first-run disable-background-networking "
        "disable-component-update disable-sync disable-dev-shm-usage"
    )
    for flag in (*flags.split(), f"user-data-dir={tmp_path_factory.mktemp('chromium')}"):
        options.add_argument(f"--{flag}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    window = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
    try:
        yield window
    finally:
        window.quit()


def opened(browser, page, width=1200):
    browser.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride",
        {"width": width, "height": 800, "deviceScaleFactor": 1, "mobile": width < 500},
    )
    browser.get_log("browser"), browser.get_log("performance")  # those of the page before
    browser.get(page.as_uri())
    return browser


def test_in_a_browser(browser, tmp_path):
    page = tmp_path / "report.html"
    write_report(diagnosis(), page)
    opened(browser, page)
    heading = browser.find_element("id", "verdict")
    assert heading.is_displayed()
    assert heading.text == verdict(diagnosis()).replace("\u00a0", " ")
    picture, slider = browser.find_element("id", "replay-nominal"), browser.find_element("id", "replay-slider")
    still = picture.get_attribute("d")
    data = json.loads(Page(page.read_text(encoding="utf-8")).scripts["replay-data"])
    set_to = "arguments[0].value = arguments[1]; arguments[0].dispatchEvent(new Event('input'));"
    browser.execute_script(set_to, slider, 7)
    points = [data["base"], *data["nominal"][7]]
    assert still != picture.get_attribute("d") == "M" + "L".join(f"{x} {y}" for x, y in points)
    browser.execute_script(set_to, slider, data["start"])
    assert picture.get_attribute("d") == still  # the still picture is the script's own
    browser.find_element("id", "replay-play").click()
    browser.execute_async_script("setTimeout(arguments[0], 400)")
    assert picture.get_attribute("d") != still
    browser.find_element("id", "replay-play").click()

    events = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    requests = [m["params"] for m in events if m["method"] == "Network.requestWillBeSent"]
    asked = [r["request"]["url"] for r in requests if r["documentURL"] == page.as_uri()]  # not the browser's own
    assert {url for url in asked if not url.startswith("data:")} == {page.as_uri()}
    assert browser.get_log("browser") == []
    printed = base64.b64decode(browser.execute_cdp_cmd("Page.printToPDF", {})["data"])
    assert printed.startswith(b"%PDF-")
    assert len(printed) > 20_000


@pytest.mark.parametrize("name", ["three joints", "not enough data", "hostile", "ambiguous"])
def test_fits_a_phone(browser, tmp_path, name):
    page = tmp_path / "report.html"
    write_report(KINDS[name](), page)
    opened(browser, page, width=360)
    assert browser.execute_script("return window.innerWidth") == 360
    assert browser.execute_script("return document.documentElement.scrollWidth") <= 360
    assert browser.get_log("browser") == []


def test_hostile_names_run_nothing(browser, tmp_path):
    page = tmp_path / "report.html"
    write_report(hostile(), page)
    opened(browser, page)  # an open alert would make every later call fail
    assert browser.execute_script("return typeof window.hacked") == "undefined"
    assert browser.execute_script("return document.images.length") == 0
    assert browser.get_log("browser") == []
