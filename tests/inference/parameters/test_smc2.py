"""SMC² against quadrature row by row, its doubling of particles, and its seeds."""

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import torch
from parameter_answers import Quadrature, simulated
from pyro.infer.smcfilter import SMCFailed

from invdyn.inference.parameters.pmmh import pmmh
from invdyn.inference.parameters.smc2 import smc2
from invdyn.recordings import InputError


@pytest.fixture(scope="module")
def case():
    model, y = simulated("linear")
    return model, y, Quadrature(y)


@pytest.fixture(scope="module")
def result(case):
    model, y, _ = case
    return smc2(model, y, num_draws=200, num_particles=60, num_runs=6, num_moves=4)


def test_posterior_and_evidence_are_those_of_quadrature(case, result):
    exact = case[2]
    assert abs(result.log_evidence - exact.log_evidence[-1]) < 3 * result.log_evidence_sd
    assert result.log_evidence_sd < 0.15
    for name, mean in exact.mean.items():
        sd = exact.sd[name]
        assert abs(result.mean(name).item() - mean) < 4 * sd / math.sqrt(result.ess / 2)
        assert abs(result.sd(name).item() / sd - 1) < 4 / math.sqrt(result.ess / 2)
    assert 0.15 < result.acceptance.mean() < 0.5


def test_every_row_has_its_evidence(case, result):
    exact = case[2]
    assert result.log_evidence_increment.sum().item() == pytest.approx(result.log_evidence)
    error = result.log_evidence_increment.cumsum(0).numpy() - exact.log_evidence
    assert np.abs(error).max() < 0.2


def test_states_come_with_the_parameters(case, result):
    exact = case[2]
    weights = result.log_weights.exp()[..., None]
    states = result.paths.squeeze(-1)
    mean = (weights * states).sum((0, 1))
    sd = (weights * (states - mean) ** 2).sum((0, 1)).sqrt()
    assert (np.abs(mean.numpy() - exact.states) < 4 * sd.numpy() / math.sqrt(result.ess / 2)).all()


def test_too_few_particles_are_doubled_and_the_evidence_stays(case):
    model, y, exact = case
    result = smc2(model, y, num_draws=150, num_particles=3, num_runs=6, num_moves=3, min_acceptance=0.2, paths=False)
    assert result.num_particles >= 12
    assert result.paths is None
    assert abs(result.log_evidence - exact.log_evidence[-1]) < 3 * result.log_evidence_sd
    for name, mean in exact.mean.items():
        assert abs(result.mean(name).item() - mean) < 4 * exact.sd[name] / math.sqrt(result.ess / 4)


def test_the_same_seed_has_the_same_bits_with_workers_and_without(case):
    model, y, _ = case
    sizes = {"num_draws": 20, "num_particles": 10, "num_runs": 3}
    with ThreadPoolExecutor(2) as executor:
        one, two = (smc2(model, y, **sizes, executor=workers) for workers in (None, executor))
    other = smc2(model, y, **sizes, seed=1)
    assert torch.equal(one.paths, two.paths)
    assert torch.equal(one.log_weights, two.log_weights)
    assert one.log_evidence == two.log_evidence != other.log_evidence


def test_runs_that_are_done_are_kept(case, tmp_path):
    pytest.importorskip("safetensors")
    from invdyn.inference import Checkpoint

    model, y, _ = case
    sizes = {"num_draws": 10, "num_particles": 5, "num_runs": 2}
    first = smc2(model, y, **sizes, checkpoint=Checkpoint(tmp_path))
    rows = []
    again = smc2(
        model, y, **sizes, checkpoint=Checkpoint(tmp_path), progress=lambda done, total, what: rows.append(done)
    )
    assert torch.equal(first.paths, again.paths)
    assert set(rows) <= {2 * len(y)}


def test_what_cannot_be_run_is_refused(case):
    model, y, _ = case
    with pytest.raises(InputError, match=r"expected num_draws of 2 or more, .*, got 1, 100, 5 and 0\.5"):
        smc2(model, y, num_draws=1)
    with pytest.raises(InputError, match="expected at least one run, got 0"):
        smc2(model, y, num_runs=0)


def test_rows_that_do_not_fit_the_model_are_refused(case):
    model, y, _ = case
    for sample in (smc2, pmmh):
        with pytest.raises(InputError, match=r"observations: expected rows \(15, 1\)"):
            sample(model, y[:9])


def test_a_row_that_no_parameter_explains_is_named(case):
    model, y, _ = case
    y = y.clone()
    y[7] = 1e200
    with pytest.raises(SMCFailed, match="all parameters have likelihood zero at row 7"):
        smc2(model, y, num_draws=10, num_particles=10, num_runs=1)


def test_a_model_in_single_precision_has_the_same_answer(case):
    model, y, exact = case
    single = model.replace(**{name: value.float() for name, value in model.parameters.items()})
    result = smc2(single, y.float(), num_draws=100, num_particles=40, num_runs=5)
    assert result.paths.dtype == torch.float32
    assert abs(result.log_evidence - exact.log_evidence[-1]) < 3 * result.log_evidence_sd
