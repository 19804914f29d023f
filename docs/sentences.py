"""How long the sentences of README, site, docstrings, messages and help are: `python docs/sentences.py [--longest 40]`.

Prose alone counts: no code, tables, headings, formulas or pictures. A sentence ends at a full stop, a question mark or
an exclamation mark, with the paragraph, or with the item of a list. Words are what has a letter or a digit; code within
a sentence is one word.
"""

import argparse
import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from statistics import fmean
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
ROOMS = ("recordings", "models", "inference", "diagnosis", "blindcheck", "invdyn")
WRITTEN = ("docs/reference/cli.md", "docs/reference/effects.md", "docs/reference/api")
"""Pages that the site's build writes from the code."""
ERRORS = {"InputError", "BodyError", "warn", "fail"}

_NO_PROSE = re.compile(
    r"^```.*?^```[^\n]*$|^\$\$.*?\$\$|<!--.*?-->|^\|.*?$|^#.*?$|^!\[.*?\)$", re.DOTALL | re.MULTILINE
)
_LINK = re.compile(r"!?\[((?:[^\[\]]|\[[^\]]*\])*)\]\([^)]*\)")
_CODE = re.compile(r"``[^`]+``|:\w+:`[^`]+`|`[^`]+`|\$[^$]+\$")
_ITEM = re.compile(r"\n\s*(?:[-*]|\d+\.) ")
_END = re.compile(r"(?<=[.!?])(?<!e\.g\.)(?<!i\.e\.)[*)\"']*\s+(?=[\"'(*]*(?:[A-Z0-9`]|invdyn\b))")
_WORD = re.compile(r"[A-Za-z0-9_À-ÿ\u0370-\u03ff]")
_SECTION = re.compile(r"^(Args|Returns|Raises|Yields|Attributes|Source|Sources):$")


class Sentence(NamedTuple):
    """A sentence and where it stands."""

    place: str
    text: str

    @property
    def words(self) -> int:
        """How many words it has."""
        return sum(bool(_WORD.search(word)) for word in re.sub(r"[/=–—]", " ", self.text).split())


def sentences(text: str, place: str) -> Iterator[Sentence]:
    """Those of three words or more in Markdown or a docstring."""
    plain = _CODE.sub("Code", _LINK.sub(r"\1", _NO_PROSE.sub("\n\n", text)))
    for paragraph in re.split(r"\n\s*\n", _ITEM.sub("\n\n", plain)):
        for sentence in _END.split(" ".join(paragraph.split())):
            found = Sentence(place, sentence)
            if found.words > 2:
                yield found


def page(file: Path) -> list[Sentence]:
    """Those of a page."""
    return list(sentences(file.read_text("utf-8"), str(file.relative_to(ROOT))))


def site() -> list[Path]:
    """The pages of the site that are written by hand, the benchmarks' among them."""
    pages = [*sorted((ROOT / "docs").rglob("*.md")), ROOT / "CONTRIBUTING.md", ROOT / "benchmarks" / "README.md"]
    return [file for file in pages if not str(file.relative_to(ROOT)).startswith(WRITTEN)]


def notebooks() -> list[Sentence]:
    """Those of the notebooks' text."""
    found: list[Sentence] = []
    for file in sorted((ROOT / "notebooks").glob("*.py")):
        cells = re.findall(r"^# %% \[markdown\].*?\n((?:^#.*\n)*)", file.read_text("utf-8"), re.MULTILINE)
        text = "\n\n".join(re.sub(r"^# ?", "", cell, flags=re.MULTILINE) for cell in cells)
        found += sentences(text, str(file.relative_to(ROOT)))
    return found


@cache
def sources() -> list[tuple[str, ast.Module]]:
    """Every module of the rooms, parsed, by its place; a link into another room is not followed."""
    files = [file for room in ROOMS for file in sorted((ROOT / room).rglob("*.py"))]
    own = [file for file in files if not any(part.is_symlink() for part in file.parents)]
    return [(str(file.relative_to(ROOT)), ast.parse(file.read_text("utf-8"))) for file in own]


def docstrings() -> list[Sentence]:
    """Those of public docstrings; lines that are tables or formulas (indented, or in columns) are left out."""
    found: list[Sentence] = []
    for place, tree in sources():
        for node in _public(tree):
            name = getattr(node, "name", "")
            found += sentences(running_text(ast.get_docstring(node) or ""), f"{place} {name}".strip())
    return found


def running_text(docstring: str) -> str:
    """Without tables and formulas; what is said of one argument is a paragraph."""
    prose, section = [], False
    for line in docstring.splitlines():
        section = bool(_SECTION.match(line)) or (section and line.startswith("    "))
        if re.match(r"\s*\S.* {3,}\S", line) or (not section and line.startswith("    ")):
            prose.append("")
        else:
            prose += ["", line] if section and not line.startswith("     ") else [line]
    return "\n".join("" if _SECTION.match(line) else line for line in prose)


def _public(node: ast.AST) -> Iterator[ast.Module | ast.ClassDef | ast.FunctionDef]:
    if isinstance(node, ast.Module):
        yield node
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.ClassDef | ast.FunctionDef) and not child.name.startswith("_"):
            yield child
            if isinstance(child, ast.ClassDef):
                yield from _public(child)


def messages() -> list[Sentence]:
    """Those of errors and warnings; what is filled in is one word."""
    found: list[Sentence] = []
    for place, tree in sources():
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and node.args:
                name = getattr(node.func, "id", getattr(node.func, "attr", ""))
                if name in ERRORS:
                    found += sentences(_said(node.args[0]), f"{place}:{node.lineno}")
    return found


def help_texts() -> list[Sentence]:
    """Those of options' and arguments' help on the command line."""
    found: list[Sentence] = []
    for place, tree in sources():
        for node in ast.walk(tree) if place.startswith("invdyn") else ():
            if isinstance(node, ast.keyword) and node.arg == "help":
                found += sentences(_said(node.value), f"{place}:{node.value.lineno}")
    return found


def _said(node: ast.expr) -> str:
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(_said(value) if isinstance(value, ast.Constant) else "X" for value in node.values)
    return " ".join(_said(side) for side in (node.left, node.right)) if isinstance(node, ast.BinOp) else ""


def kinds() -> dict[str, list[Sentence]]:
    """All sentences, by where users meet them."""
    return {
        "README": page(ROOT / "README.md"),
        "site": [sentence for file in site() for sentence in page(file)],
        "notebooks": notebooks(),
        "docstrings": docstrings(),
        "messages": messages(),
        "help": help_texts(),
    }


def main() -> None:
    """Print a table of means, and the longest sentences if asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--longest", type=int, default=0, metavar="N", help="list the N longest of each kind")
    longest = parser.parse_args().longest
    print(f"README.md: {len((ROOT / 'README.md').read_text('utf-8').split())} words, code among them\n")
    print("| | sentences | words a sentence, mean | over 25 words |\n|---|---|---|---|")
    found = kinds()
    for kind, said in found.items():
        words = [sentence.words for sentence in said]
        print(f"| {kind} | {len(words)} | {fmean(words):.1f} | {sum(n > 25 for n in words)} |")
    for kind, said in found.items() if longest else ():
        print(f"\n{kind}")
        for sentence in sorted(said, key=lambda sentence: -sentence.words)[:longest]:
            print(f"{sentence.words:4d} {sentence.place}: {sentence.text}")


if __name__ == "__main__":
    main()
