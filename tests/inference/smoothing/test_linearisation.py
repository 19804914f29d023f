"""A model along a path: slopes beside a backward pass, and the path's density beside the model's own."""

import numpy as np
import pytest
import torch
from stiff_arm import arm

from invdyn.inference.smoothing import linearisation
from invdyn.inference.smoothing.linearisation import deviations, emission_mean, log_joint, slopes_along
from invdyn.inference.smoothing.posterior_linearisation import fit_linear
from invdyn.inference.variational.affine import jacobian
from invdyn.models import Keypoints, Matern32, Observation
from invdyn.models.effects import EFFECTS
from invdyn.models.state_space import gaussian_mean

F64 = torch.float64


@pytest.mark.parametrize("family", ["gaussian", "student_t"])
@pytest.mark.parametrize("torque", [None, Matern32])
def test_log_joint_of_the_path_that_was_linearised_along(family, torque):
    """Also where the emission's Gaussian is a fit only, rows are missing, and for many paths at once."""
    options = {} if torque is None else {"torque": torque(2)}
    model = arm(40, 0.01, observation=Observation(Keypoints([0, 1]), family=family), **options)
    torch.manual_seed(0)
    paths, observations = model.simulate((3,))
    observations = observations[0].clone()
    observations[5:9, :2] = torch.nan
    found = log_joint(deviations(model, paths, observations))
    np.testing.assert_allclose(found, model.log_joint(paths, observations).numpy(), rtol=1e-10)


@pytest.mark.parametrize("batch", [(), (3,)])
@pytest.mark.parametrize(("wide", "digits"), [(12, 7), (1, 5)])
def test_slopes_are_tangents(batch, wide, digits, monkeypatch):
    """Differences beside a backward pass, central and one-sided; with an effect on what moves, one on what is seen."""
    monkeypatch.setattr(linearisation, "ONE_SIDED_FROM", wide)
    model = arm(30, 0.003).with_effects(EFFECTS["viscous_friction"]("joint1"), EFFECTS["lens_distortion"]())
    path = model.simulate(batch)[0]
    rows, dim = torch.arange(30), model.state_dim
    F, H = slopes_along(model, path)
    _, expected = jacobian(lambda x: gaussian_mean(model.transition(x, rows[1:])), path[..., :-1, :], dim)
    torch.testing.assert_close(F, expected, rtol=10**-digits, atol=0.1 * 10**-digits)
    _, expected = jacobian(lambda x: emission_mean(model, x, rows), path, model.observation_dim)
    torch.testing.assert_close(H, expected, rtol=10**-digits, atol=0.1 * 10**-digits)


@pytest.mark.parametrize("batch", [(), (3,)])
def test_blocks_of_rows_have_the_lines_of_the_whole(batch, monkeypatch):
    """Tangents and fits of a model whose steps differ in length, in blocks of few rows."""
    model = arm(30, 0.003, dt=np.linspace(0.01, 0.04, 30))
    torch.manual_seed(0)
    path, y = model.simulate(batch)
    y = y[0] if batch else y
    wide = torch.diag(torch.tensor([1.0, 1.0, 0.01, 0.01, 0.1, 0.1], dtype=F64)).expand(*batch, 30, 6, 6)
    found = []
    for numbers in (1e9, 300):
        monkeypatch.setattr(linearisation, "NUMBERS_AT_ONCE", int(numbers))
        linear = fit_linear(model, y, path, wide)
        found.append([*slopes_along(model, path), *map(torch.as_tensor, (linear.F, linear.a, linear.E, linear.V))])
    for whole, blocks in zip(*found, strict=True):
        torch.testing.assert_close(blocks, whole, rtol=1e-7, atol=1e-8)


@pytest.mark.long
def test_slopes_follow_what_is_driven_through_contacts():
    """Play at the elbow: what a hair's difference in the first row becomes is the product of all rows' slopes."""
    model = arm(60, 0.003, parameters={"torque.scale": 0.0}).with_effects(EFFECTS["backlash"]("joint1"))
    model = model.replace(**{"effect.backlash.joint1.width": torch.tensor([0.05], dtype=F64)})

    def rolled(first):
        rows = [first]
        for t in range(1, model.num_steps):
            rows.append(model.transition_mean(rows[-1], t))
        return torch.stack(rows, -2)

    begun = torch.tensor([0.0, 0.0, -0.025, 0.0, 0.5, 1.2, 0.0, -2.0], dtype=F64)
    hairs = 1e-7 * torch.eye(8, dtype=F64)[4:]
    path = rolled(begun)
    contacts = ((path[1:, 2].abs() == 0.025) != (path[:-1, 2].abs() == 0.025)).sum()
    assert contacts > 6
    F, _ = slopes_along(model, path)
    moved = (rolled(begun + hairs) - path) / 1e-7
    expected = hairs / 1e-7
    for t in range(1, len(path)):
        expected = expected @ F[t - 1].mT
        off = (moved[:, t] - expected).abs().max()
        assert off < 2e-3 * moved[:, t].abs().max(), t
