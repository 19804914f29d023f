"""Every method on a model of one's own: one layout, ArviZ's figures, exact answers; methods side by side."""

import warnings
from functools import cache

import arviz as az
import numpy as np
import pytest
import torch
from oracles import Chain, kalman, random_chain, rts
from pyro.distributions import Normal

from invdyn.inference import compare_methods, infer_states, load_posterior, pooled, save_posterior
from invdyn.inference.contract import ModelError
from invdyn.inference.infer_states import generic_methods
from invdyn.inference.methods.registry import PARAMETER_METHODS, WITHOUT_EVIDENCE
from invdyn.models import StateSpaceModel
from invdyn.recordings import InputError

pytestmark = [
    pytest.mark.filterwarnings("ignore:Estimated shape parameter of Pareto:UserWarning"),
    pytest.mark.filterwarnings("ignore:The inplace keyword in DataFrame:DeprecationWarning"),  # ArviZ on pandas 3
]

T, D = 12, 2
SIZES = {"num_filters": 8, "num_particles": 40, "num_draws": 8}
QUICK = {
    "nuts": {"chains": 2, "warmup": 30},
    "particle-gibbs": {"warmup": 2, "thin": 1},
    "svi": {"max_steps": 200},
    "svi-markov": {"max_steps": 200},
    "vsmc": {"steps": 2},
}
METHODS = [name for name in generic_methods() if name not in PARAMETER_METHODS]


@pytest.fixture(scope="module")
def linear():
    """A linear-Gaussian model with a missing row and a missing entry, its rows, and the exact answers."""
    chain = random_chain(3, dim=D, size=2)
    _, rows = chain.simulate(T, 1)
    rows[4] = np.nan
    rows[7, 1] = np.nan
    means, covariances = rts(chain, rows)
    sd = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    return chain.model(T), rows, kalman(chain, rows)[0], means, sd


@pytest.fixture(scope="module")
def inferred(linear):
    """Function of a method -> its posterior; each runs once."""
    model, rows, *_ = linear
    return cache(lambda method: infer_states(model, rows, method=method, seed=1, **SIZES, **QUICK.get(method, {})))


@pytest.mark.quick("smc", "vsmc", "laplace", "bootstrap", "particle-gibbs")
@pytest.mark.parametrize("method", METHODS)
def test_every_method_gives_one_layout_that_arviz_reads(linear, inferred, method, tmp_path):
    _, rows, evidence, means, sd = linear
    idata = inferred(method)

    states = idata["posterior"]["state"]
    assert states.dims == ("chain", "draw", "time", "state_name")
    assert states.shape[2:] == (T, D)
    assert idata["log_likelihood"]["y"].dims == ("chain", "draw", "time")
    assert 4 not in idata["log_likelihood"]["time"]  # a missing row says nothing
    assert idata["log_likelihood"].sizes["time"] == T - 1
    assert idata["posterior_predictive"]["y"].dims == ("chain", "draw", "time", "column")
    assert np.array_equal(idata["observed_data"]["y"], rows, equal_nan=True)
    if method not in WITHOUT_EVIDENCE:
        assert np.isfinite(idata.attrs["log_evidence"])
    if method in ("smc", "laplace", "vsmc"):
        assert idata.attrs["log_evidence"] == pytest.approx(evidence, abs=1e-4)

    table = az.summary(idata, var_names=["state"])
    assert len(table) == T * D
    if method not in ("svi", "bootstrap"):  # too sure by design; too few particles
        size = max(float(table["ess_bulk"].min()), 20.0)
        off = (pooled(idata)["state"].mean("sample").values - means) / sd
        assert np.abs(off).max() < 4.5 / np.sqrt(size)
    assert np.isfinite(az.loo(idata, var_name="y").elpd_loo)

    save_posterior(idata, tmp_path / "p.nc")
    again = load_posterior(tmp_path / "p.nc")
    assert again["posterior"].equals(idata["posterior"])
    assert again["log_likelihood"].equals(idata["log_likelihood"])


@pytest.mark.long
def test_nuts_has_its_own_statistics(inferred):
    idata = inferred("nuts")
    statistics = idata["sample_stats"]
    for name in ("energy", "lp", "diverging"):
        assert statistics[name].dims == ("chain", "draw")
    # The log-density of whitened draws differs from the joint by a constant and by the whitening's own density.
    assert statistics["energy"].std() > 0
    assert (statistics["energy"] > -statistics["lp"] - 50).all()
    assert float(az.bfmi(idata).min()) > 0.2
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # ArviZ on a newer Matplotlib
        az.plot_energy(idata)


def test_one_number_a_row_has_no_dimension_of_its_own():
    chain = random_chain(5, dim=1, size=1)
    _, rows = chain.simulate(T, 1)
    idata = infer_states(chain.model(T), rows, method="laplace", seed=1, **SIZES)
    assert idata["observed_data"]["y"].dims == ("time",)
    pit = az.loo_pit(idata, y="y")
    assert ((pit >= 0) & (pit <= 1)).all()


def test_models_are_compared_by_arviz():
    """The right noise scale predicts better than one four times too large."""
    chain = random_chain(5, dim=1, size=1)
    _, rows = chain.simulate(60, 1)
    right = chain.model(60)
    wrong = right.replace(emission_root=4 * right.parameters["emission_root"])
    found = {
        name: infer_states(model, rows, method="laplace", seed=1, num_filters=4, num_draws=200)
        for name, model in {"right": right, "wrong": wrong}.items()
    }
    table = az.compare(found, ic="loo", var_name="y")
    assert table.index[0] == "right"
    assert table.loc["wrong", "elpd_diff"] > 2 * table.loc["wrong", "dse"]


def test_priors_need_a_method_that_learns_parameters(linear):
    model, rows, *_ = linear
    uncertain = model.with_priors(mean=Normal(torch.zeros(D, dtype=torch.float64), 1.0).to_event(1))
    with pytest.raises(ModelError, match="smc takes parameters as they are, and mean has a prior"):
        infer_states(uncertain, rows)


@pytest.mark.quick("smc2")
@pytest.mark.parametrize("method", ["pmmh", "smc2"])
def test_parameters_with_priors_are_learned(method):
    """A level that is seen 12 times with known noise: its mean has a Gaussian posterior, known exactly."""
    few = {"pmmh": {"num_chains": 4, "num_draws": 400, "num_warmup": 200, "num_particles": 150, "evidence_draws": 400}}
    chain = random_chain(3, dim=1, size=1)
    _, rows = chain.simulate(T, 1)
    model = chain.model(T).with_priors(mean=Normal(torch.zeros(1, dtype=torch.float64), 1.0).to_event(1))
    arguments = few.get(method, {"num_draws": 100, "num_particles": 30})
    idata = infer_states(model, rows, method=method, seed=1, **arguments)

    # Integrated over N(0, 1): the same chain with a wider first state.
    wide = Chain(chain.A, chain.Q, chain.C, chain.R, 0 * chain.m, chain.P + 1)
    means, covariances = rts(wide, rows)
    gain = 1 / wide.P[0, 0]
    mean = gain * means[0, 0]
    sd = np.sqrt(1 - gain + gain**2 * covariances[0, 0, 0])
    drawn = idata["posterior"]["mean"]
    assert drawn.dims == ("chain", "draw", "mean_dim_0")
    size = float(az.ess(idata, var_names=["mean"])["mean"].min())
    assert size > 50
    assert float(drawn.mean()) == pytest.approx(mean, abs=4 * sd / np.sqrt(size))
    assert float(drawn.std()) == pytest.approx(sd, rel=4 / np.sqrt(size))
    evidence = kalman(wide, rows)[0]
    assert idata.attrs["log_evidence"] == pytest.approx(evidence, abs=4 * idata.attrs["log_evidence_sd"] + 0.02)
    assert idata["sample_stats"].attrs["usable"] == 1
    if method == "smc2":
        increments = idata["sample_stats"]["log_evidence_increment"]
        assert increments.sizes["time"] == T
        assert increments.sum("time").values == pytest.approx(idata.attrs["log_evidence"])

    # States belong to the parameters of their draw.
    assert idata["posterior"]["state"].shape[2:] == (T, 1)
    assert np.isfinite(az.loo(idata, var_name="y").elpd_loo)
    assert "mean" not in idata["constant_data"]


class Pair(StateSpaceModel):
    """An autoregression of order two as a pair: the second state is the first one's past, without noise."""

    state_dim, observation_dim, num_steps = 2, 1, T

    def initial(self):
        return Normal(torch.zeros(2, dtype=torch.float64), 1.0).to_event(1)

    def transition(self, state, t):
        now = 0.6 * state[..., :1] + 0.2 * state[..., 1:]
        mean = torch.cat([now, state[..., :1]], -1)
        scale = torch.tensor([0.25, 0.0], dtype=torch.float64)
        return Normal(mean, scale, validate_args=False).to_event(1)

    def emission(self, state, t):
        return Normal(state[..., :1], 0.5).to_event(1)


def test_a_state_without_noise_is_smoothed_along_its_genealogy():
    model = Pair()
    _, rows = model.simulate(seed=2)
    with pytest.raises(ModelError, match="genealogy"):
        infer_states(model, rows, method="bootstrap")
    idata = infer_states(model, rows, method="bootstrap", smoothing="genealogy", num_particles=400, seed=0)
    states = idata["posterior"]["state"].values
    np.testing.assert_allclose(states[..., 1:, 1], states[..., :-1, 0], atol=1e-12)
    A, noise = np.array([[0.6, 0.2], [1.0, 0.0]]), np.diag([0.25**2, 0.0])
    chain = Chain(A, noise, np.array([[1.0, 0.0]]), np.array([[0.25]]), np.zeros(2), np.eye(2))
    evidence = kalman(chain, rows.numpy())[0]
    assert idata.attrs["log_evidence"] == pytest.approx(evidence, abs=4 * idata.attrs["log_evidence_sd"])


def test_learning_parameters_needs_priors(linear):
    model, rows, *_ = linear
    with pytest.raises(ModelError, match="pmmh learns parameters, and none has a prior"):
        infer_states(model, rows, method="pmmh")


def test_what_has_no_body_is_refused_in_one_line(linear):
    model, rows, *_ = linear
    with pytest.raises(ModelError, match="differentiate needs a body"):
        infer_states(model, rows, method="differentiate")
    with pytest.raises(ModelError, match="expected a method among smc, bootstrap"):
        infer_states(model, rows, method="magic")


def test_the_old_name_of_a_method_is_known(linear):
    model, rows, *_ = linear
    with pytest.warns(UserWarning, match="'nested' is now 'smc'"):
        assert infer_states(model, rows, method="nested", **SIZES).attrs["method"] == "smc"


# -- side by side ------------------------------------------------------------------------------------
@pytest.mark.long
def test_methods_in_one_table(linear):
    model, rows, evidence, means, _ = linear
    found = compare_methods(
        model, rows, ["smc", "laplace", "particle-gibbs"], truth=means, seed=1, replicates=2,
        arguments={"particle-gibbs": QUICK["particle-gibbs"]},
        **SIZES,
    )  # fmt: skip
    table = found.table
    assert list(table.index) == ["smc", "laplace", "particle-gibbs"]
    assert found.failures == {}
    for name in ("elpd_loo", "elpd_loo_se", "pareto_k", "r_hat", "ess_bulk", "ess_tail", "mcse", "ess_per_second"):
        assert np.isfinite(table[name]).all(), name
    assert (table["replicates"] == 2).all()
    assert table.loc["smc", "log_evidence"] == pytest.approx(evidence, abs=1e-4)
    assert table.loc["smc", "replicates_sd"] < 1e-4
    assert 0 < table.loc["laplace", "0_rmse"] < 1
    # 64 independent draws
    assert 30 < table.loc["laplace", "ess_bulk"] < 110


def test_sizes_reach_methods_that_learn_parameters(linear, tmp_path):
    """And a comparison continues from its checkpoint."""
    model, rows, *_ = linear
    uncertain = model.with_priors(mean=Normal(torch.zeros(D, dtype=torch.float64), 1.0).to_event(1))
    few = {"pmmh": {"num_warmup": 4, "evidence_draws": 20}, "smc2": {"num_moves": 1, "max_particles": 10}}

    def run(**given):
        sizes = {"num_filters": 2, "num_particles": 10, "num_draws": 40}
        return compare_methods(uncertain, rows, ["pmmh", "smc2"], arguments=few, checkpoint=tmp_path, **sizes, **given)

    found = run()
    assert found.failures == {}
    for idata in found.posteriors.values():
        assert dict(idata["posterior"].sizes) | {"chain": 2, "draw": 40} == dict(idata["posterior"].sizes)
        assert idata["sample_stats"].attrs["num_particles"] == 10
    assert run().table.equals(found.table)  # the seconds too: nothing was run again
    with pytest.raises(InputError, match="another run"):
        run(seed=1)


def test_a_method_that_fails_leaves_its_reason(linear):
    model, rows, *_ = linear
    found = compare_methods(model, rows, ["laplace", "nuts"], seed=1, num_filters=1, num_draws=1, num_particles=10)
    assert set(found.failures) == {"nuts"}
    assert "nuts: expected 4 draws" in found.failures["nuts"]
    assert found.table.loc["nuts", "failure"] == found.failures["nuts"]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"methods": []}, "expected methods among"),
        ({"methods": ["differentiate"]}, "got differentiate"),
        ({"replicates": 0}, "at least one replicate"),
        ({"truth": np.zeros((T, 5))}, "true states of shape"),
    ],
)
def test_what_cannot_be_compared_is_refused(linear, change, said):
    model, rows, *_ = linear
    with pytest.raises(InputError, match=said):
        compare_methods(**{"model": model, "rows": rows, "methods": ["laplace"], **change})
