"""Exact inference in a model with finitely many states: forward–backward and Viterbi's algorithm.

Rabiner (1989), "A tutorial on hidden Markov models and selected applications in speech recognition", sections III.A and
III.B, in logarithms. With g_t(k) = p(y_t | x_t = k), or g_t(k, l) where the emission sees x_{t−1} too,

    α_t(l) = g_t(l) Σ_k α_{t−1}(k) A_t[k, l],     p(y) = Σ_k α_{T−1}(k),
    β_{t−1}(k) = Σ_l A_t[k, l] g_t(l) β_t(l),     P(x_t = k | y) ∝ α_t(k) β_t(k),
    P(x_{t−1} = k, x_t = l | y) ∝ α_{t−1}(k) A_t[k, l] g_t(l) β_t(l),
    δ_t(l) = g_t(l) max_k δ_{t−1}(k) A_t[k, l]    (the most probable path).

α is normalised at each row, so that log p(y) is a sum of increments. Paths are drawn backwards from
P(x_t = k | x_{t+1} = l, y_{0:t}) ∝ α_t(k) A_{t+1}[k, l]. The cost is T K² operations.

Shapes: observations (T, O), NaN where missing; probabilities (T, K); paths (R, T, 1), of the states' numbers.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from invdyn.inference.contract import check_model
from invdyn.inference.execution.seeds import seeded
from invdyn.models.finite import FiniteStateModel
from invdyn.models.observation.missing import observed_log_prob


@dataclass(frozen=True)
class ForwardBackward:
    """Result of :func:`forward_backward`; all in float64.

    Attributes:
        log_evidence: () log p(y).
        log_evidence_increment: (T,) log p(y_t | y_{0:t}).
        log_filtered: (T, K) log P(x_t = k | y_{0:t+1}), with row t's observation.
        log_smoothed: (T, K) log P(x_t = k | y).
        log_pairs: (T − 1, K, K) log P(x_{t−1} = k, x_t = l | y).
        log_steps: (T − 1, K, K) log p(x_t = l, y_t | x_{t−1} = k) of rows 1 … T − 1.
    """

    log_evidence: Tensor
    log_evidence_increment: Tensor
    log_filtered: Tensor
    log_smoothed: Tensor
    log_pairs: Tensor
    log_steps: Tensor

    @property
    def smoothed(self) -> Tensor:
        """P(x_t = k | y), (T, K)."""
        return self.log_smoothed.exp()

    def sample(self, num_draws: int, *, seed: int) -> Tensor:
        """Independent paths (R, T, 1) from p(x_{0:T} | y)."""
        with seeded(seed):
            index = torch.multinomial(self.log_filtered[-1].exp(), num_draws, replacement=True)
            path = [index]
            for filtered, log_step in zip(self.log_filtered[:-1].flip(0), self.log_steps.flip(0), strict=True):
                # P(x_t = k | x_{t+1} = l), a row for each l: draws of equal l share it.
                backward = (filtered + log_step.T).softmax(-1).nan_to_num()
                index = torch.multinomial(backward[index], 1).squeeze(-1)
                path.append(index)
        return torch.stack(path[::-1], -1).unsqueeze(-1).double()


@torch.no_grad()
def forward_backward(model: FiniteStateModel, observations: Tensor) -> ForwardBackward:
    """Evidence and smoothed probabilities of ``observations`` (T, O).

    Raises ModelError for a model that does not fit the observations, and ValueError, naming the row, where no state
    can have produced an observation.
    """
    first, log_steps = _logarithms(model, check_model(model, observations))

    log_filtered: list[Tensor] = []
    increments: list[Tensor] = []
    joint = first
    for t in range(len(observations)):
        if t > 0:
            joint = (log_filtered[-1].unsqueeze(-1) + log_steps[t - 1]).logsumexp(-2)
        increments.append(joint.logsumexp(-1))
        if not bool(torch.isfinite(increments[-1])):
            raise ValueError(
                f"expected a row that some state can produce, got row {t} of probability zero: widen the emission"
            )
        log_filtered.append(joint - increments[-1])

    log_beta = [torch.zeros_like(first)]
    for log_step, increment in zip(log_steps.flip(0), increments[:0:-1], strict=True):
        # Scaled by the same increments as α, β stays near one.
        log_beta.append((log_step + log_beta[-1]).logsumexp(-1) - increment)
    filtered, beta, increment = torch.stack(log_filtered), torch.stack(log_beta[::-1]), torch.stack(increments)

    onward = (beta - increment.unsqueeze(-1))[1:]
    return ForwardBackward(
        log_evidence=increment.sum(),
        log_evidence_increment=increment,
        log_filtered=filtered,
        log_smoothed=filtered + beta,
        log_pairs=filtered[:-1].unsqueeze(-1) + log_steps + onward.unsqueeze(-2),
        log_steps=log_steps,
    )


@torch.no_grad()
def viterbi(model: FiniteStateModel, observations: Tensor) -> tuple[Tensor, Tensor]:
    """The most probable path (T, 1) given ``observations`` (T, O), and its log p(x, y), shape ().

    Raises ModelError for a model that does not fit the observations.
    """
    best, log_steps = _logarithms(model, check_model(model, observations))
    parents = []
    for log_step in log_steps:
        best, parent = (best.unsqueeze(-1) + log_step).max(-2)
        parents.append(parent)

    log_joint, number = best.max(-1)
    path = [number]
    for parent in reversed(parents):
        path.append(parent[path[-1]])
    return torch.stack(path[::-1]).unsqueeze(-1).double(), log_joint


def _logarithms(model: FiniteStateModel, observations: Tensor) -> tuple[Tensor, Tensor]:
    """Log π(k) g_0(k), (K,), and log A_t[k, l] g_t(l) of rows t = 1 … T − 1, (T − 1, K, K), in float64."""
    model, observations = model.to(dtype=torch.float64), observations.double()
    states, size = model.all_states(), model.num_states
    initial = model.parameters["initial"].log() + _log_emission(model, None, states, observations[0], 0)
    log_steps = [
        model.matrix(t).log() + _log_emission(model, states.unsqueeze(-2), states, y, t)
        for t, y in enumerate(observations[1:], 1)
    ]
    return initial, torch.stack(log_steps) if log_steps else initial.new_empty(0, size, size)


def _log_emission(model: FiniteStateModel, previous: Tensor | None, states: Tensor, y: Tensor, t: int) -> Tensor:
    """Log p(y_t | x_t) of all states, (K,), or (K, K) where it depends on x_{t−1} too; zero where nothing was seen."""
    if bool(y.isnan().all()):
        return states.new_zeros(len(states))
    return observed_log_prob(model.row_emission(previous, states, t), y)
