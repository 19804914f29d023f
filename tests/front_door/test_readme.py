"""Everything in README.md runs, in the order in which it stands there."""

import re
import shlex
import tomllib
from functools import partial

import numpy as np
import pandas as pd
import pytest
from pages import ROOT, blocks, commands

from invdyn.inference import METHODS

README = ROOT / "README.md"
MAX_WORDS = 900
"""Words, code among them: whoever reads on finds the rest in docs/."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with the reader's own files: an arm, and tracks of it in pixels as DeepLabCut writes them."""
    folder = tmp_path_factory.mktemp("reader")
    (folder / "my_arm.toml").write_text(
        'name = "mine"\n[[links]]\nname = "forearm"\njoint = "elbow"\ntip = "wrist"\nlength = 0.26\nmass = 1.5\n'
    )
    rng, time = np.random.default_rng(0), np.arange(60) / 30
    angle = -1.2 + 0.5 * np.sin(3 * time)
    wrist = 400 + 0.26 / 0.0021 * np.stack([np.cos(angle), -np.sin(angle)], -1)
    points = np.stack([np.full_like(wrist, 400.0), wrist], 1) + 0.5 * rng.standard_normal((60, 2, 2))
    sure = np.full((60, 2, 1), 0.98)
    columns = pd.MultiIndex.from_product(
        [["net"], ["elbow", "wrist"], ["x", "y", "likelihood"]], names=["scorer", "bodyparts", "coords"]
    )
    pd.DataFrame(np.concatenate([points, sure], -1).reshape(60, -1), columns=columns).to_csv(folder / "tracks.csv")
    return folder


@pytest.mark.long
def test_every_command_and_snippet_runs(folder, monkeypatch, run, capsys):
    """As they stand; variational guides take fewer steps."""
    monkeypatch.chdir(folder)
    monkeypatch.setitem(METHODS, "svi", partial(METHODS["svi"], max_steps=300))
    for line in commands(README):
        found = run(*shlex.split(line)[1:])
        assert found.exit_code == 0, f"{line}: {found.stderr}"
    for snippet in blocks(README, "python"):
        exec(compile(snippet, str(README), "exec"), {})
    assert {"posterior.nc", "figure.png", "torques.csv", "comparison", "found"} <= {p.name for p in folder.iterdir()}
    assert (folder / "found" / "report.html").exists()
    assert "nan" not in capsys.readouterr().out.lower()


def test_its_extras_are_those_that_can_be_installed():
    text = README.read_text("utf-8")
    known = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["optional-dependencies"]
    (installed,) = re.findall(r'^python -m pip install -c constraints.txt -e "\.\[(.*)\]"$', text, re.MULTILINE)
    assert set(installed.split(",")) <= set(known)
    listed = re.findall(r"`(\w+)`", text.split("Extras: ")[1].split("\n\n")[0])
    assert set(listed) == set(known) - {"dev", "docs"}


def test_it_is_short():
    assert len(README.read_text("utf-8").split()) <= MAX_WORDS
