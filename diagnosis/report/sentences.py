"""The verdict: is there a gap, where, which cause with what probability, and how far it closes."""

from collections import Counter

from invdyn.diagnosis.assessment.closing_measures import REGRESSION, SEARCH
from invdyn.diagnosis.assessment.result import (
    LEFT_OUT,
    NO_SEARCH,
    REFUSED,
    STEPS,
    UNCHECKED,
    Cause,
    Diagnosis,
    Finding,
    Where,
    named,
)
from invdyn.diagnosis.report.file_sentences import at_edges, at_work, changes, learned, written
from invdyn.diagnosis.report.numbers import handies, handy, known, largest, percent
from invdyn.diagnosis.report.regression_sentences import differing, interim, of_torque, regression_words
from invdyn.diagnosis.report.words import (
    SIDES,
    cause_words,
    effect_words,
    finding_words,
    key_words,
    place_words,
    variable_words,
)
from invdyn.diagnosis.rules import FIXED

COUNTS = {2: "two", 3: "three", 4: "four", 5: "five", 6: "six"}


def kind(diagnosis: Diagnosis) -> str:
    """Which answer it is: "not_enough_data", "none", "outside", "unclear", "ambiguous" or "cause"."""
    if diagnosis.not_enough_data is not None:
        return "not_enough_data"
    if not diagnosis.gap.detected:
        return "none"
    cause = best(diagnosis)
    rival = 0.5 if cause is None else indistinguishable(diagnosis, cause)[1]
    if known(diagnosis.outside.probability) and diagnosis.outside.probability > rival:
        return "outside"
    if cause is None:
        return "unclear"
    return "ambiguous" if len(indistinguishable(diagnosis, cause)[0]) > 1 else "cause"


def best(diagnosis: Diagnosis) -> Cause | None:
    """The most probable cause that has an effect."""
    return max((c for c in diagnosis.causes if c.effects), key=lambda c: c.probability, default=None)


def indistinguishable(diagnosis: Diagnosis, cause: Cause) -> tuple[tuple[str, ...], float]:
    """What the recording cannot tell from a cause, itself first, in words; and their probability together.

    Two causes are indistinguishable where each effect of one is the other's, or in one ambiguity set with it.
    """

    def group(finding: Finding) -> str:
        names = {finding.key, finding.effect}
        found = [i for i, keys in enumerate(diagnosis.ambiguity_set) if names & set(keys) and len(keys) > 1]
        return f"#{found[0]}" if found else finding.key

    signature = sorted(group(f) for f in cause.effects)
    same = [c for c in diagnosis.causes if c.effects and sorted(group(f) for f in c.effects) == signature]
    words = [cause_words(c) for c in sorted(same, key=lambda c: c is not cause)]
    if len(cause.effects) == 1 and signature[0].startswith("#"):
        mine, ranked = cause.effects[0], {n for c in same for f in c.effects for n in (f.key, f.effect)}
        others = [k for k in diagnosis.ambiguity_set[int(signature[0][1:])] if k not in ranked and k != mine.key]
        words += [key_words(key, diagnosis) for key in others]
    return tuple(dict.fromkeys(words)), min(sum(c.probability for c in same), 1.0)


def verdict(diagnosis: Diagnosis) -> str:
    """One sentence; where no search was made it begins with that."""
    if NO_SEARCH not in diagnosis.method:
        return _verdict(diagnosis)
    if diagnosis.gap.detected:
        text = _verdict(diagnosis)
        return f"By regression alone {text[0].lower()}{text[1:]}"
    hidden = {joint: FIXED.clear_torque * limit for joint, limit in diagnosis.gap.tolerated_torque.items()}
    joint, torque = max(hidden.items(), key=lambda each: each[1])
    rest = ", and not all effects were examined" * bool(diagnosis.not_looked_at)
    lacks = f"{handy(torque, diagnosis.torque_unit(joint))} at {place_words('joint', joint)}"
    return f"By regression alone no gap shows, but {lacks} could be missing and not show{rest}."


def _verdict(diagnosis: Diagnosis) -> str:
    answer, probability = kind(diagnosis), percent(diagnosis.gap.probability)
    hidden = not diagnosis.knows_torque
    if answer == "not_enough_data" and diagnosis.not_enough_data is not None:
        return f"Not enough data to say whether there is a gap: {diagnosis.not_enough_data.strip().rstrip('.')}."
    if answer == "none" and hidden:
        return (
            "No gap shows, but the joint torques are unknown and could hide one in how the arm moves "
            f"(probability of a gap {probability})."
        )
    if answer == "none" and diagnosis.gap.probability > 0.5:
        return f"No gap that matters: what the simulation lacks{_small(diagnosis)} is too little to look into."
    if answer == "none":
        return f"No gap: the simulation explains the recording down to its noise (probability of a gap {probability})."
    if (lead := _explained(diagnosis, answer)) is not None:
        return lead
    if answer == "outside":
        return _beyond(diagnosis)
    cause = best(diagnosis)
    if answer == "unclear" or cause is None:
        return f"There is a gap{_place(diagnosis)}, but its cause is open (probability of a gap {probability})."
    words, together = indistinguishable(diagnosis, cause)
    if answer == "ambiguous":
        them = "either" if len(words) == 2 else "any of them"
        return (
            f"There is a gap, caused by {' or '.join((', '.join(words[:-1]), words[-1]))}, which this recording cannot "
            f"tell apart (together {percent(together)} probable); {_closing(diagnosis, them)}."
        )
    count = len(cause.effects)
    what = cause_words(cause)
    missing = f"{COUNTS.get(count, count)} effects: {what}" if count > 1 else what
    if cause.probability < 0.5:
        return (
            f"There is a gap; its most probable cause is {what}, at only {percent(cause.probability)}; "
            f"{_closing(diagnosis, 'it' if count == 1 else 'them')}."
        )
    return (
        f"There is a gap: the simulation leaves out {missing} ({percent(cause.probability)} probable); "
        f"{_closing(diagnosis, 'it' if count == 1 else 'them')}."
    )


def _explained(diagnosis: Diagnosis, answer: str) -> str | None:
    """How much named effects explain where something is left, or the search is behind the regression; None elsewhere.

    None, too, where they explain nothing, or torque does not tell.
    """
    closing, regression = diagnosis.closing, diagnosis.regression
    if closing is None or regression is None:
        return None
    by_regression, cause = _by_regression(diagnosis), at_work(diagnosis)
    torque = closing.torque[closing.shown]
    searched = cause and answer in ("outside", "unclear") and torque.interval_90[0] > 0
    if torque.share <= 0 or not (by_regression or searched):
        return None
    what = regression_words(regression) if by_regression else _together(diagnosis, cause) if cause else ""
    text = f"There is a gap{_place(diagnosis)}: {what} {'explain' if ' and ' in what else 'explains'} "
    text += of_torque(torque)
    if closing.replay:
        longest = closing.replay[-1]
        share = longest.closed[closing.shown][0]
        text += f" and {percent(max(share, 0.0))} of the error of a replay of {longest.horizon:g} s"
    rest = [
        f"{handy(after, diagnosis.torque_unit(joint))} at {place_words('joint', joint)}"
        for joint, after in zip(closing.joints, torque.after.tolist(), strict=True)
    ]
    if len(rest) > 2:
        most = int(torque.after.argmax())
        rest = [rest[most]]
    return f"{text}; {named(rest)} {'are' if len(rest) > 1 else 'is'} left."


def _by_regression(diagnosis: Diagnosis) -> bool:
    """Whether the answer is the regression's: the search, if there was one, closes less."""
    closing = diagnosis.closing
    return closing is not None and closing.shown == REGRESSION and closing.torque[REGRESSION].share > 0


def _search_behind(diagnosis: Diagnosis) -> str | None:
    """What the search found instead of the regression's answer, and how much of the missing torque that explains."""
    cause = at_work(diagnosis)
    if diagnosis.closing is None or cause is None or SEARCH not in diagnosis.closing.torque:
        return None
    share = diagnosis.closing.torque[SEARCH].share
    much = f"{percent(share)} of the missing torque" if share >= 0.005 else "none of the missing torque"
    what = _together(diagnosis, cause)
    return f"The search explains less, and is not the answer: its best, {what}, explains {much}."


def _together(diagnosis: Diagnosis, cause: Cause) -> str:
    """A cause in words, in which an effect at all joints, or of all links, is said once."""
    places = {"joint": len(diagnosis.joint_names), "link": len(diagnosis.link_names)}
    count, words = Counter((f.effect, *f.where) for f in cause.effects), []
    for finding in cause.effects:
        (kind, *more) = finding.where or ("",)
        everywhere = not more and count[finding.effect, kind] == places.get(kind) != 1
        all_of = f"{effect_words(finding.effect, finding.entry)} {'of' if kind == 'link' else 'at'} all {kind}s"
        words.append(all_of if everywhere else finding_words(finding))
    return named(list(dict.fromkeys(words)))


def _closing(diagnosis: Diagnosis, them: str) -> str:
    closed = diagnosis.shrinkage.gap_closed
    if not known(closed):
        return "how far that closes the gap was not measured"
    if closed <= 0:
        return f"adding {them} closes none of the gap"
    return f"adding {them} closes {'all' if closed >= 0.995 else percent(closed)} of the gap"


def _beyond(diagnosis: Diagnosis) -> str:
    """Where something is left: what explains most, how far that closes the gap, and the rest; or that nothing does."""
    place, outside = _place(diagnosis), percent(diagnosis.outside.probability)
    what = "no effect in the catalogue" if not diagnosis.not_looked_at else "no effect that the search came to"
    cause = max((c for c in diagnosis.causes if c.effects), key=lambda c: c.in_part, default=None)
    if cause is None or cause.in_part <= 0.5:
        return f"There is a gap{place}, and {what} explains it ({outside} probable)."
    them, closed = "it" if len(cause.effects) == 1 else "them", diagnosis.shrinkage.gap_closed
    much = "most" if known(closed) and closed > 0.5 else "a part"
    return (
        f"There is a gap{place}; {much} of it is {cause_words(cause)} ({percent(cause.in_part)} probable): "
        f"{_closing(diagnosis, them)}; {_rest(diagnosis, what)}."
    )


def _rest(diagnosis: Diagnosis, what: str) -> str:
    """What the best cause leaves, in N·m where torques are known, and that ``what`` explains it: no effect."""
    after, limits = diagnosis.shrinkage.residual_torque_rms_after, diagnosis.gap.tolerated_torque
    top = largest(after) if diagnosis.knows_torque else None
    if top is None:
        return f"{what} explains the rest"
    rest = f"the rest, {handy(top[1], diagnosis.torque_unit(top[0]))} at {place_words('joint', top[0])}"
    if limits and all(after[joint] <= limit for joint, limit in limits.items()):
        return f"{rest}, is less than is tolerated"
    return f"{what} explains {rest}"


def _small(diagnosis: Diagnosis) -> str:
    """The torque of a gap that does not matter, at the joint where it is nearest to its limit, and that limit."""
    gap = diagnosis.gap
    shares = {n: gap.residual_torque_rms[n] / limit for n, limit in gap.tolerated_torque.items() if limit > 0}
    if (top := largest(shares)) is None:
        return ""
    lacks, limit = handies(diagnosis.torque_unit(top[0]), gap.residual_torque_rms[top[0]], gap.tolerated_torque[top[0]])
    return f", {lacks} at {place_words('joint', top[0])} where {limit} is tolerated,"


def _place(diagnosis: Diagnosis) -> str:
    seen, site, shares = _shares(diagnosis.where)
    if (top := largest(shares)) and top[1] >= 0.5 - FIXED.equal_share:
        return f" at {named(_largest(site, shares))}"
    return f" in {SIDES['observation']}" if seen else ""


def _shares(w: Where) -> tuple[bool, str, dict[str, float]]:
    """Whether the gap is in what sensors show; kind and shares of the places: keypoints where a camera shows it."""
    seen = (side := largest(w.side)) is not None and side[0] == "observation"
    return (seen, "keypoint", w.keypoints) if seen and any(w.keypoints.values()) else (seen, "joint", w.joints)


def _most(shares: dict[str, float]) -> list[str]:
    """The places that have the largest share as it is written: of a tie, all."""
    most = max(shares.values(), default=0.0)
    return [name for name, share in shares.items() if share >= most - FIXED.equal_share]


def _largest(kind: str, shares: dict[str, float]) -> list[str]:
    """The same in words."""
    return [place_words(kind, name) for name in _most(shares)]


def details(diagnosis: Diagnosis) -> list[str]:
    """The sentences under the verdict."""
    answer = kind(diagnosis)
    if answer == "not_enough_data":
        return []  # the reason has the remedy
    found = [f"{why}."] if (why := diagnosis.method.get(NO_SEARCH)) else []
    found += [text] if (regression := diagnosis.regression) and (text := differing(regression)) else []
    behind = not why and _by_regression(diagnosis)  # then what the search found is not the answer
    if answer != "none":
        own = (_search_behind(diagnosis),) if behind else (_closed(diagnosis), _each(diagnosis))
        found += [s for s in (where(diagnosis), depends(diagnosis), *own) if s]
    if not behind:
        found += (changes(diagnosis) + at_edges(diagnosis)) * (answer != "none") + learned(diagnosis)
    if answer != "none" and not behind and diagnosis.regression is not None and diagnosis.regression.stated:
        found.append(interim(diagnosis.regression))
    if answer in ("outside", "none") and not behind and diagnosis.outside.description:
        found.append(f"What is left over looks like {diagnosis.outside.description}.")
    elif answer not in ("outside", "none") and known(o := diagnosis.outside.probability) and o >= 0.05:
        found.append(f"With {percent(o)} probability the true cause is not in the catalogue.")
    if answer in ("ambiguous", "outside", "unclear") and diagnosis.separating_experiment:
        found.append(f"To tell the causes apart: {diagnosis.separating_experiment.strip().rstrip('.')}.")
    if answer == "none" and diagnosis.gap.probability > 0.5 and (cause := best(diagnosis)):
        chance = percent(max(cause.probability, cause.in_part))
        found.append(f"The little that there is looks most like {cause_words(cause)} ({chance} probable).")
    found += [f"{text}." for key in (REFUSED, LEFT_OUT, STEPS, UNCHECKED) if (text := diagnosis.method.get(key))]
    if (count := diagnosis.not_looked_at) and not why:
        found.append(
            f"The search stopped at the budget; {count} candidate{'s were' if count > 1 else ' was'} not looked at "
            "(--budget gives more)."
        )
    if diagnosis.written is not None:
        found += written(diagnosis.written, diagnosis.shifting)
    if diagnosis.length_unit != "m":
        found.append(f"Lengths are in {diagnosis.length_unit}s: read that for m in every unit, of torques, too.")
    if not diagnosis.knows_torque and answer != "none":
        found.append("The joint torques are unknown, so no effect is named that a torque could imitate.")
    return found


def where(diagnosis: Diagnosis) -> str | None:
    """Side, place and time."""
    w = diagnosis.where
    parts = []
    if side := largest(w.side):
        parts.append(f"in {SIDES.get(side[0], side[0])} ({percent(side[1])})")
    _, site, shares = _shares(w)
    if (top := largest(shares)) and len(shares) > 1:
        much = "" if top[1] >= 0.9 else "mostly " if top[1] > 0.5 else "in part "
        if len(places := _largest(site, shares)) > 1:
            parts.append(f"as much at {named(places)} ({percent(top[1])} each)")
        else:
            parts.append(f"{much}at {places[0]} ({percent(top[1])})")
    if w.intervals:
        when = max(w.intervals, key=lambda i: i.share)
        if when.share >= 0.3:
            parts.append(f"{percent(when.share)} of it between {when.start:.2f} s and {when.stop:.2f} s")
    return f"The gap lies {', '.join(parts)}." if parts else None


def depends(diagnosis: Diagnosis) -> str | None:
    """What the residual follows."""
    names = [variable_words(v) for v in diagnosis.where.depends_on]
    return f"The missing torque depends on {named(names)}." if names else None


def _closed(diagnosis: Diagnosis) -> str | None:
    shrinkage, before = diagnosis.shrinkage, diagnosis.gap.residual_torque_rms
    parts = []
    if known(shrinkage.gap_closed) and shrinkage.interval_90 is not None:
        low, high = shrinkage.interval_90
        on = "data held out from the fit" if shrinkage.held_out else "the same data as the fit"
        parts.append(f"the share closed is {percent(low)} to {percent(high)} with 90 % probability, on {on}")
    # At the joint where the gap lies: with much noise more may seem to be missing at another.
    at = {name: before[name] for name in _most(diagnosis.where.joints) if name in before}
    top = largest(at or before)
    if top and diagnosis.knows_torque and known(after := shrinkage.residual_torque_rms_after.get(top[0])):
        old, new = handies(diagnosis.torque_unit(top[0]), top[1], after)
        change = f"stays at {old}" if old == new else f"changes from {old} to {new}"
        parts.append(f"the torque left unexplained at {place_words('joint', top[0])} {change}")
    replayed = [diagnosis.gap.replay_rms_m.get(name) for name in ("corrected", "nominal")]
    if diagnosis.tracks is not None and all(map(known, replayed)):
        new, old = handies("m", *replayed)
        errs = f"errs by {old}" if old == new else f"then errs by {new}, not {old}"
        parts.append(f"run for {diagnosis.tracks.replay_window:g} s on its own, the simulation {errs}")
    text = "; ".join(parts)
    return f"{text[0].upper()}{text[1:]}." if text else None


def _each(diagnosis: Diagnosis) -> str | None:
    """What each of several effects closes that the others leave, and which of them withheld rows do not confirm."""
    shrinkage = diagnosis.shrinkage
    parts = {key_words(name, diagnosis): part for name, part in shrinkage.by_effect.items() if known(part.gap_closed)}
    if len(parts) < 2:
        return None
    first, *more = [(words, percent(part.gap_closed)) for words, part in parts.items()]
    opens = [f"{first[0]} would reopen {first[1]} of the gap", *(f"{words} {share}" for words, share in more)]
    doubtful = [words for words, part in parts.items() if part.interval_90 is None or part.interval_90[0] <= 0]
    data = "Data held out from the fit" if shrinkage.held_out else "These data"
    text = f"Leaving out {named(opens)}."
    return f"{text} {data} do not confirm {named(doubtful)}." if doubtful else text


def left(diagnosis: Diagnosis) -> list[str]:
    """What the recording leaves open, one sentence a set."""
    found = []
    for group in diagnosis.ambiguity_set:
        if len(group) > 1:
            words = [key_words(key, diagnosis) for key in group]
            shares = [share for one, other, share in diagnosis.overlaps if {one, other} <= set(group)]
            similar = "" if not shares else f" (the changes that they predict are {_range(shares)} correlated)"
            found.append(f"{named(words)} all remain probable: this recording cannot tell them apart{similar}.")
    return [f"{s[0].upper()}{s[1:]}" for s in found]


def _range(shares: list[float]) -> str:
    low, high = percent(min(shares)), percent(max(shares))
    return low if low == high else f"{low} to {high}"


def left_over(diagnosis: Diagnosis) -> str:
    """Whether something outside the catalogue remains."""
    outside = diagnosis.outside
    if outside.description is None:
        return "No formula was found for what is left over."
    gain = (
        f"; it improves each held-out frame by {handy(outside.gain_per_frame, 'nats')}"
        if known(outside.gain_per_frame)
        else ""
    )
    return f"Short formula for what is left over: {outside.description}{gain}."
