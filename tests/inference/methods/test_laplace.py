"""The Gaussian smoother as a method."""

from functools import partial
from importlib import import_module

import numpy as np
import pytest
from grids import grid_posterior
from one_state import Counts, Growth, Multiplicative

from invdyn.inference import SMCOptions, infer, infer_states, pooled
from invdyn.inference.posterior import posterior
from invdyn.models import Link, planar_body
from invdyn.recordings import InputError, Recording

module = import_module("invdyn.inference.methods.laplace")  # the package's attribute is the function


def record():
    time = 0.03 * np.arange(15)
    angle = -1.2 + 0.5 * np.sin(3 * time)
    tips = 0.5 * np.stack([np.cos(angle), np.sin(angle)], -1)[:, None]
    tips = tips + 0.005 * np.random.default_rng(0).normal(size=tips.shape)
    return Recording(time=time, keypoints=tips, keypoint_names=("elbow",))


KNOWN = {"torque.scale": 4.0, "torque.decay": 5.0, "emission.keypoint_scale": 0.005}


@pytest.mark.long
def test_an_uncertain_body_is_integrated_out():
    link = {"joint": "shoulder", "tip": "elbow", "length": 0.5, "mass": 2.0}
    arm = planar_body("arm", [Link("l", **link)], uncertainty={"mass": 0.3})
    sizes = {"num_filters": 20, "num_draws": 50, "settings": KNOWN, "seed": 1}
    idata = infer(record(), arm, method="laplace", **sizes)
    assert idata["posterior"].sizes["chain"] == 20  # of 50 draws each
    assert len(np.unique(idata["posterior"]["mass"])) > 16  # as many sets as chains, less what is drawn twice
    fixed = infer(record(), planar_body("arm", [Link("l", **link)]), method="laplace", **sizes)
    wide, narrow = (pooled(i)["torque"].std("sample").mean().item() for i in (idata, fixed))
    assert wide > 1.1 * narrow
    with pytest.raises(InputError, match="nuts takes the body as known"):
        infer(record(), arm, method="nuts", settings=KNOWN)
    plain = infer(record(), arm, method="differentiate", settings=KNOWN)
    assert "mass" not in plain["posterior"]
    assert plain["constant_data"]["mass"].values == pytest.approx([2.0])


def test_bodies_are_drawn_where_the_recording_has_them():
    """A length known to a tenth, of which 15 rows of 5 mm leave a few mm: draws of its prior would all be far off."""
    arm = planar_body("arm", [Link("l", "shoulder", "elbow", length=0.53, mass=2.0)], uncertainty={"length": 0.1})
    idata = infer(record(), arm, method="laplace", num_filters=16, num_draws=4, settings=KNOWN, seed=1)
    length = idata["posterior"]["length"].values.ravel()
    assert idata.attrs["outer_ess"] > 14
    assert length.mean() == pytest.approx(0.5, abs=3 * 0.005 / np.sqrt(15))
    assert 0.5 < length.std() / (0.005 / np.sqrt(15)) < 2
    assert len(np.unique(length)) > 8


def test_draws_are_as_many_as_requested():
    arm = planar_body("arm", [Link("l", "shoulder", "elbow", length=0.5, mass=2.0)])
    idata = infer(record(), arm, method="laplace", num_filters=3, num_draws=5, settings=KNOWN)
    assert idata["posterior"]["torque"].shape == (3, 5, 15, 1)
    assert SMCOptions().num_filters * SMCOptions().num_draws == 256


def test_a_long_recording_comes_in_blocks_and_in_single_precision(monkeypatch):
    arm = planar_body("arm", [Link("l", "shoulder", "elbow", length=0.5, mass=2.0)])
    run = partial(infer, record(), arm, method="laplace", num_filters=5, num_draws=4, settings=KNOWN)
    whole = run()
    monkeypatch.setattr(posterior, "SINGLE_FROM", 1)
    monkeypatch.setattr(posterior, "AT_ONCE", 2 * 4 * 15 * 3)
    parts = run()
    for group, name in (("posterior", "torque"), ("posterior", "position"), ("log_likelihood", "y")):
        assert parts[group][name].dtype == np.float32
        assert parts[group][name].values == pytest.approx(whole[group][name].values, rel=1e-4, abs=1e-4)
    noise = (parts["posterior_predictive"]["position"] - parts["posterior"]["position"]).std()
    assert noise == pytest.approx(KNOWN["emission.keypoint_scale"], rel=0.1)


def test_fewer_paths_of_a_very_long_recording_are_said(monkeypatch):
    arm = planar_body("arm", [Link("l", "shoulder", "elbow", length=0.5, mass=2.0)])
    monkeypatch.setattr(module, "MAX_NUMBERS", 15 * 3 * 20)
    monkeypatch.setattr(module, "MIN_PATHS", 8)
    with pytest.warns(UserWarning, match="laplace draws 16 paths of this long recording, of 32"):
        idata = infer(record(), arm, method="laplace", num_filters=8, num_draws=4, settings=KNOWN)
    assert idata["posterior"].sizes["chain"] * idata["posterior"].sizes["draw"] == 16


def test_a_linearisation_in_a_wrong_mode_is_not_usable():
    """The growth model: Gauss–Newton ends hundreds of nats below what a bootstrap filter finds."""
    model = Growth(30)
    _, rows = model.simulate(seed=3)
    idata = infer_states(model, rows, method="laplace", seed=0)
    found = idata["sample_stats"].attrs
    exact = grid_posterior(model, rows, -40.0, 40.0).log_evidence
    assert abs(idata.attrs["log_evidence"] - exact) > 5
    assert found["usable"] == 0
    assert "a bootstrap filter" in found["doubt"]


def test_a_linearisation_of_another_model_is_not_usable():
    """Noise that grows with the state: the linearised model has that of one path, and misses the evidence by nats."""
    model = Multiplicative(50)
    _, rows = model.simulate(seed=3)
    idata = infer_states(model, rows, method="laplace", seed=0)
    exact = grid_posterior(model, rows, -8.0, 8.0).log_evidence
    assert abs(idata.attrs["log_evidence"] - exact) > 2
    assert idata["sample_stats"].attrs["usable"] == 0


def test_a_linearisation_that_is_right_is_usable():
    model = Counts(30)
    _, rows = model.simulate(seed=3)
    idata = infer_states(model, rows, method="laplace", seed=0)
    exact = grid_posterior(model, rows, -8.0, 8.0).log_evidence
    assert idata.attrs["log_evidence"] == pytest.approx(exact, abs=1.0)
    assert idata["sample_stats"].attrs["usable"] == 1
