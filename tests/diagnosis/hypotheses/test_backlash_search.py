"""Play beside a base: evidence that is smooth in the width, and the search for it."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from pendulum import LOOSE, PENDULUM, path_of

from invdyn.diagnosis.hypotheses.backlash_search import BacklashFit, refine_backlash, summit
from invdyn.diagnosis.hypotheses.continuation import data_path
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.models.effects import EFFECTS
from invdyn.simulate import random_arm, record


@cache
def loose_joint():
    """A rod whose load reverses, with play of .06 rad: its setting, "no effect", and play."""
    body = replace(PENDULUM, gravity=(0.0, 0.0))
    play = EFFECTS["backlash"]("pivot")
    arm = random_arm(body, duration=2.0, fps=50, noise=0.0005, torque_scale=0.5, commanded=True, seed=0)
    width = torch.tensor([0.06], dtype=torch.float64)
    recording = record(arm.with_effects(play).replace(**{"effect.backlash.pivot.width": width}), 0)[0]
    here = diagnosis_problem(recording, body)
    return here, refine(here, (), {}, path_of(here), LOOSE), play.bound(body)


def widths(here, none, play):
    return BacklashFit(here, none, play, play.parameters(here.model.scale)[0])


@cache
def searched():
    return refine_backlash(*loose_joint())


@pytest.mark.slow
def test_evidence_is_smooth_in_the_width_and_largest_near_the_true_one():
    """Within some tenths of a nat of a cubic, in ten percent either way; all of them leave nothing.

    The true width is within two standard deviations of the top, two nats, which is no end of what is looked at.
    """
    play = widths(*loose_joint())
    logs = np.log(0.06) + np.linspace(-0.1, 0.1, 7)
    score = np.array([play.score(x) for x in logs])
    assert all(cause.complete for cause in play.tried.values())
    fitted = np.polynomial.Polynomial.fit(logs, score, 3)
    assert np.abs(fitted(logs) - score).max() < 0.3
    assert score.max() - score.min() > 2
    assert 0 < score.argmax() < 6
    assert score.max() - score[3] < 2


@pytest.mark.long
def test_play_is_searched_and_found():
    """The width, from a grid that does not have it, and far more than none explains."""
    here, none, play = loose_joint()
    cause = searched()
    assert cause.log_evidence > none.log_evidence + 20
    assert cause.noise["backlash.pivot.width"] == pytest.approx(0.06, rel=0.1)
    assert cause.path.shape[-1] == none.path.shape[-1] + 2
    assert refine_backlash(here, none, play, cause.log_evidence + 100) is None
    # Its evidence has the width integrated out, and what an integral added to the base's is in that of each width.
    there = widths(here, none, play).refined(cause.noise["backlash.pivot.width"])
    assert set(cause.noise_log) == {"backlash.pivot"}
    assert cause.log_evidence - cause.noise_log["backlash.pivot"] == pytest.approx(there.log_evidence, abs=2.0)
    lower = replace(none, noise_log={"outliers": -7.0})
    pairs = zip(*(widths(here, base, play).along_base([0.02, 0.06]) for base in (none, lower)), strict=True)
    assert [one - other for one, other in pairs] == pytest.approx([7.0, 7.0])


@pytest.mark.long
def test_its_width_is_as_certain_as_its_evidence_is_sharp():
    """The posterior's standard deviation is that of the evidence, by differences; and the truth is within three."""
    here, none, play = loose_joint()
    width, sd = (values["backlash.pivot.width"] for values in (searched().noise, searched().noise_sd))
    assert abs(width - 0.06) < 3 * sd
    around = widths(here, none, play)
    low, top, high = (around.score(np.log(width + step * sd)) for step in (-2.5, 0.0, 2.5))
    assert top - (low + high) / 2 == pytest.approx(2.5**2 / 2, rel=0.3)


@pytest.mark.parametrize(
    ("gained", "followed"),
    [
        ((50.0, 50.1, 49.9, 45.0), False),
        ((50.0, 49.0, 20.0, -300.0), False),
        ((50.0, 40.0, -100.0, -900.0), True),
        ((50.0, 50.1, 55.0, 45.0), True),
    ],
)
def test_what_the_narrowest_gap_explains_as_well_is_not_followed(monkeypatch, gained, followed):
    """Nats by width along the base's path: as good at any small one, no gap is needed; a peak there needs one."""
    here, none, play = loose_joint()
    asked = []
    monkeypatch.setattr(BacklashFit, "along_base", lambda _, widths: [none.log_evidence + nats for nats in gained])
    monkeypatch.setattr(BacklashFit, "refined", lambda _, width: asked.append(width))
    assert refine_backlash(here, none, play) is None
    assert bool(asked) is followed


@pytest.mark.slow
def test_wide_play_is_found_from_a_base_that_it_bends():
    """Along the base's path none of the grid's widths shows what the true one explains."""
    body = replace(PENDULUM, gravity=(0.0, 0.0))
    play, name = EFFECTS["backlash"]("pivot"), "backlash.pivot.width"
    arm = random_arm(body, duration=4.0, fps=100, noise=0.0005, torque_scale=0.5, commanded=True, seed=1)
    recording = record(arm.with_effects(play).replace(**{f"effect.{name}": torch.tensor([0.16]).double()}), 0)[0]
    here, play = diagnosis_problem(recording, body), play.bound(body)
    none = refine(here, (), {}, data_path(here)[0], LOOSE)
    cause = refine_backlash(here, none, play)
    known = BacklashFit(here, none, play, play.parameters(here.model.scale)[0]).refined(0.16)
    assert known.complete
    assert cause.noise[name] == pytest.approx(0.16, rel=0.05)
    assert cause.log_evidence > known.log_evidence - 10


@pytest.mark.parametrize("start", [-2.0, 0.1, 3.0])
def test_the_summit_of_a_parabola_is_exact(start):
    asked = []

    def score(x):
        asked.append(x)
        return 7.0 - 0.5 * ((x - 0.4) / 0.02) ** 2

    top, variance = summit(score, start)
    assert top == pytest.approx(0.4, abs=1e-9)
    assert variance == pytest.approx(0.02**2, rel=1e-6)
    assert len(asked) == len(set(asked)) <= 24


def test_the_summit_of_what_falls_off_faster_on_one_side():
    """As wide as the curvature at its top says, and no wider than a prior."""
    top, variance = summit(lambda x: -np.cosh(30 * x) + 10 * x, 0.5)
    true = np.arcsinh(10 / 30) / 30
    assert top == pytest.approx(true, abs=0.003)
    assert variance == pytest.approx(1 / (900 * np.cosh(30 * true)), rel=0.2)
    assert summit(lambda x: -1e-3 * x**2, 0.0)[1] == 1.0


def test_no_time_is_spent_on_a_path_that_stands_alone():
    asked = []

    def score(x):
        asked.append(x)
        return 7.0 if x == 0.0 else -0.5 * ((x - 0.1) / 0.3) ** 2

    top, variance = summit(score, 0.0)
    assert abs(top) < 1e-4
    assert variance < 0.005**2
    assert len(set(asked)) < 12


def test_where_a_simulation_does_not_run_there_is_no_summit():
    top, _ = summit(lambda x: -0.5 * (x / 0.05) ** 2 if x < 0.03 else -1e9, -0.6)
    assert -0.03 < top < 0.03
