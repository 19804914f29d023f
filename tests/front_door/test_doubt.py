"""An evidence that is not usable is said to be so in the line, the figure's title and the table."""

import sys
import warnings

import numpy as np
import pandas as pd
import pytest
import typer
from typer.testing import CliRunner

from invdyn.console import Commands, say
from invdyn.inference import Comparison
from invdyn.inference.comparison import COLUMNS
from invdyn.plots import heading
from invdyn.summary import comparison_text, summary_text

DOUBT = "outer effective sample size 1.0 of 64 filters is under 16: use more particles"


@pytest.fixture
def doubted(make_posterior):
    idata = make_posterior(num_filters=6)
    assert f"{idata.attrs['log_evidence']:.1f}" in heading(idata)
    assert f"log evidence {idata.attrs['log_evidence']:.2f}" in summary_text(idata)
    idata["sample_stats"].attrs.update(usable=0, doubt=DOUBT)
    return idata


def test_the_line_and_the_title_say_so(doubted):
    stated = f"{doubted.attrs['log_evidence']:.1f}"
    assert f"log evidence not usable: {DOUBT}" in summary_text(doubted)
    assert "log evidence not usable" in heading(doubted)
    assert stated not in heading(doubted)


def test_the_table_says_so(doubted):
    row = dict.fromkeys(COLUMNS, np.nan) | {"log_evidence": -90899.94, "evidence_kind": "estimate", "usable": False}
    row |= {"outer_ess": 1.0, "seconds": 1.0, "memory": 1.0}
    table = pd.DataFrame({"smc": {**row, "usable": True, "log_evidence": 12.3}, "bootstrap": row}).T
    notes = {"bootstrap": f"evidence not usable: {DOUBT}"}
    text = comparison_text(Comparison(table, {"bootstrap": doubted}, {}, notes, 0, False, "swing", 0))
    line = next(line for line in text.splitlines() if line.startswith("bootstrap"))
    assert "not usable" in line
    assert "90899" not in text
    assert "12.30" in text
    assert DOUBT in text


def test_few_filters_that_count_say_what_to_do(make_posterior):
    idata = make_posterior(num_filters=6)
    assert "carry the weight" not in summary_text(idata)
    idata.attrs["outer_ess"] = 1.7
    first = summary_text(idata).splitlines()[0]
    assert first.startswith("warning: 1.7 of 6 filters carry the weight")
    assert "raise --particles" in first


def test_few_bodies_that_count_are_said_where_there_are_no_filters(make_posterior):
    """As by the Gaussian smoother over bodies that are drawn, of which the recording bears out one."""
    idata = make_posterior(num_filters=6)
    idata["sample_stats"] = idata["sample_stats"].drop_vars("ess")
    assert "carry the weight" not in summary_text(idata)
    idata.attrs["outer_ess"] = 1.7
    first = summary_text(idata).splitlines()[0]
    assert first.startswith("warning: 28 % of the parameter sets drawn carry the weight")
    assert "smaller doubts" in first


@pytest.mark.filterwarnings("default:row 3 is off")
@pytest.mark.parametrize("terminal", [True, False])
def test_a_summary_repeats_a_warning_only_where_that_may_not_be_seen(terminal):
    app = typer.Typer(cls=Commands)

    app.callback()(lambda: None)

    @app.command()
    def tried():
        sys.stdout.isatty = sys.stderr.isatty = lambda: terminal
        warnings.warn("row 3 is off", stacklevel=2)
        say("row 3 is off\nanother doubt\n\nJoint torques")

    outcome = CliRunner().invoke(app, ["tried"])
    assert outcome.stderr == "warning: row 3 is off\n"
    assert outcome.stdout == "row 3 is off\n" * (not terminal) + "another doubt\n\nJoint torques\n"
