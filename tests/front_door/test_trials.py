"""`invdyn trials`: a table of trials and a folder of them, through the command line and in Python."""

import math

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import invdyn
from invdyn.inputs import load_body
from invdyn.models import person
from invdyn.recordings import InputError, read_keypoint_csv, write_keypoint_csv
from invdyn.simulate import random_arm, record
from invdyn.study_commands import _texts, how
from invdyn.study_table import ManyTrials, read_rows, read_trials
from invdyn.view import view_of

SMALL = ("--filters", 8, "--set", "draws=2")
BODY = "paper_planar_arm"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A folder of four recordings, and a table that names them and one that is not there."""
    folder = tmp_path_factory.mktemp("recorded")
    rows = ["recording,subject,session,condition,event_touch,note"]
    for seed in range(4):
        recording, _ = record(random_arm(load_body(BODY), duration=0.6, fps=20, seed=seed), seed)
        write_keypoint_csv(recording, folder / f"t{seed}.csv")
        rows.append(f"t{seed}.csv,{'ab'[seed // 2]},1,{'xy'[seed % 2]},{0.3 if seed else ''},good")
    rows.append("gone.csv,a,1,x,0.3,")
    (folder / "trials.txt").write_text("\n".join(rows))
    return folder


def test_a_table_becomes_a_folder_of_tables(recorded, tmp_path, run):
    done = run("trials", recorded / "trials.txt", "--body", BODY, "--out", tmp_path / "study", *SMALL)
    assert done.exit_code == 0, done.stderr
    assert "4 of 5 trials, 2 sessions" in done.stdout
    assert "left out: gone.csv: " in done.stdout
    table = pd.read_csv(tmp_path / "study" / "trials.csv")
    assert set(table["trial"]) == {"t0.csv", "t1.csv", "t2.csv", "t3.csv"}
    assert table.loc[(table["trial"] == "t0.csv") & (table["quantity"] == "at touch"), "mean"].isna().all()
    assert table.loc[(table["trial"] == "t1.csv") & (table["quantity"] == "at touch"), "mean"].notna().all()
    differences = pd.read_csv(tmp_path / "study" / "differences.csv")
    assert {"impulse", "work", "mean_power"} <= set(differences["quantity"])
    averages = pd.read_csv(tmp_path / "study" / "averages_touch.csv")
    assert set(averages["condition"]) == {"x", "y"}
    with xr.open_dataset(tmp_path / "study" / "posteriors" / "a_1.nc", engine="h5netcdf") as session:
        np.testing.assert_array_equal(session["event_touch"].values, [np.nan, 0.3])
    view = view_of(tmp_path / "study")
    assert view.title == "Torques of 3 trials by condition"
    assert [len(panel["trials"]) for panel in view.panels] == [3, 3]
    assert [doubt.split(":")[0] for doubt in view.doubts] == ["gone.csv is left out"]


@pytest.mark.long
def test_python_and_the_command_line_say_the_same(recorded, tmp_path, run):
    run("trials", recorded / "trials.txt", "--body", BODY, "--out", tmp_path / "study", *SMALL)
    table = pd.read_csv(tmp_path / "study" / "trials.csv")
    study = invdyn.trials(recorded / "trials.txt", load_body(BODY), filters=8, draws=2)
    for name in ("mean", "sd"):
        assert study.table[name].to_numpy() == pytest.approx(table[name].to_numpy(), nan_ok=True)


def test_a_folder_is_a_table_of_its_files(recorded):
    given = ManyTrials(recordings=[str(recorded)], body=BODY)
    found = read_trials(read_rows(given), given, None)
    assert [trial.name for trial in found] == [f"t{n}.csv" for n in range(4)]
    assert found[2].recording.keypoints == pytest.approx(
        read_keypoint_csv(recorded / "t2.csv").keypoints, abs=1e-9, nan_ok=True
    )
    assert found[2].factors == {"condition": "all"}


def test_events_have_a_clock_of_their_own(recorded, tmp_path):
    (tmp_path / "events.csv").write_text("event,time\nlift,99.0\ntouch,100.25\ntouch,100.35\nrelease,105.0\n")
    table = pd.DataFrame(
        {"recording": [str(recorded / "t0.csv")], "events": [str(tmp_path / "events.csv")], "clock_offset": [100.0]}
    )
    study_rows = table.astype(str).to_dict("records")
    study_rows[0]["trial"] = "t0"
    given = ManyTrials(recordings=["."], body=BODY)
    (trial,) = read_trials(study_rows, given, None)
    assert trial.events["touch"] == pytest.approx(0.25)  # of two the first
    assert math.isnan(trial.events["lift"])
    assert math.isnan(trial.events["release"])


def test_a_line_of_events_may_end_early(recorded, tmp_path):
    (tmp_path / "events.csv").write_text("event,time\ntouch\n")
    row = {"recording": str(recorded / "t0.csv"), "trial": "t0", "events": str(tmp_path / "events.csv")}
    (trial,) = read_trials([row], ManyTrials(recordings=["."], body=BODY), None)
    assert math.isnan(trial.events["touch"])


def test_none_is_a_condition_and_a_missing_cell_is_not(recorded, tmp_path):
    (tmp_path / "table.csv").write_text("recording,condition,\nt0.csv,None,\n,,\nt1.csv,,\n")
    rows = read_rows(ManyTrials(recordings=[str(tmp_path / "table.csv")]))
    assert [row["condition"] for row in rows] == ["None", ""]
    frame = pd.DataFrame(
        {"recording": ["t0.csv", "t1.csv"], "condition": ["None", None], "event_touch": [0.5, math.nan]}
    )
    assert [tuple(row.values()) for row in _texts(frame)] == [("t0.csv", "None", "0.5"), ("t1.csv", "", "")]


def test_batches_are_of_the_size_that_is_asked_for():
    assert how(ManyTrials(recordings=["."], filters_per_task=4), "smc").sizes.filters_per_task == 4


def test_a_row_may_have_a_person_of_its_own(tmp_path):
    arm = person(1.8, 75.0, "m")
    recording, _ = record(random_arm(arm, duration=0.6, fps=20, seed=0), 0)
    write_keypoint_csv(recording, tmp_path / "t0.csv")
    row = {"recording": str(tmp_path / "t0.csv"), "trial": "t0", "height": "1.8", "mass": "75", "sex": "m"}
    given = ManyTrials(recordings=["."], body=BODY)
    (trial,) = read_trials([row], given, None)
    assert trial.unread == ""
    assert trial.body == arm


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("recording,sesion\nt0.csv,1\n", "'sesion' is not known"),
        ("file,session\nt0.csv,1\n", "expected a column recording"),
        ("recording\n", "one trial a row"),
        ("recording,event_touch\nt0.csv,soon\n", "expected a number, got 'soon'"),
        ("recording,event_touch\nt0.csv,1_5\n", "expected a number, got '1_5'"),
        ("recording;event_touch\nt0.csv;0.1\n", "separated by commas"),
        ("recording,subject,condition\nt0.csv,Doe, Jane,x\n", "line 2: expected 3 cells, got 4"),
        ("recording,condition,condition\nt0.csv,x,y\n", "'condition' twice"),
        ("recording,condition,factor_condition\nt0.csv,x,y\n", "one column of the condition"),
        ("recording,factor_joint\nt0.csv,x\n", "another name of factor 'joint'"),
        ("recording,event_\nt0.csv,0.1\n", "got an empty one"),
        ("recording,subject\nt0.csv,J\xfcrgen\n", "not a text table"),
    ],
)
def test_a_table_that_cannot_be_meant_is_refused(text, says, tmp_path, run):
    (tmp_path / "table.csv").write_bytes(text.encode("latin-1"))
    done = run("trials", tmp_path / "table.csv", "--body", BODY, "--out", tmp_path / "study")
    assert done.exit_code == 2
    assert says in done.stderr
    assert not (tmp_path / "study").exists()


@pytest.mark.parametrize("out", [".", "study"])
def test_a_study_is_not_written_among_its_recordings(recorded, out, run):
    done = run("trials", recorded, "--body", BODY, "--out", recorded / out)
    assert done.exit_code == 2
    assert "expected a folder outside of" in done.stderr


def test_no_trial_left_writes_nothing(tmp_path, run):
    (tmp_path / "table.csv").write_text("recording\ngone.csv\nlost.csv\n")
    done = run("trials", tmp_path / "table.csv", "--body", BODY, "--out", tmp_path / "study")
    assert done.exit_code == 2
    assert "no trial of 2 is left" in done.stderr
    assert not (tmp_path / "study").exists()


def test_a_truth_has_no_part_in_a_study(recorded):
    with pytest.raises(InputError, match="--set truth"):
        invdyn.trials(recorded / "trials.txt", BODY, truth="truth.csv")


def test_a_data_frame_is_a_table(recorded):
    frame = pd.DataFrame({"recording": [str(recorded / "t1.csv"), str(recorded / "t2.csv")], "condition": ["x", "y"]})
    study = invdyn.trials(frame, BODY, filters=8, draws=2)
    assert np.isfinite(study.table.loc[study.table["quantity"] == "impulse", "mean"]).all()
