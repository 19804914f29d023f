"""The Gauss–Newton smoother: exact on linear models, and convergent on arms from sharp to blurred."""

import math
import sys

import oracles
import pyro.distributions as dist
import pytest
import torch
from stiff_arm import LENGTHS, arm

from invdyn.inference import ModelError, gauss_newton
from invdyn.inference.smoothing.gauss_newton import gauss_newton_path
from invdyn.inference.smoothing.linearisation import slopes_along
from invdyn.inference.smoothing.square_root import forward_mean
from invdyn.models import Encoders, Keypoints, LinearGaussian, Matern32, Observation, StateSpaceModel
from invdyn.models.divergence import Diverged

F64 = torch.float64


@pytest.mark.parametrize("sharpness", [1.0, 1e-8])
def test_linear_models_are_solved_in_one_step(sharpness):
    chain = oracles.random_chain(seed=2, noise=sharpness)
    y = oracles.with_gaps(chain.simulate(30, seed=2)[1])
    smoother = gauss_newton(chain.model(30), torch.as_tensor(y), max_iterations=1)
    means, covs = oracles.rts(chain, y)
    assert smoother.path.numpy() == pytest.approx(means, abs=1e-8)
    assert smoother.covariance().numpy() == pytest.approx(covs, abs=1e-8)
    assert smoother.log_evidence.item() == pytest.approx(oracles.kalman(chain, y)[0], rel=1e-9)
    joint = chain.model(30).log_joint(smoother.path, torch.as_tensor(y))
    assert smoother.log_joint.item() == pytest.approx(joint.item(), rel=1e-12)
    assert bool(gauss_newton(chain.model(30), torch.as_tensor(y)).converged)


def test_many_parameter_sets_of_a_linear_model_are_a_loop():
    chain = oracles.random_chain(seed=2)
    y = torch.as_tensor(oracles.with_gaps(chain.simulate(12, seed=2)[1]))
    model = chain.model(12)
    factors = torch.tensor([1.0, 1.3, 0.6], dtype=F64)
    stacked = model.replace(
        **{name: value * factors.reshape(3, 1, *[1] * value.ndim) for name, value in model.parameters.items()}
    )
    found = gauss_newton(stacked, y, start=torch.zeros(3, 12, 3, dtype=F64))
    for i, factor in enumerate(factors):
        alone = gauss_newton(model.replace(**{k: v * factor for k, v in model.parameters.items()}), y)
        torch.testing.assert_close(found.path[i], alone.path, rtol=1e-8, atol=1e-8)
        torch.testing.assert_close(found.log_evidence[i], alone.log_evidence)
        torch.testing.assert_close(found.covariance()[i], alone.covariance(), rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("noise", [1e-4, 1e-3, 1e-2, 0.1, 0.5])
def test_an_arm_from_sharp_to_blurred(noise):
    """σ_y over the arm's reach from 1e-4 to 0.5."""
    model = arm(120, noise * sum(LENGTHS))
    truth, y = model.simulate()
    smoother = gauss_newton(model, y)
    assert smoother.log_joint > model.log_joint(truth, y)
    # blurred, a flat valley is left in which steps gain a hundredth of a nat each
    assert_stationary(model, y, smoother, 0.1 if noise < 0.05 else 1.0)
    assert bool(smoother.converged) or noise > 0.05
    sd = smoother.covariance().diagonal(dim1=-2, dim2=-1).sqrt()
    z = (truth - smoother.path) / sd
    assert torch.isfinite(z).all()
    # the Gaussian around the mode fits the truth (dozens of independent ones among 720), unless all is blurred
    assert 0.7 < z.square().mean().sqrt().item() < 1.4 or noise > 0.2
    assert math.isfinite(smoother.log_evidence.item())


def assert_stationary(model, y, smoother, nats=0.1):
    """The next step promises nothing that could be noticed: ½ gᵀ P g in nats, the gradient by autograd."""
    path = smoother.path.clone().requires_grad_()
    model.log_joint(path, y).backward()
    step = forward_mean(smoother.factors, smoother.linearisation.m0)
    assert 0.5 * (path.grad * torch.as_tensor(step)).sum().item() == pytest.approx(0, abs=nats)


@pytest.mark.parametrize("noise", [1e-3, 0.05])
def test_stiff_dynamics(noise):
    """Angles that slip by 1e-6 rad a row: the homotopy has to find the way."""
    model = arm(100, noise, stiff=1e-6, parameters={"noise.velocity": 1e-4})
    truth, y = model.simulate()
    smoother = gauss_newton(model, y)
    assert bool(smoother.converged)
    # at least as likely as the truth
    assert smoother.log_joint > model.log_joint(truth, y)
    assert_stationary(model, y, smoother)


@pytest.mark.parametrize("noise", [0.02, 0.05])
def test_the_bend_of_stiff_dynamics_is_no_reason_for_small_steps(noise):
    """From kinematics, without a homotopy: damped steps alone would need 160 and more."""
    torch.manual_seed(1)
    model = arm(100, noise, stiff=1e-5, parameters={"noise.velocity": 1e-4})
    truth, y = model.simulate()
    smoother = gauss_newton(model, y, start=model.initial_paths(y)[0], max_iterations=20)
    assert bool(smoother.converged)
    assert smoother.log_joint > model.log_joint(truth, y)
    assert_stationary(model, y, smoother)


def test_from_a_start_that_is_far_off():
    model = arm(60, 0.005)
    _, y = model.simulate()
    best = gauss_newton(model, y)
    away = best.path + 0.2 * torch.randn(model.state_dim, dtype=F64)
    again = gauss_newton(model, y, start=away, max_iterations=100)
    torch.testing.assert_close(again.log_joint, best.log_joint, rtol=0, atol=0.02)


def test_a_whole_step_that_is_hardly_a_difference_ends_the_search(monkeypatch):
    """Were it a small loss, ever shorter steps would be tried for what is not there."""
    model = arm(60, 0.005)
    _, y = model.simulate()
    best = gauss_newton(model, y).path
    away = best + torch.tensor([0.0, 0.0, 2.0, -2.0, 0.0, 0.0], dtype=F64)
    room, looked = sys.modules[gauss_newton.__module__], {"deviations": 0, "linearise": 0}

    def counted(name):
        plain = getattr(room, name)

        def look(*given):
            looked[name] += 1
            return plain(*given)

        monkeypatch.setattr(room, name, look)

    def steps_from(away, *given):
        """The path, how many steps were tried, and how often slopes were asked for."""
        looked.update(deviations=0, linearise=0)
        path = gauss_newton_path(model, y, away, *given)
        return path, looked["deviations"] - 1, looked["linearise"]

    for name in looked:
        counted(name)
    with monkeypatch.context() as uncorrected:  # a whole step is a loss from there
        uncorrected.setattr(room, "bent", lambda linear, *_: linear)
        assert torch.equal(steps_from(away, 1, 1e-6)[0], away)
    path, steps, slopes = steps_from(away, 10, 1e9)
    assert torch.equal(path, away)
    assert (steps, slopes) == (1, 1)
    path, steps, slopes = steps_from(away, 10, 1e-6)
    assert not torch.equal(path, away)
    assert slopes < steps <= 10  # none for steps that were refused


@pytest.mark.parametrize("rows", [2_000, pytest.param(10_000, marks=pytest.mark.slow)])
def test_many_rows(rows):
    # a given motion: without friction, random torques would whirl the arm up without end
    model = arm(rows, 0.01)
    time = model.time[:, None]
    angles = torch.tensor([-1.2, 0.8]) + 0.9 * torch.sin(time * torch.tensor([2.1, 3.3]))
    tips = model.dynamics.keypoints(angles, model.body_parameters())
    y = tips.flatten(-2) + 0.01 * torch.randn(rows, 4, dtype=F64)
    y[1000:1040] = torch.nan
    y[::7, 1] = torch.nan
    smoother = gauss_newton(model, y)
    assert bool(smoother.converged)
    assert_stationary(model, y, smoother)
    sd = smoother.covariance().diagonal(dim1=-2, dim2=-1).sqrt()
    z = ((angles - smoother.path[:, 2:4]) / sd[:, 2:4]).square().mean().sqrt().item()
    # the true motion is smoother than random torques make it, so it is met a little too well
    assert 0.5 < z < 1.2


def test_other_emissions_and_torques():
    for emission, noise in (
        (Observation(Encoders()), 1.0),
        (Observation(Keypoints([1])), 0.01),
        (Observation(Keypoints([0, 1]), Encoders()), 0.01),
        (Observation(Keypoints([0, 1]), family="student_t"), 0.01),
    ):
        model = arm(60, noise, observation=emission, torque=Matern32(), parameters={"torque.scale": 0.5})
        truth, y = model.simulate()
        y[10:14] = torch.nan
        smoother = gauss_newton(model, y)
        assert bool(smoother.converged)
        assert smoother.log_joint > model.log_joint(truth, y)


def test_student_t_shrugs_off_outlying_detections():
    model = arm(80, 0.005, observation=Observation(Keypoints([0, 1]), family="student_t"))
    truth, y = model.simulate()
    clean = gauss_newton(model, y).path
    y[20, 2:] += 0.5
    y[50, :2] -= 0.4
    smoother = gauss_newton(model, y)
    assert bool(smoother.converged)
    joints = slice(2, 4)
    assert (smoother.path - clean)[:, joints].abs().max() < 0.05
    gaussian = arm(80, 0.005)
    assert (gauss_newton(gaussian, y).path - clean)[:, joints].abs().max() > 0.05
    assert (smoother.path - truth)[:, joints].abs().max() < 0.1


def test_a_start_without_density_is_refused():
    model = oracles.random_chain().model(5)
    y = torch.zeros(5, 2, dtype=F64)
    with pytest.raises(Diverged, match="its state is no number at row 0"):
        gauss_newton(model, y, start=torch.full((5, 3), torch.inf, dtype=F64))


def test_other_noise_than_gaussian_is_refused():
    class Jumps(StateSpaceModel):
        state_dim = observation_dim = 1
        num_steps = 4

        def initial(self):
            return dist.Normal(torch.zeros(1, dtype=F64), 1.0).to_event(1)

        def transition(self, state, t):
            return dist.Laplace(state, self.parameters["scale"]).to_event(1)

        def emission(self, state, t):
            return dist.Normal(state, 1.0).to_event(1)

    model = Jumps({"scale": torch.ones(1, dtype=F64)})
    with pytest.raises(ModelError, match="bootstrap guide"):
        gauss_newton(model, torch.zeros(4, 1, dtype=F64))
    assert isinstance(oracles.random_chain().model(3), LinearGaussian)


def test_parameter_sets_that_are_similar_may_share_the_slopes_of_one():
    """What is found then is a tenth of a nat below the mode at most, though it may not be all the way there."""
    model = arm(60, 0.005)
    y = model.simulate()[1]
    masses = model.body_parameters().mass * torch.tensor([0.97, 1.0, 1.03], dtype=F64).reshape(-1, 1, 1)
    many = model.replace(**{"body.mass": masses})
    middle = gauss_newton(model, y).path
    start = middle.expand(3, -1, -1)
    own = gauss_newton(many, y, start=start)
    shared = gauss_newton(many, y, start=start, slopes=slopes_along(model, middle))
    assert (own.log_joint - many.log_joint(start, y)).max() > 1.0  # somewhere to go
    assert (own.log_joint - shared.log_joint).abs().max() < 0.1
    torch.testing.assert_close(shared.log_joint, many.log_joint(shared.path, y))
    assert shared.factors.log_evidence.shape == (3,)
