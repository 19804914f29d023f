"""Mechanics of a posterior: the balance of its parts, and their units."""

import numpy as np
import pytest

from invdyn.inference import infer, load_posterior, mechanics, save_posterior
from invdyn.models import Link, planar_body
from invdyn.recordings import Recording

BODY = planar_body("arm", [Link("upper", "shoulder", "elbow", 0.3, 1.5), Link("lower", "elbow", "wrist", 0.25, 1.0)])


@pytest.fixture(scope="module")
def recording():
    time = np.arange(30) / 50
    q = np.stack([-np.pi / 2 + 0.4 * np.sin(3 * time), 0.5 * np.sin(5 * time)], -1)
    phi = np.cumsum(q, axis=1)
    links = np.array([0.3, 0.25])[:, None] * np.stack([np.cos(phi), np.sin(phi)], -1)
    tips = np.cumsum(links, axis=1) + 0.002 * np.random.default_rng(0).normal(size=(30, 2, 2))
    return Recording(time, tips, ("elbow", "wrist"))


@pytest.fixture(scope="module")
def posterior(recording):
    return infer(recording, BODY, num_filters=4, num_particles=20, num_draws=2)


def test_the_equation_of_motion_balances(posterior):
    parts = mechanics(posterior)
    inertia = parts["inertia_matrix"].values
    left = (inertia @ parts["acceleration"].values[..., None])[..., 0]
    left = left + parts["coriolis"].values + parts["gravity_load"].values
    np.testing.assert_allclose(left, posterior["posterior"]["torque"].values, atol=1e-9)
    np.testing.assert_allclose(inertia, np.swapaxes(inertia, -1, -2))
    assert (np.linalg.eigvalsh(inertia) > 0).all()


def test_energy_and_power_are_those_of_the_velocities(posterior):
    parts, draws = mechanics(posterior), posterior["posterior"]
    qd = draws["velocity"].values
    kinetic = 0.5 * np.einsum("...i,...ij,...j->...", qd, parts["inertia_matrix"].values, qd)
    np.testing.assert_allclose(parts["kinetic_energy"].values, kinetic, atol=1e-12)
    np.testing.assert_allclose(parts["power"].values, qd * draws["torque"].values)
    # hanging straight down is lowest: no draw can lie below it
    lowest = -9.81 * (1.5 * 0.15 + 1.0 * (0.3 + 0.125))
    assert parts["potential_energy"].min() >= lowest - 1e-9
    assert {parts[name].attrs["units"] for name in ("kinetic_energy", "potential_energy")} == {"J"}


@pytest.mark.long
def test_an_uncertain_body_counts_draw_by_draw(recording, tmp_path):
    body = planar_body("arm", BODY.links, uncertainty={"mass": 0.2})
    idata = infer(recording, body, num_filters=6, num_particles=20, num_draws=2)
    draws = idata["posterior"]
    assert draws["mass"].dims == ("chain", "draw", "link")
    masses = draws["mass"].values
    assert 3 <= len(np.unique(masses[..., 0])) <= 6  # a body a filter; one of little weight may go
    # the inertia matrix of each draw belongs to that draw's mass: D₂₂ = m l²/3 of a uniform rod
    elbow = mechanics(idata)["inertia_matrix"].values[..., 1, 1]
    np.testing.assert_allclose(elbow, np.broadcast_to((masses[..., 1] * 0.25**2 / 3)[..., None], elbow.shape))
    weights = np.exp(idata["sample_stats"]["log_weight"].values)
    assert weights.sum() == pytest.approx(1)
    assert idata.attrs["outer_ess"] == pytest.approx(1 / (weights**2).sum())
    save_posterior(idata, tmp_path / "uncertain.nc")
    assert load_posterior(tmp_path / "uncertain.nc")["posterior"]["mass"].equals(draws["mass"])
    again = infer(recording, body, num_filters=6, num_particles=20, num_draws=2)
    assert again["posterior"].equals(idata["posterior"])
