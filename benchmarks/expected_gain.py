"""How far a refinement gets beyond the screen: the numbers behind :func:`invdyn.diagnosis.hypotheses.pool.needed`.

Of every development case (``benchmarks/development.py make``) with known torques, the ``MOST`` best of the screen are
refined together with "no effect", then those together with the best single effect found, for any promised gain. With s
nats that a candidate gains over its base in the screen and r by its refinement, the table has quantiles of r − s by s,
and by what the base leaves. The line below it says what share of the candidates that end within ``NEAR`` nats of the
best one the rule would have refined. One file a case; continues where it ended.

    python benchmarks/expected_gain.py --cases CASES --out MEASURED
"""

import argparse
import json
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
from ablation import filed

from invdyn.diagnosis.hypotheses.add import _refined, screened_with
from invdyn.diagnosis.hypotheses.continuation import data_path
from invdyn.diagnosis.hypotheses.laws import finely_stepped
from invdyn.diagnosis.hypotheses.pool import considered, needed
from invdyn.diagnosis.hypotheses.search import _initial_pool
from invdyn.diagnosis.sensitivity.screen import added
from invdyn.models.divergence import diverging

MOST, NEAR = 20, 10.0
EDGES = (-np.inf, 0.0, 5.0, 20.0, 60.0, 200.0, 1000.0, np.inf)
"""Nats in the screen between which candidates are counted together."""


def measured(case: Path) -> list[dict]:
    """Of each of the two bases: key, whether it leaves nothing, and its candidates' gains, best of the screen first."""
    bound, left_out = filed(case)
    rows = []
    with diverging():
        path, outlier = data_path(bound)
        bound = finely_stepped(bound.shaped(path), path)
        found = _initial_pool(bound, path, outlier, considered(bound, left_out), 1)
        base = found.pool[""]
        for _ in range(2):
            best = screened_with(found, base)
            nothing = next(s.log_evidence for s in best if s.effect is None)
            row: dict = {"base": base.key, "complete": base.complete, "cands": []}
            for each in added(best)[:MOST]:
                started = time.process_time()
                causes = [cause for cause in _refined(bound, base, each, {}) if cause is not None]
                for cause in causes:
                    found.add(cause)
                top = max((cause.log_evidence for cause in causes), default=None)
                row["cands"].append(
                    {
                        "key": each.effect.key,
                        "s": each.log_evidence - nothing,
                        "r": None if top is None else top - base.log_evidence,
                        "done": any(cause.complete for cause in causes),
                        "plaus": [bool(cause.plausible) for cause in causes],
                        "cpu": time.process_time() - started,
                    }
                )
            rows.append(row)
            singles = [cause for cause in found.pool.values() if len(cause.effects) == 1]
            if not singles:
                break
            base = max(singles, key=found.score)
    return rows


def table(rows: list[dict]) -> str:
    """Quantiles of r − s, and of r/s where there is something to gain."""
    lines = [
        ("base", "s, nats", "candidates", "r − s: .05", ".5", ".95", ".99", "r/s: .5", ".95", ".99"),
        ("---",) * 10,
    ]
    for complete, what in ((False, "leaves something"), (True, "leaves nothing")):
        mine = [row for row in rows if (row["complete"] and bool(row["base"])) is complete]
        gains = [(c["s"], c["r"]) for row in mine for c in row["cands"] if c["r"] is not None]
        for low, high in pairwise(EDGES):
            here = np.array([(s, r) for s, r in gains if low <= s < high])
            if not len(here):
                continue
            off = np.quantile(here[:, 1] - here[:, 0], (0.05, 0.5, 0.95, 0.99))
            times = np.quantile(here[:, 1] / here[:, 0], (0.5, 0.95, 0.99)) if low >= 5 else ()
            between = (
                f"under {high:g}" if np.isinf(low) else f"{low:g} and more" if np.isinf(high) else f"{low:g}–{high:g}"
            )
            reported = [f"{value:.1f}" for value in (*off, *times)] + [""] * (3 - len(times))
            lines.append((what, between, str(len(here)), *reported))
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def kept(rows: list[dict]) -> str:
    """Of candidates that end near the best one, the share that the rule refines."""
    near = []
    for row in rows:
        some = [c for c in row["cands"] if c["r"] is not None and all(c["plaus"])]
        top, most = max((c["r"] for c in some), default=0.0), max((c["s"] for c in row["cands"]), default=0.0)
        explained = any(c["done"] and c["r"] > top - NEAR for c in some)
        least = needed(most, explained=explained)
        near += [c["s"] >= least for c in some if c["r"] > max(top - NEAR, NEAR)]
    return f"Of {len(near)} candidates that end within {NEAR:g} nats of the best one, {sum(near)} are refined."


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--cases", type=Path, default=Path("build/ablation_cases"))
    arguments.add_argument("--out", type=Path, default=Path("build/expected_gain"))
    arguments.add_argument("--only", default="", help="cases of these kinds")
    given = arguments.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    for case in sorted(path.parent for path in given.cases.glob("*/answer.json")):
        there, kind = given.out / f"{case.name}.json", case.name.rpartition("-")[0]
        known = json.loads((case / "case.json").read_text())["regime"] in ("commanded", "passive")
        if there.exists() or not known or (given.only and kind not in given.only.split(",")):
            continue
        there.write_text(json.dumps({"rows": measured(case)}))
        print(case.name, flush=True)
    rows = [row for path in sorted(given.out.glob("*.json")) for row in json.loads(path.read_text())["rows"]]
    print(table(rows))
    print()
    print(kept(rows))


if __name__ == "__main__":
    main()
