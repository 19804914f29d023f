"""Pages that the site's build writes from the code: what each effect's entry says."""

import re
import unicodedata
from pathlib import Path

import numpy as np
import pytest
from pages import script

from invdyn.diagnosis.catalogue import CATALOGUE
from invdyn.diagnosis.catalogue.engine_effects import EFFECTS as ENGINE
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


def test_a_table_says_which_effects_run_on_which_engine(written):
    """Six run on both; the guide says how many, and has MuJoCo's in their order."""
    rows = re.findall(r"^\| (\w+) \| (yes)? ?\| (yes)?", written.effects_page(None).split("\n## ")[0], re.M)
    arm, engine = ([name for name, *on in rows if on[k]] for k in (0, 1))
    assert arm == list(CATALOGUE)
    assert sorted(engine) == sorted(each.name for each in ENGINE)
    both = len(set(arm) & set(engine))
    guide = (Path(__file__).parents[2] / "docs" / "how-to" / "wrong_contact.md").read_text("utf-8")
    assert both == 6
    assert "Six of them are effects of arms, too" in guide
    assert f"The other {len(arm) - both} effects" in guide
    table = guide.partition("| effect | its number")[2].partition("\n\n")[0]
    named = [name for row in table.splitlines()[2:] for name in re.findall(r"`(\w+)`", row.split("|")[1])]
    assert named == [each.name for each in ENGINE]


def test_prose_is_no_formula():
    assert not any(map(is_formula, "A camera that isn't level, 3 degrees (or so): rotated about the frame's origin."))


def test_a_picture_shows_the_effect_of_the_formula(written):
    """A camera's roll has a mean of 0 and no quantiles written down; a gain has another form, a forgotten gear."""
    for name, least, most in (("camera_roll", 2e-3, 2e-2), ("actuator_gain", 1e-2, 0.2)):
        apart = np.abs(written.simulated_keypoints(written.arm_with(EFFECTS[name])) - written.ideal_path())
        assert least < apart.max() < most, name
        assert written.at_last_place(EFFECTS[name]).form is None
