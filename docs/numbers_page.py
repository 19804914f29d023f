"""Write numbers.md: every number of the registry (:mod:`invdyn.diagnosis.rules`), and the files in which it acts.

python docs/numbers_page.py
"""

import ast
from collections import Counter, defaultdict
from pathlib import Path
from typing import Any

from invdyn.diagnosis.rules import COLUMNS, numbers

ROOT = Path(__file__).parents[1]
TITLES = {
    "evidence": "Evidence: `rules.evidence`",
    "residual": "Residual torque and errors: `rules.residual`",
    "recording": "Rows of a recording: `rules.recording`",
    "screening": "Screening: `rules.screening`",
    "search": "Search: `rules.search`",
    "descent": "Refinement: `rules.descent`",
    "outcome": "SMC, held-out rows, places, formulas: `rules.outcome`",
    "check": "Mistakes in a log: `rules.check`",
    "fixed": "Fixed: no run changes them",
}
HEAD = """# The numbers of a diagnosis

Written by `python docs/numbers_page.py` from [rules.py](../diagnosis/rules.py), which explains the sources. A run takes
other ones as an argument: `diagnose(recording, body, rules=Rules().replace(min_dprime=4))`, with `Rules` of
`invdyn.diagnosis`. For `tolerance` and `robot_tolerance` there is also `diagnose(recording, body, tolerance=0.02)`, or
`--set tolerance=0.02` on the command line: either takes the place of both. "Acts in" names files of `diagnosis/`, with
their folder where two have one name, and files of `invdyn/`.
"""


def page() -> str:
    """The page as Markdown: a table for each group."""
    acts = _where()
    text = HEAD
    groups: dict[str, list] = defaultdict(list)
    for group, each in numbers():
        groups[group].append(each)
    for group, every in groups.items():
        text += f"\n## {TITLES[group]}\n\n| name | value | {' | '.join(COLUMNS)} | acts in |\n"
        text += f"|{'---|' * (len(COLUMNS) + 3)}\n"
        for each in every:
            described = " | ".join(each.metadata[what] for what in COLUMNS)
            text += f"| `{each.name}` | {_written(each.default)} | {described} | {', '.join(acts[each.name])} |\n"
    return text


def _where() -> dict[str, list[str]]:
    """By name of a number, the files that read it, of the diagnosis and of the front door; see the page's head."""
    found = defaultdict(list)
    room, door = ROOT / "diagnosis", (ROOT / "invdyn").glob("*.py")
    readers = [path for path in sorted(door) if "invdyn.diagnosis.rules" in path.read_text("utf-8")]
    paths = [*sorted(room.rglob("*.py")), *readers]
    names = Counter(path.stem for path in paths)
    for path in paths:
        if path.name != "rules.py":
            full = path.relative_to(ROOT if path in readers else room).with_suffix("").as_posix()
            file = full if names[path.stem] > 1 or path in readers else path.stem
            tree = ast.parse(path.read_text("utf-8"))
            for name in sorted({node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute)}):
                found[name].append(file)
    return found


def _written(value: Any) -> str:
    return ", ".join(map(_written, value)) if isinstance(value, tuple) else f"{value:.4g}"


if __name__ == "__main__":
    (ROOT / "docs" / "numbers.md").write_text(page(), "utf-8")
