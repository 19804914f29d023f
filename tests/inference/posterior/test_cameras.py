"""A film of several cameras bound to a body: its rows, and what is fitted of lengths, clocks and poses."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scenes import looking, ring
from scipy.spatial.transform import Rotation

from invdyn.inference import SMCOptions
from invdyn.inference.fitting.log_parameters import Free, LogParameters
from invdyn.inference.fitting.marginal_likelihood import fit
from invdyn.inference.free_parameters import free_parameters
from invdyn.inference.methods.laplace import laplace
from invdyn.inference.methods.smc import smc
from invdyn.inference.posterior.cameras import pinhole
from invdyn.inference.posterior.initialise import arm_problem
from invdyn.inference.smoothing.gauss_newton import gauss_newton
from invdyn.inference.study.run import _fingerprint, run_study
from invdyn.inference.study.trial import How, Trial
from invdyn.models import ArmModel, Body, Joint, Keypoints, Learned, Link, Observation
from invdyn.models.observation import pinhole as in_torch
from invdyn.recordings import InputError, Recording
from invdyn.recordings.cameras import Calibration, Views, filmed, project

FRAMES, RATE, FINE = 24, 30.0, 10
HANGING = ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0))
KNOWN = {"torque.scale": 1.0, "torque.decay": 4.0, "emission.pixel_scale": 1.0, "emission.bias_scale": 2.0}
KNOWN |= {"emission.bias_time": 0.3, "initial.angle_scale": 0.5}


def rod(length=0.4):
    """A stick that hangs before the cameras, and its tip."""
    inertia = (0.01, 0.02, 0.02, 0.0, 0.0, 0.0)
    link = Link(
        "rod",
        Joint("pivot", "universal"),
        origin=(0.0, 0.0, 1.0),
        rotation=HANGING,
        length=length,
        tip="tip",
        mass=1.0,
        inertia=inertia,
    )
    return Body("rod", [link])


def views_of(calibration, offsets=(), seed=0):
    """What trackers give: noise of 1 px, 2 px that last, a camera's clock ahead; and the pixels' true middle."""
    moments = np.arange(FRAMES * FINE) / (FINE * RATE)
    own = {"initial.angle": [0.6, 0.3], "initial.angle_scale": 0.1, "initial.velocity": [5.0, 1.0]}
    torch.manual_seed(seed)
    slack = {"noise.angle": 1e-6, "noise.velocity": 1e-6}
    model = ArmModel(rod(), moments, Observation(Keypoints([0])), parameters={**KNOWN_TORQUE, **own, **slack})
    angles = model.split(model.simulate()[0])[1]
    points = model.dynamics.keypoints(angles, model.body_parameters()).numpy()
    rows = np.arange(FRAMES) * FINE
    rng, pixels = np.random.default_rng(seed), []
    for c, camera in enumerate(calibration):
        at = moments[rows] - (offsets[c] if offsets else 0.0)
        shown = np.stack([np.interp(at, moments, column) for column in points.reshape(len(points), 3).T], -1)
        pixels.append(project(camera, shown[:, None]))
    whole = np.stack(pixels, 1)
    lasting = 2 * rng.standard_normal(whole.shape)
    keep = np.exp(-1 / (0.3 * RATE))
    for t in range(1, FRAMES):
        lasting[t] = keep * lasting[t - 1] + np.sqrt(1 - keep**2) * lasting[t]
    whole = whole + lasting + rng.standard_normal(whole.shape)
    return Views(calibration, moments[rows], whole, np.ones(whole.shape[:3]), ("tip",))


KNOWN_TORQUE = {name: value for name, value in KNOWN.items() if name.startswith("torque.")}


def test_cameras_are_the_readers():
    points = np.random.default_rng(0).normal(0, 0.3, (5, 2, 3)) + np.array([0, 0, 1])
    bent = looking("fish", (3.0, 0, 1.0), distortion=(0.02, -0.01, 0.002, 0.0), fisheye=True)
    calibration = Calibration((*ring(2), bent), metric=True)
    ours, seen = in_torch.project(pinhole(calibration), torch.as_tensor(points))
    assert seen.all()
    for c, camera in enumerate(calibration):
        np.testing.assert_allclose(ours[:, c], project(camera, points), rtol=0, atol=1e-9)


@pytest.mark.long
def test_rows_and_start():
    views = views_of(ring(3))
    views.pixels[4, 1] = np.nan
    problem = arm_problem(filmed(views), rod(), family="student_t")
    seen = problem.model.observation.of(problem.model.observation.pixels, problem.observations)
    np.testing.assert_array_equal(seen, views.pixels)
    p = problem.model.parameters
    assert 0.5 < p["emission.pixel_scale"].median() < 2  # px, 1
    assert 1 < p["emission.bias_scale"].median() < 4  # px, 2 beside 1 of noise
    path = problem.model.initial_paths(problem.observations)
    assert torch.isfinite(problem.model.log_joint(path, problem.observations)).all()
    names = {free.name for free in free_parameters(problem)}
    assert {"emission.pixel_scale", "emission.bias_scale", "emission.bias_time"} <= names
    assert not any(name.startswith("camera.") for name in names)
    learned = arm_problem(filmed(views), rod(), learn_cameras=("offset", "pose"))
    entries = {free.name: free.entries for free in free_parameters(learned) if free.name.startswith("camera.")}
    assert entries == {
        "camera.offset": (1, 2),
        "camera.turn": tuple(range(3, 9)),
        "camera.shift": tuple(range(3, 9)),
    }


def test_what_cannot_be_learned_is_reported():
    film = filmed(views_of(ring(2)))
    with pytest.raises(InputError, match="of cameras offset, pose, turn may be learned, got 'lens'"):
        arm_problem(film, rod(), learn_cameras=("lens",))
    with pytest.raises(InputError, match="expected pose or turn to be learned of cameras, got both"):
        arm_problem(film, rod(), learn_cameras=("turn", "pose"))
    points = Recording(film.time, film.keypoints, film.keypoint_names)
    with pytest.raises(InputError, match="is no film of several cameras"):
        arm_problem(points, rod(), learn_cameras=("pose",))


def test_a_clock_that_is_20_ms_ahead_is_found():
    views = views_of(ring(3), offsets=(0.0, 0.02, 0.0))
    problem = arm_problem(filmed(views), rod(), parameters=KNOWN, learn_cameras=("offset",), substeps=1)
    found = fit(problem.model, problem.observations, [Free("camera.offset", sd=1.0, entries=(1, 2), unit=0.05)])
    sd = 0.05 * found.log_sd["camera.offset"]
    off = found.model.parameters["camera.offset"].numpy()[1:] - [0.02, 0.0]
    assert found.converged
    assert (sd < 5e-3).all()  # s; what lasts, 2 px, is 6 mm, and the tip moves at 2 m/s
    assert (np.abs(off) < 3 * sd).all()


def test_a_study_of_films_knows_its_checkpoint_by_their_pixels_and_cameras():
    films = [filmed(views_of(ring(3), offsets)) for offsets in ((0.0, 0.0, 0.0), (0.0, 0.02, 0.0))]
    own, same, other = (_fingerprint([Trial("t", film, rod())], How()) for film in (films[0], films[0], films[1]))
    assert own == same != other


@pytest.mark.long
def test_a_session_shares_the_clocks_of_its_cameras():
    """One camera is 20 ms ahead in all trials of a study: their session knows it better than each of them."""
    trials = [Trial(f"t{seed}", filmed(views_of(ring(3), (0.0, 0.02, 0.0), seed)), rod()) for seed in range(3)]
    how = How(sizes=SMCOptions(num_filters=8, num_draws=2), settings=KNOWN, binding={"learn_cameras": ("offset",)})
    study = run_study(trials, how)
    ((members, shared),) = study.sessions
    assert members == tuple(study.posteriors) == (0, 1, 2)
    parts = (shared, *study.fits)
    sds = [0.05 * part["covariance"].diagonal().sqrt() for part in parts]  # a clock's unit is .05 s
    for part, sd in zip(parts, sds, strict=True):
        off = part["values"]["camera.offset"] - torch.tensor([0.0, 0.02, 0.0])
        assert (off[1:].abs() < 3 * sd).all()
    alone = torch.stack(sds[1:]).square().reciprocal().sum(0).rsqrt()
    assert sds[0] == pytest.approx(alone, rel=0.1), "as three trials together tell it"


@pytest.mark.long
def test_cameras_that_are_rotated_are_integrated_out():
    """A calibration half a degree off: without turns, what is off for good is taken for what lasts."""
    views = views_of(ring(3))
    by = np.random.default_rng(3).normal(0, 0.01, (3, 3))
    off = tuple(
        replace(camera, rotation=about @ camera.rotation, translation=about @ camera.translation)
        for camera, about in zip(views.calibration, Rotation.from_rotvec(by).as_matrix(), strict=True)
    )
    given = filmed(replace(views, calibration=Calibration(off, metric=True)))
    found = {}
    for learn in ((), ("turn",)):
        problem = arm_problem(given, rod(), parameters=KNOWN, learn_cameras=learn, substeps=1)
        found[learn] = gauss_newton(problem.model, problem.observations)
    assert found[("turn",)].log_evidence > found[()].log_evidence + 10
    names = {free.name: free for free in free_parameters(problem, tuple(KNOWN))}
    assert names["camera.turn_scale"].tied
    own = slice(-4 - 9, -4)  # before two angles and their velocities
    turn = -found[("turn",)].path[0, own].reshape(3, 3).numpy()  # the cameras as given are rotated back
    sd = found[("turn",)].covariance()[0].diagonal()[own].sqrt().reshape(3, 3).numpy()
    assert (np.abs(turn - by) < 3 * sd).all()
    assert (sd < 0.0105).all()
    assert sd.min() < 0.005  # something was learned


@pytest.mark.long
def test_a_length_is_learned_from_two_cameras():
    problem = arm_problem(filmed(views_of(ring(2))), rod(Learned(0.3)), parameters=KNOWN, substeps=1)
    (free,) = [free for free in free_parameters(problem, tuple(KNOWN)) if free.name == "body.sites"]
    found = fit(problem.model, problem.observations, [free])
    sd = 0.4 * found.log_sd["body.sites"][0]
    assert sd < 0.01
    assert abs(float(found.model.parameters["body.sites"][0, 0]) - 0.4) < 3 * sd


@pytest.mark.long
def test_filters_agree_with_the_gaussian_smoother():
    """Of noise that is Gaussian, and a rod that turns little within it: both have nearly the same evidence."""
    problem = arm_problem(filmed(views_of(ring(2))), rod(), parameters=KNOWN, substeps=1)
    options = SMCOptions(num_filters=4, num_particles=100, num_draws=2)
    by_filters, smoothed = (method(problem, options=options) for method in (smc, laplace))
    assert by_filters.attrs["log_evidence"] == pytest.approx(smoothed.attrs["log_evidence"], abs=0.5)
    assert by_filters.attrs["outer_ess"] > 2  # of 4
    assert "unseen" not in smoothed.attrs  # two cameras tell all of a rod
    torques = [each["posterior"]["torque"].mean(("chain", "draw")) for each in (by_filters, smoothed)]
    scatter = smoothed["posterior"]["torque"].std(("chain", "draw"))
    assert float(np.abs(torques[0] - torques[1]).mean()) < float(scatter.mean())  # 8 draws of each


def test_parameters_with_a_unit_are_shifted_and_others_scaled():
    problem = arm_problem(filmed(views_of(ring(2))), rod(), parameters=KNOWN, learn_cameras=("offset",), substeps=1)
    parameters = LogParameters(
        problem.model, [Free("camera.offset", entries=(1,), unit=0.05), Free("torque.scale", tied=True)]
    )
    moved = parameters.at(torch.tensor([-0.4, np.log(2.0)], dtype=torch.float64)).parameters
    torch.testing.assert_close(moved["camera.offset"], torch.tensor([0.0, -0.02], dtype=torch.float64))
    torch.testing.assert_close(moved["torque.scale"], torch.tensor([2.0, 2.0], dtype=torch.float64))
    many = parameters.at(torch.zeros(5, 2, dtype=torch.float64)).parameters
    assert many["camera.offset"].shape == (5, 1, 2)
