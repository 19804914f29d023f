"""Fitted lines under relaxed noise: exact where nothing is bent, and along where tangents fail."""

import itertools
from dataclasses import replace
from importlib import import_module

import legs
import numpy as np
import oracles
import pytest
import torch

from invdyn.inference import SMCOptions, gaussian_smoother
from invdyn.inference.filters.best_guide import best_guide
from invdyn.inference.filters.filtering import run_filters
from invdyn.inference.fitting.log_parameters import Free
from invdyn.inference.fitting.scales_on_linearisation import fit_scales
from invdyn.inference.smoothing.statistical_homotopy import statistical_homotopy
from invdyn.models.engine.drives import JointTorques
from invdyn.models.engine.model import EngineModel
from invdyn.models.engine.scene import Scene

SCALES = [Free("torque.scale", tied=True), Free("emission.keypoint_scale", tied=True)]


def leg_model(leg, **parameters):
    given = {"emission.keypoint_scale": 0.002, "torque.scale": 20.0} | parameters
    scene = Scene.of(leg.text, dimensions=2)
    return EngineModel(scene, leg.time, drive=JointTorques(("hip", "knee")), parameters=given)


def test_linear_models_stay_exact():
    chain = oracles.random_chain(seed=1)
    y = oracles.with_gaps(chain.simulate(15, seed=1)[1])
    model, rows = chain.model(15), torch.as_tensor(y)
    smoother = statistical_homotopy(model, rows)
    means, covariances = oracles.rts(chain, y)
    assert smoother.path.numpy() == pytest.approx(means, abs=1e-6)
    assert smoother.covariance().numpy() == pytest.approx(covariances, abs=1e-6)
    assert smoother.log_evidence.item() == pytest.approx(oracles.kalman(chain, y)[0], abs=1e-6)
    assert bool(smoother.converged)


def test_it_says_whether_the_last_stage_settled(monkeypatch):
    """Passes whose evidence goes to and fro have not; the best of them is taken."""
    chain = oracles.random_chain(seed=2)
    model, rows = chain.model(8), torch.as_tensor(chain.simulate(8, seed=2)[1])
    room = import_module("invdyn.inference.smoothing.statistical_homotopy")
    real, count = room.one_pass, itertools.count()

    def to_and_fro(*given):
        found = real(*given)
        return replace(found, log_evidence=found.log_evidence + (5.0 if next(count) % 2 else 0.0))

    exact = float(statistical_homotopy(model, rows).log_evidence)
    monkeypatch.setattr(room, "one_pass", to_and_fro)
    found = statistical_homotopy(model, rows)
    assert not bool(found.converged)
    assert float(found.log_evidence) == pytest.approx(exact + 5.0)


def test_scales_fitted_on_a_linearisation_are_those_of_most_evidence():
    """Of a linear model the evidence of a grid of scales is Kalman's."""
    leg = legs.leg_recording("drop", 3, rows=8)  # in the air: nothing is bent much
    model = leg_model(leg)
    rows = torch.as_tensor(leg.rows)
    fitted, smoother, settled = fit_scales(model, rows, SCALES[1:], statistical_homotopy(model, rows))
    assert settled
    found = fitted.parameters["emission.keypoint_scale"][0].item()
    evidence = {}
    for factor in (0.8, 1.0, 1.25):
        other = fitted.replace(**{"emission.keypoint_scale": fitted.parameters["emission.keypoint_scale"] * factor})
        prior = 0.5 * (np.log(found * factor / 0.002) / 2) ** 2
        evidence[factor] = float(statistical_homotopy(other, rows, smoother).log_evidence) - prior
    assert evidence[1.0] == max(evidence.values())
    assert 0.0014 < found < 0.0028


def test_a_hopping_leg_is_followed_where_tangents_are_not(monkeypatch):
    """Forty rows with a landing: filters agree, and confirm the fitted model's evidence."""
    leg = legs.leg_recording("hop", 0, rows=40)
    model, rows = leg_model(leg), torch.as_tensor(leg.rows)
    smoother = gaussian_smoother(model, rows)
    assert bool(smoother.converged)
    with monkeypatch.context() as without:  # from a path that was found no stage has more noise
        without.setattr(EngineModel, "relaxed", None)
        again = gaussian_smoother(model, rows, smoother.path)
    assert float(again.log_evidence) == pytest.approx(float(smoother.log_evidence), abs=1.0)
    options = SMCOptions(num_filters=6, num_particles=100)
    torch.manual_seed(0)
    result = run_filters(model, rows, options, smoother=smoother)
    assert float(result.log_evidence.std()) < 1.0
    assert float(smoother.log_evidence) == pytest.approx(float(result.log_evidence.mean()), abs=3.0)
    torque = smoother.path[:-1, :2].numpy()
    assert np.sqrt(np.mean((torque - leg.torque[:-1]) ** 2)) < 0.35 * leg.torque.std()


def test_an_evidence_that_settled_is_within_a_nat_of_more_passes(monkeypatch):
    """Of legs that land, from a path that is given; passes go on until a thousandth of a nat, or thirty."""
    missing = []
    for kind, seed in (("drop", 2), ("slip", 0)):
        leg = legs.leg_recording(kind, seed, rows=20)
        model, rows = leg_model(leg), torch.as_tensor(leg.rows)
        path = model.initial_paths(rows)[0]
        found = statistical_homotopy(model, rows, path)
        assert bool(found.converged)
        with monkeypatch.context() as longer:
            longer.setattr("invdyn.inference.smoothing.statistical_homotopy.PASSES", 30)
            longer.setattr("invdyn.inference.smoothing.statistical_homotopy.SETTLED", 1e-3)
            missing.append(float(statistical_homotopy(model, rows, path).log_evidence - found.log_evidence))
    assert max(missing) < 1.0
    assert np.mean(missing) < 0.4


@pytest.mark.long
@pytest.mark.parametrize(
    "kind", ["stance", *(pytest.param(k, marks=pytest.mark.slow) for k in ("drop", "hop", "slip"))]
)
def test_filters_agree_on_every_kind_of_contact(kind):
    """Scales are fitted; the spread of log Ẑ over filters stays within a nat or so, and the guide is the look-ahead."""
    leg = legs.leg_recording(kind, 1)
    model, rows = leg_model(leg), torch.as_tensor(leg.rows)
    model, smoother, _ = fit_scales(model, rows, SCALES, statistical_homotopy(model, rows))
    torch.manual_seed(0)
    result = run_filters(model, rows, SMCOptions(num_filters=8, num_particles=200), smoother=smoother)
    assert float(result.log_evidence.std()) < 1.5


@pytest.mark.long
def test_the_guide_of_a_model_with_kinks():
    leg = legs.leg_recording("hop", 2, rows=40)
    model, rows = leg_model(leg), torch.as_tensor(leg.rows)
    guide = best_guide(model, rows, SMCOptions(num_filters=8, num_particles=100), seed=0)
    assert guide.name == "controlled"
    assert guide.doubt == ""
