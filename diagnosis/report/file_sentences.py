"""Sentences of a diagnosis about the simulation's own file: what of it changes, was learned, and was written."""

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from invdyn.diagnosis.assessment.result import Cause, Diagnosis, Written, named
from invdyn.diagnosis.report.numbers import changed, handies, handy, percent
from invdyn.diagnosis.report.words import finding_words, place_words
from invdyn.diagnosis.rules import FIXED
from invdyn.models.bodies.joint_parts import PARTS


def at_work(diagnosis: Diagnosis) -> Cause | None:
    """The most probable cause that has an effect, with or without something else."""
    return max((c for c in diagnosis.causes if c.effects), key=lambda c: c.probability + c.in_part, default=None)


def changes(diagnosis: Diagnosis) -> list[str]:
    """What of the simulation's own numbers the best cause changes: from … to …."""
    found, cause = [], at_work(diagnosis)
    for finding in cause.effects if cause else ():
        for name, change in finding.changes.items():
            after = change.after
            old, new, low, high = changed(after.unit, change.before, after.mean, after.interval_90)
            found.append(
                f"Of {finding_words(finding)} the {name.replace('_', ' ')} changes from {old} to {new} "
                f"(90 % interval {low} to {high})."
            )
    return found


def at_edges(diagnosis: Diagnosis) -> list[str]:
    """Numbers of the best cause that are at the largest distinguishable value, and what that means."""
    found, cause = [], at_work(diagnosis)
    for finding in cause.effects if cause else ():
        entry = finding.entry
        for name, (edge, means) in entry.limits.items() if entry else ():
            e = finding.parameters.get(name)
            if e is not None and max(map(abs, e.interval_90)) >= edge:
                what = f"The {name.replace('_', ' ')} of {finding_words(finding)}"
                found.append(f"{what} may be {handy(edge, e.unit, 3)} or more: {means}.")
    return found


def learned(diagnosis: Diagnosis) -> list[str]:
    """Joints' numbers of the body's file that were uncertain, as the best cause has them; not those it changes too."""
    causes = [c for c in diagnosis.causes if diagnosis.gap.detected or not c.effects]
    cause = max(causes, key=lambda c: c.probability + c.in_part, default=None)
    if cause is None:
        return []
    changed_too = {
        (f.where.get("joint"), entry.body_file_fields[name])
        for f in cause.effects
        if (entry := f.entry)
        for name in f.changes
    }
    found = []
    for number in cause.learned:
        if number.quantity in PARTS and (number.place, number.quantity) not in changed_too:
            after = number.change.after
            old, new, low, high = changed(after.unit, number.change.before, after.mean, after.interval_90)
            what = f"{number.quantity} of {place_words('joint', number.place)}"
            found.append(f"Learned: {what} is {new} (90 % interval {low} to {high}), {old} in the file.")
    return found


def written(copy: Written, shifting: Collection[str] = ()) -> list[str]:
    """What the corrected file is, what it cannot say, and what MuJoCo is off by with it.

    That is said of the joints that turn, and of those that are ``shifting`` where none turns.
    """
    if copy.nothing is not None:
        return [f"No corrected file was written: {copy.nothing}."]
    what = _by_quantity(copy.changes)
    if what:
        found = [f"The corrected simulation is {copy.file}: changed is {named(what)}."]
    else:
        found = [f"{copy.file} is a plain copy of the simulation: nothing in it is changed."]
    found += [f"Not in it is {words}: {why}." for words, why in copy.unsaid.items()]
    if copy.refined is not None:
        found.append(_refined(copy.refined))
    if (tried := copy.rollout) is not None:
        total, on = tried["total_rms_rad"], "a withheld recording" if tried["held_out"] else "the same recording"
        off = tried["angle_rms_rad"]
        turning = [name for name in off if name not in shifting]
        rms = [np.sqrt(np.mean([off[n][when] ** 2 for n in turning or off])) for when in ("before", "after")]
        before, after = handies("rad" if turning else "m", *rms)
        quantity = "angles" if turning else "positions"
        found.append(
            f"{tried['engine']} replayed {on}, and restarted every {tried['window_s']:g} s from the state that the "
            f"file itself is consistent with. Its {quantity} are off by {after} rms with the corrected file, by "
            f"{before} with the original."
        )
        if (whole := tried.get("whole_rms_rad")) is not None:
            found.append(_whole(whole))
        if what and total["after"] >= total["before"]:
            found.append("The corrected file is no nearer to the recording: keep the original.")
    return found


def _by_quantity(made: Sequence[Mapping[str, Any]]) -> list[str]:
    """Changes in words: the places of a quantity by name, or how many they are."""
    places: dict[str, list[str]] = {}
    for each in made:
        places.setdefault(each["quantity"], []).append(each["place"])
    counted = {quantity: f"{len(of)} places" if len(of) > 2 else named(of) for quantity, of in places.items()}
    return [f"{quantity}{' of ' * bool(of)}{of}" for quantity, of in counted.items()]


def _refined(fit: dict) -> str:
    """What replays of held-out windows are off by, in the mean square of joints."""
    by_joint = fit["held_out_rms_rad"]
    off = {who: math.sqrt(sum(x**2 for x in each.values()) / len(each)) for who, each in by_joint.items()}
    refined, regression, filed = handies("rad", off["refined"], off["regression"], off["file"])
    shares = [
        f"{percent(1 - by_joint['refined'][name] / size)} at {place_words('joint', name)}"
        for name, size in by_joint["file"].items()
    ]
    return (
        f"Its numbers are fitted to MuJoCo's replays of the logs. In held-out windows of {fit['window_s']:g} s the "
        f"angles are off by {refined} rms, by {regression} with the regression's numbers, by {filed} with the "
        f"original: closed are {named(shares)}."
    )


def _whole(total: dict[str, float | None]) -> str:
    """What is off without a restart; an arm that is unstable says nothing there."""
    before, after = total["before"], total["after"]
    if before is None or after is None or min(before, after) > FIXED.replay_runs_away:
        return "Without a restart the motion is lost in both: the arm is unstable, and the windows alone count."
    first, second = handies("rad", before, after)
    return f"Without a restart they are off by {second} and {first}."
