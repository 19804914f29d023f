"""Cases of development seeds, diagnosed in this process: small checks of a change before a run of the blind check.

The blind check's cases and judge (:mod:`invdyn.blindcheck`), on seeds below 10,000, which are there to be looked at.
Cases are made once; any version of the code then diagnoses the same files:

    python benchmarks/development.py make CASES --seed 7000 --kinds commanded=12,two=4,leave_one_out=4
    python benchmarks/development.py run CASES --out OLD       with one version of the code on the path
    python benchmarks/development.py run CASES --out NEW       with another; continues where it ended
    python benchmarks/development.py score CASES OLD NEW       rates with 90 % intervals, and where the two differ

What a search found is kept with ``--pools FOLDER``, and taken from there if it is known: what is decided afterwards is
then compared on the very same causes. They are pickles, which run code when they are read: keep them in a folder that
is yours alone, and read no other file. ``--only`` takes some of the cases.

Case n of a kind has seed + n, independently of the other kinds. Intervals are Jeffreys'. Seconds are those of the
processor.
"""

import argparse
import json
import pickle
import time
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import beta

from invdyn.blindcheck.cases import make_case
from invdyn.blindcheck.judge import OUTSIDE_KINDS, Verdict, judge
from invdyn.blindcheck.kinds import KINDS
from invdyn.blindcheck.worker import diagnose_case

stage: Any = import_module("invdyn.diagnosis.diagnose")
SEARCHED = stage.searched
MEASURES = ("by_set", "exact", "detected", "outside", "some", "side", "joint")


def make(folder: Path, seed: int, kinds: dict[str, int]) -> None:
    """Write ``kinds`` cases each, with their answers, into folders of their own."""
    for kind, count in kinds.items():
        for n in range(count):
            where = folder / f"{kind}-{n:02d}"
            if (where / "answer.json").exists():
                continue
            case = make_case(seed + n, kind)
            case.write(where)
            (where / "answer.json").write_text(json.dumps(case.answer))


def keep(pool: Path) -> None:
    """Have the next diagnosis take what its search found from a file, or leave it there."""

    def searched(*given: Any) -> Any:
        if pool.exists():
            return pickle.loads(pool.read_bytes())
        found = SEARCHED(*given)
        pool.parent.mkdir(parents=True, exist_ok=True)
        pool.write_bytes(pickle.dumps(found))
        return found

    stage.searched = searched


def run(folder: Path, out: Path, pools: Path | None, only: Sequence[str]) -> None:
    """Diagnose every case that ``out`` has no answer to."""
    for case in sorted(path.parent for path in folder.glob("*/answer.json")):
        there = out / case.name
        if (there / "seconds.json").exists() or (only and case.name not in only):
            continue
        if pools is not None:
            keep(pools / f"{case.name}.pickle")
        started = time.process_time()
        diagnose_case(case, there)
        (there / "seconds.json").write_text(json.dumps(time.process_time() - started))


def verdicts(folder: Path, out: Path) -> dict[str, Verdict]:
    """Judged, of the cases that were diagnosed."""
    found = {}
    for case in sorted(path.parent for path in folder.glob("*/answer.json")):
        said = out / case.name / "diagnosis.json"
        if said.exists():
            answer = json.loads((case / "answer.json").read_text())
            found[case.name] = judge(case.name, answer, json.loads(said.read_text()))
    return found


def rate(hits: Sequence[bool]) -> str:
    """A rate, with the 90 % interval of Jeffreys' prior."""
    n, k = len(hits), sum(hits)
    if not n:
        return "–"
    low, high = beta.ppf([0.05, 0.95], k + 0.5, n - k + 0.5)
    return f"{k}/{n} ({0.0 if k == 0 else low:.2f}–{1.0 if k == n else high:.2f})"


def score(folder: Path, outs: Sequence[Path]) -> None:
    """Print rates by kind, on the cases that all of ``outs`` have, and the cases on which they differ."""
    judged = [verdicts(folder, out) for out in outs]
    names = sorted(set.intersection(*(set(each) for each in judged)))
    for kind in KINDS:
        mine = [name for name in names if judged[0][name].kind == kind]
        for measure in MEASURES if mine else ():
            known = [[getattr(each[name], measure) for name in mine] for each in judged]
            asked = [all(values[i] is not None for values in known) for i in range(len(mine))]
            if measure == "outside" and kind not in OUTSIDE_KINDS:
                measure = "wrongly outside"
            cells = [rate([v for v, use in zip(values, asked, strict=True) if use]) for values in known]
            print(f"{kind:15s} {measure:15s} " + "   ".join(cells))
    fia = [float(np.mean([each[name].fia for name in names])) for each in judged]
    closed = [float(np.median([each[n].closed for n in names if each[n].closed is not None])) for each in judged]
    seconds = [[json.loads((out / name / "seconds.json").read_text()) for name in names] for out in outs]
    print(f"{len(names)} cases: probability on the truth {fia}; closed, median {closed}")
    print("seconds, median and sum", [(float(np.median(each)), float(np.sum(each))) for each in seconds])
    for name in names:
        rows = [each[name] for each in judged]
        if (
            len({(v.answer, v.by_set, v.outside) for v in rows}) > 1
            or max(v.fia for v in rows) - min(v.fia for v in rows) > 0.1
        ):
            print(
                f"{name} {rows[0].truth}: " + " | ".join(f"{v.answer} {v.probability:.3f} ({v.fia:.3f})" for v in rows)
            )


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("what", choices=("make", "run", "score"))
    arguments.add_argument("folder", type=Path)
    arguments.add_argument("outs", type=Path, nargs="*")
    arguments.add_argument("--out", type=Path)
    arguments.add_argument("--pools", type=Path)
    arguments.add_argument("--only", default="")
    arguments.add_argument("--seed", type=int, default=7000)
    arguments.add_argument("--kinds", default="commanded=12,none=3,passive=2,two=3,unknown_torque=2,leave_one_out=3")
    asked = arguments.parse_args()
    if asked.what == "make":
        make(asked.folder, asked.seed, {kind: int(n) for kind, n in (k.split("=") for k in asked.kinds.split(","))})
    elif asked.what == "run":
        run(asked.folder, asked.out, asked.pools, asked.only.split(",") if asked.only else ())
    else:
        score(asked.folder, asked.outs)


if __name__ == "__main__":
    main()
