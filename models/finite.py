"""Hidden Markov models with finitely many states: the first ones, and those whose answers are sums.

Rabiner (1989), "A tutorial on hidden Markov models and selected applications in speech recognition", section II.

    P(x_0 = k) = π_k,     P(x_t = l | x_{t−1} = k) = A_t[k, l],     y_t ~ emission(x_t, t)

A state is its number 0 … K − 1, written as a floating-point vector of one entry, so that every filter and sampler takes
it as it takes any other state. Exact answers are in :mod:`invdyn.inference.smoothing.forward_backward`.

Shapes: π (K,), A (K, K), or (T, K, K) with A_t for the step into row t (A_0 is not used); states (..., 1).
"""

from abc import ABC
from collections.abc import Sequence
from typing import Any

import torch
from pyro.distributions import Distribution, TorchDistribution
from torch import Tensor
from torch.distributions import constraints

from invdyn.models.shapes import common
from invdyn.models.state_space import StateSpaceModel


class StateNumber(TorchDistribution):
    """Distribution of a state's number, as a floating-point vector of one entry; event shape (1,).

    Args:
        probabilities: (..., K), each row summing to one.
    """

    arg_constraints = {"probabilities": constraints.simplex}  # noqa: RUF012
    has_rsample = False

    def __init__(self, probabilities: Tensor):
        self.probabilities = probabilities
        super().__init__(probabilities.shape[:-1], torch.Size([1]), validate_args=False)

    @property
    def support(self) -> constraints.Constraint:
        """The numbers 0 … K − 1."""
        return constraints.independent(constraints.integer_interval(0, self.probabilities.shape[-1] - 1), 1)

    def expand(self, batch_shape: Sequence[int], _instance: Any = None) -> "StateNumber":
        """The same for more states."""
        return StateNumber(self.probabilities.expand(*batch_shape, self.probabilities.shape[-1]))

    def sample(self, sample_shape: Sequence[int] = ()) -> Tensor:
        """Numbers (..., 1), of the probabilities' type."""
        shape = self._extended_shape(torch.Size(sample_shape))
        flat = self.probabilities.detach().expand(*shape[:-1], -1).reshape(-1, self.probabilities.shape[-1])
        return torch.multinomial(flat, 1).to(flat.dtype).reshape(shape)

    def log_prob(self, value: Tensor) -> Tensor:
        """Log-probability of numbers (..., 1)."""
        batch = common(self.batch_shape, value.shape[:-1])
        log_probabilities = self.probabilities.log().expand(*batch, -1)
        return log_probabilities.gather(-1, value.long().expand(*batch, 1)).squeeze(-1)


class FiniteStateModel(StateSpaceModel, ABC):
    """A hidden Markov model with K states; a subclass writes ``emission(state, t)`` for states (..., 1).

    Parameters are "initial" (K,) and "transition" (K, K) or (T, K, K); a subclass adds those of its emission to
    ``parameters``. Raises ValueError for shapes that do not match, or rows that are no probabilities.
    """

    state_dim = 1

    def __init__(self, initial: Tensor, transition: Tensor, observation_dim: int, num_steps: int):
        size = len(initial)
        shapes = ((size, size), (num_steps, size, size))
        if tuple(transition.shape) not in shapes:
            raise ValueError(
                f"expected a transition matrix of shape {' or '.join(map(str, shapes))}, got "
                f"{tuple(transition.shape)}: give one entry for each pair of states"
            )
        for name, rows in (("initial", initial), ("transition", transition)):
            if bool((rows < 0).any()) or not torch.allclose(rows.sum(-1), torch.ones_like(rows[..., 0])):
                raise ValueError(f"expected {name} probabilities that sum to one along the last dimension, got {rows}")
        super().__init__({"initial": initial, "transition": transition})
        self.observation_dim, self.num_steps = observation_dim, num_steps

    @property
    def num_states(self) -> int:
        """Number of states, K."""
        return self.parameters["initial"].shape[-1]

    def all_states(self) -> Tensor:
        """Every state once, (K, 1)."""
        return torch.arange(self.num_states, dtype=self.dtype, device=self.device).unsqueeze(-1)

    def matrix(self, t: int | Tensor) -> Tensor:
        """A_t (..., K, K) of the step into row t."""
        transition = self.parameters["transition"]
        return transition if transition.ndim == 2 else transition[t]

    def initial(self) -> Distribution:
        """Probabilities π."""
        return StateNumber(self.parameters["initial"])

    def transition(self, state: Tensor, t: int | Tensor) -> Distribution:
        """The row of A_t that belongs to each state."""
        matrix, number = self.matrix(t), state.squeeze(-1).long()
        if matrix.ndim == 2:
            return StateNumber(matrix[number])
        # Rows of a path: each has a matrix of its own.
        rows = number[..., None, None].expand(*number.shape, 1, self.num_states)
        return StateNumber(matrix.expand(*number.shape, -1, -1).gather(-2, rows).squeeze(-2))

    def _constraint(self, name: str) -> constraints.Constraint:
        return constraints.simplex if name in ("initial", "transition") else super()._constraint(name)
