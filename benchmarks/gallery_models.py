"""Seventeen state-space models of the literature, each a small class, for :mod:`gallery`.

Those of one state are in :mod:`gallery_one_state`. ``answer`` says how exact answers are found
(:mod:`gallery_answers`):

    "kalman"    linear-Gaussian, by its ``matrices``
    "grid"      one state on the dense grid ``grid`` = (low, high, points)
    "sum"       finitely many states
    "library"   a bootstrap filter of the library `particles`

Shapes: states (..., D), rows (T, O), NaN where missing.
"""

import torch
from gallery_one_state import (
    F64,
    Bimodal,
    Binary,
    Cox,
    Directions,
    GammaSteps,
    GrowingNoise,
    Growth,
    HeavySteps,
    Leverage,
    Nutria,
    T,
    Volatility,
    number,
)
from pyro.distributions import MultivariateNormal, Normal
from torch import Tensor

from invdyn.models import ConditionallyLinear, FiniteStateModel, StateNumber, StateSpaceModel
from invdyn.models.shapes import apply


# -- linear and Gaussian ---------------------------------------------------------------------------
class Tracking(StateSpaceModel):
    """Position and velocity with a known push u_t, at irregular times; entries and whole rows are missing."""

    answer, state_dim, observation_dim, num_steps = "kalman", 2, 2, T

    def __init__(self):
        super().__init__({"noise": number(0.5)})
        generator = torch.Generator().manual_seed(0)
        step = 0.05 + torch.rand(T, generator=generator, dtype=F64)
        one, zero = torch.ones(T, dtype=F64), torch.zeros(T, dtype=F64)
        self.A = torch.stack([one, step, zero, one], -1).reshape(T, 2, 2)
        push = torch.sin(0.5 * step.cumsum(0))
        self.b = torch.stack([step**2 / 2 * push, step * push], -1)
        # The noise is a Wiener process on the velocity.
        Q = 0.3 * torch.stack([step**3 / 3, step**2 / 2, step**2 / 2, step], -1).reshape(T, 2, 2)
        self.root = torch.linalg.cholesky(Q)

    def initial(self):
        return Normal(torch.zeros(2, dtype=F64), 1.0).to_event(1)

    def transition(self, state, t):
        return MultivariateNormal(apply(self.A[t], state) + self.b[t], scale_tril=self.root[t])

    def emission(self, state, t):
        return Normal(state, self.parameters["noise"]).to_event(1)

    def missing(self, rows):
        rows = rows.clone()
        rows[5:9], rows[::4, 1], rows[2::7, 0] = torch.nan, torch.nan, torch.nan
        return rows

    def matrices(self, t):
        """A, b, Q, C and R of the step into row t."""
        eye = torch.eye(2, dtype=F64)
        return self.A[t], self.b[t], self.root[t] @ self.root[t].mT, eye, self.parameters["noise"] ** 2 * eye


class SecondOrder(StateSpaceModel):
    """AR(2) as a pair (z_t, z_{t−1}): the second state has no noise, and the transition no density."""

    answer, state_dim, observation_dim, num_steps = "kalman", 2, 1, T

    def __init__(self):
        super().__init__({"coefficients": number([1.2, -0.5]), "noise": number(0.5)})

    def initial(self):
        return Normal(torch.zeros(2, dtype=F64), 1.0).to_event(1)

    def transition(self, state, t):
        latest = (state * self.parameters["coefficients"]).sum(-1)
        scale = number([0.6, 0.0])
        return Normal(torch.stack([latest, state[..., 0]], -1), scale, validate_args=False).to_event(1)

    def emission(self, state, t):
        return Normal(state[..., :1], self.parameters["noise"]).to_event(1)

    def matrices(self, t):
        """A, b, Q, C and R of the step into row t."""
        A = torch.stack([self.parameters["coefficients"], number([1.0, 0.0])])
        return A, number([0.0, 0.0]), number([[0.36, 0], [0, 0]]), number([[1.0, 0.0]]), number([[0.25]])


# -- several states ----------------------------------------------------------------------------------
class Lorenz96(StateSpaceModel):
    """Lorenz (1996): eight places on a ring, forced by 8, each seen with noise; Runge–Kutta steps of .05."""

    answer, state_dim, observation_dim, num_steps = "library", 8, 8, 30

    def __init__(self):
        super().__init__({"sd": number(0.5)})

    def initial(self):
        return Normal(torch.full((8,), 2.0, dtype=self.dtype), 1.0).to_event(1)

    def transition(self, state, t):
        def slope(x):
            return (x.roll(-1, -1) - x.roll(2, -1)) * x.roll(1, -1) - x + 8.0

        h = 0.05
        a = slope(state)
        b = slope(state + h / 2 * a)
        c = slope(state + h / 2 * b)
        d = slope(state + h * c)
        return Normal(state + h / 6 * (a + 2 * b + 2 * c + d), self.parameters["sd"]).to_event(1)

    def emission(self, state, t):
        return Normal(state, 1.0).to_event(1)


class Bearings(StateSpaceModel):
    """Gordon, Salmond & Smith (1993): a ship that passes, of which one observer sees the bearing alone."""

    answer, state_dim, observation_dim, num_steps = "library", 4, 1, 30

    def __init__(self):
        super().__init__({"noise": number(0.03)})

    def initial(self):
        return Normal(number([-3.0, 5.0, 0.3, -0.05]), number([0.5, 0.5, 0.05, 0.05])).to_event(1)

    def transition(self, state, t):
        x, y, v, w = state.unbind(-1)
        mean = torch.stack([x + v, y + w, v, w], -1)
        return Normal(mean, number([0.02, 0.02, 0.03, 0.03])).to_event(1)

    def emission(self, state, t):
        return Normal(torch.atan2(state[..., 1:2], state[..., :1]), self.parameters["noise"]).to_event(1)


class Levels(FiniteStateModel):
    """Three hidden states, each of which has a level that is seen with noise."""

    answer = "sum"

    def __init__(self):
        stay = 0.85 * torch.eye(3, dtype=F64) + 0.05 * torch.ones(3, 3, dtype=F64)
        super().__init__(number([0.5, 0.2, 0.3]), stay, observation_dim=1, num_steps=T)
        self.parameters["level"] = number([[-1.0], [0.3], [1.5]])

    def emission(self, state, t):
        return Normal(self.parameters["level"][state.squeeze(-1).long()], 0.8).to_event(1)


class Switching(ConditionallyLinear):
    """An autoregression that switches between a calm and a lively regime; state (regime, x)."""

    answer, outer_dim, inner_dim, observation_dim, num_steps = "library", 1, 1, 1, T

    def __init__(self):
        super().__init__({"A": number([0.95, 0.5]), "sd": number([0.2, 1.2])})

    def outer_initial(self):
        return StateNumber(number([0.5, 0.5]))

    def outer_transition(self, outer, t):
        return StateNumber(number([[0.9, 0.1], [0.2, 0.8]])[outer.squeeze(-1).long()])

    def inner_initial(self, outer):
        return number([0.0]), number([[1.0]])

    def inner_transition(self, outer, t):
        A, sd = (self.parameters[name][outer.squeeze(-1).long()][..., None, None] for name in ("A", "sd"))
        return A, number([0.0]), sd**2

    def inner_emission(self, outer, t):
        return number([[1.0]]), number([0.0]), number([[0.16]])


MODELS: dict[str, type[StateSpaceModel]] = {
    "linear, inputs, gaps": Tracking,
    "volatility": Volatility,
    "leverage": Leverage,
    "growth": Growth,
    "Lorenz-96": Lorenz96,
    "bearings-only": Bearings,
    "nutria": Nutria,
    "Cox": Cox,
    "finite HMM": Levels,
    "switching linear": Switching,
    "AR(2) pair": SecondOrder,
    "Gamma steps": GammaSteps,
    "Student-t steps": HeavySteps,
    "Bernoulli": Binary,
    "von Mises": Directions,
    "growing noise": GrowingNoise,
    "bimodal": Bimodal,
}


def recording(name: str, seed: int = 1) -> tuple[StateSpaceModel, Tensor, Tensor]:
    """A model, its true states (T, D), and rows (T, O) that it simulates, NaN where missing."""
    model = MODELS[name]()
    states, rows = model.simulate(seed=seed)
    return model, states, model.missing(rows) if hasattr(model, "missing") else rows
