"""What a sampler of parameters returns, and the same as ``arviz.InferenceData``.

Chains are Markov chains (PMMH) or independent runs (SMC², tempered SMC); runs weigh exp(log_weight), draws within a run
likewise. :func:`to_inference_data` resamples weighted draws, so that ArviZ's summaries of all chains together are those
of the posterior.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from invdyn.inference.execution.distribute import Tensors
from invdyn.inference.execution.seeds import derived, seeded
from invdyn.inference.filters.nested import outer_weights
from invdyn.inference.filters.resampling import ess, resample
from invdyn.inference.parameters.unconstrained import UnconstrainedParameters

if TYPE_CHECKING:
    import arviz as az

RESAMPLING = 7_207_207
"""Place of the random numbers of resampled draws among those of a run."""


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
        statistics: further numbers of the method, by name.
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
    statistics: Mapping[str, float] = field(default_factory=dict)

    @property
    def ess(self) -> float:
        """Number of equally weighted draws that the weights are worth, 1 … C R; chains' autocorrelation aside."""
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
        log_evidence_sd=outer.log_evidence_sd,
        log_evidence_increment=increments,
        paths=joined.get("paths"),
        num_particles=num_particles,
        statistics={"outer_ess": outer.ess},
    )


def to_inference_data(result: ParameterPosterior, observations: Tensor | None = None) -> "az.InferenceData":
    """InferenceData with one variable a parameter, dims chain and draw; "state" [chain, draw, time, state_dim] if kept.

    ``sample_stats`` has log_likelihood [chain, draw] and acceptance_rate [chain]; its attributes have the evidence, the
    largest R-hat, the smallest bulk and tail ESS of any parameter, and the method's statistics. ``observed_data`` has
    the observations (T, O) if they are given.

    Weighted draws are resampled: chains keep their number of draws, and all draws together are the posterior's.
    """
    import arviz as az
    import xarray as xr

    chains, draws = result.log_weights.shape
    index = torch.arange(chains * draws)
    if result.ess < (1 - 1e-9) * chains * draws:
        with seeded(derived(result.seed, RESAMPLING)):
            index = resample(result.log_weights.reshape(1, -1))[0]
            # Systematic resampling sorts by run; a run with more weight would fill more than one chain in a row.
            index = index[torch.randperm(len(index))]

    def picked(values: Tensor) -> np.ndarray:
        return values.flatten(0, 1)[index].unflatten(0, (chains, draws)).numpy()

    def dataset(variables: Mapping[str, Tensor]) -> xr.Dataset:
        arrays = {}
        for name, values in variables.items():
            own = [f"{name}_dim_{k}" for k in range(values.ndim - 2)]
            own = ["time", "state_dim"] if name == "state" else own
            arrays[name] = (["chain", "draw", *own], picked(values))
        return xr.Dataset(arrays, coords={"chain": np.arange(chains), "draw": np.arange(draws)})

    posterior = dataset(result.draws)
    # Before resampling: copies of one draw would count as a chain that stands still.
    raw = xr.Dataset(
        {name: (posterior[name].dims, values.numpy()) for name, values in result.draws.items()}, posterior.coords
    )
    mixing = {"r_hat": az.rhat(raw), "ess_bulk": az.ess(raw, method="bulk"), "ess_tail": az.ess(raw, method="tail")}
    worst = {name: float(np.nanmax(_flat(v)) if name == "r_hat" else np.nanmin(_flat(v))) for name, v in mixing.items()}

    if result.paths is not None:
        posterior = posterior.merge(dataset({"state": result.paths}))
    stats = dataset({"log_likelihood": result.log_likelihood})
    stats["acceptance_rate"] = (["chain"], result.acceptance.numpy())
    if result.log_evidence_increment is not None:
        stats["log_evidence_increment"] = (["time"], result.log_evidence_increment.numpy())
    stats.attrs.update(
        {
            "method": result.method,
            "log_evidence": result.log_evidence,
            "log_evidence_sd": result.log_evidence_sd,
            "weight_ess": result.ess,
            "num_particles": result.num_particles,
            **worst,
            **result.statistics,
        }
    )
    groups: dict[str, Any] = {"posterior": posterior, "sample_stats": stats}
    if observations is not None:
        groups["observed_data"] = xr.Dataset({"y": (["time", "observation_dim"], observations.numpy())})
    return az.InferenceData(**groups)


def _flat(data: Any) -> np.ndarray:
    return np.concatenate([np.atleast_1d(value.values).ravel() for value in data.data_vars.values()])
