"""Write numbers.md: every number of the registry (:mod:`invdyn.diagnosis.rules`), and the files in which it acts.

python docs/numbers_page.py
"""

import ast
from collections import defaultdict
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
other ones as an argument: `diagnose(recording, body, rules=Rules().replace(tolerance=0.02))`.
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
    """By name of a number, the files of the diagnosis that read it."""
    found = defaultdict(list)
    for path in sorted((ROOT / "diagnosis").rglob("*.py")):
        if path.name != "rules.py":
            tree = ast.parse(path.read_text("utf-8"))
            for name in sorted({node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute)}):
                found[name].append(path.stem)
    return found


def _written(value: Any) -> str:
    return ", ".join(map(_written, value)) if isinstance(value, tuple) else f"{value:.4g}"


if __name__ == "__main__":
    (ROOT / "docs" / "numbers.md").write_text(page(), "utf-8")
