"""What every number of the decision rule decides: verdicts at half and twice its value, on cases that are known.

Searches come from ``benchmarks/development.py run CASES --out OUT --pools POOLS``; what is decided of their causes is
done again under each rule (:class:`invdyn.diagnosis.rules.Rules`), all but filters and fits to held-out rows, so
that one case takes seconds. A verdict is what is said (a cause, no gap, outside, not enough data), whether it matters,
and the ambiguity set. Writes ``decision_sensitivity.md``. Pools are pickles,
which run code when they are read: give your own alone.

    python benchmarks/decision_sensitivity.py POOLS
"""

import argparse
import pickle
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from textwrap import fill
from typing import Any

from invdyn.diagnosis.assessment.matters import matters, tolerated
from invdyn.diagnosis.assessment.model_posterior import weigh
from invdyn.diagnosis.assessment.power import too_little
from invdyn.diagnosis.prediction.predict import residual
from invdyn.diagnosis.rules import DEFAULT, numbers

ROOM: Any = import_module(weigh.__module__)
CONFIRM = ROOM.confirm_all
KNOWN: dict[tuple[int, str], Any] = {}
"""What SMC said, by search and cause."""
DECIDE = ("evidence", "residual")
"""Groups of numbers that are changed here: those of held-out rows need fits, other ones say how hard to look."""
ELSEWHERE = {"temper_scale_within", "min_dprime", "clear_dprime", "clear_se", "max_filter_se", "engine_error_step"}
"""Of intervals, of the report and of SMC, which are not done again here."""
SEARCHED = re.compile("(spike|slab|limb|path|size|decay|noise|memory|tail|prior_sds|edge|initial|interval)")
"""In names of numbers that the search itself needs."""
TABLE = Path(__file__).with_suffix(".md")
HEAD = (
    "Written by `python benchmarks/decision_sensitivity.py`: {cases}, of opened or development seeds, searched once. "
    "Meanings are in [numbers.md](../docs/numbers.md). Left out: {left_out}, which are of intervals, of the report and "
    "of SMC; and what the search itself needs. The prior of the number of effects is tilted: each further effect is "
    "half or twice as likely."
)


@dataclass(frozen=True)
class Said:
    """What is said of a case: the most probable answer, whether the gap matters, rivals, and two probabilities."""

    answer: str
    matters: bool
    rivals: frozenset[str]
    probability: float
    outside: float

    def other(self, than: "Said") -> bool:
        return (self.answer, self.matters, self.rivals) != (than.answer, than.matters, than.rivals)

    def apart(self, than: "Said") -> float:
        return max(abs(self.probability - than.probability), abs(self.outside - than.outside))


def said(bound: Any, found: Any, missing: tuple) -> Said:
    """The verdict of a search under the rule that stands."""
    if too_little(bound, found) is not None:
        return Said("not enough data", False, frozenset(), 0.0, 0.0)
    weighed = weigh(bound, found, 0)
    before, path = missing
    none, best = found.pool[""], weighed.best
    large = matters(bound, none, best, before, tolerated(bound, path))
    likely, alone = max(((key, p) for key, (_, p) in weighed.causes.items()), key=lambda each: each[1])
    named = sorted(((p, key) for key, (cause, p) in weighed.causes.items() if cause.effects), reverse=True)
    covered, rivals = 0.0, set[str]()
    for p, key in named:
        if covered <= bound.rules.evidence.credible_mass * sum(each for each, _ in named):
            rivals.add(key)
            covered += p
    outside = weighed.outside > alone
    return Said("outside" if outside else likely or "no gap", large, frozenset(rivals), alone, weighed.outside)


def remembered(bound: Any, causes: Any, seed: int, temper: float, workers: int) -> Any:
    """What SMC said of these causes before."""
    for cause in causes:
        key = bound.content, cause.key
        if key not in KNOWN:
            (KNOWN[key],) = CONFIRM(bound, [cause], seed, temper, workers)
    return [KNOWN[bound.content, cause.key] for cause in causes]


def changed(name: str, value: Any, factor: float) -> Any:
    """A number at half or twice its value; of the prior each effect more that much less likely, or more."""
    if isinstance(value, tuple):
        weights = [p * factor**n for n, p in enumerate(value)]
        return tuple(w / sum(weights) for w in weights)
    if isinstance(value, int):
        return max(round(value * factor), 1)
    return min(value * factor, 0.999) if name == "credible_mass" else value * factor


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("pools", type=Path)
    given = arguments.parse_args()
    ROOM.confirm_all = remembered
    searches = {}
    for pool in sorted(given.pools.glob("*.pickle")):
        found = pickle.loads(pool.read_bytes())
        bound = found.problem
        before, _, path = residual(bound, found.pool[""])
        searches[pool.stem] = bound, found, (before, path)
    usual = {name: said(*search) for name, search in searches.items()}
    rows = [("number", "value", "unit", "source", "verdicts at half", "at twice", "largest change of a probability")]
    rows.append(("---",) * len(rows[0]))
    asked_of = [each for group, each in numbers() if group in DECIDE and each.name not in ELSEWHERE]
    for each in (each for each in asked_of if not SEARCHED.search(each.name) or each.name == "effect_count_prior"):
        cells, most = [], 0.0
        for factor in (0.5, 2.0):
            rules = DEFAULT.replace(**{each.name: changed(each.name, each.default, factor)})
            now = {}
            for name, (bound, found, missing) in searches.items():
                other = replace(bound, rules=rules)
                now[name] = said(other, replace(found, problem=other), missing)
            others = [name for name in usual if now[name].other(usual[name])]
            cells.append(f"{len(others)}{': ' if others else ''}{', '.join(others)}")
            most = max(most, *(now[name].apart(usual[name]) for name in usual))
        what: Mapping[str, str] = each.metadata
        value = each.default
        shown = ", ".join(map(str, value)) if isinstance(value, tuple) else f"{value:g}"
        rows.append((f"`{each.name}`", shown, what["unit"], what["source"], *cells, f"{most:.3f}"))
        print(rows[-1], flush=True)
    text = "\n".join(f"| {' | '.join(row)} |" for row in rows)
    left_out = ", ".join(f"`{name}`" for name in sorted(ELSEWHERE))
    kinds = Counter(name.rpartition("-")[0] for name in searches)
    cases = ", ".join(f"{count} {kind.replace('_', ' ')}" for kind, count in kinds.items())
    head = fill(HEAD.format(cases=cases, left_out=left_out), 120, break_on_hyphens=False)
    TABLE.write_text(f"# What each number of the decision rule decides\n\n{head}\n\n{text}\n", "utf-8")


if __name__ == "__main__":
    main()
