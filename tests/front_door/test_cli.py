"""The commands: what each writes, and that it does what was said."""

import re
import subprocess
import sys
import warnings
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
import typer.main

import invdyn.inference
from invdyn.cli import app
from invdyn.diagnosis_options import Diagnosed
from invdyn.options import present_names
from invdyn.plots import quantiles
from invdyn.recordings import load, read_sto, read_table, read_truth
from invdyn.renamed_options import RENAMED, SETTINGS, with_new_names
from invdyn.settings import spelled
from invdyn.summary import independent_draws, summary_text

GIVEN = {"arm.toml", "rec.csv", "hand.csv"}


# -- help -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", ["simulate", "infer", "plot", "demo"])
def test_each_command_explains_itself(command, run):
    outcome = run(command, "--help")
    assert outcome.exit_code == 0
    assert "--out" in outcome.stdout
    assert command in run("--help").stdout


def test_a_help_fits_80_columns_uncut(run):
    listed = run("--help").stdout.split("Commands:")[1]
    assert "..." not in listed
    for command in ("", *(line.split()[0] for line in listed.strip().splitlines())):
        assert max(map(len, run(*command.split(), "--help").stdout.splitlines())) <= 80


def test_options_stand_in_groups_and_settings_below(run):
    titles = [line for line in run("infer", "--help").stdout.splitlines() if line.endswith(":") and line[0] != " "]
    assert titles == [
        "Arguments:",
        "Recording:",
        "Model:",
        "Computation:",
        "Settings, each as --set NAME=VALUE:",
        "Options:",
    ]


def test_the_old_name_of_a_method_works_with_a_warning():
    with pytest.warns(UserWarning, match="the method 'nested' is now 'smc'"):
        assert present_names("nested, laplace") == "smc,laplace"
    assert present_names("laplace") == "laplace"


def test_a_field_is_called_what_a_command_line_calls_it():
    names = {"mapping": "--map", "episodes": "--set episodes", "held_out": "--held-out"}
    assert {name: spelled(Diagnosed, name) for name in names} == names


def test_settings_that_old_options_name_exist():
    commands = typer.main.get_command(app).commands.values()
    known = {name.replace("_", "-") for each in commands for name in getattr(each.callback, "settings", ())}
    flags = [re.match("--set (.+?)=", new) for new in RENAMED.values()]
    assert {*SETTINGS, *(flag[1] for flag in flags if flag)} <= known


def test_old_flags_become_values():
    own, warned = {"--torque", "--set", "--set browser=", "--set sd="}, []
    found = with_new_names(["a.csv", "--kinematic", "--no-browser", "--sd=x.csv"], own, {"--set"}, warned.append)
    assert found == ["a.csv", "--torque", "none", "--set", "browser=no", "--set", "sd=x.csv"]
    assert [line.split(";")[0] for line in warned] == [
        "--kinematic is now --torque none",
        "--no-browser is now --set browser=no",
        "--sd is now --set sd=…",
    ]
    assert with_new_names(["--no-confine"], own, {"--set"}, warned.append) == ["--no-confine"]  # not of this command
    for words, said in (
        (["--kinematic", "--torque", "auto"], "--kinematic is --torque none now, and --torque is given too"),
        (["--kinematic=yes"], "--kinematic is --torque none now: expected no value of --kinematic, got 'yes'"),
        (["a.csv", "--sd"], "--sd is --set sd=… now: expected a value, got none"),
    ):
        with pytest.raises(ValueError, match=said):
            with_new_names(words, own, {"--set"}, warned.append)


def test_old_options_work_with_a_warning_each(folder, quick_inference, run, contents):
    call = ("infer", "rec.csv", "--body", "arm.toml", "--out", "p.nc")
    old = (
        "--passive",
        "--learn-lengths",
        "--csv",
        "t.csv",
        "--figure=f.png",
        "--device",
        "cpu",
        "--filters-per-task=2",
    )
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        outcome = run(*call, *old)
    assert outcome.exit_code == 0, outcome.output
    assert [line.split(";")[0] for line in outcome.stderr.splitlines()] == [
        "warning: --passive is now --zero-torque",
        "warning: --learn-lengths is now --learn lengths",
        "warning: --csv is now --out",
        "warning: --figure is now --out",
        "warning: --device is now --set device=…",
        "warning: --filters-per-task is now --set filters-per-task=…",
    ]
    new = (
        "--zero-torque",
        "--learn",
        "lengths",
        "--out",
        "u.csv",
        "--set",
        "device=cpu",
        "--set",
        "filters_per_task=2",
    )
    assert run(*call, *new).stderr == ""
    before, after = ({**each, "recording": None, "body": None} for each in quick_inference)
    assert before == after
    assert (before["passive"], before["filters_per_task"]) == (True, 2)
    assert {"t.csv", "f.png", "u.csv"} <= set(contents(folder))


def test_version(run):
    outcome = run("--version")
    assert outcome.exit_code == 0
    assert outcome.stdout == f"invdyn {version('invdyn')}\n"


def test_help_imports_nothing_heavy():
    script = (
        "import sys\n"
        "sys.argv = ['invdyn', '--help']\n"
        "from invdyn.cli import app\n"
        "try:\n    app()\nexcept SystemExit as end:\n    assert end.code == 0\n"
        "heavy = {'torch', 'pyro', 'matplotlib', 'arviz.data', 'pandas', 'numpy', 'scipy'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    subprocess.run([sys.executable, "-c", script], check=True, capture_output=True)


# -- what is written --------------------------------------------------------------------------------------


def test_simulate_writes_a_recording_and_its_truth(folder, run):
    outcome = run("simulate", "--body", "arm.toml", "--out", "sim.csv", "--truth", "truth.csv",
                  "--duration", 2, "--fps", 20, "--noise", 0.01, "--commanded", "--seed", 3)  # fmt: skip
    assert outcome.exit_code == 0, outcome.output
    recording, truth = load("sim.csv"), read_truth("truth.csv")
    assert recording.num_frames == 40
    assert recording.keypoint_names == ("elbow", "wrist")
    np.testing.assert_allclose(recording.torques, truth.torque, rtol=1e-9)
    first = Path("sim.csv").read_bytes()
    again = ("simulate", "--body", "arm.toml", "--out", "sim.csv", "--duration", 2, "--fps", 20)
    run(*again, "--noise", 0.01, "--commanded", "--seed", 3)
    assert Path("sim.csv").read_bytes() == first
    run(*again, "--noise", 0.01, "--commanded", "--seed", 4)
    assert Path("sim.csv").read_bytes() != first


def test_infer_writes_all_that_is_wanted(folder, quick_inference, run, contents):
    wanted = ["p.nc", "f.png", "f.gif", "t.sto", "t.csv"]
    outcome = run("infer", "rec.csv", "--body", "arm.toml", "--out", "p.nc", "--out", "f.png",
                  "--out", "f.gif", "--out", "t.sto", "--out", "t.csv")  # fmt: skip
    assert outcome.exit_code == 0, outcome.output
    assert set(contents(folder)) == {*GIVEN, *wanted}
    for name in wanted:
        assert name in outcome.stdout
    assert "shoulder" in outcome.stdout
    idata = invdyn.inference.load_posterior("p.nc")
    low, _, median, _, high = quantiles(idata, "torque")
    moments, (table, _) = read_sto("t.sto"), read_table("t.csv")
    for number, joint in enumerate(("shoulder", "elbow")):
        for ending, values in (("moment", median), ("q05", low), ("q95", high)):
            np.testing.assert_allclose(moments[f"{joint}_{ending}"], values[:, number], rtol=1e-8)
        np.testing.assert_allclose(table[f"{joint}_torque"], median[:, number], rtol=1e-12)
    np.testing.assert_allclose(table["time"], idata.posterior.time)


def test_infer_passes_on_what_was_said(folder, quick_inference, run):
    Path("truth.csv").write_text("time,shoulder_torque,shoulder_angle,shoulder_velocity,elbow_torque,elbow_angle,"
                                 "elbow_velocity\n0,1,2,3,4,5,6\n1,1,2,3,4,5,6\n")  # fmt: skip
    outcome = run("infer", "rec.csv", "--body", "arm.toml", "--out", "p.nc", "--set", "truth=truth.csv",
                  "--method", "bootstrap", "--filters", 3, "--particles", 7, "--set", "draws=2", "--seed", 5,
                  "--frames", "2:10", "--learn", "lengths", "--zero-torque", "--set", "hide_torque=yes")  # fmt: skip
    assert outcome.exit_code == 0, outcome.output
    (call,) = quick_inference
    assert call["recording"].time[0] == pytest.approx(0.06)
    assert call["recording"].num_frames == 8
    assert call["body"].joint_names == ("shoulder", "elbow")
    assert call["truth"].torque[0].tolist() == [1, 4]
    expected = {"method": "bootstrap", "num_filters": 3, "num_particles": 7, "num_draws": 2, "seed": 5}
    expected |= dict.fromkeys(("learn_lengths", "passive", "hide_torque"), True)
    assert {name: call[name] for name in expected} == expected
    assert "90 % covers" in outcome.stdout


def test_a_tracked_base_is_kept_and_its_middle_is_the_bodys(folder, quick_inference, run):
    rows = [f"{0.03 * f},{5 + f},7,{6 + f},7.0,{7 + f},7.0\n" for f in range(5)]
    Path("rec.csv").write_text("time,shoulder_x,shoulder_y,elbow_x,elbow_y,wrist_x,wrist_y\n" + "".join(rows))
    assert run("infer", "rec.csv", "--body", "arm.toml", "--out", "p.nc").exit_code == 0
    recording = quick_inference[0]["recording"]
    assert recording.keypoint_names == ("shoulder", "elbow", "wrist")
    np.testing.assert_allclose(recording.keypoints[3], [[1, 0], [2, 0], [3, 0]])


@pytest.mark.parametrize("link", [1.0, 0.5])
def test_film_without_scale_is_as_long_as_the_body(link, folder, quick_inference, run):
    tracks = [f"{f},100,200,0.9,160,200,0.9,160,{160 + f},0.9\n" for f in range(5)]
    Path("film.csv").write_text(
        "scorer"
        + ",net" * 9
        + "\nbodyparts"
        + "".join(f",{p}" * 3 for p in ("shoulder", "elbow", "wrist"))
        + "\ncoords"
        + ",x,y,likelihood" * 3
        + "\n"
        + "".join(tracks)
    )
    call = ("infer", "film.csv", "--body", "arm.toml", "--out", "p.nc", "--units", "px", "--fps", 30)
    refused = run(*call)
    assert refused.exit_code == 2
    assert "--scale", "body" in refused.stderr
    Path("arm.toml").write_text(Path("arm.toml").read_text().replace("length = 1.0", f"length = {link}"))
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        outcome = run(*call, "--scale", "body")
    assert outcome.exit_code == 0
    said = "as long as the body's links together, 2 m" in outcome.stderr
    recording = quick_inference[0]["recording"]
    assert (recording.length_unit, said) == (("m", True) if link == 1.0 else ("body length", False))
    total = (60 + 38) / (2 * link)  # px: median lengths of the two links
    np.testing.assert_allclose(recording.keypoints[2], [[0, 0], [60 / total, 0], [60 / total, 38 / total]])


def test_plot_draws_a_saved_posterior_again(folder, quick_inference, run):
    run("infer", "rec.csv", "--body", "arm.toml", "--out", "p.nc", "--out", "first.png")
    outcome = run("plot", "p.nc", "--out", "again.png", "--out", "film.gif", "--out", "t.sto")
    assert outcome.exit_code == 0, outcome.output
    assert Path("again.png").read_bytes() == Path("first.png").read_bytes()
    assert Path("film.gif").stat().st_size > 1000
    assert "shoulder" in outcome.stdout


def test_simulate_infer_plot_end_to_end(folder, run):
    """Nothing replaced: the real inference, small."""
    simulated = run("simulate", "--body", "arm.toml", "--out", "sim.csv", "--truth", "truth.csv",
                    "--duration", 1, "--fps", 30, "--seed", 1)  # fmt: skip
    assert simulated.exit_code == 0, simulated.output
    call = [
        "infer",
        "sim.csv",
        "--body",
        "arm.toml",
        "--set",
        "truth=truth.csv",
        "--filters",
        4,
        "--particles",
        50,
        "--torque",
        "ornstein_uhlenbeck",
    ]
    outcome = run(*call, "--out", "p.nc", "--out", "f.png", "--seed", 1)
    assert outcome.exit_code == 0, outcome.output
    idata = invdyn.inference.load_posterior("p.nc")
    assert idata.posterior.torque.dims == ("chain", "draw", "time", "joint")
    assert np.isfinite(idata.posterior.torque).all()
    assert run("plot", "p.nc", "--out", "again.png").exit_code == 0


def test_a_posterior_of_too_few_draws_says_so(make_posterior):
    words = "warning: bands of 20 independent draws or more mean something, these rest on "
    assert words not in summary_text(make_posterior(num_filters=6))
    assert f"{words}4: raise --filters, --particles or --set draws" in summary_text(make_posterior(num_filters=1))
    one = make_posterior(num_filters=6)
    one.posterior["angle"][:] = one.posterior["angle"][:1].values  # copies of one filter's draws
    assert f"{words}4:" in summary_text(one)
    same = make_posterior(num_filters=6)
    same.posterior["angle"][:, 1:] = same.posterior["angle"][:, :1].values  # one particle a filter
    assert independent_draws(same) == pytest.approx(6, abs=1)
    same.attrs["method"] = "differentiate"
    assert words not in summary_text(same)
    chains = make_posterior(num_filters=6)
    chains.sample_stats.attrs["ess_bulk"] = 7.0
    assert f"{words}7:" in summary_text(chains)


@pytest.mark.long
def test_three_rows_are_enough_and_their_bands_wide(folder, run):
    run("simulate", "--body", "arm.toml", "--duration", 1, "--out", "sim.csv")
    widths = []
    for rows in ("0:3", "0:30"):
        call = ("infer", "sim.csv", "--body", "arm.toml", "--frames", rows, "--method", "laplace", "--out", "c.csv")
        assert run(*call, "--out", "p.nc").exit_code == 0
        table, _ = read_table("c.csv")
        widths.append(np.mean(table["shoulder_torque_q95"] - table["shoulder_torque_q05"]))
    assert widths[0] > 2 * widths[1]


@pytest.mark.filterwarnings("ignore:.*the last position was written again:UserWarning")  # the film repeats frames
def test_a_known_recording_by_its_name(folder, run, with_human_arm):
    call = ("infer", "human-arm", "--body", "human_arm_on_table", "--scale", "body", "--frames", "50:65")
    outcome = run(*call, "--method", "laplace", "--torque", "ornstein_uhlenbeck", "--out", "p.nc", "--out", "f.gif")
    assert outcome.exit_code == 0, outcome.output
    idata = invdyn.inference.load_posterior("p.nc")
    assert idata.posterior.sizes["time"] == 15
    assert idata.posterior.position.attrs["units"] == "body length"
    assert Path("f.gif").stat().st_size > 10_000


@pytest.mark.long
def test_demo_leaves_everything_and_says_where(folder, run, contents):
    outcome = run("demo", "--out", "shown/here")
    assert outcome.exit_code == 0, outcome.output
    files = {"posterior.nc", "figure.png", "film.gif", "torques.sto", "torques.csv"}
    files |= {"recording.csv", "truth.csv", "arm.toml"}
    assert set(contents(folder / "shown" / "here")) == files
    assert all(f"shown/here/{file}" in outcome.stdout for file in files)
    low, _, _, _, high = quantiles(invdyn.inference.load_posterior("shown/here/posterior.nc"), "torque")
    truth = read_truth("shown/here/truth.csv").torque
    # 400 of them, but neighbours in time agree: some 60 independent ones
    assert np.mean((low <= truth) & (truth <= high)) == pytest.approx(0.9, abs=4 * np.sqrt(0.09 / 60))


@pytest.mark.quick("laplace")
@pytest.mark.parametrize("method", ["laplace", "differentiate"])
def test_a_method_without_filters_is_drawn_and_summarised_too(folder, run, method):
    run("simulate", "--body", "paper_planar_arm", "--duration", 1, "--out", "short.csv")
    outputs = ("p.nc", "p.png", "p.sto", "p.csv")
    options = [word for name in outputs for word in ("--out", name)]
    done = run("infer", "short.csv", "--body", "paper_planar_arm", "--method", method, *options)
    assert done.exit_code == 0, done.output
    assert all(Path(name).stat().st_size > 0 for name in outputs)
    assert "effective sample size" not in done.stdout
    assert "nan" not in done.stdout.lower()
