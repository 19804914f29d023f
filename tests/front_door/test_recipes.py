"""A recipe sets options that exist, what is given takes precedence, and a page explains each."""

import re

import pytest
import typer.main
from pages import ROOT

from invdyn.cli import app
from invdyn.inference import METHODS
from invdyn.inference_options import AUTO, NONE
from invdyn.models import FAMILIES, TORQUE_PROCESSES
from invdyn.recipes import RECIPES
from invdyn.settings import read_settings

GUIDE = (ROOT / "docs" / "how-to" / "recipes.md").read_text("utf-8")


def parameters(*words):
    command = typer.main.get_command(app).commands["infer"]
    with command.make_context("infer", ["rec.csv", "--body", "arm.toml", "--out", "p.nc", *words]) as context:
        return context.params


@pytest.mark.parametrize("name", RECIPES)
def test_it_sets_what_it_says_and_nothing_else(name):
    usual, found = parameters(), parameters("--recipe", name)
    changed = {option for option in usual if usual[option] != found[option]} - {"recipe"}
    said = {{"settings": "assignments"}.get(option, option): value for option, value in RECIPES[name].items()}
    assert {option: found[option] for option in changed} == said


@pytest.mark.parametrize("name", RECIPES)
def test_its_values_are_known(name):
    found = parameters("--recipe", name)
    assert found["torque"] in (*TORQUE_PROCESSES, AUTO, NONE)
    settings = dict(text.split("=") for text in found["assignments"])
    assert settings.get("noise") in (None, *FAMILIES)
    assert found["method"] in METHODS


def test_what_is_given_takes_precedence():
    given = parameters("--set", "noise=gaussian", "--recipe", "mouse")
    command = typer.main.get_command(app).commands["infer"]
    assert given["assignments"] == [*RECIPES["mouse"]["settings"], "noise=gaussian"]
    assert read_settings(command.callback.settings, given["assignments"]) == {"noise": "gaussian"}
    assert given["learn"] == RECIPES["mouse"]["learn"]


def test_another_name_is_refused(run):
    said = run("infer", "rec.csv", "--body", "arm.toml", "--recipe", "tennis", "--out", "p.nc")
    assert said.exit_code == 2
    assert said.stderr.startswith(f"error: --recipe: expected one of {', '.join(RECIPES)}, got 'tennis'")


@pytest.mark.parametrize("name", RECIPES)
def test_the_guide_says_what_it_sets(name):
    """Of each recipe: one screen, with every option that it sets."""
    sections = dict(re.findall(r"^## `(\w+)`[^\n]*\n(.*?)(?=^## |\Z)", GUIDE, re.DOTALL | re.MULTILINE))
    assert set(sections) == set(RECIPES)
    assert len(sections[name].splitlines()) <= 40
    for option, value in RECIPES[name].items():
        words = [value] if isinstance(value, str) else value if isinstance(value, list) else []
        flag = "--set" if option == "settings" else "--" + option.replace("_", "-")
        assert " ".join([flag, *words]) in sections[name]
