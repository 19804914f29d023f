"""Many filters of one model, guided and smoothed, on any Pyro state-space model.

The guide looks ahead (:mod:`.controlled`); what it steers by is refitted on pilot runs (:mod:`.iterated`). Filters come
in tasks, each a batch with a seed of its own, so that results do not depend on how many workers share them.

Shapes: M filters, N particles each, R smoothed trajectories of each; observations (T, O), paths (M, R, T, D).
"""

from dataclasses import dataclass, replace

import torch

from invdyn.inference.contract import ModelError, check_model
from invdyn.inference.execution.distribute import Tensors
from invdyn.inference.execution.progress import Report
from invdyn.inference.execution.seeds import seeded
from invdyn.inference.filters.backward_simulation import backward_simulation, genealogy
from invdyn.inference.filters.bootstrap import Bootstrap
from invdyn.inference.filters.defended import Defended, look_ahead
from invdyn.inference.filters.iterated import iterate, refitted_over_paths
from invdyn.inference.filters.moment_matching import moment_matched
from invdyn.inference.filters.particle_filter import ParticleFilter
from invdyn.inference.filters.particles import FilterResult
from invdyn.inference.filters.proposal import Proposal
from invdyn.inference.smoothing.gauss_newton import GaussianSmoother
from invdyn.inference.smoothing.linearised import linearised
from invdyn.models import StateSpaceModel
from invdyn.recordings import InputError

SMOOTHING = ("backward", "genealogy")

PILOT_PARTICLE_STEPS = 4e6
"""Particles × rows that the pilot runs of a refit keep, at most."""


@dataclass(frozen=True)
class SMCOptions:
    """M filters, N particles each, R smoothed trajectories of each.

    The controlled guide is refitted ``refits`` times on pilot runs; 0 takes the linearised model's
    factors as they are. ``dtype`` None means float32 particles where that is precise enough
    (:func:`sufficient_dtype`) and the model has no constants in float64, else float64.

    ``filters_per_task`` filters are one batch with a seed of its own; a worker takes one batch at a time. Results
    depend on this number, and not on how many workers there are. Small batches keep more workers busy; large ones
    need less time a filter (measured: batches of 16 take a quarter longer than 32 with 100 particles each, 6 % with
    1,000). None means 32, and on a GPU all of them.

    Trajectories are drawn by ``smoothing`` "backward", which needs a transition density, or "genealogy", which
    follows ancestors and needs none (:mod:`.backward_simulation`).
    """

    num_filters: int = 64
    num_particles: int = 100
    num_draws: int = 4
    refits: int = 2
    ess_threshold: float = 0.5
    resampling: str = "systematic"
    dtype: torch.dtype | None = None
    device: str = "cpu"
    filters_per_task: int | None = None
    smoothing: str = "backward"

    @property
    def at_once(self) -> int:
        """Number of filters in a task, but for the rest in the last one."""
        return min(self.num_filters, self.filters_per_task or (32 if self.device == "cpu" else self.num_filters))

    def tasks(self) -> list[int]:
        """Number of filters in each task, the last one's being the rest."""
        whole, rest = divmod(self.num_filters, self.at_once)
        return [self.at_once] * whole + [rest] * (rest > 0)

    def check(self) -> None:
        """Raise InputError for a device that torch does not have here, tasks of no filters, an unknown smoothing."""
        if self.smoothing not in SMOOTHING:
            raise InputError(f"expected a smoothing among {', '.join(SMOOTHING)}, got {self.smoothing!r}")
        if self.filters_per_task is not None and self.filters_per_task < 1:
            raise InputError(f"expected at least one filter in a task, got {self.filters_per_task}")
        kind = self.device.partition(":")[0]
        if kind not in ("cpu", "cuda"):
            raise InputError(f"expected the device cpu or cuda, got {self.device!r}")
        if kind == "cuda" and not torch.cuda.is_available():
            raise InputError("device cuda: torch finds no CUDA device here (nvidia-smi lists them); use cpu")


def adapted_smoother(
    model: StateSpaceModel, observations: torch.Tensor, options: SMCOptions, start: torch.Tensor | None = None
) -> GaussianSmoother:
    """What the controlled guide and the smoother use: that of :func:`adapted`."""
    return adapted(model, observations, options, start)[0]


def adapted(
    model: StateSpaceModel,
    observations: torch.Tensor,
    options: SMCOptions,
    start: torch.Tensor | None = None,
    blind: FilterResult | None = None,
) -> tuple[GaussianSmoother, torch.Tensor | None]:
    """A smoother with factors refitted on pilot runs (:mod:`.iterated`), and the log-evidences (M,) of its own, if any.

    The start is Gauss–Newton's linearisation at the mode or one over the posterior, whichever guides the steadier
    filters; of a model with kinks there is one, which is fitted again over pilots' paths. A bootstrap run ``blind``
    that kept all rows gives a second path to begin at, its most probable, and points to refit on: where log p(x, y)
    has many modes a search from afar ends in any.
    Dynamics that are not Gaussian are taken for their approximation (:mod:`.moment_matching`) but in the pilots'
    weights. Random numbers are torch's own (global seed).
    """
    gaussian = moment_matched(model)
    starts = [start] if blind is None else [start, most_probable_line(model, observations, blind)]
    smoothers = [each for begin in starts for each in linearised(gaussian, observations, begin)]
    if options.refits == 0 or options.num_filters == 1:
        return max(smoothers[1::2], key=lambda each: float(each.log_joint)), None

    # Enough particles to fit a quadratic to, and no more than memory holds for every row.
    room = int(PILOT_PARTICLE_STEPS / (options.num_filters * len(observations)))
    few = replace(options, num_particles=min(options.num_particles, 100, max(room, 16)))

    def pilot(smoother: GaussianSmoother) -> FilterResult:
        return run_filters(model, observations, few, smoother=smoother)

    seen = [] if blind is None else [blind]
    if model.nonsmooth:
        return refitted_over_paths(gaussian, observations, smoothers[1::2], pilot, options.refits)
    return iterate(gaussian, observations, smoothers, pilot, iterations=options.refits, results=seen)


@torch.no_grad()
def most_probable_line(model: StateSpaceModel, observations: torch.Tensor, result: FilterResult) -> torch.Tensor:
    """Of a few ancestral lines (T, D) of each filter that with the highest log p(x, y)."""
    lines = genealogy(result, 4).flatten(0, 1).cpu().double()
    joint = model.to(dtype=torch.float64, device="cpu").log_joint(lines, observations.cpu().double())
    return lines[int(joint.nan_to_num(-torch.inf).argmax())]


def sufficient_dtype(smoother: GaussianSmoother) -> torch.dtype:
    """float32 if its rounding of the states stays under a hundredth of their posterior sd everywhere, else float64."""
    sd = smoother.covariance().diagonal(dim1=-2, dim2=-1).sqrt()
    rounding = torch.finfo(torch.float32).eps * smoother.path.abs()
    return torch.float32 if bool((rounding < 0.01 * sd).all()) else torch.float64


def run_filters(
    model: StateSpaceModel,
    observations: torch.Tensor,
    options: SMCOptions,
    *,
    guide: str = "controlled",
    smoother: GaussianSmoother | None = None,
    keep: int | None = None,
    progress: Report | None = None,
    kind: type[ParticleFilter] = ParticleFilter,
    windows: bool = False,
) -> FilterResult:
    """Run M filters with ``guide`` "controlled", "defended" or "bootstrap"; see :meth:`ParticleFilter.run`.

    A controlled guide for dynamics that have no closed form is the defended one (:func:`.defended.look_ahead`).
    """
    if guide != "bootstrap" and smoother is None:
        smoother = adapted_smoother(model, observations, options)
    dtype = options.dtype or (torch.float32 if smoother is None else sufficient_dtype(smoother))
    fast = in_type(model, observations, options, dtype)
    rows = check_model(fast, observations)
    proposal = _proposal(guide, fast, observations, smoother)
    return filters_of(fast, proposal, options, kind).run(rows, keep=keep, progress=progress, windows=windows)


def filters_of(
    model: StateSpaceModel, guide: Proposal, options: SMCOptions, kind: type[ParticleFilter] = ParticleFilter
) -> ParticleFilter:
    """The filters of a model and its guide that the options say."""
    return kind(
        model,
        guide,
        options.num_particles,
        num_filters=options.num_filters,
        ess_threshold=options.ess_threshold,
        resampling=options.resampling,
    )


def in_type(
    model: StateSpaceModel, observations: torch.Tensor, options: SMCOptions, dtype: torch.dtype
) -> StateSpaceModel:
    """The model in ``dtype`` on its device; in its own type if it has constants of that, and none is prescribed."""
    fast = model.to(dtype=dtype, device=options.device)
    if options.dtype is None:
        try:
            check_model(fast, observations)
        except ModelError:
            return model.to(device=options.device)  # what is wrong with this, too, is reported of it
    return fast


def _proposal(
    guide: str, model: StateSpaceModel, observations: torch.Tensor, smoother: GaussianSmoother | None
) -> Proposal:
    if smoother is None or guide == "bootstrap":
        return Bootstrap(model)
    return (Defended if guide == "defended" else look_ahead)(model, observations, smoother)


def run_task(
    model: StateSpaceModel,
    observations: torch.Tensor,
    options: SMCOptions,
    guide: str,
    smoother: GaussianSmoother | None,
    seed: int,
    progress: Report | None = None,
) -> Tensors:
    """Filters and their smoothed trajectories, from a seed of their own: what one worker does.

    ``progress`` counts the rows of both. Returns, of :class:`FilterResult`, the fields without a particle
    dimension, and "paths" (M, R, T, D).

    Raises ModelError for a model that does not fit the observations, or without a density that its smoothing needs.
    """
    rows = len(observations)

    def counted(before: int) -> Report | None:
        return None if progress is None else lambda done, _: progress(before + done, 2 * rows)

    backward = options.smoothing == "backward"
    observations = check_model(model, observations, needs=("transition_density",) if backward else ())
    with seeded(seed, options.device):
        result = run_filters(
            model, observations, options, guide=guide, smoother=smoother, progress=counted(0), windows=True
        ).cpu()
        paths = (
            backward_simulation(
                model, result, observations, options.num_draws, smoother=smoother, progress=counted(rows)
            )
            if backward
            else genealogy(result, options.num_draws)
        )
    return {"paths": paths, **{name: getattr(result, name) for name in PER_FILTER}}


PER_FILTER = {"log_evidence": 0, "log_evidence_increment": 1, "ess": 1, "resampled": 1}
"""Fields of :class:`FilterResult` without a particle dimension, and which of theirs is the filters'."""
