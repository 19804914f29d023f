"""Pages that the site's build writes from the code: what each effect's entry says."""

import re
import unicodedata

import numpy as np
import pytest
from pages import script

from invdyn.models.effects import EFFECTS


@pytest.fixture(scope="module")
def written():
    return script("docs/reference_pages.py")


@pytest.fixture(scope="module")
def entries(written):
    return dict(part.split("\n", 1) for part in written.effects_page(None).split("\n## ")[1:])


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
    assert not any(map(is_formula, "A camera that isn't level, 3 degrees (or so): rotated about the frame's origin."))


def test_a_picture_shows_the_effect_of_the_formula(written):
    """A camera's roll has a mean of 0 and no quantiles written down; a gain has another form, a forgotten gear."""
    for name, least, most in (("camera_roll", 2e-3, 2e-2), ("actuator_gain", 1e-2, 0.2)):
        apart = np.abs(written.simulated_keypoints(written.arm_with(EFFECTS[name])) - written.ideal_path())
        assert least < apart.max() < most, name
        assert written.at_last_place(EFFECTS[name]).form is None
