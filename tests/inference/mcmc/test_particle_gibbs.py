"""Particle Gibbs: exact on linear models for few particles, and invariant whatever guides it."""

from dataclasses import replace

import numpy as np
import pyro.distributions as dist
import pytest
import torch
from oracles import random_chain, rts, with_gaps
from scipy.stats import kstest

from invdyn.inference import (
    Bootstrap,
    Checkpoint,
    Controlled,
    Problem,
    SMCOptions,
    arm_problem,
    gauss_newton,
    pooled,
    process_pool,
    smc,
)
from invdyn.inference.filters.bridge import Bridge
from invdyn.inference.mcmc.particle_gibbs import first_paths, move_blocks, sweep
from invdyn.inference.methods.particle_gibbs import particle_gibbs
from invdyn.inference.smoothing.gaussian_chain import GaussianChain
from invdyn.models import Link, planar_body
from invdyn.recordings import InputError, Recording

STEPS = 16


def small(seed=1, steps=STEPS):
    """A linear model with gaps in what it saw: model, observations, exact smoothed means and covariances."""
    chain = random_chain(seed, dim=2, size=1)
    y = with_gaps(chain.simulate(steps, seed)[1])
    return chain.model(steps), torch.as_tensor(y), *rts(chain, y)


def assert_exact(paths, means, covariances, effective):
    """Means and covariances of paths (S, T, D), each of S draws, of which ``effective`` are independent."""
    paths = paths.numpy()
    sd = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    assert np.abs((paths.mean(0) - means) / sd).max() < 4.5 / np.sqrt(effective)
    off = paths - paths.mean(0)
    found = np.einsum("sti,stj->tij", off, off) / len(paths)
    unit = sd[:, :, None] * sd[:, None, :]
    assert np.abs((found - covariances) / unit).max() < 4.5 * np.sqrt(2 / effective)


@pytest.mark.quick("5-0.5")
@pytest.mark.parametrize(("particles", "threshold"), [(5, 1.0), (15, 1.0), (5, 0.5)])
def test_few_blind_particles_find_the_exact_posterior(particles, threshold):
    model, y, means, covariances = small()
    torch.manual_seed(0)
    guide = Bootstrap(model)
    paths = first_paths(guide, y, 600, particles, threshold=threshold)
    for _ in range(15):
        paths = sweep(guide, y, paths, particles, threshold=threshold)
    assert_exact(paths, means, covariances, 600)


@pytest.mark.quick("controlled-1.0", "bootstrap-0.5")
@pytest.mark.parametrize("threshold", [1.0, 0.5])
@pytest.mark.parametrize("kind", ["bootstrap", "controlled", "misled"])
def test_a_sweep_leaves_the_posterior_as_it_is(kind, threshold):
    model, y, means, covariances = small()
    smoother = gauss_newton(model, y)
    # A guide that believes other data: its weights are uneven and its twist is wrong.
    misled = Controlled(model, y, gauss_newton(model, 0.5 * y.roll(2, 0)))
    guide = {"bootstrap": Bootstrap(model), "controlled": Controlled(model, y, smoother), "misled": misled}[kind]
    torch.manual_seed(1)
    reference = GaussianChain.of(smoother).sample((20_000,))
    paths = sweep(guide, y, reference, 3, threshold=threshold)
    assert_exact(paths, means, covariances, 20_000)
    assert (paths != reference).any(-1).double().mean() > 0.1


def test_ancestor_sampling_gives_the_path_a_new_past():
    """Without it, the first rows of a path of 60 rows never change with 4 particles."""
    model, y, *_ = small(steps=60)
    torch.manual_seed(0)
    paths = first_paths(Bootstrap(model), y, 500, 4, threshold=1.0)
    changed = sweep(Bootstrap(model), y, paths, 4, threshold=1.0) != paths
    assert changed.any(-1).double().mean(0).min() > 0.3


def test_an_exact_guide_gives_an_independent_draw():
    model, y, means, covariances = small()
    guide = Controlled(model, y)
    torch.manual_seed(0)
    reference = torch.full((4000, STEPS, 2), 10.0, dtype=torch.float64)
    paths = sweep(guide, y, reference, 40)
    # The reference path is one of 40 equally good ones, were it any good: nothing else of it is left.
    fresh = (paths != reference).any(-1).all(-1)
    assert fresh.double().mean() > 0.95
    assert_exact(paths[fresh], means, covariances, int(fresh.sum()))


def test_no_ancestor_is_preferred_by_its_number():
    """With two particles, dropping one ancestor rather than another shows: the reference one has the last number."""
    model, y, means, covariances = small()
    smoother = gauss_newton(model, y)
    misled = Controlled(model, y, gauss_newton(model, 0.5 * y.roll(2, 0)))
    torch.manual_seed(4)
    paths = GaussianChain.of(smoother).sample((20_000,))
    for _ in range(3):
        paths = sweep(misled, y, paths, 2, threshold=1.0)
    assert_exact(paths, means, covariances, 20_000)


def test_blocks_move_and_leave_the_posterior_as_it_is():
    model, y, means, covariances = small()
    smoother = gauss_newton(model, y)
    torch.manual_seed(2)
    reference = GaussianChain.of(smoother).sample((20_000,))
    paths = move_blocks(Bridge(model, y, smoother, 4), reference, 1)
    assert_exact(paths, means, covariances, 20_000)
    moved = (paths != reference).any(-1).double().mean(0)
    assert (moved[[0, 1, -1]] == 0).all()
    assert (moved[2:-2] == 1).all()  # on a linear model every move is accepted


# -- arms --------------------------------------------------------------------------------------------
def arm(steps=12):
    """A pendulum whose torque is unknown."""
    body = planar_body("arm", [Link("rod", "pivot", "tip", length=0.5, mass=1.0)])
    time = 0.05 * np.arange(steps)
    angle = -1.2 + 0.5 * np.sin(4 * time)
    tips = 0.5 * np.stack([np.cos(angle), np.sin(angle)], -1)[:, None]
    known = {"torque.scale": 6.0, "emission.keypoint_scale": 0.03, "noise.velocity": 0.1, "noise.angle": 0.02}
    return arm_problem(Recording(time=time, keypoints=tips, keypoint_names=("tip",)), body, parameters=known)


def test_a_nonlinear_model_and_its_data_keep_their_joint_distribution():
    """Geweke's test: (x, y) from the prior; sweeps given y change x, and no moment of (x, y)."""
    model = arm(8).model
    torch.manual_seed(0)
    states, y = model.simulate((8000,))
    rows = y.movedim(1, 0).unsqueeze(-2)  # each chain has data of its own
    paths = states
    for _ in range(3):
        paths = sweep(Bootstrap(model), rows, paths, 4, threshold=1.0)
    assert (paths != states).any(-1).double().mean() > 0.4

    def moments(path):
        angle = path[..., 1]
        return torch.cat([path.flatten(1), path.flatten(1) ** 2, angle * y[..., 0], path[..., 0] * y[..., 1]], -1)

    off = moments(paths) - moments(states)
    z = off.mean(0) / (off.std(0) / len(off) ** 0.5).clamp_min(1e-12)
    assert z.abs().max() < 4.5


@pytest.mark.slow
def test_ranks_of_the_truth_are_uniform():
    """Simulation-based calibration of the whole method, warm-up and all."""
    given, ranks = arm(), []
    for seed in range(150):
        torch.manual_seed(seed)
        path, y = given.model.simulate()
        options = SMCOptions(num_filters=8, num_particles=10, num_draws=4, refits=0)
        idata = particle_gibbs(replace(given, observations=y), options=options, seed=seed, warmup=5)
        torque = idata["posterior"]["torque"].values[..., 0].reshape(32, -1)
        ranks.append((torque < path[:, 0].numpy()).mean(0)[[2, 6, 10]])
    jitter = np.random.default_rng(0).uniform(size=(150, 3)) / 33
    for row in (np.array(ranks) * 32 / 33 + jitter).T:
        assert kstest(row, "uniform").pvalue > 1e-3


@pytest.mark.long
def test_it_agrees_with_controlled_smc_and_says_how_it_mixed():
    given = arm()
    options = SMCOptions(num_filters=50, num_particles=10, num_draws=4)
    idata = particle_gibbs(given, options=options, seed=1)
    reference = pooled(smc(given, options=replace(options, num_particles=100), seed=2))["torque"].values
    draws = idata["posterior"]["torque"].values.reshape(reference.shape)
    sd = reference.std(0)
    assert np.abs((draws.mean(0) - reference.mean(0)) / sd).max() < 4.5 * np.sqrt(2 / 50)
    stats = idata["sample_stats"].attrs
    assert 0.9 < stats["r_hat"] < 1.1
    assert stats["ess_bulk"] > 150


@pytest.mark.long
def test_chains_are_the_same_wherever_they_run_and_are_kept(tmp_path):
    pytest.importorskip("safetensors")
    given = arm()
    options = SMCOptions(num_filters=5, num_particles=6, num_draws=2, filters_per_task=2)
    alone = particle_gibbs(given, options=options, seed=1, warmup=2)
    with process_pool(1) as pool:
        scatter = particle_gibbs(
            given, options=options, seed=1, warmup=2, executor=pool, checkpoint=Checkpoint(tmp_path)
        )
    again = particle_gibbs(given, options=options, seed=1, warmup=2, checkpoint=Checkpoint(tmp_path))
    for other in (scatter, again):
        assert (other["posterior"]["torque"].values == alone["posterior"]["torque"].values).all()
    assert len(list(tmp_path.rglob("part-*/manifest.json"))) == 3


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"particles": 1}, "at least 2 particles"),
        ({"mass": dist.LogNormal(0.0, 0.1)}, "uncertain"),
    ],
)
def test_what_it_cannot_do_is_refused(change, message):
    given: Problem = arm()
    if "mass" in change:
        body = planar_body("arm", [Link("rod", "pivot", "tip", length=0.5, mass=change["mass"])])
        given = arm_problem(given.recording, body)
    with pytest.raises(InputError, match=message):
        particle_gibbs(given, options=SMCOptions(4, change.get("particles", 5), 2))
