"""Which rules of the search are needed: what each added to the answer, and what removing it costs.

One search a case is watched: of every rule, how often it was tried, in what share of the time, how often it found a
better best cause, and in how many cases it has a say: the final best is its find, or a rival within ``NEAR`` nats of
that. A rule without a say cost time alone, there. ``--without RULE`` searches once more with that rule gone, where it
had a say, or, with ``--tried``, wherever it was tried; what the best's score loses is its worth.

    python benchmarks/ablation.py --cases CASES --out WATCHED       a line a case, and the table; continues
    python benchmarks/ablation.py --cases CASES --out WATCHED --without drop

Cases are those of ``benchmarks/development.py make``. Intervals are Jeffreys', of 90 %.
"""

import argparse
import json
import time
from collections import defaultdict
from collections.abc import Callable
from functools import wraps
from importlib import import_module
from pathlib import Path
from typing import Any

from scipy.stats import beta

from invdyn.diagnosis.diagnose import searched as search_problem
from invdyn.diagnosis.hypotheses.pool import HypothesisPool
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem, diagnosis_problem
from invdyn.models import Body
from invdyn.recordings import read_keypoint_csv

ROOMS = "invdyn.diagnosis.hypotheses."
RULES = {
    "_refine_tracker_errors": ("search", "a tracker's errors come first"),
    "drop": ("search", "drop: leave effects out"),
    "exchange": ("search", "swap: another effect in the place of one"),
    "refine_best": ("add", "add: the best of the screen"),
    "regularised": ("add", "the regularised form of what would need implausible values"),
    "refine_backlash": ("profile_likelihood", "backlash, by paths of its own"),
    "_refine_moved": ("swap", "neighbour: a push at another moment"),
    "refine_regularised": ("swap", "neighbour: the regularised form"),
    "twin": ("swap", "neighbour: an exact stand-in"),
    "wider": ("swap", "neighbour: what contains an effect"),
    "narrower": ("swap", "neighbour: its special case"),
    "similar": ("swap", "neighbour: an effect that it may imitate"),
}
"""Rule → the module that calls it, and what it does; a function but for the kinds of neighbours, of ``_follow``."""
KINDS = ("twin", "wider", "narrower", "similar")
NEAR = 5.0
"""Nats of the score behind the best within which a cause has a say in the answer."""


class Watch:
    """What each rule did in one search; times are those of the processor, without those of rules within it."""

    def __init__(self) -> None:
        self.tried: dict[str, int] = defaultdict(int)
        self.better: dict[str, int] = defaultdict(int)
        self.seconds: dict[str, float] = defaultdict(float)
        self.last = self.found_by = ""
        self.stack: list[float] = []
        self.made: list[tuple[Any, str]] = []
        self.known: dict[str, float] = {}
        self.finder: dict[str, str] = {}

    def watched(self, name: str, rule: Callable) -> Callable:
        """The rule, counted."""

        @wraps(rule)
        def reported(*given: Any, **options: Any) -> Any:
            if name in KINDS and given[-1].kind != name:
                return rule(*given, **options)
            pool = next((each for each in given if isinstance(each, HypothesisPool)), None)
            before, started = pool and best(pool), time.process_time()
            self.tried[name] += 1
            self.stack.append(0.0)
            found = None
            try:
                found = rule(*given, **options)
                return found
            finally:
                took = time.process_time() - started
                self.seconds[name] += took - self.stack.pop()
                if self.stack:
                    self.stack[-1] += took
                if pool is None and not any(found is each for each in given):
                    self.made.append((found, name))
                if pool is not None:
                    self.seen(pool, name)
                    if best(pool) != before and self.last != best(pool):
                        self.better[name] += 1
                        self.last, self.found_by = best(pool), name

        return reported

    def seen(self, pool: HypothesisPool, name: str) -> None:
        """What is new in the pool is this rule's find, or that of a rule within it that made it."""
        for key, cause in pool.pool.items():
            if self.known.get(key) != cause.log_evidence:
                self.known[key] = cause.log_evidence
                self.finder[key] = next((rule for made, rule in self.made if made is cause), name)


def without_it(name: str, rule: Callable) -> Callable:
    """What stands in for a rule that is gone."""
    if name not in KINDS:
        return lambda *_, **__: None
    return lambda *given: None if given[-1].kind == name else rule(*given)


def filed(case: Path) -> tuple[DiagnosisProblem, tuple[str, ...]]:
    """The problem of a case in a folder, and effects to leave out."""
    public = json.loads((case / "case.json").read_text())
    body = Body.from_toml(case / "body.toml")
    recording = read_keypoint_csv(case / "recording.csv", joints=body.joint_names)
    return diagnosis_problem(recording, body, passive=public["regime"] == "passive"), tuple(public["without"])


def best(pool: HypothesisPool) -> str:
    """The best cause, by key and evidence."""
    first = pool.best
    return f"{first.key} {first.log_evidence:.2f}"


def searched(bound: DiagnosisProblem, left_out: tuple[str, ...], without: str) -> dict:
    """One search, watched or without a rule."""
    watch, kept = Watch(), {}
    for name, (module, _) in RULES.items():
        room, called = import_module(ROOMS + module), "_follow" if name in KINDS else name
        rule = getattr(room, called)
        kept.setdefault(called, (room, rule))
        setattr(room, called, without_it(name, rule) if name == without else watch.watched(name, rule))
    started = time.process_time()
    try:
        found = search_problem(bound, left_out, 1)
    finally:
        for name, (room, rule) in kept.items():
            setattr(room, name, rule)
    first = found.best
    rivals = [cause for cause in found.ranked if found.score(cause) > found.score(first) - NEAR]
    return {
        "best": first.key,
        "score": float(found.score(first)),
        "evidence": first.log_evidence,
        "complete": first.complete,
        "seconds": time.process_time() - started,
        "tried": watch.tried,
        "better": watch.better,
        "spent": watch.seconds,
        "found_by": watch.finder.get(first.key, ""),
        "near": sorted({watch.finder.get(cause.key, "") for cause in rivals}),
    }


def rate(k: int, n: int) -> str:
    """A rate with its interval."""
    low, high = beta.ppf([0.05, 0.95], k + 0.5, n - k + 0.5)
    return f"{k}/{n} ({0.0 if k == 0 else low:.2f}–{1.0 if k == n else high:.2f})"


def has_a_say(run: dict, rule: str) -> bool:
    """Whether the best or a near rival is a rule's find."""
    return rule in (run["found_by"], *run["near"])


def table(out: Path) -> str:
    """What each rule did in the watched searches, and the loss without it."""
    runs = {path.stem: json.loads(path.read_text()) for path in sorted(out.glob("*.json"))}
    rows = [
        ("rule", "what it does", "tried", "share of the time", "found a better best", "has a say", "lost without it")
    ]
    rows.append(("---",) * len(rows[0]))
    for name, (_, what) in RULES.items():
        tried, better = (sum(run[each].get(name, 0) for run in runs.values()) for each in ("tried", "better"))
        share = sum(run["spent"].get(name, 0.0) for run in runs.values()) / sum(run["seconds"] for run in runs.values())
        said = rate(sum(has_a_say(run, name) for run in runs.values()), len(runs))
        less = {path.stem: json.loads(path.read_text()) for path in sorted(out.glob(f"without-{name}/*.json"))}
        missing = ", ".join(f"{runs[case]['score'] - run['score']:.1f}" for case, run in less.items()) or "–"
        rows.append((f"`{name}`", what, str(tried), f"{share:.2f}", str(better), said, missing))
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--cases", type=Path, default=Path("build/ablation_cases"))
    arguments.add_argument("--out", type=Path, default=Path("build/ablation_mujoco"))
    arguments.add_argument("--without", choices=RULES, default="")
    arguments.add_argument("--tried", action="store_true")
    arguments.add_argument("--only", default="")
    asked = arguments.parse_args()
    cases = sorted(path.parent for path in asked.cases.glob("*/answer.json"))
    folder = asked.out / f"without-{asked.without}" if asked.without else asked.out
    folder.mkdir(parents=True, exist_ok=True)
    for case in cases:
        there, whole = folder / f"{case.name}.json", asked.out / f"{case.name}.json"
        wanted = not asked.only or case.name in asked.only.split(",")
        if asked.without and wanted:
            run = json.loads(whole.read_text()) if whole.exists() else {"tried": {}, "found_by": "", "near": ()}
            wanted = has_a_say(run, asked.without) or (asked.tried and run["tried"].get(asked.without, 0) > 0)
        if wanted and not there.exists():
            there.write_text(json.dumps(searched(*filed(case), asked.without)))
            found = json.loads(there.read_text())
            print(f"{case.name}: {found['best']}, {found['score']:.1f}, {found['seconds']:.1f} s", flush=True)
    print(table(asked.out))


if __name__ == "__main__":
    main()
