"""What every stage of :func:`.variational_smc.vsmc` shares: its start, the training of its guide, its filters."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace

import arviz as az
import pyro
import torch
from pyro.infer import SVI
from pyro.optim import ClippedAdam
from torch import Tensor

from invdyn.inference.execution.checkpoint import Checkpoint
from invdyn.inference.execution.progress import Report
from invdyn.inference.execution.seeds import seeded
from invdyn.inference.filters.backward_simulation import backward_simulation
from invdyn.inference.filters.best_guide import second_opinion
from invdyn.inference.filters.filtering import SMCOptions, filters_of, in_type, sufficient_dtype
from invdyn.inference.filters.particles import FilterResult
from invdyn.inference.filters.second_opinion import Evidence, evidence
from invdyn.inference.fitting.log_parameters import Free
from invdyn.inference.posterior.posterior import to_inference_data
from invdyn.inference.posterior.problem import StateSpaceProblem
from invdyn.inference.smoothing.linearised import gaussian_smoother
from invdyn.inference.variational.affine import Corrected
from invdyn.inference.variational.training import train
from invdyn.inference.variational.vsmc import VSMC_ELBO
from invdyn.models import StateSpaceModel

MIN_GAIN = 0.01
"""Nats that training must gain to be kept."""
PILOTS = 32
"""Filters of a pilot run."""
CHUNK = 500
"""Rows whose graph is in memory at once, of longer recordings."""


class Learner(ABC):
    """What the stages of :func:`vsmc` share: the problem, its start, its guide and the model that it is trained for."""

    guide: Corrected
    target: StateSpaceModel

    def __init__(self, problem: StateSpaceProblem, options: SMCOptions, model: StateSpaceModel, start: Tensor | None):
        self.problem, self.options, self.start = problem, options, start
        self.observations = problem.observations.double()
        self.smoother = gaussian_smoother(model, self.observations, start)
        precise = options.dtype or sufficient_dtype(self.smoother)
        self.model = in_type(model, self.observations, options, precise)
        self.dtype = self.model.dtype
        self.rows = self.observations.to(dtype=self.dtype, device=options.device)

    @abstractmethod
    def posterior(
        self, seed: int, settings: dict, report: Report | None, smoothing: Report | None
    ) -> tuple[az.InferenceData, list[dict]]:
        """What the trained filters find; and what of the parameters is not identified."""

    @abstractmethod
    def bound(self, count: int) -> Tensor:
        """Log of the weights' numerator over denominator, (M,), of ``count`` filters."""

    def train(self, steps: int, learning_rate: float, report: Report | None, checkpoint: Checkpoint | None) -> float:
        """Ascend the bound; the parameters stay in Pyro's store. Returns the gain; 0 where it was undone."""
        if steps == 0:
            return 0.0
        slow = {"lr": learning_rate / 10, "lrd": 0.1 ** (1 / steps), "clip_norm": 100.0}
        fast = {**slow, "lr": learning_rate}
        own = (f"{self.guide.name}.loc", f"{self.guide.name}.root")
        chunk = CHUNK if len(self.rows) > 2 * CHUNK else None
        particles = min(self.options.num_particles, 50)
        # The guide looks ahead and leaves little to resample: what is dropped is small, and the gradient is steady.
        loss = VSMC_ELBO(
            particles, num_filters=4, ess_threshold=self.options.ess_threshold, gradient="dropped", chunk=chunk
        )
        svi = SVI(self.target, self.guide, ClippedAdam(lambda name: fast if name in own else slow), loss=loss)
        seed = int(torch.randint(2**31, ()))
        before = self._pilot(seed)
        train(svi, steps, self.rows, checkpoint=checkpoint, report=report)
        gain = self._pilot(seed) - before
        if not gain > MIN_GAIN:
            pyro.clear_param_store()  # all of them begin at the start
            return 0.0
        return gain

    @torch.no_grad()
    def _pilot(self, seed: int) -> float:
        """The bound, by filters whose random numbers are the same before and after training."""
        with seeded(seed, self.options.device):
            return self.bound(PILOTS).mean().item()

    def _filters(self, model: StateSpaceModel, guide: Corrected, count: int, report: Report | None) -> FilterResult:
        filters = filters_of(model, guide, replace(self.options, num_filters=count))
        return filters.run(self.rows, progress=report).cpu()

    def pilot(self, seed: int) -> Evidence | None:
        """Evidence of a bootstrap filter of the model; None where it collapses, or the start is known to be good."""
        return second_opinion(self.model, self.observations, self.options, seed, self.start)

    def settings(self, given: dict) -> dict:
        """What is recorded."""
        names = ("num_filters", "num_particles", "resampling")
        return {**given, **{name: getattr(self.options, name) for name in names}}


class AtParameters(Learner):
    """Parameters as they are: only the guide is learned."""

    def __init__(
        self,
        problem: StateSpaceProblem,
        free: Sequence[Free],
        options: SMCOptions,
        start: Tensor | None,
        report: Report | None,
    ):
        super().__init__(problem, options, problem.model.to(dtype=torch.float64), start)
        self.guide, self.target = Corrected(self.model, self.rows, self.smoother), self.model

    def bound(self, count: int) -> Tensor:
        """The filters' evidence."""
        return self._trained(count, None).log_evidence

    def _trained(self, count: int, report: Report | None) -> FilterResult:
        return self._filters(self.model, self.guide.sampled(self.model), count, report)

    def posterior(
        self, seed: int, settings: dict, report: Report | None, smoothing: Report | None
    ) -> tuple[az.InferenceData, list[dict]]:
        """Filters with the trained guide, smoothed."""
        result = self._trained(self.options.num_filters, report)
        paths = backward_simulation(
            self.model,
            result,
            self.rows,
            self.options.num_draws,
            smoother=self.smoother,
            progress=smoothing,
        )
        found = evidence(result.log_evidence, "vsmc", self.pilot(seed))
        own = self.settings(settings)
        doubts: dict[str, float | str] = {"usable": int(found.usable), "doubt": found.reason}
        doubts["contradicted"] = found.contradicted
        return to_inference_data(
            self.problem, paths, result, method="vsmc", seed=seed, settings=own, diagnostics=doubts
        ), []
