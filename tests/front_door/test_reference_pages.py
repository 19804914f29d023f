"""Pages that the site's build writes from the code: what each effect's entry says."""

import importlib.util
import re
import unicodedata

import pytest
from pages import ROOT

from invdyn.models.effects import EFFECTS


@pytest.fixture(scope="module")
def entries():
    spec = importlib.util.spec_from_file_location("reference_pages", ROOT / "docs" / "reference_pages.py")
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    return dict(part.split("\n", 1) for part in script.effects_page(None).split("\n## ")[1:])


def is_formula(letter: str) -> bool:
    """A sign such as −, = or ±, or a Greek letter."""
    return unicodedata.category(letter) == "Sm" or "GREEK" in unicodedata.name(letter, "")


@pytest.mark.parametrize("name", EFFECTS)
def test_an_entry_has_a_formula_parameters_and_what_brings_it_out(entries, name):
    first = entries[name].strip().split("\n\n")[0]
    formula = first.removeprefix(first[: first.index(". ")])
    assert any(map(is_formula, formula)), f"{name}.py: its first line should hold a formula, got {formula!r}"
    assert re.search(r"\| `\w+` \| \S+", entries[name])
    assert "Brought out by " in entries[name]


def test_prose_is_no_formula():
    assert not any(map(is_formula, "A camera that isn't level, 3 degrees (or so): turned about the frame's origin."))
