"""A small study: labels, sharing, what is left out, and the same bits after each interruption."""

from dataclasses import replace

import h5py
import numpy as np
import pytest
import torch
import xarray as xr

from invdyn.inference import infer, open_executor
from invdyn.inference.execution.records import Plain
from invdyn.inference.filters.filtering import SMCOptions
from invdyn.inference.study import run as run_module
from invdyn.inference.study import work
from invdyn.inference.study.run import _fingerprint, _groups, run_study
from invdyn.inference.study.trial import How, Trial
from invdyn.inference.study.work import (
    fit_trial,
    infer_trial,
    share_session,
)
from invdyn.inputs import load_body
from invdyn.models import SmoothAndRough, planar_body
from invdyn.recordings import InputError, load, read_sto
from invdyn.simulate import random_arm, record

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
        assert Plain().of(part) == Plain().of(other.posteriors[place])  # which has arrays by their content


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
    assert not torch.equal(one["values"]["torque.scale"], two["values"]["torque.scale"])
    alone = [fit_trial(trial, HOW) for trial in trials[:2]]
    again = share_session(trials[:2], alone, HOW)
    for name, value in one["values"].items():
        assert torch.equal(value, again["values"][name])
    noise = [float(fit["values"]["emission.keypoint_scale"].log().mean()) for fit in alone]
    shared = float(one["values"]["emission.keypoint_scale"].log().mean())
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
    assert infer_trial(own[0], HOW, fits[0], shared, 0)["notes"] == []
    assert drawn[0].candidates[0].of_more_rows
    assert infer_trial(own[0], HOW, fits[0], fits[0], 0)["notes"] == []
    assert not drawn[1].candidates[0].of_more_rows


def test_a_posterior_is_at_the_parameters_of_its_session(trials, monkeypatch):
    """What the trial's own fit found is where its path begins; what its session does not explain is left out."""
    fit = fit_trial(trials[0], HOW)
    own = infer_trial(trials[0], HOW, fit, fit, 5)
    other = {**fit, "values": {name: 3.0 * value for name, value in fit["values"].items()}}
    assert torch.equal(infer_trial(trials[0], HOW, other, fit, 5)["torque"], own["torque"])
    assert not torch.equal(infer_trial(trials[0], HOW, fit, fit, 6)["torque"], own["torque"])
    # 8 draws kept of 64
    assert (own["spread"] / own["torque"].double().std(0)).median().item() == pytest.approx(1.0, abs=0.2)
    monkeypatch.setattr(work, "evidence_note", lambda idata: "too rough")
    assert infer_trial(trials[0], HOW, fit, fit, 5)["left_out"] == "the evidence of laplace is too rough"
    at = []

    def unexplained(problem, path):
        at.append(problem.model.parameters)
        return ["it is off"]

    monkeypatch.setattr(work, "unexplained", unexplained)
    assert infer_trial(trials[0], HOW, fit, other, 5)["left_out"] == "at its session's parameters it is off"
    for name, value in other["values"].items():
        assert at[0][name].numpy() == pytest.approx(value.numpy())


def test_a_trial_without_evidence_keeps_no_session_from_sharing(trials):
    """Its path is infinite: no linearisation of it has an evidence."""
    alone = [fit_trial(trial, HOW) for trial in trials[:2]]
    broken = {**alone[1], "path": alone[1]["path"] * float("inf")}
    shared = share_session([*trials[:2], trials[1]], [*alone, broken], HOW)
    expected = share_session(trials[:2], alone, HOW)
    for name, value in expected["values"].items():
        assert shared["values"][name].numpy() == pytest.approx(value.numpy(), rel=0.15)  # it begins elsewhere


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
    names = list(part["quantities"])
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


def test_a_process_of_the_torque_does_not_change_a_checkpoint(trials):
    def own(*given):
        return _fingerprint(trials[:1], How(binding={"torque": SmoothAndRough(*given)}))

    assert own() == own()
    assert own() != own(0.3)


def test_tracks_of_other_points_share_nothing(trials):
    first = trials[0]
    other = replace(first, name="o", recording=first.recording.with_keypoints(first.recording.keypoint_names[::-1]))
    fits = {k: {"values": {}} for k in range(3)}
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
    elsewhere = replace(first, recording=replace(first.recording, name="another/folder.csv"))
    assert _fingerprint([elsewhere], HOW) == own
    fits = {k: {"values": {}} for k in range(2)}
    assert _groups([first, heavy], fits) == [(0,), (1,)]
    other = {"values": {"torque.scale": torch.ones(3)}}
    assert _groups([first, trials[1]], {0: fits[0], 1: other}) == [(0,), (1,)]


@pytest.mark.parametrize("given", [[], [simulated(0), simulated(0)]], ids=["none", "two of one name"])
def test_no_study_is_refused(given):
    with pytest.raises(InputError, match="expected"):
        run_study(given, HOW)
