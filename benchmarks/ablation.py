"""Which rules of the search are needed: what each added to the answer, and what removing it costs.

On cases of development seeds (``benchmarks/development.py make``). One search a case is watched: of every rule, how
often it was tried, in what share of the time, how often it found a better best cause, and in how many cases the final
one is its find. A rule that never found a better one has cost time alone, there. ``--without RULE`` searches once more
with that rule gone, and says where the best cause is another, and by how many nats.

    python benchmarks/ablation.py CASES --out WATCHED          one line a case, and the table; goes on where it ended
    python benchmarks/ablation.py CASES --out LESS --without reduce
    python benchmarks/ablation.py CASES --out WATCHED --table LESS
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

from invdyn.diagnosis.diagnose import _searched
from invdyn.diagnosis.hypotheses.pool import HypothesisPool
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.models import Body
from invdyn.recordings import read_keypoint_csv

ROOMS = "invdyn.diagnosis.hypotheses."
RULES = {
    "_mistaken": ("search", "what leaves stray detections comes first"),
    "_several": ("search", "sets of up to four as a whole, from a beam"),
    "_overtaken": ("search", "extend the best single effect, too"),
    "_without_older": ("search", "drop the older of two, look for another"),
    "shortened": ("search", "shorter sub-steps where a force jumps"),
    "refine_every": ("search", "every effect on what is seen, in the end"),
    "reduce": ("search", "leave effects out"),
    "exchange": ("search", "another effect in the place of one"),
    "refine_promising": ("forward_step", "the best of the screen"),
    "refine_clearing": ("forward_step", "those that would leave little to a small residual"),
    "refine_barred": ("forward_step", "those that gain less than a torque could"),
    "_refine_twins": ("moves", "exact twins"),
    "_refine_wider": ("moves", "what contains an effect"),
    "_refine_narrower": ("moves", "its special case"),
    "_refine_load": ("moves", "a payload for an error of the last link"),
    "_refine_bent": ("moves", "a bending link for soft tissue"),
    "refine_softer": ("moves", "the softer form"),
}
"""Function → the module that calls it, and what it does."""


class Watch:
    """What each rule did in one search; times are those of the processor, without those of rules within it."""

    def __init__(self) -> None:
        self.tried: dict[str, int] = defaultdict(int)
        self.better: dict[str, int] = defaultdict(int)
        self.seconds: dict[str, float] = defaultdict(float)
        self.last = self.found_by = ""
        self.stack: list[float] = []

    def watched(self, name: str, rule: Callable) -> Callable:
        """The rule, counted."""

        @wraps(rule)
        def told(*given: Any, **options: Any) -> Any:
            pool = next(each for each in given if isinstance(each, HypothesisPool))
            before, begun = best(pool), time.process_time()
            self.tried[name] += 1
            self.stack.append(0.0)
            try:
                return rule(*given, **options)
            finally:
                took = time.process_time() - begun
                self.seconds[name] += took - self.stack.pop()
                if self.stack:
                    self.stack[-1] += took
                if best(pool) != before and self.last != best(pool):
                    self.better[name] += 1
                    self.last, self.found_by = best(pool), name

        return told


def best(pool: HypothesisPool) -> str:
    """The best cause, by key and evidence."""
    first = pool.ranked[0]
    return f"{first.key} {first.log_evidence:.2f}"


def searched(case: Path, without: str) -> dict:
    """One search, watched or without a rule."""
    public = json.loads((case / "case.json").read_text())
    body = Body.from_toml(case / "body.toml")
    names = {"keypoints": body.keypoint_names, "joints": body.joint_names, "base": body.base_keypoint}
    bound = diagnosis_problem(
        read_keypoint_csv(case / "recording.csv", **names), body, passive=public["regime"] == "passive"
    )
    watch, kept = Watch(), {}
    for name, (module, _) in RULES.items():
        room = import_module(ROOMS + module)
        kept[name] = room, getattr(room, name)
        gone = name == without
        setattr(room, name, (lambda problem, *_: problem) if gone else watch.watched(name, kept[name][1]))
    begun = time.process_time()
    try:
        _, found = _searched(bound, tuple(public["without"]), 1)
    finally:
        for name, (room, rule) in kept.items():
            setattr(room, name, rule)
    first = found.ranked[0]
    return {
        "best": first.key,
        "score": float(found.score(first)),
        "evidence": first.log_evidence,
        "complete": first.complete,
        "seconds": time.process_time() - begun,
        "tried": watch.tried,
        "better": watch.better,
        "spent": watch.seconds,
        "found_by": watch.found_by,
    }


def table(runs: list[dict]) -> str:
    """What each rule did in the watched searches."""
    total = sum(run["seconds"] for run in runs)
    rows = [("rule", "what it does", "tried", "found a better best", "final best is its find", "share of the time")]
    rows.append(("---",) * len(rows[0]))
    for name, (_, what) in RULES.items():
        tried, better = (sum(run[each].get(name, 0) for run in runs) for each in ("tried", "better"))
        final = sum(run["found_by"] == name for run in runs)
        share = sum(run["spent"].get(name, 0.0) for run in runs) / total
        rows.append((f"`{name}`", what, str(tried), str(better), f"{final} of {len(runs)}", f"{share:.2f}"))
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("cases", type=Path)
    arguments.add_argument("--out", type=Path, required=True)
    arguments.add_argument("--without", choices=RULES, default="")
    arguments.add_argument("--only", default="")
    arguments.add_argument("--table", type=Path)
    asked = arguments.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    for case in sorted(path.parent for path in asked.cases.glob("*/answer.json")):
        there = asked.out / f"{case.name}.json"
        if asked.table is None and not there.exists() and (not asked.only or case.name in asked.only.split(",")):
            there.write_text(json.dumps(searched(case, asked.without)))
            print(case.name, json.loads(there.read_text())["best"], flush=True)
    runs = {path.stem: json.loads(path.read_text()) for path in sorted(asked.out.glob("*.json"))}
    if not asked.without:
        print(table(list(runs.values())))
    for path in sorted(asked.table.glob("*.json")) if asked.table else ():
        less, whole = json.loads(path.read_text()), runs[path.stem]
        print(f"{path.stem}: {whole['best']} → {less['best']}, {less['evidence'] - whole['evidence']:+.1f} nats")


if __name__ == "__main__":
    main()
