"""What a regression says, in words: effects, their places, and the share of the torque that they explain."""

from invdyn.diagnosis.assessment.result import named
from invdyn.diagnosis.catalogue import CATALOGUE
from invdyn.diagnosis.catalogue.linear_laws import INERTIAL
from invdyn.diagnosis.regression.regress import Regression
from invdyn.diagnosis.regression.stated_numbers import Estimated, Stated
from invdyn.diagnosis.regression.torque_closing import TorqueClosing
from invdyn.diagnosis.report.numbers import percent, plus_minus
from invdyn.diagnosis.report.words import effect_words, place_words
from invdyn.diagnosis.rules import FIXED


def regression_words(regression: Regression) -> str:
    """Effects and places of a regression: "viscous friction at all joints and perhaps a spring at the elbow (60 %)".

    Numbers that are less probable than not are in the report's table alone.
    """
    sure, perhaps = [], []
    for stated in regression.stated:
        words, of = effect_words(stated.effect), "link" if stated.effect == INERTIAL else "joint"
        words += " of" if of == "link" else " at"
        rest = [place for place in stated.places if place not in stated.sure]
        if stated.everywhere and not rest and len(stated.places) > 1:
            sure.append(f"{words} all {of}s")
        elif stated.sure:
            sure.append(f"{words} {named([_or_rivals(stated, place, of) for place in stated.sure])}")
        probable = [place for place in rest if stated.probability[place] >= 0.5]
        if probable:
            places = [f"{_or_rivals(stated, place, of)} ({percent(stated.probability[place])})" for place in probable]
            perhaps.append(f"{words} {named(places)}")
    parts = [named(sure)] * bool(sure) + [f"perhaps {named(perhaps)}"] * bool(perhaps)
    without = "numbers that the parts of the log do not agree on" if regression.stated else "no effect"
    return " and ".join(parts) or without


def _or_rivals(stated: Stated, place: str, of: str) -> str:
    """A place, of a stop with its side, of a pair both joints; and which other effects may be there instead."""
    rivals = [effect_words(effect) for effect in stated.rivals.get(place, ())]
    entry, (first, _, last) = CATALOGUE.get(stated.effect), place.rpartition(".")
    site = entry.effect.site if entry and first else ""
    ends = {"stop": f", {last} side", "pair": f" and {place_words(of, last)}"}
    words = place_words(of, first if site in ends else place) + ends.get(site, "")
    return words + (f" (or {' or '.join(rivals)} there: one of these)" if rivals else "")


def interim(regression: Regression) -> str:
    """What a regression says before the search ends, one sentence."""
    torque = regression.torque
    if not regression.stated:
        return "By regression alone no effect explains the torque better than the simulation does."
    words = regression_words(regression)
    verb = "explain" if " and " in words or "numbers" in words else "explains"
    return f"By regression alone: {words} {verb} {of_torque(torque)}."


def number_words(number: Estimated) -> str:
    """Which number it is: "Coulomb friction: torque at elbow"."""
    of = "of" if number.effect == INERTIAL else "at"
    return f"{effect_words(number.effect)}: {number.parameter} {of} {number.place}"


def of_parts(number: Estimated) -> list[str]:
    """What each part of the rows says of it, with its sd."""
    return [plus_minus(value, sd, number.unit) for value, sd in number.by_part]


def differing(regression: Regression) -> str | None:
    """What recordings, or thirds of one, do not tell the same of; the numbers that are farthest apart first."""
    every = [each for each in regression.numbers if each.by_part]
    if not every:
        return None
    every.sort(key=lambda each: (min(each.by_part)[0] - max(each.by_part)[0]) / each.sd)
    some = [f"{number_words(each)} is {named(of_parts(each))}" for each in every[: FIXED.num_shown]]
    what = "recordings" if regression.recordings > 1 else "thirds of the log"
    count = f"{len(every)} of the {len(regression.numbers)} numbers of the regression"
    return f"The {what} differ in {count}, whose intervals are wider for that: {'; '.join(some)}."


def of_torque(torque: TorqueClosing) -> str:
    """Share of the missing torque that is explained, and that of another motion's."""
    low, high = (percent(end) if end > 0 else "none" for end in torque.interval_90)
    return f"{percent(max(torque.share, 0.0))} of the missing torque ({low} to {high} of another motion's)"
