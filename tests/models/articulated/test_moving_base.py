"""A base that moves: its law, its path from its own track, and what it does to a body, against MuJoCo."""

import numpy as np
import pytest
import torch
from carried import Carried, person
from scipy.linalg import expm

from invdyn.models import ArmModel, Encoders, Keypoints, Observation
from invdyn.models.articulated.base_track import filtered, without_outliers
from invdyn.models.articulated.moving_base import MovingBase, OnMovingBase
from invdyn.models.effects.link_flexibility import LinkFlexibility
from invdyn.models.observation.keypoints import BasePoint
from invdyn.models.torques import Matern32

F64 = torch.float64


def parameters(scale=(2.0, 3.0), lengthscale=(0.3, 0.05)):
    every = MovingBase(len(scale)).defaults()
    own = {"base.scale": scale, "base.lengthscale": lengthscale}
    return every | {name: torch.tensor(value, dtype=F64) for name, value in own.items()}


def law(scale, lengthscale, dt):
    """Φ and Q by matrix exponentials and a fine quadrature."""
    k = 3**0.5 / lengthscale
    F = np.array([[0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], [0, 0, -(k**2), -2 * k]])
    nodes, weights = np.polynomial.legendre.leggauss(60)
    impulses = [expm(F * (x + 1) / 2 * dt)[:, 3] for x in nodes]
    Q = sum(w / 2 * dt * 4 * k**3 * scale**2 * np.outer(c, c) for w, c in zip(weights, impulses, strict=True))
    return expm(F * dt), Q


@pytest.mark.parametrize("dt", [1e-4, 1 / 60, 0.3])
def test_a_step_is_that_of_the_stochastic_differential_equation(dt):
    base, own = MovingBase(2), parameters()
    step = torch.tensor([dt], dtype=F64)
    root, moved = base.noise_blocks(step, own), base.propagator(step, own)
    for axis in range(2):
        phi, Q = law(own["base.scale"][axis].item(), own["base.lengthscale"][axis].item(), dt)
        size = np.sqrt(np.outer(np.diag(Q), np.diag(Q)))
        np.testing.assert_allclose(moved[axis], phi, rtol=1e-9, atol=1e-9 * np.abs(phi).max())
        np.testing.assert_allclose((root @ root.mT)[axis].numpy() / size, Q / size, atol=1e-6)


def test_the_acceleration_is_stationary():
    base, own = MovingBase(2), parameters()
    sd, step = base.initial_sd(own), torch.tensor([0.07], dtype=F64)
    root, moved = base.noise_blocks(step, own), base.propagator(step, own)
    after = moved @ torch.diag_embed(sd**2) @ moved.mT + root @ root.mT
    np.testing.assert_allclose(after[:, 2:, 2:], torch.diag_embed(sd**2)[:, 2:, 2:], rtol=1e-9, atol=1e-9)


def test_both_parts_of_a_process_keep_their_own_laws():
    torque, base, own = Matern32(), MovingBase(2), parameters()
    both, scale = OnMovingBase(torque, base), torch.tensor([4.0, 1.0], dtype=F64)
    own = both.defaults(scale) | own
    z, dt = torch.randn(5, both.size(2), dtype=F64), torch.tensor([0.02], dtype=F64)
    mean = both.mean(z, dt, own)
    torch.testing.assert_close(mean[:, :4], torque.mean(z[:, :4], dt, own))
    torch.testing.assert_close(mean[:, 4:], base.mean(z[:, 4:], dt, own))
    root = both.noise(dt, own)
    torch.testing.assert_close(
        root @ root.mT, torch.block_diag(*(r @ r.mT for r in (torque.noise(dt, own), base.noise(dt, own))))
    )


def test_a_track_alone_is_filtered_as_gaussians_say():
    """Evidence and smoothed states of a track with gaps, against the joint Gaussian of all rows."""
    rng = np.random.default_rng(1)
    time = np.array([0.0, 0.02, 0.04, 0.08, 0.1, 0.12])
    track = rng.normal(0, 0.02, (6, 2))
    track[2] = np.nan
    own, noise = parameters(), torch.tensor([0.003, 0.01], dtype=F64)
    evidence, path = filtered(MovingBase(2), own, time, track, noise)
    for axis in range(2):
        scale, length = own["base.scale"][axis].item(), own["base.lengthscale"][axis].item()
        k = 3**0.5 / length
        covs = {0: np.diag([1.0, 1.0, scale**2, (k * scale) ** 2])}
        full = np.zeros((24, 24))
        for t in range(6):
            if t:
                phi, Q = law(scale, length, time[t] - time[t - 1])
                covs[t] = phi @ covs[t - 1] @ phi.T + Q
                for s in range(t):
                    full[4 * t : 4 * t + 4, 4 * s : 4 * s + 4] = phi @ full[4 * t - 4 : 4 * t, 4 * s : 4 * s + 4]
                    full[4 * s : 4 * s + 4, 4 * t : 4 * t + 4] = full[4 * t : 4 * t + 4, 4 * s : 4 * s + 4].T
            full[4 * t : 4 * t + 4, 4 * t : 4 * t + 4] = covs[t]
        seen = [4 * t for t in (0, 1, 3, 4, 5)]
        S = full[np.ix_(seen, seen)] + noise[axis].item() ** 2 * np.eye(5)
        y = track[[0, 1, 3, 4, 5], axis]
        log = -0.5 * (y @ np.linalg.solve(S, y) + np.linalg.slogdet(2 * np.pi * S)[1])
        assert evidence[axis] == pytest.approx(log, abs=1e-8)
        expected = (full[:, seen] @ np.linalg.solve(S, y)).reshape(6, 4)
        np.testing.assert_allclose(path.reshape(6, 4, 2)[..., axis], expected, rtol=1e-6, atol=1e-8)


def test_outliers_are_left_out_and_nothing_else():
    rng = np.random.default_rng(0)
    time = np.arange(120) / 30
    track = np.stack([1.2 * time, 0.03 * np.cos(4 * np.pi * time)], -1) + 0.003 * rng.standard_normal((120, 2))
    wrong = track.copy()
    wrong[[30, 71]] += [0.3, -0.2]
    kept = np.isfinite(without_outliers(wrong, 0.003)).all(-1)
    assert not kept[[30, 71]].any()
    assert kept.sum() >= 116


def carried_model(dimensions, torque=None):
    body = person(dimensions)
    sites = range(len(body.keypoint_names))
    observation = Observation(Keypoints(sites), BasePoint(), Encoders())
    return ArmModel(body, np.arange(4) / 60, observation, torque=torque, base=MovingBase(dimensions), substeps=4)


def random_state(model, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(3, model.state_dim, generator=generator, dtype=F64)


@pytest.mark.parametrize("dimensions", [2, 3])
def test_accelerations_are_mujocos(dimensions):
    """The torques that MuJoCo needs for them, where slides move the base, are those of the model."""
    model = carried_model(dimensions)
    played, state = Carried(model.body), random_state(model)
    _, q, qd = model.split(state)
    bends = model.acceleration(state, 1, model.body_parameters())
    pushed = model.base_motion(state)[2]
    torque = played.torque(*(each.numpy() for each in (q, qd, bends, pushed)))
    np.testing.assert_allclose(torque, state[:, : model.body.num_joints], rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("dimensions", [2, 3])
def test_points_are_seen_where_mujoco_has_them(dimensions):
    model = carried_model(dimensions)
    played, state = Carried(model.body), random_state(model)
    place, speed, acceleration = model.base_motion(state)
    points = played.points(place.numpy(), model.split(state)[1].numpy())
    row = model.emission(state, 0).mean
    np.testing.assert_allclose(model.observation.points(row), points[:, 1:], atol=1e-8)
    np.testing.assert_allclose(model.observation.of(model.observation.base_point, row), points[:, 0], atol=1e-8)
    np.testing.assert_allclose(model.sites(state), points[:, 1:], atol=1e-8)
    view = model.observation_model.view(state, 0)
    at_rest = model.dynamics.site_velocities(view.q, view.qd, view.body)
    torch.testing.assert_close(view.velocity - at_rest, speed.unsqueeze(-2).expand_as(at_rest))
    own = model.dynamics.site_accelerations(view.q, view.qd, view.acceleration(), view.body)
    torch.testing.assert_close(view.site_acceleration - own, acceleration.unsqueeze(-2).expand_as(own))


def test_a_row_is_integrated_under_the_bases_acceleration():
    """A step in 64 parts against SciPy's, with b̈ on its straight line between the rows."""
    from scipy.integrate import solve_ivp

    model = carried_model(2).in_substeps(64)
    state = random_state(model, 3)[:1]
    after = model.transition_mean(state, 1)
    (a0, a1) = (model.base_motion(each)[2][0].numpy() for each in (state, after))
    t0, t1 = state[0, :2].numpy(), after[0, :2].numpy()
    numbers, dt = model.body_parameters(), float(model.dt[1])

    def slope(t, y):
        s = t / dt
        q, qd, torque = (torch.as_tensor(each)[None] for each in (y[:2], y[2:], t0 + s * (t1 - t0)))
        felt = numbers._replace(gravity=numbers.gravity - torch.as_tensor(a0 + s * (a1 - a0)))
        return np.concatenate([y[2:], model.dynamics.forward(q, qd, torque, felt)[0].numpy()])

    _, q, qd = model.split(state)
    expected = solve_ivp(slope, (0, dt), torch.cat([q, qd], -1)[0].numpy(), rtol=1e-10, atol=1e-12).y[:, -1]
    np.testing.assert_allclose(torch.cat(model.split(after)[1:], -1)[0], expected, atol=1e-7)


def test_a_uniform_field_loads_as_gravity_does():
    for dimensions in (2, 3):
        body = person(dimensions)
        model = carried_model(dimensions)
        q = torch.randn(4, body.num_joints, dtype=F64)
        field = torch.randn(4, dimensions, dtype=F64)
        numbers = model.body_parameters()
        each = [model.dynamics.gravity_load(a, numbers._replace(gravity=g)) for a, g in zip(q, field, strict=True)]
        torch.testing.assert_close(model.dynamics.uniform_load(q, field, numbers), torch.stack(each))


def test_a_hidden_hinge_on_a_moving_base_is_refused():
    with pytest.raises(ValueError, match="expected a base at rest under a hidden hinge"):
        carried_model(2).with_effects(LinkFlexibility("forearm"))
