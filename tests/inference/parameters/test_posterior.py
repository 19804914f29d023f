"""From draws to InferenceData: names and shapes, weights that are resampled, and diagnostics."""

import arviz as az
import numpy as np
import pytest
import torch

from invdyn.inference.parameters.posterior import ParameterPosterior, to_inference_data


def result(log_weights, draws, **rest):
    log_weights = log_weights - log_weights.flatten().logsumexp(0)
    like = torch.zeros_like(log_weights)
    return ParameterPosterior("smc2", 0, draws, log_weights, like, torch.full((len(like),), 0.3).double(), **rest)


def normal(*shape, seed=0):
    return torch.randn(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def test_names_dimensions_and_statistics():
    draws = {"scale": normal(4, 50), "drift.rate": normal(4, 50, 2)}
    made = result(
        torch.zeros(4, 50, dtype=torch.float64),
        draws,
        paths=normal(4, 50, 7, 3),
        log_evidence=-3.0,
        log_evidence_sd=0.1,
        log_evidence_increment=torch.full((7,), -3 / 7),
        statistics={"outer_ess": 3.9},
    )
    idata = to_inference_data(made, normal(7, 2))
    assert dict(idata.posterior.sizes) == {
        "chain": 4, "draw": 50, "drift.rate_dim_0": 2, "time": 7, "state_dim": 3,
    }  # fmt: skip
    assert np.array_equal(idata.posterior["scale"], draws["scale"])
    assert idata.sample_stats["log_evidence_increment"].dims == ("time",)
    assert idata.sample_stats["acceptance_rate"].dims == ("chain",)
    assert idata.observed_data["y"].shape == (7, 2)
    stats = idata.sample_stats.attrs
    assert stats["log_evidence"] == -3.0
    assert stats["outer_ess"] == 3.9
    assert stats["weight_ess"] == pytest.approx(200)
    own = az.summary(idata, var_names=["scale", "drift.rate"], round_to="none")
    assert stats["r_hat"] == pytest.approx(own["r_hat"].max())
    assert stats["ess_bulk"] == pytest.approx(own["ess_bulk"].min())


def test_weighted_draws_are_resampled():
    """Draws of N(0, 1) with weights of N(.7, 1)."""
    x = normal(4, 5000)
    made = result(0.7 * x, {"x": x})
    assert made.mean("x").item() == pytest.approx(0.7, abs=0.06)
    assert made.sd("x").item() == pytest.approx(1, abs=0.06)
    posterior = to_inference_data(made).posterior["x"]
    assert float(posterior.mean()) == pytest.approx(made.mean("x").item(), abs=0.01)
    # Every chain is the whole posterior's, whatever the weights of runs.
    assert np.abs(posterior.mean("draw") - 0.7).max() < 0.1


def test_runs_that_disagree_have_a_large_r_hat():
    apart = normal(3, 100) + 5 * torch.arange(3).unsqueeze(-1)
    made = result(torch.zeros(3, 100, dtype=torch.float64), {"x": apart})
    assert to_inference_data(made).sample_stats.attrs["r_hat"] > 2


def test_the_file_comes_back(tmp_path):
    made = result(torch.zeros(2, 10, dtype=torch.float64), {"x": normal(2, 10)}, log_evidence=-1.0)
    to_inference_data(made).to_netcdf(str(tmp_path / "posterior.nc"), engine="h5netcdf")
    back = az.from_netcdf(str(tmp_path / "posterior.nc"), engine="h5netcdf")
    assert np.array_equal(back.posterior["x"], made.draws["x"])
    assert back.sample_stats.attrs["method"] == "smc2"
