"""SMC evidence of causes against exact Kalman evidence and the linearised one; posteriors."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from oracles import kalman
from pendulum import DAMPING, FRICTION, LOOSE, PENDULUM, at_best, causes, path_of, recorded, wheel, wheel_chain
from pyro.infer.smcfilter import SMCFailed

from invdyn.diagnosis.assessment.confirm import confirm, confirm_all, posterior, scaled
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.problem.cause import best_size
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.rules import DEFAULT


def test_smc_evidence_of_a_linear_chain_is_exact():
    """The twisted proposal is perfect there: every filter finds the same number."""
    here = wheel()
    none = refine(here, (), {}, path_of(here), LOOSE)
    confirmed = confirm(here, none, filters=4)
    exact, *_ = kalman(
        wheel_chain(scaled(here, none.model, best_size(here, none), none.kappa)), here.observations.numpy()
    )
    other_sizes = none.log_evidence - at_best(here, none)[0]
    assert confirmed.log_evidence == pytest.approx(exact + other_sizes, abs=1e-4)
    assert confirmed.log_evidence_sd < 1e-4
    # What an integral over parameters that were searched added is in both evidences.
    added = replace(none, log_evidence=none.log_evidence - 7, by_size=none.by_size - 7, noise_log={"outliers": -7.0})
    assert confirm(here, added, filters=4).log_evidence == pytest.approx(confirmed.log_evidence - 7)


def test_smc_agrees_with_the_linearised_evidence():
    here, none, cause = causes()
    for each in (none, cause):
        confirmed = confirm(here, each)
        assert confirmed.log_evidence_sd < 0.3
        assert confirmed.log_evidence == pytest.approx(each.log_evidence, abs=0.5 + 4 * confirmed.log_evidence_sd)


@pytest.mark.parametrize(
    ("clear", "temper", "hopeless", "filters"),
    [(np.inf, 1.0, np.inf, 8), (1e-3, 1.0, np.inf, 16), (1e-3, 1e-3, np.inf, 8), (1e-3, 1.0, 1e-3, 8)],
)
def test_more_filters_run_where_few_are_not_clear(clear, temper, hopeless, filters):
    """All of them weigh together; evidence that is tempered need not be known so well, nor where SMC cannot say."""
    here, none, cause = causes()
    here = replace(here, rules=DEFAULT.replace(clear_se=clear, max_filter_se=hopeless))
    confirmed = confirm_all(here, [none, cause], 3, temper)[1]
    assert confirmed.result.log_evidence.shape == (filters,)
    assert confirmed.result.states.shape[1] == len(confirmed.values) == filters
    found = confirmed.result.log_evidence
    assert len(set(found.tolist())) == filters
    other_sizes = cause.log_evidence - at_best(here, cause)[0]
    assert confirmed.log_evidence == pytest.approx(float(found.logsumexp(0)) - np.log(filters) + other_sizes)


def test_one_cause_alone_is_confirmed_once():
    here, _, cause = causes()
    here = replace(here, rules=DEFAULT.replace(clear_se=0.0))
    (alone,) = confirm_all(here, [cause], 3)
    assert alone.result.log_evidence.shape == (8,)
    assert confirm_all(here, [cause, cause], 3)[0].result.log_evidence.shape == (16,)


def test_where_one_has_died_the_others_are_not_confirmed_again(monkeypatch):
    here, _, cause = causes()
    module = sys.modules[confirm.__module__]
    asked, own = [], module.filtered_under

    def dies(problem, each, *rest):
        asked.append(each)
        if each is not cause:
            raise SMCFailed("all particles of a filter have weight zero")
        return own(problem, each, *rest)

    monkeypatch.setattr(module, "filtered_under", dies)
    here = replace(here, rules=DEFAULT.replace(clear_se=0.0))
    first, second = confirm_all(here, [cause, replace(cause)], 3)
    assert np.isfinite(first.log_evidence)
    assert second.log_evidence == -np.inf
    assert len(asked) == 2


def test_where_no_draw_is_plausible_there_are_paths_and_no_evidence():
    """Drawn so widely that an arm without inertia runs away: the estimates still give a posterior."""
    here = diagnosis_problem(recorded(DAMPING), PENDULUM)
    cause = refine(here, (FRICTION,), {}, path_of(here), LOOSE)
    wild = replace(cause, covariance=1e12 * cause.covariance)
    run = confirm(here, wild, seed=1)
    assert run.log_evidence == -np.inf
    assert np.isnan(run.log_evidence_sd)
    assert (run.values == cause.mean).all()
    assert np.isfinite(posterior(here, cause, run, 1)["posterior"]["torque"]).all()


@pytest.mark.long
def test_where_filters_die_the_linearised_model_gives_the_posterior(monkeypatch):
    here, _, cause = causes()
    filtered = posterior(here, cause, confirm(here, cause, 1), 1)["posterior"]["torque"]

    def dies(*_):
        raise SMCFailed("all particles of a filter have weight zero")

    monkeypatch.setattr(sys.modules[confirm.__module__], "filtered_under", dies)
    run = confirm(here, cause, 1)
    assert run.log_evidence == -np.inf
    assert np.isnan(run.log_evidence_sd)
    idata = posterior(here, cause, run, 1)["posterior"]
    assert (idata["effect.viscous_friction.pivot.damping"] == cause.mean[0]).all()
    off = abs(idata["torque"].mean(("chain", "draw")) - filtered.mean(("chain", "draw")))
    assert float((off / filtered.std(("chain", "draw"))).median()) < 1.0
    ratio = idata["torque"].std(("chain", "draw")) / filtered.std(("chain", "draw"))
    assert float(ratio.median()) == pytest.approx(1.0, abs=0.3)


def test_same_seed_same_numbers_and_all_within_bounds():
    here, _, cause = causes(0.0)  # at the edge: half of a symmetric proposal lies beyond it
    first, again, other = (confirm(here, cause, seed) for seed in (1, 1, 2))
    assert first.log_evidence == again.log_evidence
    assert np.array_equal(first.values, again.values)
    assert not np.array_equal(first.values, other.values)
    for confirmed in (first, other):
        assert (confirmed.values >= 0).all()
        assert np.isfinite(confirmed.log_evidence)
    assert abs(first.log_evidence - other.log_evidence) < 4 * (first.log_evidence_sd + other.log_evidence_sd)


def test_posterior_has_the_parameters():
    here, _, cause = causes()
    run = confirm(here, cause, filters=4)
    idata = posterior(here, cause, run, 0)
    drawn = idata["posterior"]["effect.viscous_friction.pivot.damping"]
    assert drawn.shape == idata["posterior"]["torque"].shape[:2]
    assert np.abs(drawn - DAMPING).max() < 10 * cause.sd[0]
    np.testing.assert_array_equal(drawn, np.repeat(run.values, drawn.sizes["draw"], 1))  # each chain its filter's
    assert len(set(run.values[:, 0])) == 4
