"""What a sampler of parameters returns.

Chains are Markov chains (PMMH) or independent runs (SMC², tempered SMC); runs weigh exp(log_weight), draws within a run
likewise. :func:`.methods.parameters.learn_parameters` makes InferenceData of it.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import torch
from torch import Tensor

from invdyn.inference.execution.distribute import Tensors
from invdyn.inference.filters.nested import outer_weights
from invdyn.inference.filters.resampling import ess
from invdyn.inference.filters.second_opinion import evidence, scatter_doubt
from invdyn.inference.parameters.unconstrained import UnconstrainedParameters


@dataclass(frozen=True)
class ParameterPosterior:
    """C chains of R draws.

    Attributes:
        method: that made it.
        seed: of all its random numbers.
        draws: by parameter name, (C, R, own shape).
        log_weights: (C, R), normalised over all chains and draws.
        log_likelihood: (C, R) log p(y | θ), or the unbiased estimate that the draw was accepted with.
        acceptance: (C,) share of proposals that were accepted.
        log_evidence, log_evidence_sd: log p(y) with θ integrated out over its prior, nats, and its Monte Carlo
            standard error; NaN where it cannot be had.
        log_evidence_increment: (T,) log p(y_t | y_{0:t−1}); None for a method that takes all rows at once.
        paths: (C, R, T, D), a smoothed trajectory of each draw; None if they were not kept.
        num_particles: of each filter at the end; 0 where the likelihood is another function.
        statistics: further numbers of the method, by name; among them "usable", 1 where the evidence stands, and
            "doubt", why it does not, in a line.
    """

    method: str
    seed: int
    draws: dict[str, Tensor]
    log_weights: Tensor
    log_likelihood: Tensor
    acceptance: Tensor
    log_evidence: float = math.nan
    log_evidence_sd: float = math.nan
    log_evidence_increment: Tensor | None = None
    paths: Tensor | None = None
    num_particles: int = 0
    statistics: Mapping[str, float | str] = field(default_factory=dict)

    @property
    def ess(self) -> float:
        """Number of equally weighted draws that the weights are worth, 1 … C R; without the chains' autocorrelation."""
        return ess(self.log_weights.flatten()).item()

    def mean(self, name: str) -> Tensor:
        """Posterior mean (own shape) of a parameter."""
        return self._average(self.draws[name])

    def sd(self, name: str) -> Tensor:
        """Posterior standard deviation (own shape) of a parameter."""
        return self._average((self.draws[name] - self.mean(name)).square()).sqrt()

    def _average(self, values: Tensor) -> Tensor:
        weights = self.log_weights.exp()
        return (weights.reshape(*weights.shape, *[1] * (values.ndim - 2)) * values).sum((0, 1))


def combine_runs(
    method: str, seed: int, space: UnconstrainedParameters, parts: list[Tensors], num_particles: int = 0
) -> ParameterPosterior:
    """The posterior of independent runs, each with "z", "log_weights", "log_likelihood", "log_evidence", "acceptance".

    Where they have "log_evidence_increment" (T,) and "paths" these are joined too.
    """
    joined = {name: torch.stack([part[name] for part in parts]) for name in parts[0]}
    outer = outer_weights(joined["log_evidence"])
    doubt = scatter_doubt(evidence(outer, method), "run")
    increments = joined.get("log_evidence_increment")
    if increments is not None:
        # Row by row, the runs' estimates weighted by their evidence of the rows before.
        before = torch.cat([increments.new_zeros(len(parts), 1), increments.cumsum(1)], 1).logsumexp(0)
        increments = before.diff()
    return ParameterPosterior(
        method=method,
        seed=seed,
        draws=space.values(joined["z"]),
        log_weights=outer.log_weights.unsqueeze(-1) + joined["log_weights"],
        log_likelihood=joined["log_likelihood"],
        acceptance=joined["acceptance"],
        log_evidence=outer.log_evidence,
        log_evidence_sd=math.nan if doubt else outer.log_evidence_sd,
        log_evidence_increment=increments,
        paths=joined.get("paths"),
        num_particles=num_particles,
        statistics={"outer_ess": outer.ess, "usable": int(not doubt), "doubt": doubt},
    )
