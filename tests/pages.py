"""The pages of the repository, their fenced blocks and the commands in them; scripts that stand in no package."""

import importlib.util
import re
import sys
from pathlib import Path
from typing import Any
from unittest.mock import patch

ROOT = Path(__file__).parents[1]


def script(path: str) -> Any:
    """The module of a script of the repository, such as "docs/sentences.py", which may import those of its folder."""
    spec = importlib.util.spec_from_file_location(Path(path).stem, ROOT / path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    with patch.object(sys, "path", [str((ROOT / path).parent), *sys.path]):
        spec.loader.exec_module(module)
    return module


WRITTEN = script("docs/sentences.py").WRITTEN
PAGES = [
    page
    for page in sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "benchmarks").glob("*.md")])
    if not str(page.relative_to(ROOT)).startswith(WRITTEN)
]
GUIDES = sorted((ROOT / "docs" / "how-to").glob("*.md"))
FENCE = re.compile(r"^```([^\n]*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)


def blocks(page: Path, language: str) -> list[str]:
    """Contents of the fenced blocks of a language ("" for none)."""
    return [block for said, block in FENCE.findall(page.read_text("utf-8")) if said == language]


def languages(page: Path) -> set[str]:
    """What the fences of a page say; directives of the site's generator are in braces."""
    return {said for said, _ in FENCE.findall(page.read_text("utf-8"))}


def commands(page: Path) -> list[str]:
    """Its lines that call invdyn, continued lines joined."""
    lines = [line for block in blocks(page, "") for line in block.replace("\\\n", " ").splitlines()]
    return [line for line in lines if line.startswith("invdyn ")]
