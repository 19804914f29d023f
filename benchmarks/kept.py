"""Results of a long benchmark, a line of JSON a case: a stop loses nothing, and the same call continues."""

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).parents[1]


def kept(file: Path | None, case: str, make: Callable[[], dict]) -> dict:
    """What ``make`` gives of a case, taken from ``file`` where it is there, else made and added; None keeps nothing."""
    if file is None:
        return make()
    known = file.read_text("utf-8").splitlines() if file.exists() else []
    for row in map(json.loads, known):
        if row["case"] == case:
            return row["result"]
    result = make()
    file.parent.mkdir(parents=True, exist_ok=True)
    with file.open("a", encoding="utf-8") as lines:
        lines.write(json.dumps({"case": case, "commit": commit(), "result": result}) + "\n")
    return result


def commit() -> str:
    """Short name of the code's commit; empty where git has none."""
    command = ["git", "-C", str(ROOT), "rev-parse", "--short", "HEAD"]
    return subprocess.run(command, capture_output=True, text=True).stdout.strip()
