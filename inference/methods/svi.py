"""Stochastic variational inference: a guide of whole paths (:mod:`.path_guides`), its bound, and the ascent of it.

bound = E_q[log p(x_{0:T}, y) − log q(x_{0:T})] ≤ log p(y),        reparametrised gradients
"""

from collections.abc import Callable

import arviz as az
import pyro
import torch
from pyro.distributions import ImproperUniform
from pyro.infer import Trace_ELBO
from torch import Tensor
from torch.distributions import constraints

from invdyn.inference.execution.progress import Progress
from invdyn.inference.execution.seeds import seeded
from invdyn.inference.filters.best_guide import second_opinion
from invdyn.inference.filters.filtering import SMCOptions
from invdyn.inference.filters.second_opinion import bound_doubt
from invdyn.inference.posterior.posterior import to_inference_data
from invdyn.inference.posterior.problem import StateSpaceProblem
from invdyn.inference.smoothing.linearised import gaussian_smoother
from invdyn.inference.variational.path_guides import Markov, MeanField, PathGuide
from invdyn.models import StateSpaceModel

GUIDES = {"svi": MeanField, "svi-markov": Markov}


def svi(
    problem: StateSpaceProblem,
    *,
    guide: str = "svi",
    options: SMCOptions | None = None,
    start: Tensor | None = None,
    seed: int = 0,
    settings: dict | None = None,
    progress: Progress | None = None,
    max_steps: int = 3000,
) -> az.InferenceData:
    """Variational posterior and its bound on the evidence.

    Args are those of :func:`.smc.smc`, and:
        guide: a key of ``GUIDES``: "svi" (mean field) or "svi-markov".
        options: num_filters × num_draws are the chains × draws of the result; all draws are independent.
        max_steps: gradient steps at most.
    """
    options = options or SMCOptions()
    model, observations = problem.model.to(dtype=torch.float64), problem.observations.double()
    smoother = gaussian_smoother(model, observations, start)
    with seeded(seed):
        fitted = GUIDES[guide](smoother)
        steps, converged = maximise(fitted, path_model(model, observations), max_steps=max_steps, progress=progress)
        value, error = bound(fitted, model, observations)
        with torch.no_grad():
            paths = fitted.distribution().sample((options.num_filters, options.num_draws))
        pilot = second_opinion(model, observations, options, seed, start)
        doubt = bound_doubt(value, paths[0, 0].numel(), pilot)
        return to_inference_data(
            problem,
            paths,
            method=guide,
            seed=seed,
            settings=settings or {},
            log_evidence=value,
            log_evidence_sd=error,
            bound=True,
            diagnostics={
                "steps": steps,
                "converged": int(converged),
                "usable": int(not doubt),
                "doubt": doubt,
            },
        )


def path_model(model: StateSpaceModel, observations: Tensor) -> Callable[[], None]:
    """The Pyro model of ``model.sequence`` with the path (…, T, D) as one site, "path": for ``PathGuide()``."""
    shape = (len(observations), model.state_dim)

    def path_and_data() -> None:
        path = pyro.sample("path", ImproperUniform(constraints.real, (), shape))
        pyro.factor("log_joint", model.log_joint(path, observations))

    return path_and_data


def maximise(
    guide: PathGuide,
    target: Callable[[], None],
    *,
    num_particles: int = 16,
    learning_rate: float = 0.03,
    max_steps: int = 3000,
    window: int = 100,
    max_cuts: int = 4,
    progress: Progress | None = None,
) -> tuple[int, bool]:
    """Ascend the bound by Adam; returns steps taken, and whether it converged.

    When the average bound of a ``window`` of steps is not above the one before by more than its own Monte
    Carlo error, the learning rate is cut to a quarter; after ``max_cuts`` cuts, where its noise in thousands of
    parameters is worth a fraction of a nat, the ascent has converged.
    """
    elbo = Trace_ELBO(num_particles=num_particles, vectorize_particles=num_particles > 1, max_plate_nesting=0)
    adam = torch.optim.Adam(guide.parameters(), lr=learning_rate, betas=(0.9, 0.99))
    best, cuts, bounds = -torch.inf, 0, []
    for step in range(1, max_steps + 1):
        adam.zero_grad()
        loss = elbo.differentiable_loss(target, guide)
        loss.backward()
        adam.step()
        bounds.append(-loss.detach())
        if progress is not None:
            progress(step, max_steps, "svi")
        if step % window == 0:
            recent = torch.stack(bounds[-window:])
            average, error = recent.mean().item(), recent.std().item() / window**0.5
            if average < best + error:
                cuts += 1
                adam.param_groups[0]["lr"] /= 4
            best = max(best, average)
            if cuts == max_cuts:
                return step, True
    return max_steps, False


@torch.no_grad()
def bound(guide: PathGuide, model: StateSpaceModel, observations: Tensor, num_draws: int = 2000) -> tuple[float, float]:
    """Bound of a guide, nats, and its Monte Carlo standard error."""
    whole, values = guide.distribution(), []
    for _ in range(10):  # a tenth at a time: in little memory
        paths = whole.sample((num_draws // 10,))
        values.append(model.log_joint(paths, observations) - whole.log_prob(paths))
    every = torch.cat(values)
    return every.mean().item(), every.std().item() / len(every) ** 0.5
