"""One case: what a diagnosis.json says, compared with the answer. Plain JSON on both sides."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, overload

from invdyn.blindcheck.equivalence import agreeing, equivalent, in_group, paired, place, same, together

OUTSIDE_KINDS = ("outside", "leave_one_out")
NONE, OUTSIDE, FAILED = "no gap", "outside the catalogue", "no diagnosis"
MAX_PUSH_INTERVAL = 0.5
"""Longest interval about a push, s, if the push was shorter than a tenth of that."""


@dataclass(frozen=True)
class Verdict:
    """How one case was judged; None where a question does not arise.

    Attributes:
        name, kind, regime: of the case.
        truth, answer: effects' names, or one of the words at the top of the file.
        failed: there is no diagnosis.
        detected: a gap was said to be there.
        fia: probability on the true cause.
        exact, by_set: the most probable answer is the truth; or indistinguishable from it.
        some: at least one of several true effects is in the most probable answer.
        at_work: at least one is more probably at work than not: named, or said to be a part.
        probability: of the most probable answer.
        set_size: how many are in the ambiguity set of the most probable cause.
        side, joint, keypoint, interval: whether the largest share is at the true one.
        side_by_set: whether it is, or the answer is indistinguishable from the truth.
        outside: said to be outside the catalogue (P > ½).
        hidden: the true effect was said to be one that the recording cannot show.
        closed: share of the gap closed as reported; `of_oracle` of what knowing the effect closes.
        covered: parameter → whether its 90 % interval holds the truth; where `exact`.
        dprime: visibility of the weakest true effect.
        truth_side: of a single true effect.
        named: of a robot's log, whether the answer that is shown has each odd effect, or what is indistinguishable.
        usual: share of the effects at all places that it has; `invented`: how many it has that are not there.
        torque_closed: share of the missing torque that it closes on held-out rows.
    """

    name: str
    kind: str
    regime: str
    truth: str
    answer: str = FAILED
    failed: bool = True
    detected: bool = False
    fia: float = 0.0
    exact: bool = False
    by_set: bool = False
    some: bool = False
    at_work: bool = False
    probability: float | None = None
    set_size: int | None = None
    side: bool | None = None
    side_by_set: bool | None = None
    joint: bool | None = None
    keypoint: bool | None = None
    interval: bool | None = None
    outside: bool = False
    hidden: bool = False
    closed: float | None = None
    of_oracle: float | None = None
    covered: Mapping[str, bool] = field(default_factory=dict)
    dprime: float | None = None
    truth_side: str | None = None
    named: tuple[bool, ...] = ()
    usual: float | None = None
    invented: int | None = None
    torque_closed: float | None = None


def judge(name: str, answer: Mapping, found: Mapping | None, oracle: Mapping | None = None) -> Verdict:
    """Judge one case; `found` is its diagnosis.json, or None where there is none."""
    kind, truth = answer["kind"], answer["effects"]
    unknown = kind in OUTSIDE_KINDS
    label = OUTSIDE if unknown else label_of(truth)
    only = truth[0] if len(truth) == 1 else None
    start: dict[str, Any] = {
        "name": name,
        "kind": kind,
        "regime": answer["regime"],
        "truth": label,
        "dprime": min((e["dprime"] for e in truth), default=None),
        "truth_side": only["side"] if only else None,
    }
    scored = only is not None and not unknown
    if found is None:
        places = ("side", "side_by_set", *_scored(answer)) if scored else ()
        nothing = {"named": (False,) * len(truth), "usual": 0.0} if "everywhere" in answer else {}
        return Verdict(**start | dict.fromkeys(places, False) | nothing)
    causes = sorted(found["causes"], key=lambda cause: -number(cause["probability"], 0.0))
    outside = number((found.get("outside_catalogue") or {}).get("probability"), 0.0)
    groups = found.get("ambiguity_set") or []
    best = causes[0] if causes else None
    says_outside = best is None or outside > number(best["probability"], 0.0)
    entries = [] if best is None or says_outside else best["effects"]
    right = says_outside and bool(causes or outside) if unknown else not says_outside and paired(truth, entries, same)
    like = right if unknown or says_outside else equivalent(truth, entries, answer, groups)
    said = OUTSIDE if says_outside and outside > 0 else label_of(entries) if best is not None else FAILED
    verdict: dict[str, Any] = {
        "answer": said,
        "failed": False,
        "detected": bool(found["gap"]["detected"]),
        "fia": min(1.0, fia(truth, causes, outside, unknown)),
        "exact": right,
        "by_set": like,
        "some": paired(truth, entries, lambda a, b: agreeing(a, b, answer, groups), 1) if truth and entries else False,
        "at_work": any(shared(e, causes, lambda a, b: agreeing(a, b, answer, groups)) > 0.5 for e in truth),
        "probability": outside if best is None or says_outside else number(best["probability"], 0.0),
        "set_size": None if says_outside or not entries else set_size(entries, groups),
        "outside": outside > 0.5,
        "hidden": only is not None and any(in_group(only, key) for key in found.get("not_identifiable") or []),
        "closed": number((found.get("shrinkage") or {}).get("gap_closed"), None) if truth else None,
        "of_oracle": closed_of(found, oracle) if oracle else None,
        "covered": covered(only, entries[0]) if only is not None and scored and right else {},
    }
    where = found.get("where") or {}
    if only is not None and scored:
        verdict["side"] = top(where.get("side")) == only["side"]
        verdict["side_by_set"] = verdict["side"] or like
        located: dict[str, Callable[[], bool]] = {
            "joint": lambda: top(where.get("joints")) in place(truth[0]),
            "keypoint": lambda: top(where.get("keypoints")) in place(truth[0]),
            "interval": lambda: in_time(truth[0]["interval"], where.get("intervals") or []),
        }
        verdict |= {name: located[name]() for name in _scored(answer)}
    if "everywhere" in answer:
        verdict |= as_real(answer, found, groups)
    return Verdict(**start, **verdict)


def as_real(answer: Mapping, found: Mapping, groups: Sequence[Sequence[str]]) -> dict[str, Any]:
    """What is judged of a robot's log, which lacks effects at all places: the answer that is shown, part by part."""
    entries, odd, usual = shown(found), answer["effects"], answer["everywhere"]
    names = {str(each["effect"]) for each in usual}
    closing = found.get("closing") or {}
    torque = (closing.get("torque") or {}).get(closing.get("shown"), {})
    true = [*odd, *usual]
    if closing.get("shown") == "regression":  # which may say one of several effects at a place
        said = [(s, p) for s in found["regression"]["statements"] for p in s["places"]]
        groups = [*groups, *([f"{e}.{p}" for e in (s["effect"], *s.get("rivals", {}).get(p, ()))] for s, p in said)]
    label = label_of([entry for entry in entries if entry["effect"] not in names])
    named = tuple(any(agreeing(each, entry, answer, groups) for entry in entries) for each in odd)
    return {
        "answer": label,
        "exact": all(any(same(each, entry) for entry in entries) for each in odd),
        "by_set": all(named),
        "named": named,
        "usual": sum(any(same(each, entry) for entry in entries) for each in usual) / len(usual),
        "invented": sum(not any(agreeing(each, entry, answer, groups) for each in true) for entry in entries),
        "torque_closed": number(torque.get("closed"), None),
    }


def shown(found: Mapping) -> list[Mapping]:
    """Effects of the most probable cause, also in part, or of the regression if it does."""
    if (found.get("closing") or {}).get("shown") == "regression":
        stated = (found.get("regression") or {}).get("statements") or []
        places = {"inertial_error": "link"}
        return [
            {"effect": each["effect"], places.get(each["effect"], "joint"): place}
            for each in stated
            for place in each["places"]
        ]
    causes = [cause for cause in found["causes"] if cause["effects"]]

    def weight(cause: Mapping) -> float:
        return number(cause["probability"], 0.0) + number(cause.get("probability_in_part"), 0.0)

    return list(max(causes, key=weight)["effects"]) if causes else []


def label_of(entries: Sequence[Mapping]) -> str:
    """Names of effects, "a + b"; `NONE` for none."""
    return " + ".join(sorted(str(e["effect"]) for e in entries)) or NONE


def fia(truth: Sequence[Mapping], causes: Sequence[Mapping], outside: float, unknown: bool) -> float:
    """Probability on the true cause: of all causes that have its effects at its places."""
    if unknown:
        return outside
    return sum(number(c["probability"], 0.0) for c in causes if paired(truth, c["effects"], same))


def shared(truth: Mapping, causes: Sequence[Mapping], agree: Callable[[Mapping, Mapping], bool]) -> float:
    """Probability that one effect is at work: of all causes that have it, by themselves or as a part of what is."""
    having = [c for c in causes if any(agree(truth, e) for e in c["effects"])]
    return sum(number(c["probability"], 0.0) + number(c.get("probability_in_part"), 0.0) for c in having)


def set_size(entries: Sequence[Mapping], groups: Sequence[Sequence[str]]) -> int:
    """Size of the ambiguity sets that hold a cause, 1 where none does."""
    whole = [len(group) for group in groups if together(entries, group)]
    each = [max((len(g) for g in groups if together([entry], g)), default=1) for entry in entries]
    return max(whole, default=math.prod(each))


def covered(truth: Mapping, found: Mapping) -> dict[str, bool]:
    """Parameter → whether the 90 % interval holds it; angles up to whole turns; those that both have."""
    covers = {}
    for name, true in truth["parameters"].items():
        interval = (found.get("parameters") or {}).get(name, {}).get("interval_90")
        if name == "side" or not interval or not all(math.isfinite(number(v, math.nan)) for v in interval):
            continue
        low, high = interval
        value = true["value"]
        if true["unit"] == "rad":
            value += 2 * math.pi * round(((low + high) / 2 - value) / (2 * math.pi))
        covers[name] = low <= value <= high
    return covers


def in_time(true: Sequence[float], intervals: Sequence[Mapping]) -> bool:
    """Whether the interval with the largest share overlaps the true one and is not much longer."""
    if not intervals:
        return False
    best = max(intervals, key=lambda i: number(i["share"], 0.0))
    start, stop = best["start"], best["end"]
    return start < true[1] and stop > true[0] and stop - start <= max(MAX_PUSH_INTERVAL, 10 * (true[1] - true[0]))


def closed_of(found: Mapping, oracle: Mapping) -> float | None:
    """Share of the oracle's gain, nats a frame, that the diagnosis has; both from the same simulation."""
    ours, best = (d["gap"]["elpd_per_frame"] for d in (found, oracle))
    gains = [number(e.get("corrected"), math.nan) - number(e.get("nominal"), math.nan) for e in (ours, best)]
    return gains[0] / gains[1] if all(map(math.isfinite, gains)) and gains[1] > 0 else None


def top(shares: Mapping[str, float] | None) -> str | None:
    """Name with the largest share."""
    known = {name: number(share, 0.0) for name, share in (shares or {}).items()}
    return max(known, key=known.__getitem__) if known else None


@overload
def number(value: object, otherwise: float) -> float: ...


@overload
def number(value: object, otherwise: None) -> float | None: ...


def number(value: object, otherwise: float | None) -> float | None:
    """A finite float, or something else."""
    return float(value) if isinstance(value, int | float) and math.isfinite(value) else otherwise


def _scored(answer: Mapping) -> list[str]:
    """Of the places of a single effect those that there is a choice of."""
    only, several = answer["effects"][0], len(answer["joints"]) > 1
    arises = {
        "joint": several and "joint" in only,
        "keypoint": several and only["side"] == "observation" and "keypoint" in only,
        "interval": bool(only.get("interval")),
    }
    return [name for name, does in arises.items() if does]
