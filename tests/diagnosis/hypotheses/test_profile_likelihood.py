"""Effects on the scatter, whose parameters are searched."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from pendulum import ARM, LOOSE, PENDULUM, causes, path_of, recorded

from invdyn.diagnosis.assessment.findings import finding
from invdyn.diagnosis.hypotheses.continuation import data_path
from invdyn.diagnosis.hypotheses.pool import considered
from invdyn.diagnosis.hypotheses.profile_likelihood import refine_searched
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.hypotheses.simplex_search import grid, log_sd_prior
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.problem.noise import is_noise
from invdyn.diagnosis.problem.unknowns import at_far_end
from invdyn.diagnosis.sensitivity.whiten import linear_of
from invdyn.inference.smoothing.linearisation import seen_as, seen_rows, slopes_along
from invdyn.models.effects import EFFECTS
from invdyn.simulate import random_arm, record

SLOPE, SLOPES = "effect.varying_noise.slope", torch.tensor([5.0], dtype=torch.float64)


def with_stray(recording, share, width):
    """A recording with a share of its frames' detections off by so much, m, and which; the first place the arm."""
    rng = np.random.default_rng(3)
    stray = rng.random(len(recording.time)) < share
    stray[:3] = False
    points = recording.keypoints + stray[:, None, None] * rng.normal(0.0, width, size=recording.keypoints.shape)
    return replace(recording, keypoints=points), stray


def test_stray_detections_are_counted():
    recording = recorded(0.0, rows=100)
    astray, stray = with_stray(recording, 0.08, 0.06)
    here = diagnosis_problem(astray, PENDULUM)
    clean = diagnosis_problem(recording, PENDULUM)
    path = path_of(clean)
    outliers = EFFECTS["outliers"]().bound(PENDULUM)
    cause = refine_searched(here, refine(here, (), {}, path, LOOSE), outliers)
    assert cause.names == ()
    assert abs(cause.noise["outliers.rate"] - stray.mean()) < 4 * cause.noise_sd["outliers.rate"] < 0.2
    assert abs(cause.noise["outliers.scale"] - 0.06) < 4 * cause.noise_sd["outliers.scale"] < 0.12
    assert cause.log_evidence > refine(here, (), {}, path, LOOSE).log_evidence + 50
    assert refine_searched(clean, refine(clean, (), {}, path, LOOSE), outliers) is None


@pytest.mark.long
@pytest.mark.parametrize("order", [("outliers", "varying_noise"), ("varying_noise", "outliers")])
def test_noise_that_grows_with_speed_and_stray_detections_make_room_for_each_other(order):
    """Whichever comes first takes the other's part as well, and gives it up: half of the detections stray, or none."""
    arm = random_arm(PENDULUM, duration=4.0, fps=100, noise=0.0005, torque_scale=0.5, commanded=True)
    recording, _ = record(arm.with_effects(EFFECTS["varying_noise"]()).replace(**{SLOPE: SLOPES}), 1)
    astray, stray = with_stray(recording, 0.02, 0.1)
    here = diagnosis_problem(astray, PENDULUM)
    path, _ = data_path(here)
    none = refine(here, (), {}, path, LOOSE)
    cause = replace(none, path=path)
    for name in order:
        cause = refine_searched(here, cause, EFFECTS[name]().bound(PENDULUM))
    found, sd = cause.noise, cause.noise_sd
    assert abs(found["varying_noise.slope"] - SLOPES.item()) < 4 * sd["varying_noise.slope"] < SLOPES.item()
    assert abs(found["outliers.rate"] - stray.mean()) < 4 * sd["outliers.rate"] < 0.06
    assert set(cause.noise_log) == set(order)
    known = {f"effect.{name}": torch.tensor([value], dtype=torch.float64) for name, value in found.items()}
    assert {name: cause.model.parameters[name] for name in known} == known


def test_one_of_several_that_were_searched_may_be_left_out_as_it_is():
    """The rest keep path, parameters, spreads and what their integrals added."""
    here, _, cause = causes()
    both = tuple(EFFECTS[name]().bound(PENDULUM) for name in ("outliers", "varying_noise"))
    noise = {"outliers.rate": 0.02, "outliers.scale": 0.1, "varying_noise.slope": 3.0}
    noise_log = {"outliers": -4.0, "varying_noise": -3.0}
    effects, values = (*cause.effects, *both), cause.values | noise
    whole = refine(here, effects, values, cause.path, LOOSE, noise_log=noise_log)
    bare = refine(here, effects, values, cause.path, LOOSE)
    assert whole.log_evidence == pytest.approx(bare.log_evidence - 7.0, abs=1e-6)
    less = whole.less(here, both[0])
    assert less.noise == {"varying_noise.slope": 3.0}
    assert less.noise_log == {"varying_noise": -3.0}
    assert [e.key for e in less.effects] == [e.key for e in whole.effects if e.name != "outliers"]
    assert [e.key for e in less.model.effects] == [e.key for e in less.effects]
    assert all(less.model.parameters[name] is whole.model.parameters[name] for name in less.model.parameters)


@pytest.mark.parametrize("effect", [EFFECTS["outliers"](), EFFECTS["label_swap"]("elbow", "wrist")], ids=str)
def test_a_tracker_may_be_wrong_one_time_in_three(effect):
    """A bad one, but no wonder: larger shares are what is as large as anything may be."""
    scale = random_arm(ARM, duration=1.0, fps=50).scale
    (rate,) = (p for p in effect.parameters(scale) if p.name == "rate")
    assert not at_far_end(rate, 0.3)
    assert at_far_end(rate, 0.6)


@pytest.mark.long
def test_stray_detections_beside_a_large_gap_are_not_most_of_all():
    """Where the arm does something else altogether, a path without a residual would leave every detection stray."""
    spring = EFFECTS["joint_stiffness"]("pivot")
    arm = random_arm(PENDULUM, duration=4.0, fps=100, noise=0.0005, torque_scale=0.5, commanded=True, seed=0)
    given = {"effect.joint_stiffness.pivot.stiffness": 2.0, "effect.joint_stiffness.pivot.torque": 1.0}
    given = {name: torch.tensor([value], dtype=torch.float64) for name, value in given.items()}
    recording = record(arm.with_effects(spring).replace(**given), 0)[0]
    astray, stray = with_stray(recording, 0.05, 0.3)
    here = diagnosis_problem(astray, PENDULUM)
    path, far = data_path(here)
    assert far
    none = refine(here, (), {}, path, LOOSE)
    cause = refine_searched(here, replace(none, path=path), EFFECTS["outliers"]().bound(PENDULUM))
    assert cause.noise["outliers.rate"] == pytest.approx(stray.mean(), abs=0.03)
    assert cause.noise["outliers.scale"] == pytest.approx(0.3, rel=0.3)
    assert not cause.complete


def test_intervals_of_what_was_searched_stay_within_the_prior():
    here, _, cause = causes()
    play = EFFECTS["backlash"]("pivot").bound(PENDULUM)
    name = "backlash.pivot.width"
    counted = replace(cause, noise={name: 0.02}, noise_sd={name: 0.002})
    narrow, wide, widest = (finding(here, counted, play, 0, temper).parameters["width"] for temper in (1.0, 0.2, 1e-9))
    assert narrow.mean == wide.mean == widest.mean == 0.02
    assert np.diff(np.log(narrow.interval_90))[0] == pytest.approx(2 * 1.645 * 0.1, rel=0.05)
    assert np.diff(np.log(wide.interval_90))[0] == pytest.approx(2 * 1.645 * 0.1 / np.sqrt(0.2), rel=0.1)
    (width,) = play.parameters(here.model.scale)
    assert np.diff(np.log(widest.interval_90))[0] == pytest.approx(2 * 1.645 * log_sd_prior(width), rel=0.05)


@pytest.mark.quick("outliers", "label_swap")
@pytest.mark.parametrize("name", [name for name, kind in EFFECTS.items() if is_noise(kind.__new__(kind))])
def test_what_changes_the_scatter_leaves_the_motion_and_the_slopes(name):
    """So that one linearisation does for all of its parameters, but for the rows that are seen."""
    here = diagnosis_problem(record(random_arm(ARM, duration=0.8, fps=50, noise=0.002, commanded=True))[0], ARM)
    path, _ = data_path(here)
    effect = next(e for e in considered(here) if e.name == name)
    parameters, points = grid(effect, here.model.scale)
    values = {f"effect.{effect.key}.{p.name}": torch.tensor([v]) for p, v in zip(parameters, points[-1], strict=True)}
    model = here.model.with_effects(effect).replace(**values)
    slopes = slopes_along(here.model, path)
    for mine, plain in zip(slopes_along(model, path), slopes, strict=True):
        torch.testing.assert_close(mine, plain, rtol=1e-12, atol=1e-12)
    whole, plain = linear_of(here, model, path, slopes), linear_of(here, here.model, path, slopes)
    assert np.abs(whole.log_constant - plain.log_constant) > 0.1  # it does change the scatter
    anew = seen_as(plain, seen_rows(model, path, here.observations), slopes[1])
    for field in ("F", "a", "L", "E", "e", "m0", "log_constant"):
        np.testing.assert_array_equal(getattr(anew, field), getattr(whole, field))
