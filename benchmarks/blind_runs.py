"""Runs of the blind check side by side: every measure that has a target, run by run.

What `invdyn blind` left in each folder (scores.json), as the table of docs/blind_runs.md. With `--together`
one more column scores all their cases as those of one run, which runs of one and the same code are. `--all` has
the measures without a target too, how well probabilities are calibrated, and how long a case took.

python benchmarks/blind_runs.py [--together] [--all] FOLDER [FOLDER …]
"""

import argparse
import json
from pathlib import Path

import numpy as np

from invdyn.blindcheck.score import score

KINDS = {
    "commanded": "commanded",
    "none": "no effect",
    "passive": "passive",
    "weak": "a quarter of the size",
    "two": "two at once",
    "unknown_torque": "unknown torque",
    "outside": "outside the catalogue",
    "leave_one_out": "struck from the catalogue",
    "as_real": "as real",
    "all": "all whose effects the catalogue has",
}
UNTOLD = {
    ("weak", "first answer right, by ambiguity set"),
    ("two", "at least one named, or said to be a part"),
    ("unknown_torque", "dynamics effects blamed on something else"),
}
"""Measures without a target that are shown all the same."""


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("folders", nargs="+", type=Path, metavar="FOLDER")
    arguments.add_argument("--together", action="store_true")
    arguments.add_argument("--all", action="store_true")
    given = arguments.parse_args()
    runs = [json.loads((folder / "scores.json").read_text()) for folder in given.folders]
    names = [f"seed {run['about']['seed']}" for run in runs]
    if given.together:
        runs.append(together(given.folders))
        names.append("together")
    print("| kind | measure | aimed at | " + " | ".join(names) + " |")
    print("|---" * (3 + len(runs)) + "|")
    for kind, said in KINDS.items():
        known = {m["name"]: m for run in runs for m in run["measures"].get(kind, [])}
        for measure in known.values():
            if given.all or measure["target"] or (kind, measure["name"]) in UNTOLD:
                cells = [_cell(run["measures"].get(kind, []), measure["name"]) for run in runs]
                print(f"| {said} | {measure['name']} | {measure['target'] or ''} | " + " | ".join(cells) + " |")
    if given.all:
        print()
        for name, run in zip(names, runs, strict=True):
            reliability(name, run["calibration"])
        for name, folder in zip(names, given.folders, strict=False):
            durations(name, folder)


def together(folders: list[Path]) -> dict:
    """The scores of all cases of several runs, as those of one."""
    answers, found = {}, {}
    for number, folder in enumerate(folders):
        for name, answer in json.loads((folder / "answers.json").read_text())["answers"].items():
            answers[f"{number}-{name}"] = answer
            if (said := folder / "diagnoses" / name / "diagnosis.json").exists():
                found[f"{number}-{name}"] = json.loads(said.read_text())
    return score(answers, found).to_json()


def reliability(name: str, calibrations: dict[str, dict]) -> None:
    """Print how often answers of a probability are right, kind by kind."""
    for kind, found in calibrations.items():
        if not found["bins"]:
            continue
        bins = " ".join(f"{b['probability']:.3f} → {b['right']:.3f} of {b['n']};" for b in found["bins"])
        print(f"{name}, {KINDS[kind]}: Brier {found['brier']:.4f}, ECE {found['ece']:.4f}; {bins}")


def durations(name: str, folder: Path) -> None:
    """Print quantiles of the seconds that cases took, kind by kind."""
    answers = json.loads((folder / "answers.json").read_text())["answers"]
    taken: dict[str, list[float]] = {kind: [] for kind in KINDS}
    for case, answer in answers.items():
        if (reported := folder / "diagnoses" / case / "took.json").exists():
            seconds = json.loads(reported.read_text())["seconds"]
            taken[answer["kind"]].append(seconds)
            taken["all"].append(seconds)
    for kind, seconds in taken.items():
        if seconds:
            middle, most, longest = np.quantile(seconds, [0.5, 0.9, 1.0])
            print(f"{name}, {KINDS[kind]}: {middle:.0f} s in the middle, nine in ten < {most:.0f} s, {longest:.0f} s")


def _cell(measures: list[dict], name: str) -> str:
    """Value and number of cases, bold where a target is missed; "–" where a run does not have it."""
    found = next((m for m in measures if m["name"] == name and m["value"] is not None), None)
    if found is None:
        return "–"
    value = f"{found['value']:.3f}".rstrip("0").rstrip(".").removeprefix("0") or "0"
    value = f"**{value}**" if found["met"] is False else value
    return f"{value} of {found['n']}"


if __name__ == "__main__":
    main()
