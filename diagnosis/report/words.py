"""Effects and places in plain words."""

import re

from invdyn.diagnosis.assessment.result import Cause, Diagnosis, Finding, named
from invdyn.models.effects.catalogue import EFFECTS
from invdyn.models.effects.joint_limit import SIDES as STOPS

SIDES = {"dynamics": "how the arm moves", "observation": "how the motion is seen"}
SHORT_SIDES = {"dynamics": "arm’s motion", "observation": "sensors’ view"}


def effect_words(effect: str) -> str:
    """An effect's name in a sentence."""
    return EFFECTS[effect].phrase if effect in EFFECTS else effect.replace("_", " ")


def meaning(finding: Finding) -> str | None:
    """What an effect is, in its regularised form too; None for one of the user's own."""
    if finding.effect not in EFFECTS:
        return None
    kind = EFFECTS[finding.effect]
    forms = [text for name, text in kind.form_words.items() if name in finding.parameters]
    return "; ".join([kind.meaning, *forms])


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
    site = EFFECTS[effect].site if effect in EFFECTS else ""
    first, _, form = place.rpartition(".")
    if effect in EFFECTS and form in EFFECTS[effect].forms:
        return f"{key_words(f'{effect}.{first}'.rstrip('.'), diagnosis)} {_form_words(effect, form)}"
    kind = {"pair": "joint", "keypoints": "keypoint"}.get(site, site)
    names = {
        "joint": diagnosis.joint_names,
        "link": diagnosis.link_names,
        "keypoint": tuple(diagnosis.where.keypoints),
    }.get(kind, ())
    if first in names and form in STOPS and effect in EFFECTS:
        return _placed(effect, {kind: first, "stop": form})
    if site == kind and kind:
        return _placed(effect, {kind: place})
    for name in names:  # names may hold full stops themselves
        if place.startswith(f"{name}.") and (partner := place[len(name) + 1 :]) in names:
            return _placed(effect, {kind: name, "partner": partner})
    return f"{effect_words(effect)} at {place}"


def _placed(effect: str, where: dict[str, str]) -> str:
    words, partner, form = effect_words(effect), where.pop("partner", None), where.pop("form", None)
    if (stop := where.pop("stop", None)) is not None:
        return f"{_placed(effect, where)}, {stop} side"
    if form is not None:
        return f"{_placed(effect, where)} {_form_words(effect, form)}"
    if not where:
        return words
    ((kind, name),) = list(where.items())[:1]
    place = place_words("" if kind in words.split() else kind, name)
    if partner is not None:
        return f"{words} between {place} and {place_words(kind, partner)}"
    return f"{words} {'at' if kind != 'link' else 'on' if effect == 'payload' else 'of'} {place}"


def _form_words(effect: str, form: str) -> str:
    return EFFECTS[effect].form_words.get(form, form) if effect in EFFECTS else form


def variable_words(variable: str) -> str:
    """What a residual depends on: "velocity:shoulder" is "the shoulder's velocity"."""
    quantity, _, name = variable.partition(":")
    quantity = quantity.replace("_", " ")
    return f"{place_words('joint', name)}’s {quantity}" if name else quantity
