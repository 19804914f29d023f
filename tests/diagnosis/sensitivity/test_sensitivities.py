"""Columns and unknowns of every effect: differences of the model itself, in each regime."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from pendulum import LOOSE, PENDULUM
from pyro.distributions import LogNormal
from scipy.stats import halfnorm, norm
from scipy.stats import t as student_t

from invdyn.diagnosis.hypotheses.pool import considered
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem, diagnosis_problem
from invdyn.diagnosis.problem.noise import is_noise
from invdyn.diagnosis.problem.unknowns import bounds, centre, prior_sd, unknowns
from invdyn.diagnosis.rules import DEFAULT, FIXED
from invdyn.diagnosis.sensitivity import sensitivities as candidates
from invdyn.diagnosis.sensitivity.latent_response import latent_response
from invdyn.diagnosis.sensitivity.sensitivities import hypotheses, slopes, spacing, unchanged
from invdyn.inference.smoothing.gauss_newton import gauss_newton
from invdyn.models import Link, planar_body
from invdyn.models.effects import EFFECTS
from invdyn.recordings import Recording
from invdyn.simulate import random_arm, record

UPPER = Link("upper_arm", "shoulder", "elbow", length=0.3, mass=1.5)
BODY = planar_body("arm", [UPPER, Link("forearm", "elbow", "wrist", length=0.25, mass=1.0)], gravity=(0.0, -9.81))
UNSURE = planar_body("arm", BODY.links, BODY.gravity, uncertainty={"mass": 0.05, "length": 0.01})


@cache
def bound(regime="commanded", unsure=False) -> DiagnosisProblem:
    recording = record(random_arm(BODY, duration=0.8, fps=50, noise=0.002, commanded=True))[0]
    if regime == "unknown_torque":
        recording = Recording(recording.time, recording.keypoints, recording.keypoint_names)
    return diagnosis_problem(recording, UNSURE if unsure else BODY, passive=regime == "passive")


@cache
def followed(regime="commanded") -> torch.Tensor:
    return gauss_newton(bound(regime).with_residual(LOOSE), bound(regime).observations).path


def means(model, path):
    """Next states (T−1, D) and what is seen (T, O) along a path, row by row."""
    with torch.no_grad():
        f = [model.transition_mean(path[t - 1], t) for t in range(1, len(path))]
        emissions = [model.emission(path[t], t) for t in range(len(path))]
    h = [getattr(emission, "base_dist", emission).loc for emission in emissions]
    return torch.stack(f).numpy(), torch.stack(h).numpy()


def having(model, effect, values):
    """The model with one effect at these values."""
    named = {f"effect.{effect.key}.{name}": torch.tensor([v], dtype=torch.float64) for name, v in values.items()}
    return model.with_effects(effect).replace(**named)


@pytest.mark.parametrize("regime", ["commanded", "passive", "unknown_torque"])
def test_every_effect_that_a_regime_knows_is_considered(regime):
    names = {effect.name for effect in considered(bound(regime))}
    idle = {name for name in EFFECTS if name.startswith("actuator_") and regime != "commanded"}
    idle |= {name for name, kind in EFFECTS.items() if kind.sensor == "encoders"}  # there are none
    assert names == set(EFFECTS) - idle
    assert {e.name for e in considered(bound(regime), ["payload"])} == names - {"payload"}


@pytest.mark.quick("commanded-*")
@pytest.mark.parametrize("name", [name for name in EFFECTS if name != "backlash"])  # no column stands for play
@pytest.mark.parametrize("regime", ["commanded", "unknown_torque"])
def test_columns_of_every_effect(regime, name):
    """Finite; none only for those that change nothing but the scatter; prior weights of an effect's grid sum to one."""
    here, path = bound(regime), followed(regime)
    T, D, O = len(path), here.model.state_dim, here.model.observation_dim
    for effect in considered(here):
        if effect.name != name:
            continue
        found, columns = hypotheses(here.model, effect, path, unchanged(here.model, path), ((0.1, 0.2),))
        J = columns.g.shape[-1]
        assert columns.g.shape == (T - 1, D, J)
        assert columns.d.shape == (T, O, J)
        assert np.isfinite(columns.g).all()
        assert np.isfinite(columns.d).all()
        # Without commands and encoders there is no clock that a camera could be late by.
        nothing = is_noise(effect) or (name == "camera_latency" and regime != "commanded")
        assert (columns.g.any() or columns.d.any()) != nothing
        used = [c for h in found for c in (*h.columns, *(() if h.offset is None else (h.offset,)))]
        assert sorted(used) == list(range(J))
        for hypothesis in found:
            assert len(hypothesis.free) == len(hypothesis.columns) == len(hypothesis.sd) == len(hypothesis.lower)
            assert set(hypothesis.point) == {p.name for p in effect.parameters(here.model.scale)}
            assert min(hypothesis.sd) > 0
            # A gear begins where a gain by its usual form ends.
            assert max(hypothesis.lower) <= (1 if effect.form == "geared" else 0)
        if not any(p.located for p in effect.parameters(here.model.scale)):
            assert np.exp([h.log_weight for h in found]).sum() == pytest.approx(1.0)


@pytest.mark.parametrize("name", ["link_flexibility", "actuator_lag"])
def test_slopes_at_a_grid_point_lead_no_further_than_its_neighbours(name):
    """A stiffness of a hundredth of the smallest on the grid is nothing that a straight line from it could tell."""
    model, path = bound().model, followed()
    effect = next(e for e in considered(bound()) if e.name == name)
    grids = {p.name: np.sort(p.grid) for p in effect.parameters(model.scale) if p.grid}
    found, _ = hypotheses(model, effect, path, unchanged(model, path))
    for hypothesis in found:
        for free, low, high in zip(hypothesis.free, hypothesis.lower, hypothesis.upper, strict=True):
            grid, here = grids[free], hypothesis.point[free]
            place = int(np.argmin(np.abs(grid - here)))
            before, after = grid[max(place - 1, 0)], grid[min(place + 1, len(grid) - 1)]
            ends = here + low, here + high
            assert ends[0] == pytest.approx(before) if place else here / 2 - 1e-12 <= ends[0] < here
            assert ends[1] == pytest.approx(after) if place < len(grid) - 1 else here < ends[1] <= 2 * here


FOLLOWED = (
    "viscous_friction", "gravity_tilt", "payload", "torque_ripple", "actuator_lag", "actuator_saturation",
    "drifting_friction", "keypoint_offset", "camera_yaw", "lens_distortion", "clock_rate", "rolling_shutter",
)  # fmt: skip


@pytest.mark.parametrize("name", FOLLOWED)
def test_columns_are_differences_of_the_model(name):
    """Secants from "absent" on; offsets and local slopes where there is no straight line; one row at a time here."""
    model, path = bound().model, followed()
    effect = next(e for e in considered(bound()) if e.name == name)
    parameters = {p.name: p for p in effect.parameters(model.scale)}
    found, columns = hypotheses(model, effect, path, unchanged(model, path))
    ideal = means(model, path)
    for hypothesis in (found[0], found[-1]):
        point = hypothesis.point
        base = ideal
        if hypothesis.offset is None:
            assert hypothesis.sd == pytest.approx([prior_sd(parameters[free]) for free in hypothesis.free])
        else:
            base = means(having(model, effect, point), path)
            for got, here, without in zip((columns.g, columns.d), base, ideal, strict=True):
                np.testing.assert_allclose(got[..., hypothesis.offset], here - without, atol=1e-12)
        for free, column in zip(hypothesis.free, hypothesis.columns, strict=True):
            p = parameters[free]
            step = (
                DEFAULT.screening.secant_step * prior_sd(p)
                if hypothesis.offset is None
                else 0.1 * spacing(p, point[free])
            )
            moved = means(having(model, effect, point | {free: point[free] + step}), path)
            for got, there, here in zip((columns.g, columns.d), moved, base, strict=True):
                expected = (there - here) / step
                np.testing.assert_allclose(got[..., column], expected, atol=1e-9 + 1e-7 * np.abs(expected).max())


@pytest.mark.parametrize("key", ["base_motion", "camera_yaw", "link_flexibility.forearm"])
def test_many_parameter_sets_are_taken_in_turns(key, monkeypatch):
    here, path, (effect,) = bound(), followed(), chosen(key)
    plain = unchanged(here.model, path)
    _, whole = hypotheses(here.model, effect, path, plain)
    monkeypatch.setattr(candidates, "FIXED", replace(FIXED, max_parameter_sets=7))
    assert whole.g.shape[-1] > 3 * 7
    _, parts = hypotheses(here.model, effect, path, plain)
    np.testing.assert_array_equal(parts.g, whole.g)
    np.testing.assert_array_equal(parts.d, whole.d)


@pytest.mark.long
def test_a_bending_link_to_first_order():
    """What the screen makes of it is within a tenth of the model along the hinge's own path, of each grid point."""
    model, path = bound().model, followed()
    effect = next(e for e in considered(bound()) if e.name == "link_flexibility")
    found, columns = hypotheses(model, effect, path, unchanged(model, path))
    ideal = means(model, path)[0]
    for hypothesis in found:
        bent = having(model, effect, hypothesis.point)
        hinged = latent_response(bent, path, 1)[0].squeeze(0)
        following = means(bent, hinged)[0]
        hidden = slice(model.torque_size, model.torque_size + 2)
        true = np.delete(following, hidden, axis=1) - ideal
        assert np.abs(columns.g[..., hypothesis.offset] - true).max() < 0.1 * np.abs(true).max()


@pytest.mark.long
def test_friction_that_stops_a_link_within_a_row_is_followed_from_a_value_near_it():
    """Ten rows a second: what large damping does is a hundredth off from the grid, more from where there is none."""
    arm = random_arm(PENDULUM, duration=6, fps=10, noise=0.002, torque_scale=2.0, commanded=True, seed=0)
    model = diagnosis_problem(record(arm, 0)[0], PENDULUM).model
    path = torch.as_tensor(np.random.default_rng(0).normal(size=(len(model.time), model.state_dim)))
    effect = EFFECTS["viscous_friction"]("pivot").bound(PENDULUM)
    found, columns = hypotheses(model, effect, path, unchanged(model, path))
    for hypothesis in found:
        there = hypothesis.point["damping"]
        more = means(having(model, effect, {"damping": 1.5 * there}), path)[0] - means(model, path)[0]
        near = columns.g[..., hypothesis.offset] + 0.5 * there * columns.g[..., hypothesis.columns[0]]
        np.testing.assert_allclose(near, more, atol=0.01 * np.abs(more).max())
    straight = columns.g[..., found[0].offset] * 1.5 * there / found[0].point["damping"]
    assert np.abs(straight - more).max() > 0.05 * np.abs(more).max()


def test_a_push_may_come_in_any_window():
    effect = next(e for e in considered(bound()) if e.name == "external_push")
    windows = ((0.1, 0.2), (0.4, 0.5))
    model, path = bound().model, followed()
    found, columns = hypotheses(model, effect, path, unchanged(model, path), windows)
    assert [h.point["moment"] for h in found] == pytest.approx([0.15, 0.45])
    assert [h.point["duration"] for h in found] == pytest.approx([0.1, 0.1])
    time = bound().model.time.numpy()
    for hypothesis, (start, stop) in zip(found, windows, strict=True):
        assert hypothesis.free == ("impulse_x", "impulse_y")
        pushed = np.abs(columns.g[..., list(hypothesis.columns)]).sum((1, 2)) > 1e-12
        touched = (time[1:] > start - 0.011) & (time[:-1] < stop + 0.011)  # its edges are ramps, half a step each way
        assert pushed.any()
        assert not pushed[~touched].any()


# -- unknowns ------------------------------------------------------------------------------------------------------
def chosen(*names):
    return [e for e in considered(bound()) if e.key in names]


def test_names_bounds_and_gaussians():
    here = bound(unsure=True)
    among = unknowns(here, chosen("viscous_friction.elbow", "camera_roll", "outliers"))
    # What only changes the scatter has no columns, and is not among them.
    effects = ("viscous_friction.elbow.damping", "camera_roll.angle")
    assert among.names == (*effects, "body.length.0", "body.mass.0", "body.length.1", "body.mass.1")
    np.testing.assert_allclose(among.lower[:2], [0.0, -DEFAULT.residual.max_prior_sds_heavy * among.sd[1]])
    np.testing.assert_allclose(among.mean[2:], [0.3, 1.5, 0.25, 1.0], rtol=1e-6)
    np.testing.assert_allclose(among.sd[2:], [0.003, 0.075, 0.0025, 0.05], rtol=1e-6)
    assert not unknowns(bound(), []).names


def test_log_prior_is_that_of_half_normals_and_normals():
    among = unknowns(bound(unsure=True), chosen("viscous_friction.elbow"))
    values = torch.tensor([[0.1, 0.301, 1.4, 0.252, 1.1], [0.2, 0.3, 1.5, 0.25, 1.0]], dtype=torch.float64)
    damping, body = values[:, 0].numpy(), values[:, 1:].numpy()
    expected = halfnorm.logpdf(damping, scale=among.sd[0]) + norm.logpdf(body, among.mean[1:], among.sd[1:]).sum(-1)
    np.testing.assert_allclose(among.log_prior(values), expected, rtol=1e-5)


def test_the_gaussian_of_a_prior():
    damping, *_ = chosen("viscous_friction.elbow")[0].parameters(bound().model.scale)
    assert (centre(damping), bounds(damping)[0]) == (0.0, 0.0)
    assert bounds(damping)[1] == DEFAULT.residual.max_prior_sds_one_sided * prior_sd(damping)
    assert prior_sd(damping) == pytest.approx(float(damping.prior.scale))
    rate, scale = chosen("outliers")[0].parameters(bound().model.scale)
    assert (bounds(rate)[0], bounds(rate)[1]) == (
        0.0,
        min(1.0, centre(rate) + DEFAULT.residual.max_prior_sds_one_sided * prior_sd(rate)),
    )
    assert isinstance(scale.prior, LogNormal)
    assert prior_sd(scale) == pytest.approx(float(scale.prior.stddev))


def test_of_what_may_be_any_size_much_is_plausible():
    """Nine cameras in ten are level to 3°; twelve degrees cost a few nats, where a Gaussian as wide asks 18."""
    roll, yaw, play, blur = (
        chosen(key)[0].parameters(bound().model.scale)[0]
        for key in ("camera_roll", "camera_yaw", "backlash.elbow", "varying_noise")
    )
    assert student_t.cdf(np.deg2rad(3.0), 3, scale=float(roll.prior.scale)) > 0.95
    assert bounds(roll)[1] > np.deg2rad(15)
    assert np.deg2rad(60) < bounds(yaw)[1] < np.pi / 2
    assert bounds(yaw)[0] == -bounds(yaw)[1]
    for each, size, cost in ((roll, 0.21, 8.0), (yaw, 0.98, 10.0), (play, 0.25, 4.5)):
        lost = each.prior.log_prob(torch.tensor(1e-6)) - each.prior.log_prob(torch.tensor(size))
        assert 1.0 < float(lost) < cost
    assert (bounds(play)[0], bounds(blur)[0]) == (0.0, 0.0)
    assert bounds(play)[1] == pytest.approx(0.3)


@pytest.mark.parametrize("key", ["inertial_error.upper_arm", "actuator_gain.elbow"])
def test_a_file_may_be_wrong_by_more_than_a_factor_of_two(key):
    """Upward: arms without mass, and motors that give nothing, would explain whatever there is."""
    problem = bound()
    for each in chosen(key)[0].parameters(problem.model.scale):
        if each.name == "com":
            continue
        whole = each.least / -0.8
        assert bounds(each)[0] == each.least < 0
        assert bounds(each)[1] > 2 * whole
        lost = each.prior.log_prob(torch.tensor(0.0)) - each.prior.log_prob(torch.tensor(whole))
        assert 4.0 < float(lost) < 6.0  # of a Gaussian of .2 it would be 12.5


def test_sets_of_values_are_the_single_ones():
    """Means of many parameter sets at once are those of one after the other; lengths and masses reach the body."""
    here, path = bound(unsure=True), followed()
    among = unknowns(here, chosen("viscous_friction.elbow", "camera_roll"))
    model = here.model.with_effects(*chosen("viscous_friction.elbow", "camera_roll"))
    values = np.array([[0.1, 0.05, 0.31, 1.4, 0.26, 1.1], [0.3, -0.1, 0.29, 1.6, 0.25, 0.9]])
    many = among.set_in(model, values)
    with torch.no_grad():
        rows = torch.arange(len(path))
        f = many.transition_mean(path[:-1], rows[1:]).numpy()
        h = many.emission(path, rows).base_dist.loc.numpy()
    for s in range(2):
        single = among.set_in(model, values[s])
        body = single.body_parameters()
        np.testing.assert_allclose(body.length, values[s, [2, 4]])
        np.testing.assert_allclose(body.mass, values[s, [3, 5]])
        np.testing.assert_allclose(body.inertia, values[s, [3, 5]] * values[s, [2, 4]] ** 2 / 12)  # a rod still
        expected = means(single, path)
        np.testing.assert_allclose(f[s], expected[0], atol=1e-12)
        np.testing.assert_allclose(h[s], expected[1], atol=1e-12)
    np.testing.assert_allclose(here.model.body_parameters().length, [0.3, 0.25])  # as it was


def test_slopes_are_central_and_one_sided_at_a_bound():
    here, path = bound(unsure=True), followed()
    effects = chosen("viscous_friction.elbow", "camera_roll")
    among = unknowns(here, effects)
    model = here.model.with_effects(*effects)
    point = among.mean.copy()  # damping at its edge
    step = 0.05 * among.sd
    columns = slopes(model, among, point, step, path)
    for i in range(len(point)):
        up, down = point.copy(), point.copy()
        up[i] += step[i]
        down[i] = max(down[i] - step[i], among.lower[i])
        above, below = (means(among.set_in(model, at), path) for at in (up, down))
        for got, high, low in zip((columns.g, columns.d), above, below, strict=True):
            expected = (high - low) / (up[i] - down[i])
            np.testing.assert_allclose(got[..., i], expected, atol=1e-9 + 1e-7 * np.abs(expected).max())
    none = slopes(here.model, unknowns(bound(), []), np.zeros(0), np.zeros(0), path)
    assert none.g.shape == (len(path) - 1, here.model.state_dim, 0)
