"""The kinematic model: its walk is exact, and where it is linear its evidence is a Kalman filter's."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from oracles import Chain, kalman
from scenes import ring
from trees import paper_arm

from invdyn.inference import SMCOptions, run_filters
from invdyn.inference.posterior.cameras import pinhole
from invdyn.inference.smoothing.gauss_newton import gauss_newton
from invdyn.models import Encoders, KinematicModel, Link, Observation, Pixels, planar_body
from invdyn.models.articulated.defaults import WrongValue
from invdyn.models.state_space import UnknownParameter, gaussian_moments

TIME = np.array([0.0, 0.1, 0.15, 0.4, 0.5, 0.62])
ARM = planar_body("arm", [Link("a", "s", "t", length=0.3, mass=1.0), Link("b", "e", "u", length=0.2, mass=0.5)])


def test_a_long_step_is_two_short_ones():
    """The covariance of a step is the integral's own: 0 → δ₁ → δ₁ + δ₂ is 0 → δ₁ + δ₂."""

    def law(times, state):
        """Mean and covariance of the last state, given the first one."""
        model = KinematicModel(ARM, times, parameters={"walk.scale": [1.5, 0.4]})
        mean, cov = state, torch.zeros(4, 4, dtype=torch.float64)
        eye = torch.eye(4, dtype=torch.float64)
        for t in range(1, len(times)):
            F = torch.stack([model.transition(unit, t).mean - model.transition(0 * unit, t).mean for unit in eye], -1)
            mean, root = gaussian_moments(model.transition(mean, t))
            cov = F @ cov @ F.mT + root @ root.mT
        return mean, cov

    state = torch.tensor([0.2, -0.3, 1.0, 2.0], dtype=torch.float64)
    for one, other in zip(law([0.0, 0.3, 0.7], state), law([0.0, 0.7], state), strict=True):
        assert torch.allclose(one, other, atol=1e-12)


@pytest.mark.parametrize("order", [1, 2])
def test_with_encoders_alone_it_is_linear_and_its_evidence_exact(order):
    time = 0.1 * np.arange(8)
    model = KinematicModel(ARM, time, Observation(Encoders()), order=order, parameters={"emission.angle_scale": 0.05})
    torch.manual_seed(0)
    _, rows = model.simulate()
    rows[2] = torch.nan
    D = model.state_dim
    mean, root = gaussian_moments(model.initial())
    move = np.stack([model.transition(unit, 1).mean.numpy() for unit in torch.eye(D, dtype=torch.float64)], -1)
    noise = gaussian_moments(model.transition(mean, 1))[1]
    exact, *_ = kalman(
        Chain(
            A=move,
            Q=(noise @ noise.mT).numpy(),
            C=np.eye(2, D),
            R=0.05**2 * np.eye(2),
            m=mean.numpy(),
            P=(root @ root.mT).numpy(),
        ),
        rows.numpy(),
    )
    assert gauss_newton(model, rows).log_evidence.item() == pytest.approx(exact, abs=1e-6)
    with torch.random.fork_rng():
        torch.manual_seed(1)
        # The guide is exact: every filter weighs the same.
        result = run_filters(model, rows, SMCOptions(num_filters=4, num_particles=20, refits=0))
    assert result.log_evidence.numpy() == pytest.approx(np.full(4, exact), abs=1e-4)


def test_a_tree_is_found_from_its_own_simulation():
    model = KinematicModel(
        paper_arm(), 0.05 * np.arange(30), parameters={"walk.scale": 2.0, "emission.keypoint_scale": 0.01}
    )
    model = model.replace(**{"initial.velocity_scale": torch.full((4,), 0.5, dtype=torch.float64)})
    torch.manual_seed(3)
    states, rows = model.simulate()
    smoother = gauss_newton(model, rows)
    sd = smoother.covariance().diagonal(dim1=-2, dim2=-1).sqrt()
    z = (smoother.path - states) / sd
    assert bool(smoother.converged)
    # 240 standard normal numbers, correlated within a few rows.
    assert 0.7 < z.square().mean().sqrt() < 1.3


def test_what_cannot_be_is_refused():
    with pytest.raises(WrongValue, match="order 1 or 2"):
        KinematicModel(ARM, TIME, order=3)
    with pytest.raises(UnknownParameter, match=r"torque\.scale"):
        KinematicModel(ARM, TIME, parameters={"torque.scale": 1.0})
    with pytest.raises(ValueError, match="increasing"):
        KinematicModel(ARM, TIME[::-1])
    pixels = Pixels(pinhole(ring(2)), ("a", "b"), torch.full((2, 2), 640.0).double(), (0,))
    with pytest.raises(WrongValue, match=r"errors do not last, .* got pixel"):
        KinematicModel(paper_arm(), TIME, Observation(pixels))
    KinematicModel(paper_arm(), TIME, Observation(replace(pixels, lasting=False)))
