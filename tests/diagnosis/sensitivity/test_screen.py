"""Screens: a ranking of all effects along one path or another."""

from copy import copy

import numpy as np
import pytest
import torch
from pendulum import ARM, LOOSE, PENDULUM, recording_of

from invdyn.diagnosis.hypotheses.add import better_of
from invdyn.diagnosis.hypotheses.continuation import continued, data_path
from invdyn.diagnosis.hypotheses.pool import considered
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.problem.noise import is_searched
from invdyn.diagnosis.problem.unknowns import prior_sd, unknowns
from invdyn.diagnosis.rules import DEFAULT
from invdyn.diagnosis.sensitivity.screen import cost_of, halved, screen, screen_in_halves, windows
from invdyn.diagnosis.sensitivity.whiten import linear_of
from invdyn.inference.smoothing.gauss_newton import gauss_newton
from invdyn.models.effects import EFFECTS
from invdyn.simulate import random_arm, record


def test_screen_is_a_ranking_of_all_and_none():
    here = diagnosis_problem(recording_of(), PENDULUM)
    path = gauss_newton(here.with_residual(LOOSE), here.observations).path
    effects = [e for e in considered(here) if e.name in ("viscous_friction", "camera_roll", "external_push")]
    common = unknowns(here, ())
    screened = screen(here, here.model, path, effects, common, common.mean)
    assert len(screened) == len(effects) + 1
    assert [s.log_evidence for s in screened] == sorted((s.log_evidence for s in screened), reverse=True)
    none = next(s for s in screened if s.effect is None)
    assert none.log_evidence == max(s.log_evidence for s in screened)  # each effect costs its prior
    for each in screened:
        for name, value in each.values.items():
            assert np.isfinite(value), (each.effect.key, name)
    # d′ of an effect at two thirds of its prior's spread: that over what refining leaves unknown of it.
    roll = next(s for s in screened if s.effect is not None and s.effect.name == "camera_roll")
    (known,) = refine(here, (roll.effect,), {}, path, LOOSE).sd
    (parameter,) = roll.effect.parameters(here.model.scale)
    assert roll.dprime == pytest.approx(0.67 * prior_sd(parameter) / known, rel=0.02)


@pytest.mark.long
def test_half_the_sub_steps_do_for_what_is_changed():
    """Slopes of one sub-step or of four: gains are the same to a hundredth."""
    here = diagnosis_problem(
        recording_of(EFFECTS["viscous_friction"]("pivot"), rows=120, effort=0.8, damping=0.05), PENDULUM
    )
    path, common = data_path(here)[0], unknowns(here, ())
    effects = [e for e in considered(here) if not is_searched(e)]
    gains = []
    for count in (2, 8):
        model = copy(here.model)
        model = model.in_substeps(count)
        screened = {s.effect and s.effect.key: s for s in screen(here, model, path, effects, common, common.mean)}
        gains.append({key: s.log_evidence - screened[None].log_evidence for key, s in screened.items()})
        assert screened["viscous_friction.pivot"].values["damping"] == pytest.approx(0.05, rel=0.1)
    for key, gain in gains[1].items():
        assert gains[0][key] == pytest.approx(gain, rel=0.01, abs=0.1), key


@pytest.mark.long
def test_what_the_camera_does_shows_beside_the_simulation_alone():
    """Under a residual torque the arm follows what a shutter has bent, and the screen sees nothing."""
    shutter = EFFECTS["rolling_shutter"]().bound(PENDULUM)
    bound = diagnosis_problem(recording_of(shutter, rows=150, readout=0.15, effort=0.8), PENDULUM)
    path, _ = data_path(bound)
    common = unknowns(bound, ())
    effects = [e for e in considered(bound) if not is_searched(e)]
    along, own = (
        screen(bound, bound.model, each, effects, common, common.mean)
        for each in (path, continued(bound, bound.model, path, DEFAULT.residual.min_path_size))
    )
    aside = better_of(along, own)
    before, after = ({s.effect.key: s for s in some if s.effect} for some in (along, aside))
    assert set(before) == set(after)
    here = shutter.key
    assert after[here].log_evidence > before[here].log_evidence + 5
    assert abs(after[here].values["readout"] - 0.15) < abs(before[here].values["readout"] - 0.15)
    one, other, found = ({s.effect and s.effect.key: s.log_evidence for s in some} for some in (along, own, aside))
    assert found == {key: max(one[key], other[key]) for key in one}  # those of the motion, too, and none
    assert [s.log_evidence for s in aside] == sorted((s.log_evidence for s in aside), reverse=True)


def test_a_push_is_also_looked_for_at_another_time():
    push = EFFECTS["external_push"]("tip").bound(PENDULUM)
    here = diagnosis_problem(
        recording_of(push, rows=120, impulse_x=0.5, impulse_y=0.2, moment=0.75, duration=0.1), PENDULUM
    )
    path, common = data_path(here)[0], unknowns(here, ())
    effects = [push, EFFECTS["viscous_friction"]("pivot").bound(PENDULUM)]
    screened = {s.effect.name: s for s in screen(here, here.model, path, effects, common, common.mean) if s.effect}
    found = screened["external_push"]
    assert abs(found.values["moment"] - 0.75) < DEFAULT.screening.burst_window
    assert abs(found.elsewhere["moment"] - found.values["moment"]) > DEFAULT.screening.burst_window
    assert set(found.elsewhere) == set(found.values)
    assert screened["viscous_friction"].elsewhere is None


@pytest.mark.quick("1.0")
@pytest.mark.parametrize("strength", [1.0, 0.0])
def test_a_push_that_is_soon_over_is_looked_for_in_a_stretch_as_short(strength):
    """A tenth of a second hides what strikes within three rows: the arm goes elsewhere than a long push sends it."""
    push = EFFECTS["external_push"]("tip").bound(PENDULUM)
    arm = random_arm(PENDULUM, duration=1.5, fps=200, noise=0.0002, torque_scale=0.5, commanded=True, seed=0)
    values = {"impulse_x": 0.06 * strength, "impulse_y": 0.04 * strength, "moment": 0.78, "duration": 0.015}
    given = {f"effect.{push.key}.{name}": torch.tensor([v], dtype=torch.float64) for name, v in values.items()}
    here = diagnosis_problem(record(arm.with_effects(push).replace(**given), 0)[0], PENDULUM)
    path = data_path(here)[0]
    found = windows(here, here.model, path, linear_of(here, here.model, path))
    short = [(start, stop) for start, stop in found if stop - start < DEFAULT.screening.burst_window / 2]
    assert any(start < 0.78 < stop for start, stop in short) is (strength > 0)
    assert bool(short) is (strength > 0)
    assert len(found) > len(short)


def test_halves_are_a_ranking_of_the_whole():
    here = diagnosis_problem(recording_of(), PENDULUM)
    path, common = data_path(here)[0], unknowns(here, ())
    effects = [e for e in considered(here) if not is_searched(e)]
    whole = {
        s.effect and s.effect.key: s.log_evidence for s in screen(here, here.model, path, effects, common, common.mean)
    }
    for count in (0, 1, len(effects)):
        found = screen_in_halves(1, here, here.model, path, effects[:count], common, common.mean)
        assert len(found) == count + 1
        assert [s.log_evidence for s in found] == sorted((s.log_evidence for s in found), reverse=True)
        for each in found:
            assert each.log_evidence == pytest.approx(whole[each.effect and each.effect.key], abs=1e-6)


def test_halves_take_as_long_as_each_other():
    here = diagnosis_problem(record(random_arm(ARM, duration=0.8, fps=50, noise=0.002, commanded=True))[0], ARM)
    costs = {e.key: cost_of(e, here.model) for e in considered(here) if not is_searched(e)}
    one, other = halved([(e, costs[e.key]) for e in considered(here) if e.key in costs])
    assert sorted(e.key for e in (*one, *other)) == sorted(costs)
    taken = [sum(costs[e.key] for e in half) for half in (one, other)]
    assert max(costs.values()) > 5 * min(costs.values())  # which is what makes it hard
    assert max(taken) <= 1.02 * min(taken)
