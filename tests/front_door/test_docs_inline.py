"""What pages and notebooks tell a reader to type next to blocks of commands: make, pip, scripts, words in a sentence.

They are not run here: some take hours. But each names a script, a target, an extra or an option that is there.
"""

import re
import shlex
import tomllib
from pathlib import Path

import jupytext
import pytest
import typer.main
from pages import FENCE, PAGES, ROOT, blocks

from invdyn.cli import app
from invdyn.renamed_options import RENAMED, SETTINGS

GROUP = typer.main.get_command(app)
COMMANDS = GROUP.commands
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["optional-dependencies"]
TARGETS = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE)
SHELL = {"python3 -m venv .venv", ". .venv/bin/activate"}
"""What the README's test environment is made by."""
NOTEBOOKS = sorted((ROOT / "notebooks").glob("[0-9]*.py"))


def text(page: Path) -> str:
    """A page, or what is written between a notebook's cells."""
    if page.suffix == ".md":
        return page.read_text("utf-8")
    return "\n\n".join(cell.source for cell in jupytext.read(page).cells if cell.cell_type == "markdown")


def spans(page: Path) -> list[str]:
    """Code within the sentences and tables of a page, without its blocks."""
    return [" ".join(span.split()) for span in re.findall(r"(?<!`)`([^`]+)`(?!`)", FENCE.sub("", text(page)))]


def options(words: list[str]) -> set[str]:
    """Those of a command's words that are long options."""
    return {word.split("=")[0] for word in words if re.match(r"--\w", word)}


def source(script: Path) -> str:
    """A script, and those next to it that it imports: one may take its options from another."""
    own = script.read_text("utf-8")
    others = [script.parent / f"{name}.py" for name in re.findall(r"^(?:from|import) (\w+)", own, re.MULTILINE)]
    return own + "".join(each.read_text("utf-8") for each in others if each.exists())


def is_there(line: str) -> bool:
    """Whether a command names what there is; a line of another kind counts as nothing that there is."""
    words = shlex.split(line, comments=True)
    match words:
        case ["invdyn", name, *rest] if re.fullmatch(r"[a-z]+", name):
            known = {option for param in COMMANDS[name].params for option in (*param.opts, *param.secondary_opts)}
            # A page of an earlier version has names of then.
            return options(rest) <= {*known, "--help", *RENAMED, *(f"--{setting}" for setting in SETTINGS)}
        case ["invdyn", *rest]:
            return options(rest) <= {option for param in GROUP.params for option in param.opts}
        case ["make", target, *_]:
            return target in TARGETS
        case ["python", "-m", "pip", "install", *rest] | ["pip", "install", *rest]:
            wanted = [extra for word in rest for group in re.findall(r"\[(.*)\]", word) for extra in group.split(",")]
            return bool(wanted) and set(wanted) <= set(EXTRAS)
        case ["python", script, *rest] if script.endswith(".py"):
            names = {option.replace("--no-", "--") for option in options(rest)}  # --no-x of a flag --x
            return all(f'"{name}"' in source(ROOT / script) for name in names)
        case ["pytest", place, *_] if place.startswith("tests/"):
            return (ROOT / place).exists()
    return False


def test_what_is_not_there_is_reported():
    for line in ("make nothing", "pip install 'invdyn[nothing]'", "python benchmarks/cost.py --nothing", "ls"):
        assert not is_there(line)
    with pytest.raises(KeyError):
        is_there("invdyn nothing")


@pytest.mark.parametrize("page", [*PAGES, *NOTEBOOKS], ids=lambda page: page.name)
def test_a_block_without_a_language_holds_commands(page):
    """Of ours, or what sets them up; tables of files and words of others say `text`."""
    untagged = blocks(page, "") if page.suffix == ".md" else [b for said, b in FENCE.findall(text(page)) if not said]
    lines = [line for block in untagged for line in block.replace("\\\n", " ").splitlines() if line.strip()]
    assert [line for line in lines if line not in SHELL and not is_there(line)] == []


@pytest.mark.parametrize("page", [*PAGES, *NOTEBOOKS], ids=lambda page: page.name)
def test_a_command_in_a_sentence_names_what_there_is(page):
    kinds = ("invdyn ", "make ", "pip install 'invdyn", "pytest tests/")
    named = [span for span in spans(page) if span.startswith(kinds) or re.match(r"python \S+\.py", span)]
    assert [span for span in named if not is_there(span)] == []


def test_commands_are_found_in_sentences():
    assert sum(span.startswith(("invdyn ", "python benchmarks/")) for page in PAGES for span in spans(page)) > 50
