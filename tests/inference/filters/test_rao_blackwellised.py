"""Rao–Blackwellised filters against the sum over all switch paths, and against Kalman where nothing switches."""

import itertools
import math

import numpy as np
import oracles
import pyro.distributions as dist
import pytest
import torch
from pyro.infer.smcfilter import SMCFailed

from invdyn.inference import Bootstrap, ParticleFilter, backward_mcmc, rao_blackwellised, smooth_inner
from invdyn.models import ConditionallyLinear, StateNumber

K, T, F64 = 2, 6, torch.float64


def numbers(seed=0):
    """Of each of K regimes: A, b, Q, C, d, R; and the start m, P."""
    rng = np.random.default_rng(seed)
    chains = [oracles.random_chain(seed + k, dim=2, size=2, noise=0.5) for k in range(K)]
    pieces = [np.stack([getattr(c, name) for c in chains]) for name in ("A", "Q", "C", "R")]
    b, d = rng.normal(size=(K, 2)), rng.normal(size=(K, 2))
    return *pieces, b, d, chains[0].m, chains[0].P


class Switching(ConditionallyLinear):
    outer_dim, inner_dim, observation_dim, num_steps = 1, 2, 2, T

    def __init__(self, stay=(0.8, 0.6), seed=0):
        names = ("A", "Q", "C", "R", "b", "d", "m", "P")
        super().__init__({n: torch.as_tensor(v) for n, v in zip(names, numbers(seed), strict=True)})
        self.parameters["switch"] = torch.tensor([[stay[0], 1 - stay[0]], [1 - stay[1], stay[1]]], dtype=F64)

    def _of(self, outer, *names):
        number = outer.squeeze(-1).long()
        return tuple(self.parameters[name][number] for name in names)

    def outer_initial(self):
        return StateNumber(torch.tensor([0.7, 0.3], dtype=F64))

    def outer_transition(self, outer, t):
        return StateNumber(self.parameters["switch"][outer.squeeze(-1).long()])

    def inner_initial(self, outer):
        return self.parameters["m"], self.parameters["P"]

    def inner_transition(self, outer, t):
        return self._of(outer, "A", "b", "Q")

    def inner_emission(self, outer, t):
        return self._of(outer, "C", "d", "R")


class Mixed(Switching):
    """The outer state is continuous: a log-variance that wanders."""

    def outer_initial(self):
        return dist.Normal(torch.zeros(1, dtype=F64), 0.5).to_event(1)

    def outer_transition(self, outer, t):
        return dist.Normal(0.9 * outer, 0.4).to_event(1)

    def _of(self, outer, *names):
        return tuple(self.parameters[name][0] for name in names)

    def inner_emission(self, outer, t):
        C, d, R = super().inner_emission(outer, t)
        return C, d, 10 * R * outer.exp().unsqueeze(-1)


class HeavyTailed(Mixed):
    """The outer state has no memory: it says which rows are outliers."""

    def outer_initial(self):
        return StateNumber(torch.tensor([0.8, 0.2], dtype=F64))

    def outer_transition(self, outer, t):
        return self.outer_initial()


def given_path(model, path, y):
    """Log p(u, y), filtered and smoothed means given a switch path, by textbook recursions in numpy."""
    p = {name: value.numpy() for name, value in model.parameters.items()}
    start, switch = np.array([0.7, 0.3]), p["switch"]
    total, mean, cov = math.log(start[path[0]]), p["m"], p["P"]
    filtered, predicted = [], []
    for t, (k, row) in enumerate(zip(path, y, strict=True)):
        if t > 0:
            total += np.log(switch[path[t - 1], k])
            mean, cov = p["A"][k] @ mean + p["b"][k], p["A"][k] @ cov @ p["A"][k].T + p["Q"][k]
        predicted.append((mean, cov))
        seen = np.isfinite(row)
        if seen.any():
            C, d, R = p["C"][k][seen], p["d"][k][seen], p["R"][k][np.ix_(seen, seen)]
            S = C @ cov @ C.T + R
            surprise = row[seen] - C @ mean - d
            total += -0.5 * (surprise @ np.linalg.solve(S, surprise) + np.linalg.slogdet(2 * np.pi * S)[1])
            gain = cov @ C.T @ np.linalg.inv(S)
            mean, cov = mean + gain @ surprise, cov - gain @ C @ cov
        filtered.append((mean, cov))
    smoothed = [filtered[-1][0]]
    for t in range(len(y) - 2, -1, -1):
        gain = filtered[t][1] @ p["A"][path[t + 1]].T @ np.linalg.inv(predicted[t + 1][1])
        smoothed.append(filtered[t][0] + gain @ (smoothed[-1] - predicted[t + 1][0]))
    return total, filtered[-1][0], np.array(smoothed[::-1])


@pytest.fixture(scope="module")
def case():
    """Model, observations with gaps, exact log-evidence, last filtered mean, smoothed means, P(u_t = 1 | y)."""
    model = Switching()
    torch.manual_seed(5)
    y = torch.as_tensor(oracles.with_gaps(model.simulate()[1].numpy()))
    paths = list(itertools.product(range(K), repeat=T))
    logs, last, smoothed = zip(*(given_path(model, path, y.numpy()) for path in paths), strict=True)
    logs = np.array(logs)
    top = logs.max()
    weights = np.exp(logs - top)
    exact = top + math.log(weights.sum())
    weights /= weights.sum()
    return (
        model,
        y,
        exact,
        weights @ np.array(last),
        np.einsum("p,ptd->td", weights, smoothed),
        weights @ np.array(paths),
    )


def close(values, weights, exact):
    """Evidence-weighted means over filters (M, …) within four of their standard errors."""
    weighted = values * weights.reshape(-1, *[1] * (values.ndim - 1))
    error = weighted.std(0) / len(weights) ** 0.5
    return bool(((weighted.mean(0) - torch.as_tensor(exact)).abs() < 4 * error + 1e-9).all())


@pytest.mark.parametrize("threshold", [0.5, 1.0])
@pytest.mark.parametrize("proposal", ["prior", "optimal"])
def test_it_agrees_with_the_sum_over_all_switch_paths(case, proposal, threshold):
    model, y, exact, last, smoothed, switched = case
    result = rao_blackwellised(
        model, y, 15, num_filters=2000, seed=1, proposal=proposal, ess_threshold=threshold, resampling="multinomial"
    )
    assert result.filter.resampled.any()
    ratio = torch.exp(result.filter.log_evidence - exact)
    oracles.assert_unbiased(result.filter.log_evidence, exact)
    assert close(result.mean[-1], ratio, last)
    inner = smooth_inner(model, result, y, 2, seed=2)
    assert inner.outer.shape == (2000, 2, T, 1)
    assert close(inner.mean, ratio, smoothed)
    assert close(inner.outer.mean((1, 3)), ratio, switched)


def test_it_is_kalman_where_nothing_switches():
    model = Switching(stay=(1.0, 1.0))
    model.outer_initial = lambda: StateNumber(torch.tensor([1.0, 0.0], dtype=F64))
    chain = oracles.Chain(*(model.parameters[name][0].numpy() for name in ("A", "Q", "C", "R")),
                          model.parameters["m"].numpy(), model.parameters["P"].numpy())  # fmt: skip
    model.parameters["b"] = torch.zeros(K, 2, dtype=F64)
    model.parameters["d"] = torch.zeros(K, 2, dtype=F64)
    model.num_steps = 30
    y = oracles.with_gaps(chain.simulate(30, seed=1)[1])
    evidence, increments, means, covs = oracles.kalman(chain, y)
    result = rao_blackwellised(model, torch.as_tensor(y), 3, seed=0)
    assert result.filter.log_evidence.item() == pytest.approx(evidence, abs=1e-9)
    assert np.allclose(result.filter.log_evidence_increment[:, 0], increments)
    assert np.allclose(result.mean[:, 0], means)
    assert np.allclose(result.covariance[:, 0], covs)
    smooth_means, smooth_covs = oracles.rts(chain, y)
    inner = smooth_inner(model, result, torch.as_tensor(y), 2, seed=0)
    assert np.allclose(inner.means[0, 0], smooth_means)
    assert np.allclose(inner.covariances[0, 1], smooth_covs)


@pytest.mark.quick("Mixed")
@pytest.mark.parametrize("kind", [Mixed, HeavyTailed])
def test_another_outer_state_agrees_with_a_filter_of_both(kind):
    model = kind(seed=3)
    torch.manual_seed(1)
    y = model.simulate()[1]
    y[2, 0] = math.nan
    inner = rao_blackwellised(model, y, 100, num_filters=400, seed=1)
    joint = ParticleFilter(model, Bootstrap(model), 2000, num_filters=200).run(y)
    ratios = [torch.exp(value - joint.log_evidence.mean()) for value in (inner.filter.log_evidence, joint.log_evidence)]
    means = [ratio.mean() for ratio in ratios]
    error = sum(ratio.var() / len(ratio) for ratio in ratios).sqrt()
    assert error < 0.03
    assert abs(means[0] - means[1]) < 4 * error
    # A twentieth of the particles, for hardly more variance.
    assert ratios[0].var() < 5 * ratios[1].var()
    paths = backward_mcmc(model, joint, y, 20, seed=2)
    ours, theirs = smooth_inner(model, inner, y, 10, seed=1).mean, paths[..., 1:].mean(1)
    error = (ours.var(0) / len(ours) + theirs.var(0) / len(theirs)).sqrt()
    assert ((ours.mean(0) - theirs.mean(0)).abs() < 4.5 * error).all()


def test_the_joint_model_has_the_density_that_it_samples(case):
    model = case[0]
    states, y = model.simulate((3,))
    p = model.parameters
    joint = model.log_joint(states, y[0])
    path = states[1]
    u, x = path[:, 0].long(), path[:, 1:]
    expected = torch.tensor([0.7, 0.3], dtype=F64)[u[0]].log() + dist.MultivariateNormal(p["m"], p["P"]).log_prob(x[0])
    for t in range(T):
        if t > 0:
            step = dist.MultivariateNormal(p["A"][u[t]] @ x[t - 1] + p["b"][u[t]], p["Q"][u[t]])
            expected += p["switch"][u[t - 1], u[t]].log() + step.log_prob(x[t])
        row = dist.MultivariateNormal(p["C"][u[t]] @ x[t] + p["d"][u[t]], p["R"][u[t]])
        expected += row.log_prob(y[0, t])
    assert joint[1].item() == pytest.approx(expected.item())


def test_a_noiseless_inner_state_is_taken():
    """AR(2) as a pair: Q is singular, and no density of the pair exists."""

    class Pair(Switching):
        def inner_transition(self, outer, t):
            A = torch.tensor([[1.2, -0.5], [1.0, 0.0]], dtype=F64)
            return A, torch.zeros(2, dtype=F64), torch.diag(torch.tensor([0.3, 0.0], dtype=F64))

    model = Pair(stay=(1.0, 1.0))
    model.outer_initial = lambda: StateNumber(torch.tensor([1.0, 0.0], dtype=F64))
    torch.manual_seed(0)
    y = torch.randn(T, 2, dtype=F64)
    result = rao_blackwellised(model, y, 2, seed=0)
    inner = smooth_inner(model, result, y, 1, seed=0)
    # The second entry is the first of the row before, in the smoothed means too.
    assert torch.allclose(inner.means[0, 0, 1:, 1], inner.means[0, 0, :-1, 0], atol=1e-8)
    # … and in what the model of both states simulates.
    states, _ = model.simulate((5,))
    assert torch.allclose(states[:, 1:, 2], states[:, :-1, 1])


def test_same_seed_same_numbers(case):
    model, y, *_ = case
    first, second = (rao_blackwellised(model, y, 10, num_filters=3, seed=7).filter.log_evidence for _ in range(2))
    assert torch.equal(first, second)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"proposal": "best"}, ValueError, 'expected the proposal "prior" or "optimal"'),
        ({"ess_threshold": 0.0}, ValueError, "ess_threshold in"),
        ({"proposal": "optimal", "mixed": True}, TypeError, "expected a StateNumber"),
        ({"far": True}, SMCFailed, "row 4"),
    ],
)
def test_what_it_cannot_do_is_refused(case, options, error, message):
    model, y = Mixed() if options.pop("mixed", False) else case[0], case[1]
    if options.pop("far", False):
        y = y.clone()
        y[4] = 1e200
    with pytest.raises(error, match=message):
        rao_blackwellised(model, y, 5, seed=0, **options)
