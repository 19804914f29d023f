"""The score of a blind run: pure functions of the answers and of what stands in each diagnosis.json.

What each figure counts is said where it is computed; docs/blind_protocol.md has it in words. Every rate has a 90 %
interval. Cases without a diagnosis count as wrong in all of them.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial

import pandas as pd

from invdyn.blindcheck.judge import FAILED, NONE, OUTSIDE, OUTSIDE_KINDS, Verdict, judge
from invdyn.blindcheck.measures import Calibration, Measure, calibration, mean, median, rate

CLEAR_DPRIME = 30.0
"""d′ from which an effect counts as one that shows; see `visibility`."""

CATALOGUED = ("commanded", "passive", "weak", "two", "none")


@dataclass(frozen=True)
class Scores:
    """Figures by kind, the confusion matrix (truth → answer → count), calibration, and each case's verdict."""

    measures: Mapping[str, tuple[Measure, ...]]
    confusion: Mapping[str, Mapping[str, int]]
    calibrations: Mapping[str, Calibration]
    verdicts: tuple[Verdict, ...]

    def measure(self, kind: str, name: str) -> Measure:
        """One figure; raises KeyError for none of that name."""
        found = [m for m in self.measures.get(kind, ()) if m.name == name]
        if not found:
            raise KeyError(f"no figure {name!r} of kind {kind!r}")
        return found[0]

    def to_json(self) -> dict:
        """As plain values."""
        return {
            "measures": {kind: [m.to_json() for m in measures] for kind, measures in self.measures.items()},
            "confusion": self.confusion,
            "calibration": {kind: c.to_json() for kind, c in self.calibrations.items()},
            "cases": [asdict(verdict) for verdict in self.verdicts],
        }

    def text(self) -> str:
        """The figures as a table for a terminal."""
        rows = [
            {
                "kind": kind.replace("_", " "),
                "figure": m.name,
                "value": shown(m.value),
                "90 % interval": f"{shown(m.low)}–{shown(m.high)}" if m.low is not None else "–",
                "of": m.n,
                "target": m.target or "–",
                "met": {True: "yes", False: "no", None: "–"}[m.met],
            }
            for kind, measures in self.measures.items()
            for m in measures
            if m.n
        ]
        return pd.DataFrame(rows).to_string(index=False) if rows else "no case was scored"


def shown(value: float | None) -> str:
    """Three decimals, or a dash."""
    return "–" if value is None else f"{value:.3f}"


def score(
    answers: Mapping[str, Mapping], diagnoses: Mapping[str, Mapping], oracles: Mapping[str, Mapping] | None = None
) -> Scores:
    """Score diagnoses by the name of their case.

    Args:
        answers: what was put into reality, by case, as `sealed.read_opened` reads it.
        diagnoses: what was found, diagnosis.json each; a case that is missing here has failed.
        oracles: diagnoses in which the effect was given, if there are any.
    """
    oracles = oracles or {}
    verdicts = tuple(judge(n, answer, diagnoses.get(n), oracles.get(n)) for n, answer in answers.items())
    of = {kind: [v for v in verdicts if v.kind == kind] for kind in dict.fromkeys(v.kind for v in verdicts)}
    measures = {kind: tuple(FIGURES[kind](of[kind])) for kind in FIGURES if kind in of}
    measures["all"] = tuple(_overall(verdicts))
    apart = ("unknown_torque", "as_real")  # no probability of a whole cause is at stake there
    fair = [v for v in verdicts if not v.failed and v.kind not in apart]
    calibrations = {"all": _calibrated(fair)}
    calibrations |= {kind: _calibrated([v for v in fair if v.kind == kind]) for kind in of if kind not in apart}
    single = [v for v in verdicts if v.kind not in ("two", "unknown_torque", "as_real")]
    confusion: dict[str, dict[str, int]] = {}
    for v in single:
        row = confusion.setdefault(v.truth, {})
        row[v.answer] = row.get(v.answer, 0) + 1
    return Scores(measures, confusion, calibrations, verdicts)


def _calibrated(verdicts: Sequence[Verdict]) -> Calibration:
    stated = [(v.probability, v.exact) for v in verdicts if v.probability is not None]
    return calibration([probability for probability, _ in stated], [exact for _, exact in stated])


def _single(verdicts: Sequence[Verdict], targets: Mapping[str, str]) -> list[Measure]:
    """Of cases with one effect of the catalogue."""

    def known(attribute: str) -> list:
        return [value for v in verdicts if (value := getattr(v, attribute)) is not None]

    parameters = [inside for v in verdicts for inside in v.covered.values()]
    found = [
        rate("a gap is detected", [v.detected for v in verdicts]),
        mean("probability on the true cause (FIA)", [v.fia for v in verdicts]),
        rate("first answer right, exactly", [v.exact for v in verdicts]),
        rate("first answer right, by ambiguity set", [v.by_set for v in verdicts]),
        rate("side right", known("side")),
        rate("side right, by ambiguity set", known("side_by_set")),
        rate("joint right (two joints or more)", known("joint")),
        rate("keypoint right (two or more)", known("keypoint")),
        rate("push found in time", known("interval")),
        rate("true parameters in 90 % intervals", parameters),
        median("share of the gap closed", known("closed")),
        median("share of the gap closed, of an oracle's", known("of_oracle")),
        mean("effects in the ambiguity set", known("set_size"), unit="effects"),
    ]
    return [Measure(**{**asdict(m), "target": targets.get(m.name, "")}) for m in found if m.n]


COMMANDED = {
    "a gap is detected": "≥ 0.97",
    "probability on the true cause (FIA)": "≥ 0.85",
    "first answer right, exactly": "≥ 0.85",
    "first answer right, by ambiguity set": "≥ 0.95",
    "side right": "≥ 0.98",
    "joint right (two joints or more)": "≥ 0.95",
    "true parameters in 90 % intervals": "0.85–0.95",
    "share of the gap closed": "≥ 0.95",
}
PASSIVE = {"first answer right, by ambiguity set": "≥ 0.90"}
"""Targets of cases with one effect."""


def _weak(verdicts: Sequence[Verdict]) -> list[Measure]:
    sure = [not v.by_set for v in verdicts if v.probability is not None and v.probability >= 0.9]
    return [*_single(verdicts, {}), rate("wrong although 90 % sure", sure)]


def _none(verdicts: Sequence[Verdict]) -> list[Measure]:
    """A false alarm is a gap that is said to be there and is not; with unknown torque it has its own target."""
    hidden = [v.detected for v in verdicts if v.regime == "unknown_torque"]
    return [
        rate("false alarms", [v.detected for v in verdicts if v.regime != "unknown_torque"], "≤ 0.03"),
        rate("false alarms, unknown torque", hidden, "≤ 0.05"),
        mean("probability on “no gap”", [v.fia for v in verdicts]),
    ]


def _two(verdicts: Sequence[Verdict]) -> list[Measure]:
    return [
        rate("a gap is detected", [v.detected for v in verdicts]),
        rate("both named", [v.by_set for v in verdicts], "≥ 0.70"),
        rate("at least one named", [v.some for v in verdicts], "≥ 0.95"),
        rate("at least one named, or said to be a part", [v.at_work for v in verdicts]),
        mean("probability on the two together (FIA)", [v.fia for v in verdicts]),
        median("share of the gap closed", [v.closed for v in verdicts if v.closed is not None]),
    ]


def _unknown_torque(verdicts: Sequence[Verdict]) -> list[Measure]:
    """Effects of the dynamics are as well answered by naming them as by saying that they cannot be seen."""
    seen = [v for v in verdicts if v.truth_side == "observation"]
    dynamics = [v for v in verdicts if v.truth_side == "dynamics"]
    return [
        rate("observation effects named", [v.by_set for v in seen], "≥ 0.80"),
        rate(
            f"… of those that show (d′ ≥ {CLEAR_DPRIME:g})", [v.by_set for v in seen if (v.dprime or 0) >= CLEAR_DPRIME]
        ),
        rate("dynamics effects named, or said to be hidden", [v.hidden or v.by_set for v in dynamics], "≥ 1"),
        rate("dynamics effects blamed on something else", [v.detected and not v.by_set for v in dynamics]),
    ]


def _unknown_effect(verdicts: Sequence[Verdict]) -> list[Measure]:
    return [
        rate("a gap is detected", [v.detected for v in verdicts]),
        rate("flagged as outside the catalogue", [v.outside for v in verdicts], "≥ 0.80"),
    ]


def _as_real(verdicts: Sequence[Verdict]) -> list[Measure]:
    """Of the answer that a diagnosis shows, whether it leaves something or not."""
    known = [v for v in verdicts if v.torque_closed is not None]
    return [
        rate("odd effects named, by set", [each for v in verdicts for each in v.named], "≥ 0.85"),
        rate("all of a case named", [v.by_set for v in verdicts]),
        median("torque closed on held-out rows", [v.torque_closed or 0.0 for v in known], "≥ 0.9"),
        mean("effects at all places named", [v.usual or 0.0 for v in verdicts], unit="share"),
        mean("effects named that are not there", [v.invented or 0 for v in verdicts], unit="effects"),
    ]


def _overall(verdicts: Sequence[Verdict]) -> list[Measure]:
    catalogued = [v for v in verdicts if v.kind in CATALOGUED]
    return [
        rate("wrongly flagged as outside the catalogue", [v.outside for v in catalogued], "≤ 0.05"),
        rate("no diagnosis", [v.failed for v in verdicts]),
    ]


FIGURES: dict[str, Callable[[Sequence[Verdict]], list[Measure]]] = {
    "commanded": partial(_single, targets=COMMANDED),
    "none": _none,
    "passive": partial(_single, targets=PASSIVE),
    "weak": _weak,
    "two": _two,
    "unknown_torque": _unknown_torque,
    "as_real": _as_real,
    **dict.fromkeys(OUTSIDE_KINDS, _unknown_effect),
}
"""Kind → its figures."""

LAST = (NONE, OUTSIDE, FAILED)
"""Answers that are no effects; they stand last in the confusion matrix."""
