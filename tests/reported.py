"""Diagnoses of every kind that a report is made of, and a reader of its page."""

from dataclasses import replace
from html.parser import HTMLParser

import numpy as np

from invdyn.diagnosis.assessment.posture import Posture
from invdyn.diagnosis.assessment.result import (
    Cause,
    Diagnosis,
    Estimate,
    Finding,
    Gap,
    Interval,
    Outside,
    Shrinkage,
    Visibility,
    Where,
)
from invdyn.diagnosis.assessment.tracks import Tracks

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


def posture(joints=2, names=TIPS):
    lengths, heading = np.array([0.30, 0.26, 0.12])[:joints], np.cumsum([-1.2, 0.7, 0.7][:joints])
    tips = np.cumsum(lengths[:, None] * np.stack([np.cos(heading), np.sin(heading)], -1), 0)
    links = range(joints)
    keypoints = {name: k + 1 for k, name in enumerate(names[:joints])}
    return Posture(np.concatenate([np.zeros((1, 2)), tips]), tuple((k, k, k + 1) for k in links), (*links,), keypoints)


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
        posture=posture(joints),
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
        tracks=tracks(names=HOSTILE[1:]), posture=posture(names=HOSTILE[1:]),
        not_identifiable=HOSTILE, separating_experiment=HOSTILE[1],
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
