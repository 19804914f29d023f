"""Methods side by side: what the table says is what the posteriors hold, and no method stops the others."""

import json
import math
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.distributions import MultivariateNormal

from invdyn.inference import METHODS, Comparison, arm_problem, compare, evidence_note, fit
from invdyn.inference.held_out import Continued, belief, log_score
from invdyn.inference.posterior.posterior import to_inference_data
from invdyn.models import Link, Matern32, SmoothAndRough, planar_body
from invdyn.models.torques.given_torques import given_torques
from invdyn.recordings import InputError, Recording, Truth

TIME = 0.03 * np.arange(40)
ARM = planar_body("arm", [Link("rod", "shoulder", "elbow", length=0.4, mass=1.2)])
KNOWN = {
    "torque.scale": 3.0,
    "torque.decay": 4.0,
    "emission.keypoint_scale": 0.03,
    "noise.angle": 0.003,
    "noise.velocity": 0.05,
    "initial.angle": -1.3,
    "initial.angle_scale": 0.3,
    "initial.velocity_scale": 1.0,
}
SMALL = {"num_filters": 6, "num_particles": 200, "num_draws": 5, "settings": KNOWN, "substeps": 1}


def blank(time=TIME):
    return Recording(time, np.zeros((len(time), 1, 2)), ("elbow",), name="swing")


@pytest.fixture(scope="module")
def data():
    """A recording drawn from the model itself, and its truth."""
    model = arm_problem(blank(), ARM, parameters=KNOWN, substeps=1).model
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(3)
        path, rows = model.simulate()
    torque, angle, velocity = (part.numpy() for part in model.split(path))
    recording = Recording(TIME, rows.numpy().reshape(-1, 1, 2), ("elbow",), name="swing")
    return recording, Truth(TIME, angle, velocity, torque, ("shoulder",))


def failing(problem, **_):
    raise RuntimeError("no convergence\nafter all these steps")


@pytest.fixture(scope="module")
def comparison(data):
    """Of two filters, and a method that fails between them."""
    recording, truth = data
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(METHODS, "broken", failing)
        return compare(recording, ARM, ["smc", "broken", "bootstrap"], truth=truth, seed=1, **SMALL)


def test_one_row_a_method_in_the_order_requested(comparison):
    assert isinstance(comparison, Comparison)
    assert list(comparison.table.index) == ["smc", "broken", "bootstrap"]
    assert list(comparison.posteriors) == ["smc", "bootstrap"]
    assert comparison.held_out == 8


def test_scores_are_those_of_the_posterior(comparison, data):
    _, truth = data
    for method, idata in comparison.posteriors.items():
        row, torque = comparison.table.loc[method], idata.posterior.torque
        mean = torque.mean(("chain", "draw")).values
        assert row["shoulder_rmse"] == pytest.approx(np.sqrt(np.mean((mean - truth.torque) ** 2)))
        assert 0 < row["shoulder_crps"] < np.abs(torque.values - truth.torque).mean()
        assert 0 <= row["shoulder_coverage_50"] <= row["shoulder_coverage_90"] <= 1
        assert row["log_evidence"] == idata.attrs["log_evidence"]
        assert row["usable"] == bool(idata.sample_stats.attrs["usable"])
        stated = idata.attrs["log_evidence_sd"] if row["usable"] else np.nan
        assert row["log_evidence_sd"] == pytest.approx(stated, nan_ok=True, rel=0)
        assert row["outer_ess"] == idata.attrs["outer_ess"]
        assert row["evidence_kind"] == "estimate"
        assert row["seconds"] > 0
        assert row["memory"] >= 0


def test_the_right_posterior_scores_as_it_should(comparison):
    """Data of the model itself: the controlled filter is sure of its evidence, and its bands hold the truth."""
    row = comparison.table.loc["smc"]
    assert row["shoulder_coverage_90"] > 0.6  # correlated in time: a few independent stretches
    assert row["log_evidence_sd"] < 0.05
    assert row["outer_ess"] > 5


def test_filters_that_disagree_state_no_evidence(comparison):
    """The bootstrap's few filters part, and state no error; of the look-ahead they say nothing."""
    row, statistics = comparison.table.loc["bootstrap"], comparison.posteriors["bootstrap"].sample_stats
    assert row["outer_ess"] < 3
    assert not row["usable"]
    assert np.isnan(row["log_evidence_sd"])
    assert statistics.attrs["doubt"] in comparison.notes["bootstrap"]
    assert evidence_note(comparison.posteriors["bootstrap"]).startswith("not usable: outer effective sample size 2.")
    assert comparison.table.loc["smc", "usable"]
    assert evidence_note(comparison.posteriors["smc"]) == ""


def test_a_failure_is_a_row_with_its_reason(comparison):
    row = comparison.table.loc["broken"]
    assert row["failure"] == comparison.failures["broken"] == "RuntimeError: no convergence"
    assert row.drop(["failure", "evidence_kind"]).isna().all()
    assert (comparison.table.loc[["smc", "bootstrap"], "failure"] == "").all()


def test_to_dict_is_json(comparison):
    written = json.loads(json.dumps(comparison.to_dict(), allow_nan=False))
    assert written["methods"]["smc"]["log_evidence"] == pytest.approx(comparison.table.loc["smc", "log_evidence"])
    assert written["methods"]["broken"]["seconds"] is None
    assert written["held_out_rows"] == 8


def test_same_seed_same_table_and_another_method_next_to_it_changes_nothing(comparison, data):
    recording, truth = data
    timed = ["seconds", "memory", "ess_per_second"]
    again = compare(recording, ARM, ["smc"], truth=truth, seed=1, **SMALL).table.drop(columns=timed)
    first = comparison.table.loc[["smc"], again.columns]
    # Next to a method without numbers, counts are floats.
    pd.testing.assert_frame_equal(again, first, check_dtype=False, check_exact=True)


def test_parameters_are_fitted_once_for_all_methods(data, monkeypatch):
    recording, _ = data
    fits, module = [], sys.modules["invdyn.inference.fit_processes"]
    fitted = module.fit_over_gaps

    def counted(model, observations, *rest, **more):
        fits.append(len(observations))
        return fitted(model, observations, *rest, **more)

    monkeypatch.setattr(module, "fit_over_gaps", counted)
    free = {name: value for name, value in KNOWN.items() if name != "torque.scale"}
    done = compare(recording, ARM, ["smc", "laplace"], **{**SMALL, "settings": free})
    assert fits == [40, 32]  # the tail's score must not have seen the tail
    found = [json.loads(idata.attrs["settings"])["fitted"]["torque.scale"] for idata in done.posteriors.values()]
    assert found[0] == found[1]
    assert not [name for name in done.table if "rmse" in name], "without truth there is no error"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"methods": ["smc", "magic"]}, "magic"),
        ({"methods": []}, "expected methods among .*, got none"),
        ({"held_out": 1.0}, "from 0 up to 1"),
        ({"settings": {"torque.size": 1.0}}, "torque.size"),
    ],
)
def test_bad_arguments(data, change, said):
    with pytest.raises(InputError, match=said):
        compare(**{"recording": data[0], "body": ARM, "methods": ["smc"], **SMALL, **change})


def test_without_a_score_its_reason(data):
    recording, _ = data
    short = compare(recording.select(0, 11), ARM, ["laplace"], **SMALL)
    assert short.held_out == 0
    assert "too few" in short.notes["all"]
    assert math.isnan(short.table.loc["laplace", "log_score"])
    none = compare(recording, ARM, ["laplace"], held_out=0, **SMALL)
    assert not none.notes
    few = compare(recording, ARM, ["laplace"], **{**SMALL, "num_filters": 1, "num_draws": 3})
    assert "too few" in few.notes["laplace"]


@pytest.mark.long
def test_a_process_of_its_own_gives_the_same(comparison, data):
    recording, truth = data
    apart = compare(recording, ARM, ["smc"], truth=truth, seed=1, held_out=0, isolate=True, **SMALL)
    assert apart.table.loc["smc", "log_evidence"] == pytest.approx(comparison.table.loc["smc", "log_evidence"])
    assert apart.table.loc["smc", "memory"] > 0
    assert apart.to_dict()["memory"].endswith("each")


# -- the score of the tail ---------------------------------------------------------------------------------


def exact_tail(model, observations, path, first, mean, covariance):
    """Log p(y_{first+1:} | x_first ~ N) of the model linearised along ``path``: one dense Gaussian of all rows."""
    dim = model.state_dim
    rows = range(first + 1, len(observations))
    state = torch.zeros(dim, dtype=torch.float64)
    moments_mean, moments_cov, loc, cross = mean, covariance, [], []
    for t in rows:
        F = torch.autograd.functional.jacobian(lambda x, t=t: model.transition(x, t).mean, path[t - 1])
        H = torch.autograd.functional.jacobian(lambda x, t=t: model.emission(x, t).mean, path[t])
        before = model.transition(path[t - 1] + state, t)
        moments_mean = before.mean + F @ (moments_mean - path[t - 1])
        moments_cov = F @ moments_cov @ F.mT + torch.diag(before.variance)
        cross = [F @ c for c in cross] + [moments_cov]
        emission = model.emission(path[t], t)
        loc.append((emission.mean + H @ (moments_mean - path[t]), H, emission.variance, list(cross)))
    size = model.observation_dim
    total = torch.zeros(size * len(loc), size * len(loc), dtype=torch.float64)
    for j, (_, H_j, noise, crosses) in enumerate(loc):
        for i, c in enumerate(crosses):
            block = H_j @ c @ loc[i][1].mT
            total[size * j : size * (j + 1), size * i : size * (i + 1)] = block
            total[size * i : size * (i + 1), size * j : size * (j + 1)] = block.mT
        total[size * j : size * (j + 1), size * j : size * (j + 1)] += torch.diag(noise)
    stacked = torch.cat([mean for mean, *_ in loc])
    return MultivariateNormal(stacked, total).log_prob(observations[first + 1 :].flatten()).item()


def head_of(problem, count, mean, root, seed=0):
    """A posterior of the first rows whose last state has the moments N(mean, root rootᵀ) to rounding."""
    rng = torch.Generator().manual_seed(seed)
    noise = torch.randn(count, len(mean), generator=rng, dtype=torch.float64)
    noise = noise - noise.mean(0)
    noise = torch.linalg.solve_triangular(torch.linalg.cholesky(noise.T @ noise / (count - 1)), noise.T, upper=False).T
    paths = (mean + noise @ root.mT).reshape(1, count, 1, -1).expand(-1, -1, problem.model.num_steps, -1)
    return to_inference_data(problem, paths, method="given", seed=0, settings={}, log_evidence=0.0)


@pytest.fixture(scope="module")
def tail(data):
    """Whole problem, head problem, mode of the whole, and a belief at row 31."""
    recording, _ = data
    whole = arm_problem(recording, ARM, parameters=KNOWN, substeps=1)
    head = arm_problem(recording.select(0, 32), ARM, parameters=KNOWN, substeps=1)
    path = fit(whole.model, whole.observations, []).path
    return whole, head, path, torch.diag(torch.tensor([0.2, 0.01, 0.05], dtype=torch.float64))


def test_score_is_the_tails_density(tail):
    """Nearly linear over so narrow a belief: the dense Gaussian of all the tail's rows is the answer."""
    whole, head, path, root = tail
    exact = exact_tail(whole.model, whole.observations, path, 31, path[31], root @ root.mT)
    score = log_score(whole, head_of(head, 60, path[31], root), path)
    assert 8 * score == pytest.approx(exact, abs=0.15)


def test_a_wrong_belief_scores_worse(tail):
    whole, head, path, root = tail
    right = log_score(whole, head_of(head, 60, path[31], root), path)
    shifted = path[31] + 8 * root.diagonal()
    assert log_score(whole, head_of(head, 60, shifted, root), path) < right - 1


def test_missing_rows_of_the_tail_do_not_count(tail):
    whole, head, path, root = tail
    rows = whole.observations.clone()
    rows[36:] = torch.nan
    seen = log_score(replace(whole, observations=rows), head_of(head, 60, path[31], root), path)
    exact = exact_tail(whole.model, rows[:36], path, 31, path[31], root @ root.mT)
    assert 4 * seen == pytest.approx(exact, abs=0.15)


@settings(max_examples=20)
@given(first=st.integers(0, 38), seed=st.integers(0, 99))
def test_continued_model_is_the_whole_one_from_a_row_on(first, seed):
    model = arm_problem(blank(), ARM, parameters=KNOWN, substeps=1).model
    torch.manual_seed(seed)
    path, rows = model.simulate()
    start = torch.zeros(3, dtype=torch.float64), torch.eye(3, dtype=torch.float64)
    later = Continued(model, first, *start).replace(**{"torque.scale": torch.tensor([5.0], dtype=torch.float64)})
    changed = model.replace(**{"torque.scale": torch.tensor([5.0], dtype=torch.float64)})
    t = torch.arange(first + 1, 40)
    expected = MultivariateNormal(*start).log_prob(path[first])
    expected = expected + changed.transition(path[first:-1], t).log_prob(path[first + 1 :]).sum()
    expected = expected + changed.emission(path[first:], torch.arange(first, 40)).log_prob(rows[first:]).sum()
    torch.testing.assert_close(later.log_joint(path[first:], rows[first:]), expected)


GROWTH = """
import numpy as np
from invdyn.inference.comparison import resident_peak
before = resident_peak(reset=True)
block = np.ones(200 * 2**17)  # 200 MiB, touched
print(resident_peak() - before)
"""


@pytest.mark.long
def test_resident_peak_sees_an_allocation():
    # In a process of its own: in this one, memory that other tests have freed may be used again.
    grown = subprocess.run([sys.executable, "-W", "ignore", "-c", GROWTH], capture_output=True, text=True, check=True)
    assert float(grown.stdout) > 0.8 * 200


@pytest.mark.quick("Matern32")
@pytest.mark.parametrize("torque", [Matern32(), SmoothAndRough()], ids=lambda process: type(process).__name__)
def test_a_torque_with_derivatives_has_a_score(data, torque):
    """Two methods that leave nothing out predict the tail alike."""
    recording, _ = data
    free = {name: value for name, value in KNOWN.items() if not name.startswith("torque.")}
    found = compare(recording, ARM, ["smc", "laplace"], torque=torque, **{**SMALL, "settings": free})
    assert not found.notes
    table = found.table
    assert table.loc["smc", "log_score"] == pytest.approx(table.loc["laplace", "log_score"], abs=0.3)


def test_a_belief_has_the_width_of_what_torques_leave_open(data):
    """Draws that are all alike: what is left is the derivative's own variance."""
    recording, _ = data
    known = {name: value for name, value in KNOWN.items() if not name.startswith("torque.")}
    head = arm_problem(recording.select(0, 32), ARM, parameters=known, torque=Matern32(), substeps=1)
    mean = torch.zeros(head.model.state_dim, dtype=torch.float64)
    _, root = belief(head_of(head, 60, mean, 1e-9 * torch.eye(len(mean), dtype=torch.float64)), head.model)
    numbers = {name: value.double() for name, value in head.model.parameters.items() if name.startswith("torque.")}
    still = torch.zeros(1, 32, 1, dtype=torch.float64)
    _, left = given_torques(head.model.torque, still, head.model.time.double(), numbers)
    assert left[1, 1] > 1e-3
    assert (root @ root.mT)[1, 1] == pytest.approx(float(left[1, 1]), rel=1e-3)
