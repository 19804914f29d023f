"""Runs of the blind check side by side: every measure that has a target, run by run.

What `invdyn blind` left in each folder (scores.json), as the table of docs/blind_runs.md.

python benchmarks/blind_runs.py FOLDER [FOLDER …]
"""

import argparse
import json
from pathlib import Path

KINDS = {
    "commanded": "commanded",
    "none": "no effect",
    "passive": "passive",
    "weak": "a quarter of the size",
    "two": "two at once",
    "unknown_torque": "unknown torque",
    "outside": "outside the catalogue",
    "leave_one_out": "struck from the catalogue",
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
    runs = [json.loads((folder / "scores.json").read_text()) for folder in arguments.parse_args().folders]
    seeds = [str(run["about"]["seed"]) for run in runs]
    print("| kind | measure | aimed at | " + " | ".join(f"seed {seed}" for seed in seeds) + " |")
    print("|---" * (3 + len(runs)) + "|")
    for kind, said in KINDS.items():
        for measure in runs[-1]["measures"].get(kind, []):
            if measure["target"] or (kind, measure["name"]) in UNTOLD:
                cells = [_cell(run["measures"].get(kind, []), measure["name"]) for run in runs]
                print(f"| {said} | {measure['name']} | {measure['target'] or ''} | " + " | ".join(cells) + " |")


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
