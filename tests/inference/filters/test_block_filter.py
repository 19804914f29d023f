"""A filter in blocks against Kalman, and against controlled SMC row by row."""

import math
from dataclasses import replace

import numpy as np
import oracles
import pytest
import torch
from pyro.infer.smcfilter import SMCFailed

from invdyn.inference import Controlled, ParticleFilter, gauss_newton, genealogy
from invdyn.inference.filters import block_filter as room
from invdyn.inference.filters.block_filter import BlockFilter
from invdyn.models import Link, planar_body
from invdyn.simulate import random_arm, record

STEPS = 11


@pytest.fixture(scope="module")
def chain():
    return oracles.random_chain(seed=5, noise=6.0)


@pytest.fixture(scope="module")
def y(chain):
    return torch.as_tensor(oracles.with_gaps(chain.simulate(STEPS, seed=5)[1]))


def smoothers(model, y, filters):
    path = gauss_newton(model, y).path
    return gauss_newton(model, y, start=path.expand(filters, *path.shape))


def misled(smoother):
    """The same factors, but dynamics that are not the model's."""
    line = smoother.linearisation
    return replace(smoother, linearisation=replace(line, F=0.8 * line.F, a=line.a + 0.1))


@pytest.mark.parametrize("block", [1, 4, 50])
def test_exact_on_linear_models(chain, y, block):
    model = chain.model(STEPS)
    result = BlockFilter(model, smoothers(model, y, 3), 5, block=block).run(y)
    exact = oracles.kalman(chain, y.numpy())[0]
    # slopes are differences, and lines' too are rounded in the eleventh digit
    assert result.log_evidence.tolist() == pytest.approx([exact] * 3, abs=1e-8)
    assert result.log_evidence_increment.sum(0).tolist() == pytest.approx([exact] * 3, abs=1e-8)
    assert not result.resampled.any()
    assert result.states.shape == (STEPS, 3, 5, 3)
    torch.testing.assert_close(result.ess, torch.full((STEPS, 3), 5.0).double())


@pytest.mark.parametrize("threshold", [1e-6, 0.5, 1.0])
@pytest.mark.parametrize("passes", [1, 2])
def test_unbiased_when_passes_have_not_converged(chain, y, threshold, passes, monkeypatch):
    """E[Ẑ]/Z = 1 within four standard errors, of wrong dynamics that pull the draws away."""
    monkeypatch.setattr(room, "PASSES", passes)
    model = chain.model(STEPS)
    torch.manual_seed(1)
    wrong = misled(smoothers(model, y, 400))
    result = BlockFilter(model, wrong, 20, block=4, ess_threshold=threshold).run(y)
    ratio = torch.exp(result.log_evidence - oracles.kalman(chain, y.numpy())[0])
    error = ratio.std().item() / math.sqrt(len(ratio))
    assert 1e-4 < error < 0.15
    assert abs(ratio.mean().item() - 1) < 4 * error
    if threshold == 1.0:
        assert result.resampled[3].all()
    assert not result.resampled[[0, 1, 2, 4, 5, 6, -1]].any()  # within a block, and at the end


def test_passes_bring_wrong_dynamics_to_the_exact_filter(chain, y):
    """Newton's method on a block of four ends after four passes at the latest: the causes come before the effects."""
    model = chain.model(STEPS)
    right = smoothers(model, y, 4)
    result = BlockFilter(model, misled(right), 5, block=4).run(y)
    assert (result.log_evidence - oracles.kalman(chain, y.numpy())[0]).abs().max() < 1e-9


def test_paths_are_draws_from_the_posterior(chain, y, monkeypatch):
    monkeypatch.setattr(room, "PASSES", 1)
    model = chain.model(STEPS)
    torch.manual_seed(2)
    result = BlockFilter(model, misled(smoothers(model, y, 200)), 200, block=4).run(y)
    assert result.resampled.any()
    draws = genealogy(result, 50).flatten(0, 1).numpy()
    means, covs = oracles.rts(chain, y.numpy())
    sd = np.sqrt(np.diagonal(covs, axis1=1, axis2=2))
    # 200 filters; their lines have a common ancestor each at worst
    assert (np.abs(draws.mean(0) - means) < 4 / math.sqrt(200) * sd).all()
    assert (np.abs(draws.std(0) / sd - 1) < 4 / math.sqrt(400)).all()


def test_a_nonlinear_arm_as_controlled_smc():
    """Two links, filmed: same evidence as row by row, within the error of both."""
    body = planar_body("arm", [Link("a", "p", "q", 0.3, 1.0), Link("b", "q", "r", 0.25, 0.8)], gravity=(0.0, -9.81))
    arm = random_arm(body, duration=0.7, fps=50, noise=0.05, torque_scale=1.0, seed=4)
    noise = {"emission.keypoint_scale": 0.05, "noise.angle": 1e-3, "noise.velocity": 1e-2}
    arm = arm.replace(**{name: torch.full((2,), value).double() for name, value in noise.items()})
    seen = torch.as_tensor(record(arm, 4)[0].keypoints).flatten(1)
    seen[5, :2] = torch.nan
    torch.manual_seed(3)
    smoother = smoothers(arm, seen, 60)
    ours = BlockFilter(arm, smoother, 40, block=10).run(seen).log_evidence
    theirs = ParticleFilter(arm, Controlled(arm, seen), 40, num_filters=60).run(seen).log_evidence
    means = [(log - theirs.mean()).exp() for log in (ours, theirs)]
    error = math.hypot(*(float(m.std()) / math.sqrt(60) for m in means))
    assert 1e-4 < error < 0.1
    assert abs(float(means[0].mean() - means[1].mean())) < 4 * error


def test_same_seed_same_numbers(chain, y):
    model = chain.model(STEPS)
    runs = []
    for _ in range(2):
        torch.manual_seed(7)
        runs.append(BlockFilter(model, smoothers(model, y, 3), 5, block=4).run(y))
    assert torch.equal(runs[0].states, runs[1].states)
    assert torch.equal(runs[0].log_evidence, runs[1].log_evidence)


def test_a_filter_that_loses_all_its_particles_says_where(chain, y):
    model = chain.model(STEPS)
    smoother = smoothers(model, y, 2)
    far = y.clone()
    far[6] = torch.inf
    with pytest.raises(SMCFailed, match="row 6"):
        BlockFilter(model, smoother, 5, block=4).run(far)


@pytest.mark.parametrize(("options", "said"), [
    ({"num_particles": 0}, "particle"),
    ({"num_particles": 5, "block": 0}, "row"),
    ({"num_particles": 5, "ess_threshold": 0.0}, "ess_threshold"),
])  # fmt: skip
def test_bad_numbers(chain, y, options, said):
    model = chain.model(STEPS)
    with pytest.raises(ValueError, match=said):
        BlockFilter(model, smoothers(model, y, 2), **options)
