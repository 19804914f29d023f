"""Effects and places in plain words."""

import re

from invdyn.diagnosis.assessment.result import Cause, Diagnosis, Finding, named
from invdyn.diagnosis.catalogue import CATALOGUE, CatalogueEntry
from invdyn.models.effects.base import STOPS

SIDES = {"dynamics": "how the arm moves", "observation": "how the motion is seen"}
SHORT_SIDES = {"dynamics": "arm’s motion", "observation": "sensors’ view"}


def effect_words(effect: str, entry: CatalogueEntry | None = None) -> str:
    """An effect's name in a sentence."""
    entry = entry or CATALOGUE.get(effect)
    return (entry.phrase if entry else "") or effect.replace("_", " ")


def meaning(finding: Finding) -> str | None:
    """What an effect is, in its non-ideal variant too; None for one of which the catalogue has no words."""
    if (entry := finding.entry) is None or not entry.meaning:
        return None
    variant = [text for name, text in entry.variant_words.items() if name in finding.parameters]
    return "; ".join([entry.meaning, *variant])


def place_words(kind: str, name: str) -> str:
    """A joint, link or keypoint in a sentence: "the elbow", "joint j2", "keypoint wrist"."""
    word = name.replace("_", " ")
    if kind != "keypoint" and re.fullmatch("[a-z]{3,}( [a-z]{3,})*", word) and kind not in word.split():
        return f"the {word}"
    return f"{kind} {name}".strip()


def finding_words(finding: Finding) -> str:
    """An effect and its place: "viscous friction at the elbow"."""
    return _placed(finding.effect, dict(finding.where), finding.entry)


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
    entry = CATALOGUE.get(effect)
    site = entry.effect.site if entry else ""
    first, _, form = place.rpartition(".")
    if entry and form in entry.effect.forms:
        return f"{key_words(f'{effect}.{first}'.rstrip('.'), diagnosis)} {entry.forms.get(form, form)}"
    kind = {"pair": "joint", "keypoints": "keypoint", "stop": "joint"}.get(site, site)
    names = {
        "joint": diagnosis.joint_names,
        "link": diagnosis.link_names,
        "keypoint": tuple(diagnosis.where.keypoints),
    }.get(kind, ())
    if first in names and form in STOPS and site == "stop":
        return _placed(effect, {kind: first, "stop": form}, entry)
    if site == kind and kind:
        return _placed(effect, {kind: place}, entry)
    for name in names:  # names may hold full stops themselves
        if place.startswith(f"{name}.") and (partner := place[len(name) + 1 :]) in names:
            return _placed(effect, {kind: name, "partner": partner}, entry)
    return f"{effect_words(effect)} at {place}"


def _placed(effect: str, where: dict[str, str], entry: CatalogueEntry | None) -> str:
    words, partner, form = effect_words(effect, entry), where.pop("partner", None), where.pop("form", None)
    if (stop := where.pop("stop", None)) is not None:
        return f"{_placed(effect, where, entry)}, {stop} side"
    if form is not None:
        return f"{_placed(effect, where, entry)} {entry.forms.get(form, form) if entry else form}"
    if not where:
        return words
    ((kind, name),) = list(where.items())[:1]
    place = place_words("" if kind in words.split() else kind, name)
    if partner is not None:
        return f"{words} between {place} and {place_words(kind, partner)}"
    usual = "of" if kind == "link" else "at"
    return f"{words} {(entry.preposition if entry else '') or usual} {place}"


def variable_words(variable: str) -> str:
    """What a residual depends on: "velocity:shoulder" is "the shoulder's velocity"."""
    quantity, _, name = variable.partition(":")
    quantity = quantity.replace("_", " ")
    return f"{place_words('joint', name)}’s {quantity}" if name else quantity
