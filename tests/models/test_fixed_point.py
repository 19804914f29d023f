"""Gaps along a known motion: what rows one after the other give, in fewer passes than they are forgotten by."""

from functools import cache
from statistics import median

import pytest
import torch
from pendulum import ARM

from invdyn.inputs import load_body
from invdyn.models import ArmModel
from invdyn.models.effects import EFFECTS
from invdyn.models.fixed_point import LEAPS, PASSES, settled
from invdyn.models.state_space import gaussian_mean
from invdyn.simulate import random_arm

WIDTH = "effect.backlash.elbow.width"


@cache
def with_play(*widths):
    """An arm whose elbow has play of that width, rad, or of each of those."""
    arm = random_arm(ARM, duration=1.5, fps=100, torque_scale=0.5, commanded=True, seed=1)
    shape = (1,) if len(widths) == 1 else (-1, 1, 1)
    value = torch.tensor(widths, dtype=torch.float64).reshape(shape)
    return arm.with_effects(EFFECTS["backlash"]("elbow")).replace(**{WIDTH: value})


@cache
def rolled(model):
    """A path (T, D) of the model without noise, row by row."""
    rows = [torch.zeros(model.state_dim, dtype=torch.float64)]
    for t in range(1, model.num_steps):
        rows.append(model.transition_mean(rows[-1], t))
    return torch.stack(rows)


def forgotten(model, path):
    path = path.clone()
    path[..., 1:, model.contact_states] = 0.0
    return path


@pytest.fixture
def calls(monkeypatch):
    """How many rows each call asks the transition for; what is cached was rolled before."""
    rolled(with_play(0.16))
    asked, true = [], ArmModel.transition

    def transition(self, state, t):
        asked.append(len(t))
        return true(self, state, t)

    monkeypatch.setattr(ArmModel, "transition", transition)
    return asked


@pytest.mark.long
@pytest.mark.parametrize("width", [0.02, 0.16])
def test_a_gap_is_where_the_motion_drives_it(width):
    model = with_play(width)
    path = rolled(model)
    gap = path[:, model.contact_states][:, 0]
    assert (gap > 0.45 * width).sum() > 10 < (gap < -0.45 * width).sum()
    unknown = forgotten(model, path)
    torch.testing.assert_close(settled(model, unknown), path, rtol=1e-9, atol=1e-9)
    assert not unknown[1:, model.contact_states].any()


def test_what_lies_at_a_stop_lies_there_to_the_bit():
    model = with_play(0.16)
    path = rolled(model)
    at_stop = path[:, model.contact_states][:, 0].abs() == 0.08
    assert at_stop.sum() > 30
    found = settled(model, forgotten(model, path))
    assert torch.equal(found[:, model.contact_states][:, 0].abs() == 0.08, at_stop)
    assert torch.equal(found[at_stop][:, model.contact_states], path[at_stop][:, model.contact_states])


def test_what_is_settled_stays_to_the_bit():
    model = with_play(0.16)
    path = settled(model, forgotten(model, rolled(model)))
    assert torch.equal(settled(model, path), path)


@pytest.mark.long
def test_many_sets_are_each_by_itself():
    widths = (0.02, 0.05, 0.16)
    path = rolled(with_play(0.05))
    many = with_play(*widths)
    found = settled(many, forgotten(many, path).expand(3, -1, -1))
    for width, own in zip(widths, found, strict=True):
        model = with_play(width)
        torch.testing.assert_close(own, settled(model, forgotten(model, path)), rtol=1e-9, atol=1e-9)


def test_many_sets_whose_gaps_seldom_meet_a_stop_are_settled():
    """Some thousand rows, in which a change would travel farther than there are passes without slopes."""
    arm = random_arm(load_body("paper_planar_arm"), duration=2.0, fps=100, commanded=True, seed=0)
    widths = torch.tensor([0.06, 0.1, 0.2] * 3, dtype=torch.float64).reshape(-1, 1, 1)
    model = arm.with_effects(EFFECTS["backlash"]("elbow")).replace(**{WIDTH: widths})
    torch.manual_seed(0)
    path, first = arm.simulate()[0], arm.torque_size
    path = torch.cat([path[:, :first], torch.zeros(len(path), 2, dtype=path.dtype), path[:, first:]], -1)
    found = settled(model, path.expand(len(widths), -1, -1))
    again = gaussian_mean(model.transition(found[:, :-1], torch.arange(1, model.num_steps)))
    off = (again - found[:, 1:])[..., model.contact_states].abs().amax(-1)
    assert (off > 1e-9).double().mean() < 0.02


@pytest.mark.long
def test_slopes_save_passes(calls, monkeypatch):
    """A flight across a wide gap takes many rows, one a pass without slopes: as after a step of Gauss–Newton.

    For most paths; where a slope straddles a contact, how many depends on the last digits that a machine has.
    """
    model, passes = with_play(0.16), {}
    for seed in range(5):
        noise = torch.randn(rolled(model).shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
        path, found = rolled(model) + 1e-3 * noise, []
        for few in (2000, 0):
            monkeypatch.setattr("invdyn.models.fixed_point.FEW", few)
            calls.clear()
            found.append(settled(model, path))
            passes.setdefault(few, []).append(len(calls))
        torch.testing.assert_close(*found, rtol=1e-9, atol=1e-9)
    assert median(passes[2000]) < 0.6 * median(passes[0])


def test_a_path_that_runs_away_ends(calls):
    model = with_play(0.16)
    path = forgotten(model, rolled(model))
    path[100:, -1] = torch.nan
    assert settled(model, path)[101:, model.contact_states].isnan().all()
    assert len(calls) <= LEAPS + PASSES + 1


def test_only_a_gap_is_driven():
    arm = random_arm(ARM, duration=0.2, fps=100, commanded=True, seed=1)
    springy = arm.with_effects(EFFECTS["link_flexibility"]("forearm"))
    path = torch.randn(20, springy.state_dim, dtype=torch.float64)
    assert springy.contact_states is None
    assert settled(springy, path) is path
