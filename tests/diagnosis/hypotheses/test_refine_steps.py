"""How a refinement steps from round to round, and where it ends."""

import sys
from functools import cache, partial

import numpy as np
import pytest
import torch
from pendulum import ARM, DAMPING, FRICTION, LOOSE, PENDULUM, causes, path_of, recorded, recording_of
from scipy.optimize import minimize
from scipy.special import logsumexp

from invdyn.diagnosis.hypotheses.refine import promised_gain, refine, squared_distance, within_bounds
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.problem.regime import Regime
from invdyn.diagnosis.problem.unknowns import Unknowns, unknowns
from invdyn.diagnosis.rules import DEFAULT
from invdyn.models.effects import EFFECTS
from invdyn.simulate import random_arm, record


def test_what_never_rests_is_worth_what_was_seen(monkeypatch):
    """Where every step promises more than the next one keeps, the cause stands where it was expanded."""
    here, _, cause = causes()
    monkeypatch.setattr(
        Unknowns, "step", lambda among, point, target: cause.mean + 3 * cause.sd * (-1) ** (point > cause.mean)
    )
    restless = refine(here, cause.effects, {}, path_of(here), LOOSE)
    assert np.array_equal(restless.mean, restless.about)
    assert restless.log_evidence == pytest.approx(logsumexp(restless.by_size))
    assert restless.log_evidence == pytest.approx(cause.log_evidence - 0.5 * 3**2, abs=0.5)
    assert cause.log_evidence == pytest.approx(logsumexp(cause.by_size))


def test_of_rounds_that_are_as_good_the_last_one_counts(monkeypatch):
    """Expanded half a standard deviation off, or where it leads: the second, though it is worth .1 nats less."""
    here, _, cause = causes()
    rounds, own = [], Regime.log_prior.fget

    def ever_less(regime):
        rounds.append(regime)
        return own(regime) - 0.2 * len(rounds)

    monkeypatch.setattr(Regime, "log_prior", property(ever_less))
    start = {cause.names[0]: float(cause.mean[0] + 0.5 * cause.sd[0])}
    found = refine(here, cause.effects, start, cause.path, DEFAULT.residual.min_path_size)
    assert 1 < len(rounds) < 4
    assert np.abs(found.mean - found.about) <= DEFAULT.descent.settled_sds * found.sd


def test_a_positive_parameter_is_halved_at_most():
    here = diagnosis_problem(recorded(), PENDULUM)
    among = unknowns(here, (EFFECTS["stribeck_friction"]("pivot").bound(PENDULUM),))
    velocity = among.names.index("stribeck_friction.pivot.velocity")
    point = among.mean.copy()
    there = among.step(point, point - 100.0 * among.sd)
    assert there[velocity] == pytest.approx(point[velocity] / 2)
    assert (there >= among.lower).all()
    assert among.step(point, point + 0.1 * among.sd) == pytest.approx(point + 0.1 * among.sd)


def test_a_step_that_meets_a_bound_is_the_best_within_it():
    """Against a quadratic programme by another solver."""
    generator = np.random.default_rng(3)
    here = diagnosis_problem(recorded(DAMPING), PENDULUM)
    names = ("viscous_friction", "armature", "coulomb_friction")
    among = unknowns(here, [EFFECTS[name]("pivot").bound(PENDULUM) for name in names])
    met = 0
    for _ in range(20):
        root = generator.normal(size=(3, 3)) * among.sd[:, None]
        covariance, mean = root @ root.T, generator.normal(size=3) * among.sd
        point = among.lower + 0.3 * among.sd
        found = within_bounds(partial(among.step, point), point, mean, covariance)

        def cost(z, mean=mean, covariance=covariance, point=point):
            return squared_distance(point + mean - z * among.sd, covariance)

        best = minimize(cost, (found / among.sd), bounds=np.stack([among.lower, among.upper], -1) / among.sd[:, None])
        assert (found >= among.lower).all()
        assert (found <= among.upper).all()
        met += (point + mean < among.lower).any()
        # Coordinates that have met a bound stay there, though the others might let one go again.
        assert cost(found / among.sd) <= 1.5 * best.fun + 1e-6
        clipped = np.clip(point + mean, among.lower, among.upper)
        assert cost(found / among.sd) <= cost(clipped / among.sd) + 1e-9
    assert met > 5


def test_what_is_promised_is_the_gain_within_bounds():
    """From two deviations within an edge to three beyond it: 2⁻¹ (5² − 3²) nats; from the edge on, none."""
    here = diagnosis_problem(recorded(), PENDULUM)
    among = unknowns(here, [FRICTION.bound(PENDULUM)])
    sd = 0.1 * among.sd
    for inside, gain in ((2.0, 8.0), (0.0, 0.0)):
        point = among.lower + inside * sd
        assert promised_gain(among, point, among.lower - 3 * sd - point, np.diag(sd**2)) == pytest.approx(
            gain, abs=1e-9
        )


def test_all_of_a_shortened_step_is_promised():
    """Evidence knows of no step that is shorter than bounds let it be."""
    here = diagnosis_problem(recorded(), PENDULUM)
    among = unknowns(here, (EFFECTS["stribeck_friction"]("pivot").bound(PENDULUM),))
    covariance, whole = np.diag((0.1 * among.sd) ** 2), -0.9 * among.mean
    halved = within_bounds(partial(among.step, among.mean), among.mean, whole, covariance)
    assert halved == pytest.approx(among.mean / 2)
    assert promised_gain(among, among.mean, whole, covariance) == pytest.approx(
        0.5 * squared_distance(whole, covariance)
    )


@cache
def heavier():
    """An arm whose upper link is not as its file says, and what is found from there."""
    effect = EFFECTS["inertial_error"]("upper_arm")
    values = {"mass": 0.18, "com": -0.02, "inertia": 0.002}
    arm = random_arm(ARM, duration=3.0, fps=100, noise=0.0003, torque_scale=0.5, commanded=True, seed=2)
    named = {f"effect.{effect.key}.{n}": torch.tensor([v], dtype=torch.float64) for n, v in values.items()}
    here = diagnosis_problem(record(arm.with_effects(effect).replace(**named), 2)[0], ARM)
    return (
        here,
        effect,
        refine(
            here,
            (effect,),
            {f"{effect.key}.{n}": v for n, v in values.items()},
            path_of(here),
            DEFAULT.residual.min_path_size,
        ),
    )


@pytest.mark.long
def test_steps_that_are_short_in_each_parameter_go_on_where_they_are_long_together():
    """Mass times distance is known well, neither of them is: beside that ridge a step of a hundredth matters."""
    here, effect, found = heavier()
    beside = found.mean + found.sd * [1.0, -1.0, 1.0]
    again = refine(
        here, (effect,), dict(zip(found.names, beside, strict=True)), found.path, DEFAULT.residual.min_path_size
    )
    assert again.log_evidence == pytest.approx(found.log_evidence, abs=0.5)


def test_where_no_step_was_a_gain_shorter_ones_are_tried(monkeypatch):
    here, effect, found = heavier()
    room = sys.modules[refine.__module__]
    tried, plain = [], room.gauss_newton_path

    def stuck(model, observations, path, steps, tolerance):
        tried.append(steps)
        return path if steps == DEFAULT.descent.path_steps else plain(model, observations, path, steps, tolerance)

    monkeypatch.setattr(room, "gauss_newton_path", stuck)
    values = dict(zip(found.names, found.mean, strict=True))
    again = refine(here, (effect,), values, path_of(here), DEFAULT.residual.min_path_size)
    assert tried[:2] == [DEFAULT.descent.path_steps, DEFAULT.descent.max_short_steps]
    assert again.log_evidence == pytest.approx(found.log_evidence, abs=0.5)


def test_what_a_bending_link_is_made_of_stays_positive():
    """Without damping its resonance is another one, and slopes there do not lead back."""
    bound = diagnosis_problem(recording_of(rows=30), PENDULUM)
    effect = EFFECTS["link_flexibility"](PENDULUM.links[0].name).bound(PENDULUM)
    among = unknowns(bound, [effect])
    point = np.array([parameter.grid[0] for parameter in effect.parameters(bound.model.scale)])
    np.testing.assert_allclose(among.step(point, -point), point / 2)
