"""`invdyn compare model.py:Model rows.csv`: a model of one's own on the command line."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

MODEL = """
import torch
from pyro.distributions import Normal
from invdyn.models import StateSpaceModel


class Walk(StateSpaceModel):
    state_dim, observation_dim, num_steps = 1, 1, 20
    state_names = ("level",)

    def initial(self):
        return Normal(torch.zeros(1, dtype=torch.float64), 1.0).to_event(1)

    def transition(self, state, t):
        return Normal(state, 0.3).to_event(1)

    def emission(self, state, t):
        return Normal(state, 0.5).to_event(1)


def walk(rows):
    model = Walk()
    model.num_steps = len(rows)
    return model


not_a_model = 3


def of_two(one, other):
    return Walk()
"""
CALL = ("compare", "walk.py:Walk", "rows.csv", "--methods", "smc,laplace", "--out", "DIR", "--filters", 4)


@pytest.fixture
def given(tmp_path, monkeypatch):
    """A folder with a model, rows and true states."""
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(0)
    level = np.cumsum(0.3 * rng.normal(size=20))
    rows = pd.DataFrame({"time": np.arange(20.0), "y": level + 0.5 * rng.normal(size=20)})
    rows.loc[3, "y"] = np.nan
    rows.to_csv("rows.csv", index=False)
    pd.DataFrame({"level": level}).to_csv("truth.csv", index=False)
    Path("walk.py").write_text(MODEL)
    return tmp_path


def test_a_model_of_ones_own_is_compared(given, run):
    outcome = run(*CALL, "--set", "truth=truth.csv", "--replicates", 2)
    assert outcome.exit_code == 0, outcome.output
    assert {path.name for path in Path("DIR").iterdir()} == {
        "comparison.csv", "comparison.json", "figure.png", "smc.nc", "laplace.nc",
    }  # fmt: skip
    table = pd.read_csv("DIR/comparison.csv", index_col="method")
    assert table["log_evidence"].iloc[0] == pytest.approx(table["log_evidence"].iloc[1], abs=1e-4)
    assert np.isfinite(table["level_crps"]).all()
    for word in ("States against the truth", "R-hat", "Pareto k", "level"):
        assert word in outcome.stdout


@pytest.mark.long
def test_workers_give_the_serial_bits(given, run):
    outcome = run("compare", "walk.py:walk", "rows.csv", "--methods", "bootstrap", "--out", "ONE", "--filters", 4)
    assert outcome.exit_code == 0, outcome.output
    outcome = run(
        "compare", "walk.py:walk", "rows.csv", "--methods", "bootstrap", "--out", "TWO", "--filters", 4, "--workers", 1
    )
    assert outcome.exit_code == 0, outcome.output
    one, two = (pd.read_csv(f"{folder}/comparison.csv") for folder in ("ONE", "TWO"))
    assert one["log_evidence"].equals(two["log_evidence"])


@pytest.mark.parametrize(
    ("word", "said"),
    [
        ("walk.py:Nothing", "expected a model called 'Nothing', the file has none"),
        ("walk.py:not_a_model", "expected a StateSpaceModel, got int"),
        ("walk.py:of_two", "expected no argument or the rows, it takes 2"),
        ("none.py:Walk", "none.py: No such file"),
        ("broken.py:Walk", "running it failed with ZeroDivisionError"),
    ],
)
def test_what_is_no_model_is_one_line(given, run, word, said):
    Path("broken.py").write_text("1 / 0\n")
    outcome = run("compare", word, *CALL[2:])
    assert outcome.exit_code == 2
    (line,) = outcome.stderr.splitlines()
    assert said in line
    assert not Path("DIR").exists()


def test_rows_that_do_not_fit_are_one_line(given, run):
    pd.DataFrame({"y": np.zeros(7)}).to_csv("rows.csv", index=False)
    outcome = run(*CALL)
    assert outcome.exit_code == 2
    (line,) = outcome.stderr.splitlines()
    assert line.startswith("error: ")
    assert "20" in line
    assert "7" in line
