"""Evidence, weights and ancestors against Kalman, under every scheme of resampling."""

import math

import numpy as np
import oracles
import pyro
import pyro.distributions as dist
import pytest
import torch
from pyro.infer import SMCFilter
from pyro.infer.smcfilter import SMCFailed

from invdyn.inference import (
    RESAMPLERS,
    Bootstrap,
    Controlled,
    ParticleFilter,
    Proposal,
    backward_simulation,
    gauss_newton,
    genealogy,
)
from invdyn.models import LinearGaussian

F32, F64 = torch.float32, torch.float64
STEPS = 10


@pytest.fixture(scope="module")
def chain():
    return oracles.random_chain(seed=5, noise=6.0)


@pytest.fixture(scope="module")
def y(chain):
    return oracles.with_gaps(chain.simulate(STEPS, seed=5)[1])


class Ahead(Proposal):
    """The bootstrap guide with a shifted, wider proposal and a twist, both arbitrary: weights must undo them."""

    def conditional_initial(self):
        first = self.model.initial()
        return dist.MultivariateNormal(first.loc + 0.2, scale_tril=1.3 * first.scale_tril)

    def conditional(self, t, state):
        step = self.model.transition(state, t)
        return dist.MultivariateNormal(step.loc - 0.1, scale_tril=1.2 * step.scale_tril)

    def log_twist(self, state, t):
        return 0.3 * torch.sin(state["x"]).sum(-1)


def run(particle_filter, y, way):
    """Log-evidence (M,), by either of the two ways in."""
    """Log-evidence, and which filters were resampled at each row, (T, M)."""
    if way == "run":
        result = particle_filter.run(y)
        return result.log_evidence, result.resampled
    particle_filter.init(y[0])
    resampled = [particle_filter.resampled]
    for t in range(1, len(y)):
        particle_filter.step(t, y[t])
        resampled.append(particle_filter.resampled)
    return particle_filter.log_evidence, torch.stack(resampled)


@pytest.mark.quick("systematic-*", "multinomial-*-steps")
@pytest.mark.parametrize("way", ["run", "steps"])
@pytest.mark.parametrize("guide", [Bootstrap, Ahead])
@pytest.mark.parametrize("dtype", [F32, F64])
@pytest.mark.parametrize("scheme", RESAMPLERS)
def test_evidence_is_unbiased_over_a_thousand_filters(chain, y, scheme, dtype, guide, way):
    model = chain.model(STEPS, dtype)
    filters = ParticleFilter(model, guide(model), 100, num_filters=1000, resampling=scheme)
    log_evidence, resampled = run(filters, torch.as_tensor(y, dtype=dtype), way)
    # adaptive: some rows resample in some of the filters and not in others
    share = resampled.double().mean(-1)
    assert ((share > 0.02) & (share < 0.98)).any()
    assert log_evidence.shape == (1000,)
    assert log_evidence.dtype == F64
    oracles.assert_unbiased(log_evidence, oracles.kalman(chain, y)[0])


@pytest.mark.quick("0.2")
@pytest.mark.parametrize("threshold", [1e-6, 0.2, 1.0])
def test_evidence_is_unbiased_whenever_it_resamples(chain, y, threshold):
    model = chain.model(STEPS)
    filters = ParticleFilter(model, Bootstrap(model), 300, num_filters=1000, ess_threshold=threshold)
    result = filters.run(torch.as_tensor(y))
    if threshold == 1.0:
        seen = np.isfinite(y).any(-1)
        assert result.resampled[:-1][seen[:-1]].all()
    if threshold == 1e-6:
        assert not result.resampled.any()
    assert not result.resampled[-1].any()
    oracles.assert_unbiased(result.log_evidence, oracles.kalman(chain, y)[0])


@pytest.mark.parametrize("way", ["run", "steps"])
@pytest.mark.parametrize("dtype", [F32, F64])
@pytest.mark.parametrize("particles", [1, 20])
def test_the_controlled_guide_is_exact_on_linear_models(chain, y, dtype, particles, way):
    model = chain.model(STEPS, dtype)
    y = torch.as_tensor(y, dtype=dtype)
    filters = ParticleFilter(model, Controlled(model, y), particles, num_filters=3)
    log_evidence, _ = run(filters, y, way)
    exact = oracles.kalman(chain, y.double().numpy())[0]
    tolerance = 1e-8 if dtype == F64 else 1e-4  # slopes are by differences
    assert log_evidence.tolist() == pytest.approx([exact] * 3, abs=tolerance)


def test_increments_are_those_of_the_kalman_filter(chain, y):
    model = chain.model(STEPS)
    result = ParticleFilter(model, Bootstrap(model), 20_000, num_filters=4).run(torch.as_tensor(y))
    increments = oracles.kalman(chain, y)[1]
    assert result.log_evidence_increment.shape == (STEPS, 4)
    assert np.abs(result.log_evidence_increment.mean(-1).numpy() - increments).max() < 0.03
    assert result.log_evidence.tolist() == pytest.approx(result.log_evidence_increment.sum(0).tolist())
    # nothing seen, nothing learned
    assert result.log_evidence_increment[1].abs().max() < 1e-12


def test_filtered_moments_are_those_of_the_kalman_filter(chain, y):
    model = chain.model(STEPS)
    result = ParticleFilter(model, Ahead(model), 20_000, num_filters=4).run(torch.as_tensor(y))
    untwisted = torch.softmax(result.log_weights - result.log_twist, -1)
    mean = (untwisted.unsqueeze(-1) * result.states).sum(-2)
    off = result.states - mean.unsqueeze(-2)
    cov = torch.einsum("tmn,tmni,tmnj->tmij", untwisted, off, off)
    _, _, means, covs = oracles.kalman(chain, y)
    # 80,000 draws, an effective third of them: standard error of a mean 0.006 sd
    sd = np.sqrt(np.diagonal(covs, axis1=1, axis2=2))
    assert (np.abs(mean.mean(1).numpy() - means) < 0.04 * sd).all()
    assert (np.abs(cov.mean(1).numpy() - covs) < 0.06 * sd[:, :, None] * sd[:, None, :]).all()


def test_shapes_and_normalised_weights(chain, y):
    model = chain.model(STEPS, F32)
    result = ParticleFilter(model, Controlled(model, torch.as_tensor(y)), 7, num_filters=5).run(
        torch.as_tensor(y, dtype=F32)
    )
    assert result.states.shape == (STEPS, 5, 7, 3)
    assert result.states.dtype == F32
    assert result.ess.shape == result.resampled.shape == (STEPS, 5)
    assert result.log_weights.shape == result.log_twist.shape == result.ancestors.shape == (STEPS, 5, 7)
    torch.testing.assert_close(result.log_weights.exp().sum(-1), torch.ones(STEPS, 5))
    torch.testing.assert_close(1 / result.log_weights.double().exp().square().sum(-1), result.ess, rtol=1e-5, atol=0)
    torch.testing.assert_close(result.log_twist[-1], torch.zeros(5, 7))


def test_one_filter_of_plain_shapes_gives_what_a_stack_of_one_gives(chain, y):
    model = chain.model(STEPS)
    results = []
    for count in (None, 1):
        torch.manual_seed(5)
        results.append(ParticleFilter(model, Bootstrap(model), 50, num_filters=count).run(torch.as_tensor(y)))
    assert torch.equal(results[0].states, results[1].states)
    assert torch.equal(results[0].log_evidence, results[1].log_evidence)
    assert torch.equal(results[0].ancestors, results[1].ancestors)


def test_a_filter_can_run_again(chain, y):
    model = chain.model(STEPS)
    y = torch.as_tensor(y)
    particle_filter = ParticleFilter(model, Bootstrap(model), 50, num_filters=2)
    results = []
    for _ in range(2):
        torch.manual_seed(5)
        results.append(run(particle_filter, y, "run")[0])
        torch.manual_seed(6)
        results.append(run(particle_filter, y, "steps")[0])
    assert torch.equal(results[0], results[2])
    assert torch.equal(results[1], results[3])


@pytest.mark.parametrize("guide", [Bootstrap, Controlled])
def test_keep_keeps_the_last_rows_and_changes_nothing(chain, y, guide):
    model, y = chain.model(STEPS), torch.as_tensor(y)
    guide = guide(model) if guide is Bootstrap else guide(model, y)
    results = {}
    for keep in (None, 3, 0):
        torch.manual_seed(5)
        results[keep] = ParticleFilter(model, guide, 20, num_filters=4).run(y, keep=keep)
    for name in ("states", "log_weights", "ancestors", "log_twist"):
        full = getattr(results[None], name)
        if full is not None:
            assert torch.equal(getattr(results[3], name), full[-3:])
    assert len(results[0].states) == 0
    for result in results.values():
        assert torch.equal(result.log_evidence, results[None].log_evidence)
        assert result.ess.shape == (STEPS, 4)


class Recorded(Bootstrap):
    """Carries along where each particle has been: the ancestors' own account."""

    def propose_initial(self, shape):
        particles, ratio = super().propose_initial(shape)
        return {**particles, "past": particles["x"].unsqueeze(-2)}, ratio

    def propose(self, t, particles):
        new, ratio = super().propose(t, particles)
        return {**new, "past": torch.cat([particles["past"], new["x"].unsqueeze(-2)], -2)}, ratio


def test_ancestors_lead_back_along_the_particles_own_past(chain, y):
    model = chain.model(STEPS)
    guide, pasts = Recorded(model), []

    propose, propose_initial = guide.propose, guide.propose_initial

    def watch(function):
        def wrapped(*args):
            particles, ratio = function(*args)
            pasts.append(particles["past"])
            return particles, ratio

        return wrapped

    guide.propose, guide.propose_initial = watch(propose), watch(propose_initial)
    result = ParticleFilter(model, guide, 12, num_filters=6).run(torch.as_tensor(y))
    assert result.resampled.any()
    assert not result.resampled[:-1].all()
    past = pasts[-1]  # (M, N, T, D)
    index = torch.arange(12).expand(6, 12)
    for t in range(STEPS - 1, -1, -1):
        mine = result.states[t].gather(-2, index.unsqueeze(-1).expand(-1, -1, 3))
        assert torch.equal(mine, past[..., t, :])
        index = result.ancestors[t].long().gather(-1, index)
    lines = genealogy(result, 40)
    for m in range(6):
        known = {tuple(line.flatten().tolist()) for line in past[m]}
        assert {tuple(line.flatten().tolist()) for line in lines[m]} <= known


def test_progress_counts_the_rows(chain, y):
    model, reported = chain.model(STEPS), []
    ParticleFilter(model, Bootstrap(model), 5).run(torch.as_tensor(y), progress=lambda *n: reported.append(n))
    assert reported == [(t + 1, STEPS) for t in range(STEPS)]


@pytest.mark.parametrize("way", ["run", "steps"])
def test_impossible_data_fail_and_name_the_row(chain, y, way):
    model, y = chain.model(STEPS), torch.as_tensor(y).clone()
    y[5] = 1e200
    filters = ParticleFilter(model, Bootstrap(model), 10, num_filters=2)
    with pytest.raises(SMCFailed, match=r"2 filter.*row 5"), pyro.validation_enabled(False):
        run(filters, y, way)


def test_one_dead_filter_is_enough_to_fail():
    class OneDead(Bootstrap):
        def propose(self, t, particles):
            new, ratio = super().propose(t, particles)
            ratio[1] = -torch.inf
            return new, ratio

    model = oracles.random_chain().model(STEPS)
    with pytest.raises(SMCFailed, match=r"1 filter.*row 1"):
        ParticleFilter(model, OneDead(model), 10, num_filters=4).run(torch.zeros(STEPS, 2, dtype=F64))


class Overflows(Bootstrap):
    """Half of the particles end as NaN at row 2, as when dynamics run away; they count as nothing."""

    def propose(self, t, particles):
        new, ratio = super().propose(t, particles)
        if t == 2:
            new["x"][:, ::2] = torch.nan
        return new, ratio


@pytest.mark.long
def test_particles_that_overflow_have_weight_zero(chain, y):
    model = chain.model(STEPS)
    result = ParticleFilter(model, Overflows(model), 400, num_filters=500).run(torch.as_tensor(y))
    assert (result.log_weights[2, :, ::2] == -torch.inf).all()
    oracles.assert_unbiased(result.log_evidence, oracles.kalman(chain, y)[0] - math.log(2))
    assert torch.isfinite(genealogy(result, 10)).all()
    assert torch.isfinite(backward_simulation(model, result, torch.as_tensor(y), 3)).all()
    bridge = gauss_newton(model, torch.as_tensor(y))
    draws = backward_simulation(model, result, torch.as_tensor(y), 3, smoother=bridge, block=2)
    assert torch.isfinite(draws).all()


@pytest.mark.parametrize(
    "wrong",
    [{"ess_threshold": 0.0}, {"ess_threshold": 1.1}, {"num_particles": 0}, {"num_filters": 0}],
)
def test_wrong_sizes_are_refused(wrong):
    arguments = {"num_particles": 10, **wrong}
    with pytest.raises(ValueError, match="expected"):
        ParticleFilter(None, None, **arguments)


def test_a_model_and_its_proposal_run_in_the_stock_filter(chain, y):
    """The other direction: our pairs are Pyro pairs."""
    model, y = chain.model(STEPS, F32), torch.as_tensor(y, dtype=F32)
    smc = SMCFilter(model, Bootstrap(model), 500, 0)
    smc.init(y[0])
    for t in range(1, STEPS):
        smc.step(t, y[t])
    probs = torch.softmax(smc.state._log_weights, -1)
    mean = (probs.unsqueeze(-1) * smc.state["x"]).sum(0)
    _, _, means, covs = oracles.kalman(chain, y.double().numpy())
    # an ESS of at least a few dozen
    assert (np.abs(mean.numpy() - means[-1]) < 0.6 * np.sqrt(np.diag(covs[-1]))).all()


@pytest.mark.slow
def test_evidence_stays_unbiased_over_a_long_run_with_rare_resampling():
    one = np.ones((1, 1))
    chain = oracles.Chain(0.95 * one, 0.1 * one, one, 0.5 * one, np.zeros(1), one)
    y = oracles.with_gaps(chain.simulate(200, seed=2)[1])
    model = chain.model(200)
    assert isinstance(model, LinearGaussian)
    result = ParticleFilter(model, Bootstrap(model), 1000, num_filters=1000).run(torch.as_tensor(y), keep=0)
    oracles.assert_unbiased(result.log_evidence, oracles.kalman(chain, y)[0])
