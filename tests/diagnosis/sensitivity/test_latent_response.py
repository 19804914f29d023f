"""What a hinge that nobody sees does along a known motion, and to it."""

import sys

import pytest
import torch
from pendulum import ARM

from invdyn.diagnosis.hypotheses.continuation import data_path
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.rules import DEFAULT
from invdyn.diagnosis.sensitivity.latent_response import latent_response
from invdyn.models import ArmModel
from invdyn.models.effects import EFFECTS
from invdyn.models.state_space import gaussian_mean
from invdyn.simulate import random_arm, record


@pytest.fixture(scope="module")
def bent():
    """An arm, 100 frames/s, whose forearm swings at 7, 14 and 30 Hz, (3,) parameter sets; its path without that."""
    arm = random_arm(ARM, duration=1.5, fps=100, noise=0.002, torque_scale=0.5, commanded=True, seed=3)
    here = diagnosis_problem(record(arm, 3)[0], ARM)
    effect = EFFECTS["link_flexibility"]("forearm").bound(ARM)
    stiffness, damping = effect.parameters(here.model.scale)
    values = torch.tensor([stiffness.grid[i] for i in (1, 3, 5)], dtype=torch.float64).reshape(-1, 1, 1)
    known = {f"effect.{effect.key}.stiffness": values, f"effect.{effect.key}.damping": 0 * values + damping.grid[1]}
    return here.model.with_effects(effect).replace(**known), data_path(here)[0]


def test_the_hinge_goes_where_the_model_has_it_go(bent):
    """From row to row, to first order: within a tenth of the largest deflection."""
    model, path = bent
    paths, _ = latent_response(model, path, 3)
    with torch.no_grad():
        after = gaussian_mean(model.transition(paths[:, :-1], torch.arange(1, len(path))))
    angle = slice(2, 3)
    off = (paths[:, 1:, angle] - after[..., angle]).abs().amax((1, 2))
    assert (off < 0.1 * paths[..., angle].abs().amax((1, 2))).all()


def test_what_the_hinge_does_to_the_arm_is_the_models_to_first_order(bent):
    """Next states beside those without a hinge: within a tenth of the largest change of each."""
    model, path = bent
    paths, following = latent_response(model, path, 3)
    rows = torch.arange(1, len(path))
    still = paths.clone()
    still[..., 2:4] = 0.0
    with torch.no_grad():
        after, rest = (gaussian_mean(model.transition(each[:, :-1], rows)) for each in (paths, still))
    assert ((following - after).abs().amax(1) <= 0.1 * (after - rest).abs().amax(1) + 1e-12).all()


def test_slopes_of_some_rows_do_for_all(bent):
    """Within a twentieth of the largest deflection and of the largest change; of uneven rows all are asked."""
    model, path = bent
    module = sys.modules[latent_response.__module__]
    paths, following = latent_response(model, path, 3)
    assert len(module.steps_apart(model, paths[0], DEFAULT.screening.slope_turn)) < len(path) / 2
    uneven = ArmModel(ARM, model.time + 0.002 * (torch.arange(len(path)) > 70))
    assert len(module.steps_apart(uneven, path, DEFAULT.screening.slope_turn)) == len(path) - 1
    every = DEFAULT.replace(slope_turn=1e-9)
    assert len(module.steps_apart(model, paths[0], 1e-9)) == len(path) - 1
    exactly, next_exactly = latent_response(model, path, 3, every)
    hinge = slice(2, 4)
    off = (paths - exactly).abs().amax(1)[:, hinge]
    assert (off <= 0.05 * exactly[..., hinge].abs().amax(1)).all()
    moved = (next_exactly - exactly[:, :-1]).abs().amax(1)
    assert ((following - next_exactly).abs().amax(1) <= 0.05 * moved + 1e-12).all()
