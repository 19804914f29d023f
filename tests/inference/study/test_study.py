"""A small study: labels, sharing, what is left out, and the same bits after each interruption."""

from dataclasses import replace

import h5py
import numpy as np
import pandas as pd
import pytest
import torch
import xarray as xr

from invdyn.inference import infer, open_executor
from invdyn.inference.filters.filtering import SMCOptions
from invdyn.inference.study import run as run_module
from invdyn.inference.study import work
from invdyn.inference.study.averages import SETS
from invdyn.inference.study.pooling import pool
from invdyn.inference.study.quantities import STATISTICS, statistics
from invdyn.inference.study.run import _fingerprint, _groups, run_study
from invdyn.inference.study.study import Study, estimates
from invdyn.inference.study.trial import How, Trial
from invdyn.inference.study.work import (
    NOT_SETTLED,
    fit_trial,
    infer_trial,
    parameters_of,
    said,
    share_session,
    words,
)
from invdyn.inputs import load_body
from invdyn.models import SmoothAndRough, planar_body
from invdyn.recordings import InputError, load, read_sto
from invdyn.simulate import random_arm, record
from invdyn.study_commands import study_text
from invdyn.view import view_of

HOW = How(sizes=SMCOptions(num_filters=16, num_draws=4), stored=8)
BODY = load_body("paper_planar_arm")


def simulated(seed, **labels):
    recording, _ = record(random_arm(BODY, duration=0.8, fps=25, seed=seed), seed)
    condition = "xy"[seed % 2]
    return Trial(f"t{seed}", recording, BODY, factors={"condition": condition}, events={"touch": 0.4}, **labels)


@pytest.fixture(scope="module")
def trials():
    """Four that fit, one that could not be read, one whose links are half as long again, one that has no rows."""
    good = [simulated(seed, subject="ab"[seed // 2]) for seed in range(4)]
    unread = Trial("unread", None, None, "a", factors={"condition": "x"}, unread="no such file")
    long = simulated(7, subject="a")
    long = replace(long, name="long", recording=replace(long.recording, keypoints=1.5 * long.recording.keypoints))
    empty = replace(good[0], name="empty", recording=replace(good[0].recording, keypoint_names=("hip", "knee")))
    return [*good, unread, long, empty]


@pytest.fixture(scope="module")
def study(trials, tmp_path_factory):
    return run_study(trials, HOW, checkpoint=tmp_path_factory.mktemp("kept"))


def same(one, other):
    assert one.left_out == other.left_out
    for place, part in one.posteriors.items():
        assert part.keys() == other.posteriors[place].keys()
        for name, value in part.items():
            assert value.numpy().tobytes() == other.posteriors[place][name].numpy().tobytes()


def test_what_does_not_fit_is_named_and_the_others_go_on(study):
    reasons = study.reasons.set_index("trial")["reason"]
    assert set(reasons.index) == {"unread", "long", "empty"}
    assert reasons["unread"] == "no such file"
    assert "not explained" in reasons["long"]
    assert "keypoint 'hip' is not of body" in reasons["empty"]
    assert sorted(study.posteriors) == [0, 1, 2, 3]


@pytest.mark.long
def test_a_trial_that_is_left_out_moves_no_other(study, trials):
    alone = run_study(trials[:4], HOW)
    for place in range(4):
        assert torch.equal(study.posteriors[place]["torque"], alone.posteriors[place]["torque"])


def test_a_session_shares_one_set_of_parameters(study, trials):
    (first, one), (second, two) = study.sessions
    assert (first, second) == ((0, 1), (2, 3))
    assert not torch.equal(parameters_of(one)["torque.scale"], parameters_of(two)["torque.scale"])
    alone = [fit_trial(trial, HOW) for trial in trials[:2]]
    again = share_session(trials[:2], alone, HOW)
    for name, value in parameters_of(one).items():
        assert torch.equal(value, parameters_of(again)[name])
    noise = [float(parameters_of(fit)["emission.keypoint_scale"].log().mean()) for fit in alone]
    shared = float(parameters_of(one)["emission.keypoint_scale"].log().mean())
    assert min(noise) < shared < max(noise)


def test_a_trial_of_which_nothing_is_fitted_has_a_posterior(trials):
    how = replace(HOW, settings={"torque.scale": 3.0, "torque.decay": 3.0, "emission.keypoint_scale": 0.01})
    found = run_study(trials[:1], how)
    assert not found.left_out
    assert found.posteriors[0]["torque"].isfinite().all()


@pytest.mark.long
def test_a_session_shares_its_body(trials, monkeypatch):
    """Links known to a tenth, stated too long; a trial draws them from what all rows of the session tell."""
    stated = replace(BODY, links=[replace(link, length=1.06 * link.length) for link in BODY.links])
    own = [replace(trial, body=replace(stated, uncertainty={"length": 0.1})) for trial in trials[:2]]
    fits = [fit_trial(trial, HOW) for trial in own]
    shared = share_session(own, fits, HOW)
    wide, narrow = (part["covariance"].diagonal()[-2:].sqrt() for part in (fits[0], shared))
    assert (narrow < 0.9 * wide).all()
    drawn = []
    task = work.Task
    monkeypatch.setattr(work, "Task", lambda *given: drawn.append(task(*given)) or drawn[-1])
    assert said(infer_trial(own[0], HOW, fits[0], shared, 0))["notes"] == []
    assert drawn[0].candidates[0].of_more_rows
    assert said(infer_trial(own[0], HOW, fits[0], fits[0], 0))["notes"] == []
    assert not drawn[1].candidates[0].of_more_rows


def test_a_posterior_is_at_the_parameters_of_its_session(trials, monkeypatch):
    """What the trial's own fit found is where its path begins; what its session does not explain is left out."""
    fit = fit_trial(trials[0], HOW)
    own = infer_trial(trials[0], HOW, fit, fit, 5)
    other = {name: 3.0 * value if name.startswith("value ") else value for name, value in fit.items()}
    assert torch.equal(infer_trial(trials[0], HOW, other, fit, 5)["torque"], own["torque"])
    assert not torch.equal(infer_trial(trials[0], HOW, fit, fit, 6)["torque"], own["torque"])
    # 8 draws kept of 64
    assert (own["spread"] / own["torque"].double().std(0)).median().item() == pytest.approx(1.0, abs=0.2)
    monkeypatch.setattr(work, "evidence_note", lambda idata: "too rough")
    assert said(infer_trial(trials[0], HOW, fit, fit, 5))["left_out"] == "the evidence of laplace is too rough"
    at = []

    def unexplained(problem, path):
        at.append(problem.model.parameters)
        return ["it is off"]

    monkeypatch.setattr(work, "unexplained", unexplained)
    assert said(infer_trial(trials[0], HOW, fit, other, 5))["left_out"] == "at its session's parameters it is off"
    for name, value in parameters_of(other).items():
        assert at[0][name].numpy() == pytest.approx(value.numpy())


def test_a_trial_without_evidence_keeps_no_session_from_sharing(trials):
    """Its path is infinite: no linearisation of it has an evidence."""
    alone = [fit_trial(trial, HOW) for trial in trials[:2]]
    broken = {**alone[1], "path": alone[1]["path"] * float("inf")}
    shared = share_session([*trials[:2], trials[1]], [*alone, broken], HOW)
    expected = share_session(trials[:2], alone, HOW)
    for name, value in parameters_of(expected).items():
        assert parameters_of(shared)[name].numpy() == pytest.approx(value.numpy(), rel=0.15)  # it begins elsewhere


@pytest.mark.long
def test_one_trial_of_a_session_is_what_infer_says(trials):
    (part,) = run_study(trials[:1], HOW).posteriors.values()
    idata = infer(trials[0].recording, BODY, method="laplace", num_filters=16, num_draws=4)
    torque = idata["posterior"]["torque"].transpose("chain", "draw", "time", "joint").values
    sd = torque.std((0, 1))
    assert (np.abs(part["mean"].numpy() - torque.mean((0, 1))) < 1.0 * sd).all()  # 64 draws each


def test_the_table_labels_each_number_as_what_it_is(study):
    table = study.table.set_index(["trial", "joint", "quantity"])
    assert len(study.table) == 4 * 2 * 8
    part = study.posteriors[2]
    names = list(said(part)["quantities"])
    for q, quantity in enumerate(names):
        for k, joint in enumerate(BODY.joint_names):
            assert table.loc[("t2", joint, quantity), "mean"] == pytest.approx(
                part["statistics"][q, k, 0].item(), nan_ok=True
            )
    row = np.abs(part["time"].numpy() - 0.4).argmin()
    assert table.loc[("t2", "elbow", "at touch"), "mean"] == pytest.approx(part["mean"][row, 1].item())
    impulse = np.trapezoid(part["mean"].numpy()[:, 0], part["time"].numpy())
    assert table.loc[("t2", "shoulder", "impulse"), "mean"] == pytest.approx(impulse)
    assert table.loc[("t2", "shoulder", "impulse"), "unit"] == "N·m·s"


def test_differences_have_intervals_and_directions(study):
    found = study.difference("condition")
    assert (found["first"] == "x").all()
    assert (found["second"] == "y").all()
    assert ((found["q05"] < found["mean"]) & (found["mean"] < found["q95"])).all()
    assert found["direction"].between(0.5, 1.0).all()
    summary = study.summary().set_index(["joint", "quantity", "condition"])
    own = found.set_index(["joint", "quantity"]).loc[("elbow", "impulse"), "mean"]
    both = [summary.loc[("elbow", "impulse", level), "mean"] for level in "xy"]
    assert own == pytest.approx(both[1] - both[0])


@pytest.mark.parametrize("ask", [lambda s: s.difference("hand"), lambda s: s.averages("lift")])
def test_what_the_table_does_not_have_is_refused(study, ask):
    with pytest.raises(InputError, match=r"expected (a factor|an event) among"):
        ask(study)


@pytest.mark.long
def test_it_is_the_same_after_every_interruption(study, trials, tmp_path, monkeypatch):
    """Ended after one more part is kept, again and again."""

    class Ended(BaseException):
        pass

    real, runs = run_module.distribute, 0

    def one_more(part, arguments, names, *, checkpoint=None, **rest):
        save, count = type(checkpoint).save, []

        def counted(self, *tensors, **state):
            save(self, *tensors, **state)
            count.append(1)
            if len(count) == 2:
                raise Ended

        monkeypatch.setattr(type(checkpoint), "save", counted)
        try:
            return real(part, arguments, names, checkpoint=checkpoint, **rest)
        finally:
            monkeypatch.setattr(type(checkpoint), "save", save)

    monkeypatch.setattr(run_module, "distribute", one_more)
    while True:
        runs += 1
        try:
            resumed = run_study(trials, HOW, checkpoint=tmp_path / "kept")
            break
        except Ended:
            assert runs < 20
    assert runs >= 5
    same(study, resumed)


def test_the_old_name_of_a_method_is_known():
    with (
        pytest.warns(UserWarning, match="'nested' is now 'smc'"),
        pytest.raises(InputError, match="expected one trial or more"),
    ):
        run_study((), How(method="nested"))


@pytest.mark.long
def test_workers_change_no_bit(study, trials):
    with open_executor(2) as executor:
        same(study, run_study(trials, HOW, executor=executor))


def test_another_study_s_checkpoint_is_refused(trials, tmp_path):
    run_study(trials[4:5], HOW, checkpoint=tmp_path)
    other = replace(trials[0], name="other")
    run_study([other], HOW, checkpoint=tmp_path / "b")
    with pytest.raises(InputError, match="another run"):
        run_study([replace(other, subject="z")], HOW, checkpoint=tmp_path / "b")


def test_what_is_saved_is_read_again(study, tmp_path):
    files = study.save(tmp_path / "out", nwb=True)
    assert all(file.exists() for file in files)
    names = {file.relative_to(tmp_path / "out").as_posix() for file in files}
    assert {"trials.csv", "left_out.csv", "differences.csv", "averages_touch.png", "posteriors/a_1.nc"} <= names
    with xr.open_dataset(tmp_path / "out" / "posteriors" / "a_1.nc", engine="h5netcdf") as data:
        assert data["torque"].dims == ("trial", "draw", "row", "joint")
        assert data["trial"].values.tolist() == ["t0", "t1"]
        assert data["torque"].sel(trial="t1").values == pytest.approx(study.posteriors[1]["torque"].numpy())
    columns = read_sto(tmp_path / "out" / "sto" / "t3.sto")
    assert {"elbow_moment", "elbow_q95"} <= columns.keys()
    first = tmp_path / "out" / "nwb" / "a_1.nwb"
    with h5py.File(first) as store:
        series = store["processing/t1/elbow_torque_q95/data"]
        upper = np.quantile(study.posteriors[1]["torque"].double().numpy()[:, :, 1], 0.95, axis=0)
        assert series[()] == pytest.approx(upper, rel=1e-9)
        assert series.attrs["unit"] == "N·m"
    pose = load(first, units="m", individual="t1_pose")
    given = study.trials[1].recording
    order = [pose.keypoint_names.index(name) for name in given.keypoint_names]
    np.testing.assert_array_equal(pose.keypoints[:, order], given.keypoints)
    np.testing.assert_array_equal(pose.time, study.trials[1].recording.time)


def test_bands_hold_what_lies_within_trials_and_between_them(study):
    averages = study.averages("touch")
    assert ((averages["q05"] < averages["mean"]) & (averages["mean"] < averages["q95"])).all()
    assert (averages["trial_q05"] <= averages["q05"]).all()
    assert (averages["q95"] <= averages["trial_q95"]).all()
    assert averages["time"].min() == pytest.approx(-0.4)
    assert len(study.plot("touch").axes) == 2


def made(seed, joints=("shoulder", "elbow"), begin=0.0):
    """A posterior of that many joints, of no model."""
    rng, names = np.random.default_rng(seed), ("torque", "angle", "velocity")
    drawn = {name: torch.as_tensor(rng.normal(size=(8, 20, len(joints))).astype(np.float32)) for name in names}
    moments = {"mean": drawn["torque"].double().mean(0), "spread": drawn["torque"].double().std(0)}
    said_of_it = {"quantities": {"peak": "N·m"}, "joints": list(joints), "turns": [True] * len(joints), "notes": []}
    units = {"units": {"torque": "N·m", "angle": "rad", "velocity": "rad/s"}}
    numbers = torch.as_tensor(np.abs(rng.normal(size=(1, len(joints), 5))))
    time = torch.linspace(begin, begin + 1, 20, dtype=torch.float64)
    return {**drawn, **moments, "time": time, "statistics": numbers, **words(**said_of_it, **units)}


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
    alike[1] |= {"words": parts[0]["words"]}
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
    pooled = pool(*numbers.T, condition, *map(list, zip(*who, strict=True)), SETS)
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
    study.posteriors[2] |= words(**said(study.posteriors[2]) | {"notes": [few]})
    fits = tuple(words(notes=notes) for notes in ([gap, NOT_SETTLED], [NOT_SETTLED], [NOT_SETTLED]))
    sessions = (((0, 1), words(notes=["shared did not settle"])), ((2,), words(notes=[])))
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
        part |= words(**said(part) | {"turns": [True, False]})
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
    shared = (((0, 1), {"value torque.scale": torch.tensor([1.0, 2.0]), **words(notes=[])}),)
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
        part |= words(**said(part) | {"turns": [True, False]})
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


def test_no_trial_is_written_over_another(tmp_path):
    study = of_parts([made(i) for i in range(4)], names=["x-2", "x", "X", "n" * 300])
    files = study.save(tmp_path / "out")
    assert len({str(file).lower() for file in files}) == len(files)


def test_of_two_studies_in_one_folder_the_later_one_is_shown(tmp_path):
    study = of_parts([made(i) for i in range(5)])
    other = replace(study, trials=tuple(replace(trial, subject="other") for trial in study.trials))
    of_parts([made(i) for i in range(4)], "grasp").save(tmp_path / "out")
    other.save(tmp_path / "out")
    files = study.save(tmp_path / "out")
    assert all(file.exists() for file in files)
    assert (tmp_path / "out" / "posteriors" / "other_1.nc").exists()
    view = view_of(tmp_path / "out")
    assert [len(panel["trials"]) for panel in view.panels] == [5, 5]
    assert view.foot == "Events to align at: touch."


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


def test_a_process_of_the_torque_does_not_change_a_checkpoint(trials):
    def own(*given):
        return _fingerprint(trials[:1], How(binding={"torque": SmoothAndRough(*given)}))

    assert own() == own()
    assert own() != own(0.3)


def test_tracks_of_other_points_share_nothing(trials):
    first = trials[0]
    other = replace(first, name="o", recording=first.recording.with_keypoints(first.recording.keypoint_names[::-1]))
    fits = dict.fromkeys(range(3), words(notes=[]))
    assert _groups([first, trials[1], other], fits) == [(0, 1), (2,)]
    assert _fingerprint([first], HOW) != _fingerprint([replace(other, name=first.name)], HOW)


def test_what_changes_the_numbers_changes_a_checkpoint_and_bodies_share_nothing(trials):
    first = trials[0]
    heavy = replace(first, name="h", body=planar_body("b", [replace(link, mass=2.0) for link in BODY.links]))
    later = replace(first, events={"touch": 0.5})
    moved = replace(first, recording=first.recording.with_keypoints(first.recording.keypoint_names[:1]))
    own = _fingerprint([first], HOW)
    for other in ([replace(heavy, name=first.name)], [later], [moved]):
        assert _fingerprint(other, HOW) != own
    assert _fingerprint([first], replace(HOW, seed=1)) != own
    assert own["kept"] == ("path", "covariance")  # an older study kept no covariance
    fits = dict.fromkeys(range(2), words(notes=[]))
    assert _groups([first, heavy], fits) == [(0,), (1,)]
    other = words(notes=[]) | {"value torque.scale": torch.ones(3)}
    assert _groups([first, trials[1]], {0: fits[0], 1: other}) == [(0,), (1,)]


@pytest.mark.parametrize("given", [[], [simulated(0), simulated(0)]], ids=["none", "two of one name"])
def test_no_study_is_refused(given):
    with pytest.raises(InputError, match="expected"):
        run_study(given, HOW)
