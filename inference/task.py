"""A recording bound to a body, its unknown parameters fitted: what any method then runs on."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import arviz as az
from torch import Tensor

from invdyn.inference.initialise import Problem, arm_problem
from invdyn.inference.marginal_likelihood import Free, fit
from invdyn.inference.marginalise import over_bodies
from invdyn.inference.methods import METHODS, WITHOUT_EVIDENCE, timed
from invdyn.inference.smc import Progress, SMCOptions
from invdyn.models import Body, Learned
from invdyn.recordings import InputError, Recording, Truth


def free_parameters(problem: Problem, given: Sequence[str] = (), learn_lengths: bool = False) -> list[Free]:
    """Parameters to fit when not ``given``: σ_y, the torque process, and what of the body is to be learned.

    Not the dynamics' own noise ε: white noise on a velocity is a white torque by another name, and where it is
    free it takes torque away from τ (on the DFKI arm the evidence likes that, and the error doubles).
    """
    wanted = [
        Free("torque.scale"),
        Free("torque.decay", sd=1.0),
        Free("torque.lengthscale", sd=1.0),
        # One σ_y as in the paper; its ratio between keypoints is that of their misfits at the start.
        Free("emission.keypoint_scale", tied=True),
        Free("emission.confidence_slope", tied=True),
        Free("emission.angle_scale", tied=True),
        Free("emission.df", sd=1.0),
    ]
    body = problem.model.body
    for quantity in ("length", "mass", "com", "inertia"):
        entries = tuple(k for k, link in enumerate(body.links) if isinstance(getattr(link, quantity), Learned))
        if learn_lengths and quantity == "length":
            entries = tuple(range(body.num_joints))
        if entries:
            wanted.append(Free(f"body.{quantity}", sd=0.3, entries=entries))
    return [f for f in wanted if f.name in problem.model.parameters and f.name not in given]


@dataclass(frozen=True)
class Task:
    """A fitted problem, and all that a method needs to run on it.

    Attributes:
        problem: with the fitted parameters.
        path: (T, D) mode, a warm start.
        options: sizes.
        seed: of every random number.
        record: fitted values and choices, kept with the result.
    """

    problem: Problem
    path: Tensor
    options: SMCOptions
    seed: int
    record: dict

    def run(self, method: str, progress: Progress | None = None) -> az.InferenceData:
        """Posterior by ``method``, a key of ``METHODS``; over draws of the body where it is uncertain.

        Raises InputError when the method cannot do with an uncertain body.
        """
        run = METHODS[method]
        if self.problem.model.body.has_priors:
            if method == "nuts":
                raise InputError(
                    "nuts takes the body as known, and this one is uncertain: drop its priors and [uncertainty], "
                    "or use smc"
                )
            if method not in WITHOUT_EVIDENCE:
                run = timed(partial(over_bodies, run))
        return run(
            self.problem,
            options=self.options,
            start=self.path,
            seed=self.seed,
            settings=self.record,
            progress=progress,
        )


def prepare(
    recording: Recording,
    body: Body,
    *,
    options: SMCOptions,
    seed: int,
    settings: Mapping[str, object] | None = None,
    truth: Truth | None = None,
    learn_lengths: bool = False,
    report: Callable[[int, int], None] | None = None,
    **binding: Any,
) -> Task:
    """Bind ``recording`` to ``body`` and fit what is not in ``settings``.

    ``binding`` are further options of :func:`.initialise.arm_problem`; ``report`` is called with (done, total) of
    the fit. Raises InputError when the recording does not fit the body, or for an unknown parameter.
    """
    problem = arm_problem(
        recording,
        body.with_uncertainty(),
        parameters=settings,
        truth=truth,
        learn_lengths=learn_lengths,
        **binding,
    )
    free = free_parameters(problem, tuple(settings or ()), learn_lengths)
    fitted = fit(problem.model, problem.observations, free, progress=report)
    record = {
        "fitted": {f.name: fitted.model.parameters[f.name].tolist() for f in free},
        "fit_converged": fitted.converged,
        "integrator": problem.model.integrator,
        "substeps": problem.model.substeps,
        "family": problem.model.emission_model.family,
        "torque_process": type(problem.model.torque).__name__,
    }
    return Task(replace(problem, model=fitted.model), fitted.path, options, seed, record)
