"""Averages, differences, tables and files of a study whose posteriors are given: nothing is inferred."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import torch
import xarray as xr

from invdyn.inference.filters.filtering import SMCOptions
from invdyn.inference.study.pooling import pool
from invdyn.inference.study.quantities import STATISTICS, statistics
from invdyn.inference.study.study import Study, estimates
from invdyn.inference.study.trial import How, Trial
from invdyn.inference.study.work import (
    NOT_SETTLED,
)
from invdyn.recordings import InputError, read_sto
from invdyn.study_commands import study_text
from invdyn.view import view_of

HOW = How(sizes=SMCOptions(num_filters=16, num_draws=4), stored=8)


def made(seed, joints=("shoulder", "elbow"), begin=0.0):
    """A posterior of that many joints, of no model."""
    rng, names = np.random.default_rng(seed), ("torque", "angle", "velocity")
    drawn = {name: torch.as_tensor(rng.normal(size=(8, 20, len(joints))).astype(np.float32)) for name in names}
    moments = {"mean": drawn["torque"].double().mean(0), "spread": drawn["torque"].double().std(0)}
    said_of_it = {"quantities": {"peak": "N·m"}, "joints": list(joints), "turns": [True] * len(joints), "notes": []}
    units = {"units": {"torque": "N·m", "angle": "rad", "velocity": "rad/s"}}
    numbers = torch.as_tensor(np.abs(rng.normal(size=(1, len(joints), 5))))
    time = torch.linspace(begin, begin + 1, 20, dtype=torch.float64)
    return {**drawn, **moments, "time": time, "statistics": numbers, **said_of_it, **units}


def of_parts(parts, event="touch", names=None):
    trials = [
        Trial(
            f"t{i}" if names is None else names[i], None, None, factors={"condition": "xy"[i % 2]}, events={event: 0.5}
        )
        for i in range(len(parts))
    ]
    return Study(tuple(trials), HOW, ({},) * len(trials), (), dict(enumerate(parts)), {})


def test_an_average_is_of_the_trials_that_have_the_joint():
    """Joints are known by name: one body has them in another order, and one has others."""
    joints = [("shoulder", "elbow"), ("elbow", "shoulder"), ("hip", "knee", "ankle"), ("shoulder", "elbow")]
    parts = [made(i, each) for i, each in enumerate(joints)]
    averages = of_parts(parts).averages("touch")
    assert set(averages["joint"]) == {"shoulder", "elbow"}
    alike = [parts[0], {**parts[1], "mean": parts[1]["mean"].flip(-1), "spread": parts[1]["spread"].flip(-1)}, parts[3]]
    alike[1] |= {"joints": parts[0]["joints"]}
    study = of_parts(alike)
    study = replace(study, trials=(*study.trials[:2], replace(study.trials[2], factors={"condition": "y"})))
    expected = study.averages("touch")
    shoulder = averages[averages["joint"] == "shoulder"]
    assert shoulder["mean"].to_numpy() == pytest.approx(
        expected.loc[expected["joint"] == "shoulder", "mean"].to_numpy()
    )


def test_an_average_at_a_time_is_the_trials_pooled_there():
    """Of trials whose clocks begin at other times: means and spreads .1 s after the event, pooled by themselves."""
    parts = [made(i, begin=0.05 * i) for i in range(8)]
    study, at = of_parts(parts), [0.4, 0.5, 0.55, 0.6, 0.65, 0.7, 0.75, 0.8]
    who = [("a", "1"), ("a", "1"), ("a", "2"), ("a", "2"), ("b", "1"), ("b", "1"), ("b", "1"), ("b", "2")]
    labelled = [
        replace(trial, subject=subject, session=session, events={"touch": when})
        for trial, (subject, session), when in zip(study.trials, who, at, strict=True)
    ]
    averages = replace(study, trials=tuple(labelled)).averages("touch")
    time = averages["time"].unique()[20]
    numbers = np.array(
        [
            [np.interp(time + when, part["time"], part[name][:, 1]) for name in ("mean", "spread")]
            for part, when in zip(parts, at, strict=True)
        ]
    )
    condition = [trial.factors["condition"] for trial in labelled]
    pooled = pool(*numbers.T, condition, *map(list, zip(*who, strict=True)))
    own = averages[(averages["joint"] == "elbow") & (averages["time"] == time)].set_index("condition")
    for level in "xy":
        for column, mixture in (("", pooled.average(level)), ("trial_", pooled.new_trial(level))):
            for name, share in (("q05", 0.05), ("q95", 0.95)):
                assert own.loc[level, column + name] == pytest.approx(mixture.quantile(share), abs=1e-6)
        assert own.loc[level, "mean"] == pytest.approx(pooled.average(level).mean, abs=1e-6)
    begins = [part["time"][0].item() - when for part, when in zip(parts, at, strict=True)]
    assert averages["time"].min() == pytest.approx(max(np.median(begins[k::2]) for k in (0, 1)))


def test_what_is_in_doubt_is_said(tmp_path):
    """Of a trial's own fit, and of what its session shares; whether the fit alone settled does not matter then."""
    gap = "shoulder may have turned the other way"
    study = of_parts([made(i) for i in range(3)])
    few = "few of the bodies drawn carry the weight"
    study.posteriors[2] |= {"notes": [few]}
    fits = tuple({"notes": notes} for notes in ([gap, NOT_SETTLED], [NOT_SETTLED], [NOT_SETTLED]))
    sessions = (((0, 1), {"values": {}, "notes": ["shared did not settle"]}), ((2,), {"values": {}, "notes": []}))
    study = replace(study, fits=fits, sessions=sessions)
    expected = [("t0", gap), ("t0", "shared did not settle"), ("t1", "shared did not settle"), ("t2", NOT_SETTLED)]
    expected += [("t2", few)]
    assert [(row.trial, row.doubt) for row in study.doubts.itertuples()] == expected
    assert f"in doubt: t0: {gap}" in study_text(study)
    study.save(tmp_path / "out")
    assert f"t0: {gap}" in view_of(tmp_path / "out").doubts


def test_a_few_draws_far_off_do_not_widen_a_trials_error():
    """Three of a hundred, which a mean and a sd would not leave alone."""
    drawn = np.random.default_rng(0).normal(2.0, 0.1, (4000, 1))
    some = np.where(np.arange(4000)[:, None] % 100 < 3, 3 * drawn, drawn)
    numbers = pd.DataFrame(
        np.stack([statistics({"peak": (drawn, "N·m"), "work": (each, "J")})[1, 0] for each in (drawn, some)])
    )
    middle, error = estimates(numbers.set_axis(STATISTICS, axis=1))
    assert middle == pytest.approx([2.0, 2.0], abs=0.01)
    assert error[0] == pytest.approx(0.1, rel=0.05)
    assert error[1] == pytest.approx(error[0], rel=0.2)


def test_tables_say_of_how_many_trials_and_in_which_unit():
    """Of six, two lack the condition. It changes the first joint, and the second one shifts."""
    numbers = torch.tensor([0.0, 0.1, -0.1645, 0.0, 0.1645]) + torch.zeros(1, 2, 5)  # a sd of 0.1
    effect = torch.tensor([9.0, 0.0, 9.0, 9.0, 9.0]) * torch.tensor([[1.0], [0.01]])
    study = of_parts([{**made(i), "statistics": numbers + effect * (i % 2)} for i in range(6)])
    for part in study.posteriors.values():
        part |= {"turns": [True, False]}
    others = [replace(study.trials[4], factors={}), replace(study.trials[5], factors={"condition": ""})]
    study = replace(study, trials=(*study.trials[:4], *others))
    difference = study.difference().set_index("joint")
    assert difference["found"].to_dict() == {"shoulder": True, "elbow": False}
    assert set(difference["trials"]) == {4}
    assert difference["unit"].to_dict() == {"shoulder": "N·m", "elbow": "N"}
    assert study.summary().groupby("condition")["trials"].unique().to_dict() == {"x": [2], "y": [2]}
    averages = study.averages("touch")
    assert set(averages["trials"]) == {2}
    assert averages.groupby("joint")["unit"].unique().to_dict() == {"shoulder": ["N·m"], "elbow": ["N"]}
    shared = (((0, 1), {"values": {"torque.scale": torch.tensor([1.0, 2.0])}, "notes": []}),)
    parameters = replace(study, sessions=shared).parameters
    assert parameters[["trials", "entry", "value"]].to_numpy().tolist() == [[2, 0, 1.0], [2, 1, 2.0]]


def test_a_sessions_file_holds_trials_of_any_length(tmp_path):
    """The second of four has 15 rows of 20; the last of them begins later, and its event is not within it."""
    parts = [made(i, begin=0.6 * (i == 3)) for i in range(4)]
    rows = {"torque", "angle", "velocity"}
    parts[1] |= {name: parts[1][name][:, :15] for name in rows} | {
        n: parts[1][n][:15] for n in ("time", "mean", "spread")
    }
    for part in parts:
        part |= {"turns": [True, False]}
    study = of_parts(parts)
    ends = [part["time"][-1].item() - 0.5 for part in parts[:3]]
    assert study.averages("touch")["time"].max() == pytest.approx(min(np.median(ends[::2]), ends[1]))
    labelled = [
        replace(trial, subject="s", factors={**trial.factors, "hand": "lr"[i // 2]})
        for i, trial in enumerate(study.trials)
    ]
    files = replace(study, trials=tuple(labelled)).save(tmp_path / "out")
    assert {"summary_condition.csv", "differences_hand.csv"} < {file.name for file in files}
    assert (pd.read_csv(tmp_path / "out" / "averages_touch.csv")["condition"] == "x").any()
    with xr.open_dataset(tmp_path / "out" / "posteriors" / "s_1.nc", engine="h5netcdf") as data:
        assert data.attrs["subject"] == "s"
        assert data["event_touch"].values.tolist() == [0.5] * 4
        short = data["torque"].sel(trial="t1").values
        assert short[:, :15] == pytest.approx(parts[1]["torque"].numpy())
        assert np.isnan(short[:, 15:]).all()
        assert data["angle"].attrs["units"] == "rad"
    columns = read_sto(tmp_path / "out" / "sto" / "t2.sto")
    assert columns["shoulder_moment"] == pytest.approx(np.median(parts[2]["torque"][:, :, 0], axis=0), rel=1e-5)
    assert "elbow_force" in columns


def test_a_difference_that_may_be_the_subjects_says_so(tmp_path):
    numbers = torch.tensor([0.0, 0.1, -0.1645, 0.0, 0.1645]) + torch.zeros(1, 2, 5)  # a sd of 0.1
    effect = torch.tensor([9.0, 0.0, 9.0, 9.0, 9.0])
    study = of_parts([{**made(i), "statistics": numbers + effect * (i % 2)} for i in range(12)])
    apart = tuple(replace(trial, subject=trial.factors["condition"]) for trial in study.trials)
    own, other = study, replace(study, trials=apart)
    assert set(own.difference()["confounded"]) == {""}
    assert set(other.difference()["confounded"]) == {"subject"}
    assert "differs (P" in study_text(own)
    assert "differs, or its subject does (P" in study_text(other)


def test_a_level_without_a_joint_is_not_drawn_of_it(tmp_path):
    """Levels x and y of the arm, x alone of the leg."""
    parts = [made(i, ("hip",) if i in (4, 6) else ("shoulder",)) for i in range(7)]
    of_parts(parts).save(tmp_path / "out")
    panels = {panel["joint"]: panel for panel in view_of(tmp_path / "out").panels}
    assert [side["name"] for side in panels["shoulder"]["sides"]] == ["x (2 trials)", "y (3 trials)"]
    assert [side["name"] for side in panels["hip"]["sides"]] == ["x (2 trials)"]


def test_bodies_without_a_joint_in_common_are_saved(tmp_path):
    files = of_parts([made(0), made(1, ("hip", "knee"))]).save(tmp_path / "out")
    assert {"trials.csv", "left_out.csv", "in_doubt.csv"} == {file.name for file in files if file.suffix == ".csv"}


@pytest.mark.parametrize("event", ["press/left", "/../../touch", "a" * 300])
def test_any_name_of_an_event_is_saved_within_the_folder(event, tmp_path):
    study = of_parts([made(i) for i in range(4)], event)
    files = study.save(tmp_path / "deep" / "out")
    assert {file.parent.parent for file in files} <= {tmp_path / "deep", tmp_path / "deep" / "out"}
    view = view_of(tmp_path / "deep" / "out")
    assert [len(panel["trials"]) for panel in view.panels] == [4, 4]
    assert view.foot == ""  # no other event to align at


def test_no_trial_is_written_over_another(tmp_path):
    study = of_parts([made(i) for i in range(4)], names=["x-2", "x", "X", "n" * 300])
    files = study.save(tmp_path / "out")
    assert len({str(file).lower() for file in files}) == len(files)


def test_of_two_studies_in_one_folder_the_later_one_is_shown(tmp_path):
    study = of_parts([made(i) for i in range(5)])
    study = replace(study, trials=tuple(replace(trial, events={"touch": 0.5, "lift": 0.7}) for trial in study.trials))
    other = replace(study, trials=tuple(replace(trial, subject="other") for trial in study.trials))
    of_parts([made(i) for i in range(4)], "grasp").save(tmp_path / "out")
    other.save(tmp_path / "out")
    files = study.save(tmp_path / "out")
    assert all(file.exists() for file in files)
    assert (tmp_path / "out" / "posteriors" / "other_1.nc").exists()
    view = view_of(tmp_path / "out")
    assert [len(panel["trials"]) for panel in view.panels] == [5, 5]
    assert view.foot == "Events to align at: lift, touch."


def test_an_event_at_every_trial_s_end_or_begin_has_one_time(tmp_path):
    study = of_parts([made(i, begin=(-0.5, 0.5)[i % 2]) for i in range(4)])
    assert study.averages("touch")["time"].unique().tolist() == [0.0]
    study.save(tmp_path / "out")
    view_of(tmp_path / "out").html()


def test_an_event_that_is_never_is_nan_and_not_infinite():
    assert np.isnan(Trial("t", None, None, events={"touch": np.nan}).events["touch"])
    with pytest.raises(InputError, match="expected the time of event 'touch' in s, got -inf"):
        Trial("t", None, None, events={"touch": -np.inf})


@pytest.mark.parametrize("factor", ["", "joint", "time", "event_touch", "left/right"])
def test_a_factor_that_files_cannot_name_is_refused(factor):
    with pytest.raises(InputError, match="name of"):
        Trial("t", None, None, factors={factor: "x"})
