"""Pages that the site's build writes from the code: what each effect's entry says."""

import importlib.util
import re
import unicodedata

import numpy as np
import pytest
from pages import ROOT

from invdyn.models.effects import EFFECTS


@pytest.fixture(scope="module")
def script():
    spec = importlib.util.spec_from_file_location("reference_pages", ROOT / "docs" / "reference_pages.py")
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    return script


@pytest.fixture(scope="module")
def entries(script):
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


def test_a_picture_shows_the_effect_of_the_formula(script):
    """A camera's roll has a mean of 0 and no quantiles written down; a gain has another form, a forgotten gear."""
    for name, least, most in (("camera_roll", 2e-3, 2e-2), ("actuator_gain", 1e-2, 0.2)):
        apart = np.abs(script._seen(script.arm_with(EFFECTS[name])) - script.ideal_path())
        assert least < apart.max() < most, name
        assert script.at_last_place(EFFECTS[name]).form is None
