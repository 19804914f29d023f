"""Block moves: always accepted where everything is linear, and invariant where it is not."""

import numpy as np
import oracles
import pyro.distributions as dist
import pytest
import torch

from invdyn.inference import gauss_newton
from invdyn.inference.filters.bridge import Bridge
from invdyn.models import StateSpaceModel

F64 = torch.float64
STEPS = 12


def parts(block, chain=None):
    chain = chain or oracles.random_chain(seed=4)
    y = oracles.with_gaps(chain.simulate(STEPS, seed=4)[1])
    model, y = chain.model(STEPS), torch.as_tensor(y)
    return model, y, Bridge(model, y, gauss_newton(model, y), block)


@pytest.mark.parametrize("t", [0, 2, 4])
@pytest.mark.parametrize("block", [1, 3, 6])
def test_every_move_is_accepted_on_a_linear_model(block, t):
    _, _, bridge = parts(block)
    states, weights = 2 * torch.randn(5, 30, 3, dtype=F64), torch.randn(5, 30, dtype=F64)
    stretch = torch.randn(5, 8, block + 2, 3, dtype=F64)
    moved = bridge.move(t, states, weights, stretch)
    assert moved.shape == (5, 8, block + 1, 3)
    assert (moved != stretch[..., :-1, :]).any(-1).all()
    # the first state is one of the filter's particles
    assert (moved[:, :, None, 0] == states[:, None]).all(-1).any(-1).all()
    # ω is one constant for all stretches that end in the same state
    many = torch.cat([torch.randn(50, block + 1, 3, dtype=F64), stretch[0, 0, -1:].expand(50, 1, 3)], -2)
    end = many[..., -1, :] - bridge.path[t + block + 1]
    omega = bridge.log_omega(t, many, torch.cat([end, torch.ones(50, 1, dtype=F64)], -1))
    assert (omega - omega[0]).abs().max() < 1e-8 * (1 + omega.abs().max())


def test_one_move_draws_from_the_exact_conditional():
    """x_{t+1:t+ℓ} given a single ancestor and the fixed end, against a dense Gaussian."""
    block, t = 3, 2
    chain = oracles.random_chain(seed=4)
    _, y, bridge = parts(block, chain)
    ancestor, end = torch.randn(3, dtype=F64), torch.randn(3, dtype=F64)
    stretch = torch.zeros(1, 20_000, block + 2, 3, dtype=F64)
    stretch[..., -1, :] = end
    moved = bridge.move(t, ancestor.expand(1, 1, 3), torch.zeros(1, 1, dtype=F64), stretch)[0, :, 1:]
    # rows t … t+ℓ+1 as a chain of their own, whose last row is observed exactly
    L = np.stack([np.zeros((3, 3))] + (block + 1) * [np.linalg.cholesky(chain.Q)])
    E, e = np.zeros((block + 2, 3, 3)), np.zeros((block + 2, 3))
    for j in range(1, block + 1):
        row = y[t + j].numpy()
        seen = np.isfinite(row)
        if seen.any():
            whiten = np.linalg.inv(np.linalg.cholesky(chain.R[np.ix_(seen, seen)]))
            E[j, : seen.sum()], e[j, : seen.sum()] = whiten @ chain.C[seen], whiten @ row[seen]
    E[-1], e[-1] = 1e5 * np.eye(3), 1e5 * end.numpy()
    F = np.stack((block + 1) * [chain.A])
    mean, cov, _ = oracles.dense_posterior(F, np.zeros((block + 1, 3)), L, E, e, ancestor.numpy())
    sd = np.sqrt(np.diagonal(cov, axis1=1, axis2=2))[1:-1]
    assert np.abs((moved.mean(0).numpy() - mean[1:-1]) / sd).max() < 4.5 / np.sqrt(20_000)
    assert np.abs(moved.var(0).numpy() / sd**2 - 1).max() < 4.5 * np.sqrt(2 / 20_000)


class Pendulum(StateSpaceModel):
    """Two coordinates, dynamics and emission both bent."""

    def __init__(self):
        super().__init__({"noise": torch.tensor([0.3, 0.4], dtype=F64)})
        self.num_steps, self.state_dim, self.observation_dim = STEPS, 2, 1

    def initial(self):
        return dist.Normal(torch.zeros(2, dtype=F64), torch.ones(2, dtype=F64)).to_event(1)

    def transition(self, state, t):
        angle, speed = state.unbind(-1)
        mean = torch.stack([angle + 0.5 * speed, 0.9 * speed - 0.8 * torch.sin(angle)], -1)
        return dist.Normal(mean, self.parameters["noise"]).to_event(1)

    def emission(self, state, t):
        return dist.Normal(2 * torch.sin(state[..., :1]), 0.5).to_event(1)


@pytest.mark.parametrize("block", [2, 4])
def test_moves_leave_the_smoothing_distribution_of_a_bent_model_alone(block):
    """Exact draws, moved many times, are still such draws.

    The exact draws come from importance sampling of the block by its prior, given ancestor and end.
    """
    torch.manual_seed(2)
    model, t = Pendulum(), 3
    _, y = model.simulate()
    y[5] = torch.nan
    bridge = Bridge(model, y, gauss_newton(model, y), block)
    ancestors = torch.randn(1, 3, 2, dtype=F64)
    weights = torch.tensor([[0.2, 0.5, 0.3]], dtype=F64).log()
    end = torch.tensor([0.8, -0.3], dtype=F64)

    count = 400_000
    index = torch.distributions.Categorical(logits=weights[0]).sample((count,))
    states = [ancestors[0, index]]
    log_weight = torch.zeros(count, dtype=F64)
    for j in range(1, block + 1):
        states.append(model.transition(states[-1], t + j).sample())
        if not torch.isnan(y[t + j]).any():
            log_weight += model.emission(states[-1], t + j).log_prob(y[t + j])
    log_weight += model.transition(states[-1], t + block + 1).log_prob(end)
    states = torch.stack(states, -2)  # (count, ℓ+1, 2)
    probability = torch.softmax(log_weight, 0)
    effective = 1 / probability.square().sum().item()
    assert effective > 3000

    draws = 4000
    start = states[torch.multinomial(probability, draws, replacement=True)]
    stretch = torch.cat([start, end.expand(draws, 1, 2)], -2).unsqueeze(0)
    accepted = []
    for _ in range(5):
        moved = bridge.move(t, ancestors, weights, stretch)
        accepted.append((moved != stretch[..., :-1, :]).any(-1).any(-1).double().mean().item())
        stretch = torch.cat([moved, stretch[..., -1:, :]], -2)
    assert np.mean(accepted) > 0.3
    assert np.mean(accepted) < 0.99  # bent enough to be a test
    moved = stretch[0, :, :-1]
    for statistic in (lambda x: x, torch.sin, torch.square):
        exact = (probability[:, None, None] * statistic(states)).sum(0)
        scatter = (probability[:, None, None] * (statistic(states) - exact) ** 2).sum(0).sqrt()
        z = (statistic(moved).mean(0) - exact) / (scatter * (1 / draws + 1 / effective) ** 0.5)
        assert z.abs().max() < 4.5
