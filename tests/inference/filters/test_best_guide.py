"""The guide that pilots choose: right within its errors, or not usable."""

import math

import numpy as np
import pytest
import torch
from grids import grid_posterior
from one_state import Counts, Growth, HeavyTailed, Multiplicative, Positive, Volatility

from invdyn.inference import Guide, SMCOptions, best_guide, gauss_newton, run_filters
from invdyn.inference.execution.checkpoint import Checkpoint
from invdyn.inference.execution.records import keep, kept
from invdyn.inference.filters.best_guide import MAX_FACTOR, RECORDS, RUN_PARTICLE_STEPS, _most, _Pilot
from invdyn.inference.filters.second_opinion import evidence


def default_run(model, y, seed=0):
    guide = best_guide(model, y, seed=seed)
    torch.manual_seed(seed + 1)
    options = SMCOptions(num_particles=guide.num_particles)
    result = run_filters(model, y, options, guide=guide.name, smoother=guide.smoother, keep=0)
    return guide, guide.judged(result.log_evidence)


@pytest.mark.quick("Counts-*", "Volatility-*", "Positive-*")
@pytest.mark.parametrize(
    ("kind", "name", "low"),
    [
        (Volatility, "controlled", -7),
        (Counts, "controlled", -7),
        (Multiplicative, "defended", -7),
        (HeavyTailed, "defended", -7),
        (Positive, "bootstrap", 1e-3),
    ],
)
def test_evidence_of_models_of_ones_own(kind, name, low):
    model = kind(20)
    torch.manual_seed(3)
    y = model.simulate()[1]
    exact = grid_posterior(model, y, low, 7).log_evidence
    guide, found = default_run(model, y)
    assert guide.name == name
    assert found.usable, found.reason
    assert found.log_evidence == pytest.approx(exact, abs=4 * found.sd)


def check_growth(seed, num_steps):
    model = Growth(num_steps)
    torch.manual_seed(seed)
    y = model.simulate()[1]
    exact = grid_posterior(model, y, -30, 30, 400).log_evidence
    guide, found = default_run(model, y, seed=seed)
    assert guide.name != "controlled"
    assert not found.usable or found.log_evidence == pytest.approx(exact, abs=3 * found.sd)


def test_the_growth_model_is_right_or_not_usable():
    check_growth(103, 30)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [*range(100, 120), 508])  # all filters of the defended guide miss a mode of 508
def test_the_growth_model_on_recordings_of_its_usual_length(seed):
    check_growth(seed, 100)


def test_a_guide_in_a_wrong_mode_is_not_believed():
    model = Growth(60)
    torch.manual_seed(3)
    y = model.simulate()[1]
    smoother = gauss_newton(model, y)
    pilot = run_filters(model, y, SMCOptions(16, 400), guide="bootstrap", keep=0).log_evidence
    wrong = run_filters(model, y, SMCOptions(32, 100), smoother=smoother, keep=0).log_evidence
    assert evidence(pilot, "bootstrap").log_evidence - evidence(wrong, "controlled").log_evidence > 50
    judged = Guide("controlled", smoother, 100, pilot).judged(wrong)
    assert not judged.usable
    assert "disagree beyond their errors" in judged.reason


def test_guides_that_disagree_are_not_believed_where_no_pilot_decides():
    model = Growth(100)
    y = model.simulate(seed=508)[1]  # whose defended filters agree on −271.5 ± .1, and all miss a third of Z
    guide = best_guide(model, y, SMCOptions(16, 40), seed=0)
    agreed = guide.judged(torch.full((16,), -271.5, dtype=torch.float64))
    assert guide.name == "bootstrap" or not agreed.usable


def test_a_seed_gives_the_same_guide_and_leaves_the_generator_alone():
    model = Counts(10)
    torch.manual_seed(3)
    y = model.simulate()[1]
    before = torch.get_rng_state()
    first, second = (best_guide(model, y, SMCOptions(16, 50), seed=5) for _ in range(2))
    assert torch.equal(before, torch.get_rng_state())
    assert (first.smoother.factors.U == second.smoother.factors.U).all()
    assert torch.equal(first.opinion, second.opinion)


def test_a_guide_is_kept_and_comes_back(tmp_path):
    pytest.importorskip("safetensors")
    model = Counts(10)
    torch.manual_seed(3)
    y = model.simulate()[1]
    fitted = best_guide(model, y, SMCOptions(16, 50), seed=5)
    for guide in (fitted, Guide("bootstrap", None, 200, reason="why", doubt="modes")):
        keep(Checkpoint(tmp_path), guide)
        again = kept(Checkpoint(tmp_path), *RECORDS)
        assert (again.name, again.num_particles) == (guide.name, guide.num_particles)
        assert (again.reason, again.doubt) == (guide.reason, guide.doubt)
        assert (again.smoother is None) == (guide.smoother is None)
        if guide.smoother is not None:
            assert (again.smoother.factors.U == guide.smoother.factors.U).all()
            assert isinstance(again.smoother.factors.U, np.ndarray)
            assert torch.equal(again.opinion, guide.opinion)


def test_more_particles_are_expected_to_differ_less_and_a_guide_keeps_that(tmp_path):
    """By the root of their number; of log-normal evidences 1 in e^(sd²) filters count."""
    log_evidence = torch.linspace(-4, 4, 16, dtype=torch.float64)
    few = evidence(log_evidence, "controlled").filter_sd
    expected = _Pilot("controlled", log_evidence, 50).expected(800)
    assert expected.filter_sd == pytest.approx(few / 4)
    assert expected.outer_ess == pytest.approx(16 * math.exp(-((few / 4) ** 2)))
    guide = Guide("controlled", None, 800, doubt="of modes", expected=expected)
    pytest.importorskip("safetensors")
    keep(Checkpoint(tmp_path), guide)
    assert kept(Checkpoint(tmp_path), *RECORDS) == guide


def test_particles_are_fewer_where_a_row_takes_more_steps():
    options, steps = SMCOptions(16, 100), RUN_PARTICLE_STEPS / 16 / 500
    assert _most(options, steps) == 500
    assert _most(options, steps / 100) == MAX_FACTOR * 100
    assert _most(options, 100 * steps) == 100  # what was asked for in any case
