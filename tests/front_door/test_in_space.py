"""Commands on a body in space: its recordings are read, checked and drawn as those of a planar one are."""

from pathlib import Path

import numpy as np
import pytest
import torch
import xarray as xr

from invdyn.film import arm_points, film_frames, skeleton, still_parts
from invdyn.inference.plausible_for_body import rigid_distances
from invdyn.inputs import load_body, load_recording, read_table
from invdyn.models import Body, Joint, Link, dynamics_for
from invdyn.plots import plot_comparison, plot_posterior
from invdyn.recordings import InputError, Recording, write_keypoint_csv
from invdyn.simulate import resting

HINGED = """
name = "robot"
dimensions = 3
[[links]]
name = "turret"
joint = "pan"
mass = 1.0
com = [0.0, 0.0, 0.1]
inertia = [0.01, 0.01, 0.01, 0.0, 0.0, 0.0]
sites = {top = [0.0, 0.0, 0.2]}
[[links]]
name = "boom"
joint = "lift"
axis = [0.0, 1.0, 0.0]
origin = [0.0, 0.0, 0.2]
mass = 1.0
com = [0.15, 0.0, 0.0]
inertia = [0.001, 0.01, 0.01, 0.0, 0.0, 0.0]
sites = {tool = [0.3, 0.0, 0.0], camera = [0.2, 0.0, 0.05]}
"""


@pytest.fixture
def robot(tmp_path, monkeypatch):
    """Working directory with a robot of two hinges, and the robot."""
    (tmp_path / "robot.toml").write_text(HINGED)
    monkeypatch.chdir(tmp_path)
    return load_body("robot.toml")


def filmed(robot, sites, frames=20, **more):
    """A recording of some sites of a robot that sways."""
    time = 0.03 * np.arange(frames)
    angles = np.stack([np.sin(3 * time), 0.5 * np.cos(4 * time)], -1)
    points = dynamics_for(robot).keypoints(torch.tensor(angles), robot.parameters()).numpy()
    places = [robot.keypoint_names.index(site) for site in sites]
    return Recording(time, points[:, places], tuple(sites), **more)


def test_some_sites_are_enough_and_any_order_will_do(robot):
    write_keypoint_csv(filmed(robot, ["camera", "tool"]), "rec.csv")
    recording = load_recording("rec.csv", robot, frames="2:12")
    assert recording.keypoint_names == ("camera", "tool")
    assert recording.keypoints.shape == (10, 2, 3)


def test_a_trackers_markers_are_read_in_their_own_axes_and_unit(robot):
    """OpenSim's ground has y up; a .trc of millimetres holds markers that are no site, which are left out."""
    recording = filmed(robot, ["tool"])
    x, y, z = 1000 * recording.keypoints[:, 0].T
    columns = zip(recording.time, x, y, z, strict=True)
    rows = [f"{n}\t{t:.3f}\t{a:.6f}\t{c:.6f}\t{-b:.6f}\t0\t0\t0" for n, (t, a, b, c) in enumerate(columns, 1)]
    header = [
        "PathFileType\t4\t(X/Y/Z)\trec.trc",
        "DataRate\tNumFrames\tNumMarkers\tUnits",
        f"33.3\t{len(rows)}\t2\tmm",
    ]
    header += ["Frame#\tTime\ttool\t\t\thead\t\t", "\t\tX1\tY1\tZ1\tX2\tY2\tZ2"]
    with open("rec.trc", "w") as file:
        file.write("\n".join([*header, *rows]) + "\n")
    no_base = pytest.warns(UserWarning, match="no base is tracked .* pass --set base=NAME, the first joint's keypoint")
    with no_base, pytest.warns(UserWarning, match="y is up in this file"):
        read = load_recording("rec.trc", robot)
    assert read.keypoint_names == ("tool",)
    np.testing.assert_allclose(read.keypoints, recording.keypoints, atol=1e-8)


CART = """
name = "cart"
dimensions = 3
[[links]]
name = "carriage"
joint = "rail"
type = "slide"
axis = [1.0, 0.0, 0.0]
mass = 0.9
inertia = [1e-3, 1e-3, 1e-3, 0.0, 0.0, 0.0]
[[links]]
name = "pendulum"
joint = "swing"
type = "hinge"
axis = [0.0, 1.0, 0.0]
mass = 0.7
com = [0.0, 0.0, -0.2]
inertia = [4e-3, 4e-3, 1e-4, 0.0, 0.0, 0.0]
sites = {bob = [0.0, 0.0, -0.3]}
"""


def test_a_slide_stays_in_metres_where_angles_are_in_degrees(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cart.toml").write_text(CART)
    rows = [(0.02 * n, 0.01 * n, 3.0 * n) for n in range(12)]
    table = "\n".join("\t".join(f"{value:.4f}" for value in row) for row in rows)
    (tmp_path / "cart.mot").write_text(f"Coordinates\ninDegrees=yes\nendheader\ntime\trail\tswing\n{table}\n")
    cart = load_body("cart.toml")
    for read in (load_recording("cart.mot", cart), read_table(["cart.mot"], cart, as_it_stands=True)[0].recording):
        np.testing.assert_allclose(read.angles, np.array(rows)[:, 1:] * [1.0, np.pi / 180])


def test_a_tracked_base_moves_what_hangs_on_it(robot):
    shift = np.array([5.0, -3.0, 1.0])
    recording = filmed(robot, ["tool"])
    points = np.concatenate([recording.keypoints, np.zeros_like(recording.keypoints)], axis=1) + shift
    write_keypoint_csv(Recording(recording.time, points, ("tool", "foot")), "rec.csv")
    read = load_recording("rec.csv", robot, base="foot")
    assert read.keypoint_names == ("tool", robot.base_keypoint)
    np.testing.assert_allclose(read.keypoint("tool"), recording.keypoint("tool"), atol=1e-12)
    np.testing.assert_allclose(read.keypoint(robot.base_keypoint), 0.0, atol=1e-12)


def test_distances_that_no_motion_changes(robot):
    """Two sites of one link, and a site where the next link hangs: the top is the boom's own place."""
    found = rigid_distances(robot)
    expected = {("top", "tool"): 0.3, ("top", "camera"): np.hypot(0.2, 0.05), ("tool", "camera"): np.hypot(0.1, 0.05)}
    assert found == pytest.approx(expected)


WRONG = {
    "elsewhere": (
        lambda r: Recording(r.time, r.keypoints + 5.0, r.keypoint_names),
        {},
        "tool lies .* m from the base .* pass --set base=NAME, the first joint's keypoint",
    ),
    "a base": (
        lambda r: Recording(r.time, r.keypoints, ("foot", "camera")),
        {},
        "'foot' is not of the body, .*: rename .* or pass --set base=foot if it is the first joint's own track",
    ),
    "flat": (lambda r: Recording(r.time, r.keypoints[..., :2], r.keypoint_names), {}, "give tool_z and the like too"),
    "strange": (lambda r: Recording(r.time, r.keypoints, ("tol", "camera")), {}, "closest: 'tool'"),
    "millimetres": (lambda r: r.scaled(1000.0, "m"), {}, "pass --units"),
    "half the size": (lambda r: r.scaled(0.2, "m"), {}, "tool and camera lie 0.0224 m apart"),
    "a plane": (lambda r: r, {"plane": "xz"}, "moves in space: leave plane out"),
    "body lengths": (lambda r: r, {"scale": "body"}, "--scale body is for a chain in the plane"),
    "seconds": (lambda r: Recording(1000 * r.time, r.keypoints, r.keypoint_names), {}, "--units ms"),
    "degrees": (
        lambda r: Recording(
            r.time, r.keypoints, r.keypoint_names, angles=40 * np.sin([20 * r.time] * 2).T, joint_names=("pan", "lift")
        ),
        {},
        "pass --units deg",
    ),
}


@pytest.mark.parametrize(("change", "options", "message"), WRONG.values(), ids=WRONG)
def test_what_cannot_be_this_body_is_refused(robot, change, options, message):
    write_keypoint_csv(change(filmed(robot, ["tool", "camera"])), "rec.csv")
    with pytest.raises(InputError, match=message) as refusal:
        load_recording("rec.csv", robot, **options)
    assert str(refusal.value).count("\n") == 0


def test_a_body_without_points_is_refused(robot):
    write_keypoint_csv(filmed(robot, ["tool"]), "rec.csv")
    bare = Body("bare", [Link("rod", Joint("j"), mass=1.0, inertia=(1, 1, 1, 0, 0, 0))])
    with pytest.raises(InputError, match="names no point: give its last link a tip, or a site"):
        load_recording("rec.csv", bare)


def test_a_body_stays_where_it_hangs(robot):
    """The boom hangs straight down at any angle of the turret, which gravity does not move."""
    _, lift = resting(robot)
    assert lift == pytest.approx(np.pi / 2, abs=1e-4)


def test_what_gravity_does_not_move_stays_anywhere(robot):
    """A turret by itself: its energy is the same in every posture."""
    (pan,) = resting(Body("turret", robot.links[:1]))
    assert np.isfinite(pan)


def test_simulated_encoders_and_points(robot, run):
    outcome = run("simulate", "--body", "robot.toml", "--out", "rec.csv", "--duration", "1", "--set", "encoders=0.001")
    assert outcome.exit_code == 0, outcome.output
    recording = load_recording("rec.csv", robot)
    assert recording.keypoint_names == robot.keypoint_names
    seen = dynamics_for(robot).keypoints(torch.tensor(recording.angles), robot.parameters()).numpy()
    assert np.std(seen - recording.keypoints) == pytest.approx(0.005, rel=0.15)  # the points' noise, 270 numbers


def test_from_a_recording_to_torques(robot, run):
    """Encoders and one point: every output is there, and the bands hold the truth where they should."""
    run("simulate", "--body", "robot.toml", "--out", "rec.csv", "--truth", "truth.csv", "--duration", "0.6",
        "--fps", "50", "--set", "encoders=0.0005")  # fmt: skip
    outcome = run("infer", "rec.csv", "--body", "robot.toml", "--set", "truth=truth.csv", "--out", "p.nc", "--out",
                  "f.png", "--out", "f.sto", "--filters", "2", "--particles", "20")  # fmt: skip
    assert outcome.exit_code == 0, outcome.output
    row = next(line for line in outcome.stdout.splitlines() if line.startswith("lift")).split()
    assert float(row[-1]) > 0.5  # 90 % covers


@pytest.fixture(scope="module")
def posterior(make_posterior):
    """A posterior in space of three points, of which the second was not tracked; the third hangs on the first."""
    idata = make_posterior(3, num_frames=12)
    for group, keep in (("posterior", [0, 1, 2]), ("posterior_predictive", [0, 2]), ("observed_data", [0, 2])):
        flat = idata[group]["position"]
        up = flat.isel(space=[0]).assign_coords(space=["z"]) * 0.5
        own = xr.concat([flat, up], "space").isel(keypoint=keep).assign_attrs(units="m")
        idata[group] = idata[group].drop_vars(["position", "space", "keypoint"]).assign(position=own)
    idata.constant_data = idata.constant_data.assign(
        skeleton=(("edge", "end"), [[-1, 0], [0, 1], [0, 2]]), base=(("axes",), [0.1, 0.2, 0.3])
    )
    return idata


def test_a_figure_shows_the_points_that_were_tracked(posterior):
    figure = plot_posterior(posterior)
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    first, _, last = posterior.posterior.keypoint.values
    assert [title for title in titles if title.endswith("keypoint")] == [f"{first} keypoint", f"{last} keypoint"]
    assert len(figure.axes[0].get_lines()) == 6  # of x, y and z: a median, and dots


def test_rows_that_tell_nothing_of_a_coordinate_are_hatched(posterior):
    """A run, a single row, and one to the end: each from halfway to the row before to halfway to the next."""
    unseen = np.zeros((12, 3), np.int8)
    unseen[[2, 3, 7, 10, 11], 1] = 1
    marked = posterior.copy()
    marked.constant_data = marked.constant_data.assign(unseen=(("time", "joint"), unseen))
    name, time = posterior.posterior.joint.values[1], posterior.posterior.time.values
    rows = np.array([[1.5, 3.5], [6.5, 7.5], [9.5, 11.0]]) * (time[1] - time[0])
    for figure, titles in (
        (plot_posterior(marked), (f"{name} angle", f"{name} torque")),
        (plot_comparison({"smc": marked}), (f"{name} torque",)),
        (still_parts(marked, arm_points(marked), np.zeros((12, 1, 3)), None)[0], (f"{name} torque (N·m)",)),
    ):
        hatched = {axes.get_title(loc="left"): spans for axes in figure.axes if (spans := hatches(axes))}
        for title in titles:
            np.testing.assert_allclose(hatched.pop(title), rows)
        assert all(title.startswith("less the") for title in hatched)  # what a comparison's right half shows
        assert figure.legends[0].get_texts()[-1].get_text() == "not seen: the prior"
    assert not any(hatches(axes) for axes in plot_posterior(posterior).axes)


def hatches(axes):
    """Begin and end, s, of what is hatched."""
    return [
        span.get_extents().transformed(axes.transData.inverted()).intervalx for span in axes.patches if span.get_hatch()
    ]


def test_a_film_has_two_views_along_the_bodys_own_lines(posterior):
    assert skeleton(posterior) == [[0, 1, 2], [1, 3]]
    np.testing.assert_allclose(arm_points(posterior)[0, 0, 0], [0.1, 0.2, 0.3])
    frames = list(film_frames(posterior, np.arange(3)))
    assert len(frames) == 3
    height, width, _ = frames[0].shape
    blue = np.array([0, 114, 178])
    seen = (np.abs(frames[0].astype(int) - blue).max(-1) < 30)[: height // 2]
    assert seen[:, : width // 2].sum() > 50
    assert seen[:, width // 2 :].sum() > 50


def test_a_diagnosis_takes_a_body_in_space(robot, run):
    """Its whole search is in tests/diagnosis/test_in_space.py; too few rows are an answer, with a picture."""
    write_keypoint_csv(filmed(robot, ["tool", "camera"]).select(0, 8), "rec.csv")
    outcome = run("diagnose", "rec.csv", "--body", "robot.toml", "--out", "out")
    assert outcome.exit_code == 0, outcome.stderr
    assert outcome.stdout.startswith("Not enough data")
    assert Path("out/report.html").read_text(encoding="utf-8").count('<svg class="arm"') == 2
