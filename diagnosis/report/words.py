"""Effects and places in plain words."""

import re

from invdyn.diagnosis.assessment.result import Cause, Diagnosis, Finding, named
from invdyn.models.effects.catalogue import EFFECTS as CATALOGUE

EFFECTS = {
    "viscous_friction": ("viscous friction", "a torque against the motion that grows with speed"),
    "coulomb_friction": ("Coulomb friction", "a torque of one size against the motion, whatever the speed"),
    "stribeck_friction": ("Stribeck friction", "friction that is largest at low speed and falls once the joint moves"),
    "load_friction": ("load-dependent friction", "friction that grows with the torque that the joint carries"),
    "quadratic_drag": ("quadratic drag", "a torque against the motion that grows with the square of speed"),
    "joint_stiffness": ("joint stiffness", "a spring that pulls the joint to a rest angle"),
    "joint_coupling": ("joint coupling", "a spring between two joints"),
    "joint_limit": ("a joint limit", "a stop that the joint runs into"),
    "payload": ("a payload", "a mass at the tip that the simulation does not carry"),
    "inertial_error": ("an inertial error", "a link whose mass, centre of mass or inertia is not as stated"),
    "gravity_tilt": ("tilted gravity", "gravity that points elsewhere than in the simulation"),
    "armature": ("rotor inertia", "inertia of the motor that resists the joint's acceleration"),
    "actuator_gain": ("an actuator gain", "torques larger or smaller than commanded, by one factor"),
    "actuator_delay": ("actuator delay", "torques that come later than commanded"),
    "actuator_lag": ("actuator lag", "torques that follow the command sluggishly"),
    "actuator_saturation": ("actuator saturation", "torques that stop growing at a limit"),
    "actuator_deadzone": ("an actuator dead zone", "commands too small to turn into torque"),
    "backlash": ("backlash", "play between motor and joint"),
    "torque_ripple": ("torque ripple", "a torque that repeats with the joint's angle"),
    "external_push": ("an external push", "a force from outside, for a short while"),
    "base_motion": ("base motion", "a base that moves"),
    "link_flexibility": ("link flexibility", "a link that bends and swings"),
    "drifting_friction": ("drifting friction", "friction that changes during the recording"),
    "keypoint_offset": ("a keypoint offset", "a marker that sits beside its joint"),
    "soft_tissue": ("soft-tissue motion", "a marker that shifts on the skin"),
    "camera_scale": ("a camera scale error", "positions larger or smaller by one factor"),
    "camera_roll": ("camera roll", "a picture turned about the line of sight"),
    "camera_yaw": ("camera yaw", "a plane of motion that is seen obliquely"),
    "lens_distortion": ("lens distortion", "positions bent outwards or inwards towards the picture's edge"),
    "clock_rate": ("a clock-rate error", "frames that are further apart in time, or less far, than stated"),
    "camera_latency": ("camera latency", "positions that are stamped later than they were"),
    "rolling_shutter": ("a rolling shutter", "rows of the picture that are seen at different times"),
    "timestamp_jitter": ("timestamp jitter", "frames that are dropped, doubled or mistimed"),
    "outliers": ("outliers", "some detections that are far from where the keypoint is"),
    "label_swap": ("swapped labels", "two keypoints that are exchanged in some frames"),
    "varying_noise": ("varying noise", "positions that are less certain in some frames than in others"),
}
"""Name → in a sentence, and what it is."""

SOFTER = {
    "settling": "softer than the ideal law, it takes a moment to bring the joint to rest and lets it creep",
    "bristle_stiffness": "softer than the ideal law, it springs back by a little before it slips",
    "coriolis_share": "loaded by this share of the Coriolis and centrifugal torques",
    "position": "softer than in its middle alone, at this share of its length",
    "softness": "softer than a spring, it gives way to whatever presses the joint into it",
    "second_amplitude": "no pure sine, it has a second wave of twice as many periods",
    "damping_ratio": "softer than what only lags, it swings on by itself after its bone",
    "centre_x": "about a centre of the picture that is not the frame’s origin",
}
"""A parameter of an effect's softer form → what that is."""

FORMS = {
    "frames": "of the camera alone, while commands keep true time",
    "confidence": "as the tracker’s confidence falls",
    "sliding": "that slides as the joint turns",
}
"""An effect's other reading → what that is."""

SIDES = {"dynamics": "how the arm moves", "observation": "how the motion is seen"}
SHORT_SIDES = {"dynamics": "arm’s motion", "observation": "camera’s view"}

REGIMES = {
    "commanded": "commanded torques known",
    "passive": "no torque at the joints",
    "unknown_torque": "torques unknown",
}


def effect_words(effect: str) -> str:
    """An effect's name in a sentence."""
    return EFFECTS[effect][0] if effect in EFFECTS else effect.replace("_", " ")


def meaning(finding: Finding) -> str | None:
    """What an effect is, in its softer form too; None for one of the user's own."""
    if finding.effect not in EFFECTS:
        return None
    softer = [text for name, text in SOFTER.items() if name in finding.parameters]
    return "; ".join([EFFECTS[finding.effect][1], *softer])


def place_words(kind: str, name: str) -> str:
    """A joint, link or keypoint in a sentence: "the elbow", "joint j2", "keypoint wrist"."""
    word = name.replace("_", " ")
    if kind != "keypoint" and re.fullmatch("[a-z]{3,}( [a-z]{3,})*", word) and kind not in word.split():
        return f"the {word}"
    return f"{kind} {name}".strip()


def finding_words(finding: Finding) -> str:
    """An effect and its place: "viscous friction at the elbow"."""
    return _placed(finding.effect, dict(finding.where))


def cause_words(cause: Cause) -> str:
    """All effects of a cause; "no gap" for none."""
    return named([finding_words(finding) for finding in cause.effects]) if cause.effects else "no gap"


def key_words(key: str, diagnosis: Diagnosis) -> str:
    """The words of a candidate's key, "viscous_friction.elbow", or of several joined by "+"."""
    if not key:
        return "no gap"
    parts = key.split("+")
    if len(parts) > 1 and all(re.match(r"[a-z_]+(\.|$)", part) for part in parts):
        return named([key_words(part, diagnosis) for part in parts])
    for finding in (f for cause in diagnosis.causes for f in cause.effects):
        if finding.key == key:
            return finding_words(finding)
    effect, _, place = key.partition(".")
    if not place:
        return effect_words(effect)
    site = CATALOGUE[effect].site if effect in CATALOGUE else ""
    first, _, form = place.rpartition(".")
    if effect in CATALOGUE and form in CATALOGUE[effect].forms:
        return f"{key_words(f'{effect}.{first}'.rstrip('.'), diagnosis)} {FORMS.get(form, form)}"
    kind = {"pair": "joint", "keypoints": "keypoint"}.get(site, site)
    names = {
        "joint": diagnosis.joint_names,
        "link": diagnosis.link_names,
        "keypoint": tuple(diagnosis.where.keypoints),
    }.get(kind, ())
    if site == kind and kind:
        return _placed(effect, {kind: place})
    for name in names:  # names may hold full stops themselves
        if place.startswith(f"{name}.") and (partner := place[len(name) + 1 :]) in names:
            return _placed(effect, {kind: name, "partner": partner})
    return f"{effect_words(effect)} at {place}"


def _placed(effect: str, where: dict[str, str]) -> str:
    words, partner, form = effect_words(effect), where.pop("partner", None), where.pop("form", None)
    if form is not None:
        return f"{_placed(effect, where)} {FORMS.get(form, form)}"
    if not where:
        return words
    ((kind, name),) = list(where.items())[:1]
    place = place_words("" if kind in words.split() else kind, name)
    if partner is not None:
        return f"{words} between {place} and {place_words(kind, partner)}"
    return f"{words} {'at' if kind != 'link' else 'on' if effect == 'payload' else 'of'} {place}"


def variable_words(variable: str) -> str:
    """What a residual depends on: "velocity:shoulder" is "the shoulder's velocity"."""
    quantity, _, name = variable.partition(":")
    quantity = quantity.replace("_", " ")
    return f"{place_words('joint', name)}’s {quantity}" if name else quantity
