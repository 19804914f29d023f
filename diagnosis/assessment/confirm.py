"""Confirmation by SMC: the evidence of a cause without linearising, its parameters integrated out.

The nested sampler of this project (Biderman et al. 2020, §3) over parameters too, as importance sampling squared (Tran,
Scharth, Pitt & Kohn 2013): filter m gets its own parameters φ_m ~ q, Student's t around the refined estimate, a guide
linearised about its own path, and the outer weight

    W_m = Ẑ_m p(φ_m) / q(φ_m),        log p(y) ≈ log (1/M) Σ W_m,

which is unbiased for any q, any guide and any fixed M; that a second run joins where the first one's standard
error is large leaves it a little low. Noise scale, residual and parameters that were searched (:mod:`.noise`) stand at
their estimates; what integrating over the residual's size and over those adds is taken from the refinement, and so is
what a memory of the observations' errors is worth.

Shapes: M filters, N particles, T rows, p unknowns.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import arviz as az
import numpy as np
import torch
from pyro.infer.smcfilter import SMCFailed
from torch import Tensor

from invdyn.diagnosis.kept_units import kept_unit
from invdyn.diagnosis.problem.cause import FittedHypothesis, best_size
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.problem.unknowns import unknowns
from invdyn.diagnosis.side_by_side import side_by_side
from invdyn.inference.execution.seeds import derived, seeded
from invdyn.inference.filters.backward_simulation import genealogy
from invdyn.inference.filters.block_filter import BLOCK, BlockFilter
from invdyn.inference.filters.nested import outer_weights
from invdyn.inference.filters.particles import FilterResult, joined
from invdyn.inference.posterior.posterior import to_inference_data
from invdyn.inference.smoothing.gauss_newton import gauss_newton
from invdyn.inference.smoothing.gaussian_chain import GaussianChain
from invdyn.inference.smoothing.linearisation import slopes_along
from invdyn.models import ArmModel
from invdyn.models.divergence import Diverged, diverging


@dataclass(frozen=True)
class Confirmed:
    """What SMC says of a cause.

    Attributes:
        log_evidence, log_evidence_sd: with Monte Carlo standard error; comparable with
            :attr:`.FittedHypothesis.log_evidence`.
        values: (M, p) parameters.
        result: of the filters, evidences weighted by how their parameters were drawn; None where they died.
    """

    log_evidence: float
    log_evidence_sd: float
    values: np.ndarray
    result: FilterResult | None = None


def confirm_all(
    problem: DiagnosisProblem, causes: Sequence[FittedHypothesis], seed: int = 0, temper: float = 1.0, workers: int = 1
) -> list[Confirmed]:
    """Confirm each cause, a second time those whose evidence, raised to the power ``temper``, is not clear by then.

    One cause has none to be weighed against; and if filters of one of several died, or one filter speaks for all,
    evidence by SMC cannot weigh them: that is all then.
    """
    runs = side_by_side([partial(confirm, problem, cause, derived(seed, 0)) for cause in causes], workers)
    rules = problem.rules.evidence
    if len(runs) < 2 or any(not run.log_evidence_sd < rules.max_filter_se for run in runs):
        return runs
    clear = min(rules.clear_se / temper, rules.max_smc_se)
    unclear = [i for i, run in enumerate(runs) if run.log_evidence_sd >= clear]
    again = [partial(confirm, problem, causes[i], derived(seed, 1), before=runs[i]) for i in unclear]
    both = dict(zip(unclear, side_by_side(again, workers), strict=True))
    return [both.get(i, run) for i, run in enumerate(runs)]


def confirm(
    problem: DiagnosisProblem,
    cause: FittedHypothesis,
    seed: int = 0,
    filters: int | None = None,
    before: Confirmed | None = None,
) -> Confirmed:
    """Run so many filters of `num_particles` particles under the cause, and weigh them with those of a run ``before``.

    Where a filter dies, because parameters that may be let the simulation run away, or data that no noise explains,
    there is no evidence (−∞, and NaN as its error) and no result.
    """
    filters = filters or problem.rules.outcome.num_filters
    run = _run(problem, cause, seed, filters)
    if run is None:
        return Confirmed(-math.inf, math.nan, np.tile(cause.mean, (filters, 1)))
    values, result = run
    if before is not None and before.result is not None:
        values, result = torch.cat([torch.as_tensor(before.values), values]), joined([before.result, result])
    outer, top = outer_weights(result.log_evidence), int(cause.by_size.argmax())
    rest = cause.log_evidence - cause.by_size[top] + problem.regime.log_prior[top]
    rest += sum(cause.noise_log.values()) + cause.of_memory
    return Confirmed(outer.log_evidence + float(rest), outer.log_evidence_sd, values.numpy(), result)


@kept_unit("confirm", FilterResult)
def _run(
    problem: DiagnosisProblem, cause: FittedHypothesis, seed: int, filters: int
) -> tuple[Tensor, FilterResult] | None:
    """Parameters (M, p) of the filters, and what they found, weighted; None where one has died."""
    values, log_ratio = _draw(problem, cause, filters, seed)
    try:
        with diverging():
            result = filtered_under(problem, cause, values, best_size(problem, cause), seed)
    except (SMCFailed, Diverged):
        return None
    return values, replace(result, log_evidence=result.log_evidence + log_ratio)


def filtered_under(
    problem: DiagnosisProblem, cause: FittedHypothesis, values: Tensor, size: float, seed: int
) -> FilterResult:
    """One filter for each set of parameters (M, p), under a residual of ``size``."""
    among = unknowns(problem, cause.effects)
    model = among.set_in(cause.model, values.numpy()) if among.names else cause.model
    model = scaled(problem, model, size, cause.kappa)
    start = cause.path.expand(len(values), *cause.path.shape)
    # Their guides differ in where they lead, and next to nothing in how: one set's slopes do for all.
    slopes = slopes_along(scaled(problem, cause.model, size, cause.kappa), cause.path)
    smoothers = gauss_newton(model, problem.observations, start=start, max_iterations=3, tolerance=0.1, slopes=slopes)
    # No linearised dynamics show where a gap's state goes.
    block = BLOCK if model.contact_states is None else 1
    with seeded(seed):
        return BlockFilter(model, smoothers, problem.rules.outcome.num_particles, block=block).run(problem.observations)


def scaled(problem: DiagnosisProblem, model: ArmModel, size: float, kappa: float) -> ArmModel:
    """``model`` with a residual of ``size`` and all noise ``kappa`` times as large."""
    quiet = problem.with_residual(size * kappa, model)
    names = ("emission.keypoint_scale", "emission.angle_scale", "noise.angle", "noise.velocity")
    return quiet.replace(**{n: kappa * quiet.parameters[n] for n in names if n in quiet.parameters})


def _draw(problem: DiagnosisProblem, cause: FittedHypothesis, count: int, seed: int) -> tuple[Tensor, Tensor]:
    """Parameters (M, p), antithetic in pairs, and log p(φ)/q(φ) (M,)."""
    among = unknowns(problem, cause.effects)
    p = len(among.names)
    if not p:
        return torch.zeros(count, 0, dtype=torch.float64), torch.zeros(count, dtype=torch.float64)
    # In units of their own standard deviations: parameters differ by orders of magnitude.
    sd = np.maximum(cause.sd, 1e-6 * among.sd)
    shape, df = cause.covariance / np.outer(sd, sd) + 1e-8 * np.eye(p), problem.rules.outcome.proposal_degrees
    from scipy.stats import multivariate_t  # half a second to import, which most runs do not need

    q = multivariate_t(np.zeros(p), shape, df=df)
    half = q.rvs(math.ceil(count / 2), random_state=np.random.default_rng(seed)).reshape(-1, p)
    values = cause.mean + sd * np.concatenate([half, -half])[:count]
    inside = ((values > among.lower) & (values < among.upper)).all(-1)
    # Outside its prior's support a draw weighs nothing; its filter runs at the mean, or just inside a bound.
    mean = np.clip(cause.mean, among.lower + 1e-6 * among.sd, among.upper - 1e-6 * among.sd)
    values = np.where(inside[:, None], values, mean)
    log_q = q.logpdf((values - cause.mean) / sd).reshape(-1) - np.log(sd).sum()
    ratio = among.log_prior(torch.as_tensor(values)) - torch.as_tensor(log_q)
    return torch.as_tensor(values), torch.where(torch.as_tensor(inside), ratio, -torch.inf)


def posterior(problem: DiagnosisProblem, cause: FittedHypothesis, confirmed: Confirmed, seed: int) -> az.InferenceData:
    """Posterior of torques, angles and effect parameters under a cause, one chain a filter.

    Where filters died, it is that of the model linearised along the cause's path, at the estimates.
    """
    with seeded(seed), torch.no_grad():
        # One model for all chains' predictions: the parameters differ by less than the paths know.
        at_mean = scaled(problem, cause.model, best_size(problem, cause), cause.kappa)
        if confirmed.result is None:
            smoother = gauss_newton(at_mean, problem.observations, start=cause.path, max_iterations=3)
            paths = GaussianChain.of(smoother).sample((len(confirmed.values), problem.rules.outcome.paths_per_filter))
        else:
            paths = genealogy(confirmed.result, problem.rules.outcome.paths_per_filter)
        values = dict(zip(unknowns(problem, cause.effects).names, torch.as_tensor(confirmed.values).T, strict=True))
        values |= {name: torch.full((len(paths),), value) for name, value in cause.noise.items()}
        return to_inference_data(
            replace(problem.problem, model=at_mean),
            paths,
            confirmed.result,
            method="diagnosis",
            seed=seed,
            settings={"cause": cause.key, "regime": problem.regime.name},
            parameters={f"effect.{name}": each[:, None].expand(paths.shape[:2]) for name, each in values.items()},
        )
