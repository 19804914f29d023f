"""All methods on simulated, robot and human arms, side by side: the table of docs/methods.md.

    simulated   the paper's planar arm (200 rows, .03 s, keypoints to .22 m), its own parameters known
    short       its first 25 rows, which NUTS can be waited for
    film        the DFKI robot's pixels, torque hidden, parameters fitted, up to 4.4 s (132 frames; then its controller
                chatters as no camera could show); truth: its motors' torque less friction, as in sensor_cases.py
    human       the paper's human arm, frames 50 to 250, parameters and lengths fitted; no truth

Columns as :mod:`invdyn.inference.compare` has them; the log score is over the last fifth of the rows, with parameters
fitted without it, where they are fitted. Scores of torques are shoulder / elbow.

    INVDYN_DATA=… python benchmarks/ranking.py                      the tables, and benchmarks/ranking.md
    --recordings simulated,short   --methods smc,svi   --keep ranking.json       go on from what it holds
"""

import argparse
import json
import math
from importlib.resources import files
from pathlib import Path

import torch

from invdyn.inference import compare
from invdyn.inputs import load_recording
from invdyn.models import Body
from invdyn.simulate import PAPER, paper_arm, record

METHODS = (
    "smc",
    "bootstrap",
    "vsmc",
    "particle-gibbs",
    "nuts",
    "laplace",
    "svi-markov",
    "svi",
    "differentiate",
)
BODIES = files("invdyn.models") / "bodies"
CALM = 132  # frames of the film before the chatter
POINT = "differentiate"  # states one path, so that it has no intervals to cover anything
IN_SHORT = ("simulated", "film", "human")  # recordings of the short table, which docs/methods.md has
TABLE = Path(__file__).with_name("ranking.md")
HEAD = """Written by `python benchmarks/ranking.py`; what the recordings are is at the top of that file. N·m, shoulder /
elbow; CRPS, the smaller the better; log score in nats a held-out row, the larger the better. Seconds are wall time on
one thread of a machine that other jobs shared, without the fit of the parameters, which all methods have in common.
NUTS takes at most 100 rows, so it runs on the short recording alone. A point has no intervals: `differentiate` has
no coverage, and its CRPS is its mean absolute error. `≥` is a lower bound, `≈` an approximation; where fewer than 2
of the 64 filters count, the evidence is that of one lucky filter."""


def simulated(rows: int) -> tuple:
    """Recording, body, and what else `compare` takes."""
    body = Body.from_toml(BODIES / "paper_planar_arm.toml")
    recording, truth = record(paper_arm(body), seed=4)
    return recording.select(0, rows), body, {"truth": truth.at(recording.time[:rows]), **PAPER}


def film() -> tuple:
    from sensor_cases import film as case

    found = case()
    recording = found.recording.select(0, CALM)
    return recording, found.body, {"truth": found.truth.at(recording.time), "hide_torque": True}


def human() -> tuple:
    body = Body.from_toml(BODIES / "human_arm_on_table.toml")
    recording = load_recording("human-arm", body, scale="body").select(50, 250)
    return recording, body, {"learn_lengths": True}


RECORDINGS = {"simulated": lambda: simulated(200), "short": lambda: simulated(25), "film": film, "human": human}


def measure(name: str, methods: list[str], seed: int) -> dict:
    """`Comparison.to_dict` of one recording, methods that fail with their reason."""
    recording, body, options = RECORDINGS[name]()
    methods = [method for method in methods if method != "nuts" or recording.num_frames <= 100]
    return compare(recording, body, methods, seed=seed, **options).to_dict()


def pair(method: str, row: dict, score: str, digits: int) -> str:
    """A torque's score, shoulder / elbow; none where there is no truth, or no interval."""
    values = [row.get(f"{joint}_{score}") for joint in ("shoulder", "elbow")]
    if None in values or (method == POINT and "coverage" in score):
        return ""
    return " / ".join(f"{value:.{digits}f}" for value in values)


def evidence(row: dict) -> str:
    value, sd = row["log_evidence"], row["log_evidence_sd"]
    if value is None:
        return ""
    sign = {"bound": "≥ ", "approximation": "≈ "}.get(row["evidence_kind"], "")
    error = f" ± {sd:.2g}" if sd is not None and math.isfinite(sd) and not sign else ""
    if row["outer_ess"] is not None and row["outer_ess"] < 2:
        error = " (one filter's)"  # whose error one filter cannot tell
    return f"{sign}{value:.{2 if abs(value) < 1e4 else 0}f}{error}".replace("-", "−")


def number(value: float | None, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}f}".replace("-", "−")


def long_table(found: dict[str, dict]) -> str:
    """One row a recording and method, with everything."""
    lines = [
        "| recording | method | RMSE | CRPS | 50 % covers | 90 % covers | log score | log evidence | outer ESS | s |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for name, comparison in found.items():
        for method, row in comparison["methods"].items():
            if row.get("failure"):
                lines.append(f"| {name} | {method} | {row['failure']} |" + " |" * 7)
                continue
            cells = [pair(method, row, score, 2 if "cov" in score or name != "film" else 3) for score in SCORES]
            cells += [number(row["log_score"], 3), evidence(row), number(row["outer_ess"], 1)]
            cells.append(number(row["seconds"], 2 if row["seconds"] < 1 else 0))
            lines.append(f"| {name} | {method} | {' | '.join(cells)} |")
    return "\n".join(lines)


SCORES = ("rmse", "crps", "coverage_50", "coverage_90")


def short_table(found: dict[str, dict]) -> str:
    """One row a method: CRPS and coverage where the truth is known, log score and seconds of each recording."""
    titles, columns = [], []
    for name in IN_SHORT:
        if name not in found:
            continue
        rows = found[name]["methods"]
        if any("shoulder_crps" in row for row in rows.values()):
            digits = 3 if name == "film" else 2
            titles += [f"{name}: CRPS", "90 % covers"]
            columns += [{m: pair(m, row, "crps", digits) for m, row in rows.items()}]
            columns += [{m: pair(m, row, "coverage_90", 2) for m, row in rows.items()}]
            titles.append("log score")
        else:
            titles.append(f"{name}: log score")
        columns.append({m: number(row["log_score"], 2) for m, row in rows.items()})
        titles.append("s")
        columns.append({m: number(row["seconds"], 1 if row["seconds"] < 1 else 0) for m, row in rows.items()})
    methods = [m for m in METHODS if any(m in column for column in columns)]
    lines = ["| method | " + " | ".join(titles) + " |", "|---" * (len(titles) + 1) + "|"]
    lines += ["| " + " | ".join([m, *(column.get(m, "") for column in columns)]) + " |" for m in methods]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--recordings", default=",".join(RECORDINGS), help="comma-separated")
    parser.add_argument("--methods", default=",".join(METHODS), help="comma-separated")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, help="JSON file that keeps the scores")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    wanted, methods = arguments.recordings.split(","), arguments.methods.split(",")
    kept = json.loads(arguments.keep.read_text()) if arguments.keep and arguments.keep.exists() else {}
    for name in wanted:
        if name not in kept:
            kept[name] = measure(name, methods, arguments.seed)
            if arguments.keep:
                arguments.keep.write_text(json.dumps(kept, indent=1))
    found = {name: kept[name] for name in wanted}
    text = f"{long_table(found)}\n\nIn short:\n\n{short_table(found)}\n\n"
    text += "".join(f"- {name}, {method}: {note}\n" for name in found for method, note in found[name]["notes"].items())
    print(text)
    TABLE.write_text(f"# Ranking\n\n{HEAD}\n\n{text}", encoding="utf-8")


if __name__ == "__main__":
    main()
