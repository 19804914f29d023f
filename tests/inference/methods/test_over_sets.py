"""Sets of parameters in one batch: as each of them by itself, by smoothers and by filters."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from invdyn.inference import SMCOptions, pooled
from invdyn.inference.fitting.parameter_draws import ParameterSet
from invdyn.inference.methods.over_sets import SetBatch, over_sets, run_sets, stacked
from invdyn.inference.methods.registry import METHODS
from invdyn.inference.posterior.initialise import arm_problem
from invdyn.inference.smoothing.linearised import gaussian_smoother
from invdyn.models import Link, Matern32, planar_body
from invdyn.recordings import Recording

ROWS = 40
SCALES = (1.0, 2.0, 4.0)


@pytest.fixture(scope="module")
def sets():
    """A swinging rod, and three sets of its torque's parameters."""
    body = planar_body("rod", [Link("rod", "hinge", "tip", length=0.5, mass=1.0)])
    time = 0.02 * np.arange(ROWS)
    angle = 0.8 * np.sin(4 * time)
    points = 0.5 * np.stack([np.cos(angle), np.sin(angle)], -1)[:, None]
    points += 0.002 * np.random.default_rng(0).standard_normal(points.shape)
    known = {"emission.keypoint_scale": 0.002}
    problem = arm_problem(Recording(time, points, ("tip",)), body, torque=Matern32(), parameters=known, substeps=1)
    models = [problem.model.replace(**{"torque.scale": torch.tensor([scale], dtype=torch.float64)}) for scale in SCALES]
    found = [gaussian_smoother(model, problem.observations) for model in models]
    return problem, [
        ParameterSet(0, m, each.path, -each.log_evidence.item()) for m, each in zip(models, found, strict=True)
    ]


def test_a_batch_has_each_sets_smoother(sets):
    problem, own = sets
    problems = [replace(problem, model=each.model) for each in own]
    starts, offsets = torch.stack([each.path for each in own]), [each.offset for each in own]
    (whole,) = run_sets(SetBatch("laplace", problems, starts, [2, 1, 3], offsets, SMCOptions(6, 10, 100), 0))
    drawn_of = whole["posterior"]["torque"].transpose("chain", "draw", ...).values[..., 0]
    for each, mine in zip(own, (slice(0, 2), slice(2, 3), slice(3, 6)), strict=True):
        evidences = whole["sample_stats"]["log_evidence"].values[mine]
        np.testing.assert_allclose(evidences, 0, atol=0.02)
        sd = gaussian_smoother(each.model, problem.observations).covariance()[:, 0, 0].sqrt().numpy()
        drawn = drawn_of[mine].reshape(-1, ROWS).std(0)
        assert np.median(drawn / sd) == pytest.approx(1, abs=0.1)  # of 100 draws or more, over 40 rows


def test_each_filter_has_a_set_of_its_own(sets):
    """Evidences are the smoother's, which is nearly exact here, and so are mean and band of the pooled draws."""
    problem, own = sets
    options = SMCOptions(24, 50, 8)
    found, gaussian = (over_sets(each, problem, own, options=options, seed=1) for each in ("smc", "laplace"))
    assert found.attrs["method"] == found["sample_stats"].attrs["method"] == "smc"
    assert found["sample_stats"].attrs["usable"] == 1
    assert found.attrs["outer_ess"] > 20
    # Offsets are minus each set's evidence.
    np.testing.assert_allclose(found["sample_stats"]["log_evidence"], 0.0, atol=0.5)
    one, two = (pooled(each)["torque"].values[..., 0] for each in (found, gaussian))
    assert np.abs(one.mean(0) - two.mean(0)).max() < 5 * two.std(0).max() / np.sqrt(24)
    assert np.median(one.std(0) / two.std(0)) == pytest.approx(1, abs=0.15)


def test_tasks_draw_by_seeds_of_their_own(sets):
    """Three tasks of the same set, each a filter of two draws; another seed has other draws."""
    problem, own = sets
    options = SMCOptions(3, 10, 2, filters_per_task=1)
    found = [over_sets("laplace", problem, own[:1] * 3, options=options, seed=seed) for seed in (3, 4)]
    drawn = np.concatenate([each["posterior"]["torque"].values.reshape(6, -1) for each in found])
    assert len(np.unique(drawn, axis=0)) == 12


@pytest.mark.long
def test_tasks_and_seeds_decide_the_result(sets, tmp_path):
    from invdyn.inference.execution.checkpoint import Checkpoint

    problem, own = sets
    options = SMCOptions(6, 10, 2, filters_per_task=2)

    def drawn(**more):
        return pooled(over_sets("smc", problem, own, options=options, seed=3, **more))["torque"].values

    first = drawn()
    np.testing.assert_array_equal(drawn(), first)
    kept = Checkpoint(tmp_path / "run", {"of": "this"})
    np.testing.assert_array_equal(drawn(checkpoint=kept), first)
    np.testing.assert_array_equal(drawn(checkpoint=kept), first)
    assert len(list((tmp_path / "run").glob("part-*"))) == 3


def test_bodies_that_differ_are_told_apart(sets):
    problem, own = sets
    longer = [
        replace(each, model=each.model.replace(**{"body.length": torch.tensor([length], dtype=torch.float64)}))
        for each, length in zip(own, (0.499, 0.5, 0.501), strict=True)
    ]
    for method in ("laplace", "smc"):
        idata = over_sets(method, problem, longer, options=SMCOptions(6, 20, 10), seed=0)
        assert set(np.unique(idata["posterior"]["length"])) <= {0.499, 0.5, 0.501}
        assert len(np.unique(idata["posterior"]["length"])) > 1


def of_noises(sets):
    """The problem, and three sets whose keypoints have a noise of 2, 4 and 6 mm, of equal weight."""
    problem, own = sets
    models = [
        each.model.replace(**{"emission.keypoint_scale": torch.tensor([0.002 * k]).double()})
        for k, each in enumerate(own, 1)
    ]
    found = [gaussian_smoother(model, problem.observations) for model in models]
    return problem, [
        ParameterSet(0, m, each.path, -each.log_evidence.item()) for m, each in zip(models, found, strict=True)
    ]


def noise_of_chains(idata):
    """Sd (M,) of what is predicted about each draw's own position."""
    spread = idata["posterior_predictive"]["position"] - idata["posterior"]["position"]
    return spread.std(("draw", "time", "keypoint", "space")).values


@pytest.mark.parametrize("per_task", [20, 60])
def test_draws_are_of_each_set_by_its_weight(sets, per_task):
    """In tasks of one set, and of all; with evidence e times the others' its share is e/(e + 2)."""
    problem, noisy = of_noises(sets)
    uneven = [replace(each, offset=each.offset + bonus) for each, bonus in zip(noisy, (0.0, 1.0, 0.0), strict=True)]
    options = SMCOptions(60, 10, 40, filters_per_task=per_task)
    idata = over_sets("laplace", problem, uneven, options=options, seed=0)
    share = np.mean(np.abs(noise_of_chains(idata) - 0.004) < 0.001)
    assert share == pytest.approx(np.e / (np.e + 2), abs=1.5 / 60)  # resampled systematically


def test_equal_models_are_a_batch_too(sets):
    _, own = sets
    both = stacked([own[0].model, own[0].model])
    assert both.parameters["noise.angle"].shape == (2, 1, 1)
    assert both.parameters["torque.scale"].shape == (1,)


def test_draws_that_are_kept_block_by_block_are_the_same(sets, monkeypatch):
    """Each chain of a block has the parameters of its own set, not of the first ones."""
    problem, noisy = of_noises(sets)

    def found():
        return over_sets("laplace", problem, noisy, options=SMCOptions(6, 10, 50), seed=0)

    whole = found()
    size = 50 * ROWS * problem.model.state_dim  # numbers of a chain
    monkeypatch.setattr("invdyn.inference.posterior.posterior.SINGLE_FROM", 2 * size)
    monkeypatch.setattr("invdyn.inference.posterior.posterior.AT_ONCE", 2 * size)
    blocks = found()
    for group in ("posterior", "log_likelihood"):
        for name, values in whole[group].data_vars.items():
            np.testing.assert_allclose(blocks[group][name].values, values.values, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(noise_of_chains(blocks), [0.002] * 2 + [0.004] * 2 + [0.006] * 2, rtol=0.05)


def test_one_by_one_a_method_has_each_sets_filters_and_path_and_its_offset(sets, monkeypatch):
    problem, own = sets
    own, run, given = [replace(own[0], offset=own[0].offset + 0.7), *own[1:]], METHODS["laplace"], []

    def seen(one, *, options, start, **more):
        given.append((one.model, options.num_filters, options.refits, start))
        return run(one, options=options, start=start, **more)

    monkeypatch.setitem(METHODS, "laplace", seen)
    options = SMCOptions(5, 10, 4, refits=3)
    found = over_sets("laplace", problem, own, options=options, seed=0, together=False)
    assert [each[1:3] for each in given] == [(2, 1), (2, 1), (1, 1)]
    assert all(
        one is each.model and torch.equal(path, each.path) for (one, *_, path), each in zip(given, own, strict=True)
    )
    evidences = found["sample_stats"]["log_evidence"].values.ravel()
    np.testing.assert_allclose(np.sort(evidences), [0, 0, 0, 0.7, 0.7], atol=0.02)
