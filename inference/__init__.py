"""How it is learned: guides, filters, smoothing, hyperparameters, and the posterior as InferenceData."""

from invdyn.inference.compare import Comparison, compare
from invdyn.inference.execution.checkpoint import Checkpoint
from invdyn.inference.execution.distribute import LostWork
from invdyn.inference.execution.executors import open_executor, process_pool
from invdyn.inference.filters.backward_simulation import backward_simulation, genealogy
from invdyn.inference.filters.bootstrap import Bootstrap
from invdyn.inference.filters.controlled import Controlled
from invdyn.inference.filters.nested import OuterWeights, outer_weights
from invdyn.inference.filters.particle_filter import ParticleFilter
from invdyn.inference.filters.particles import FilterResult
from invdyn.inference.filters.proposal import Proposal
from invdyn.inference.filters.resampling import RESAMPLERS, ess, resample
from invdyn.inference.fitting.marginal_likelihood import Fit, Free, fit
from invdyn.inference.infer import infer
from invdyn.inference.methods.differentiate import differentiate
from invdyn.inference.methods.laplace import GaussianChain, laplace
from invdyn.inference.methods.nuts import nuts
from invdyn.inference.methods.particle_gibbs import particle_gibbs
from invdyn.inference.methods.registry import METHODS
from invdyn.inference.methods.smc import SMCOptions, gaussian_smoother, run_filters, smc
from invdyn.inference.methods.svi import svi
from invdyn.inference.methods.variational_smc import vsmc
from invdyn.inference.posterior.initialise import Problem, arm_problem
from invdyn.inference.posterior.mechanics import mechanics
from invdyn.inference.posterior.posterior import load_posterior, pooled, save_posterior, summarise
from invdyn.inference.smoothing.gauss_newton import GaussianSmoother, gauss_newton
from invdyn.inference.smoothing.posterior_linearisation import posterior_linearisation
from invdyn.inference.task import Task, free_parameters, prepare
from invdyn.inference.variational.affine import Affine, Corrected
from invdyn.inference.variational.vsmc import VSMC_ELBO

__all__ = [
    "METHODS",
    "RESAMPLERS",
    "VSMC_ELBO",
    "Affine",
    "Bootstrap",
    "Checkpoint",
    "Comparison",
    "Controlled",
    "Corrected",
    "FilterResult",
    "Fit",
    "Free",
    "GaussianChain",
    "GaussianSmoother",
    "LostWork",
    "OuterWeights",
    "ParticleFilter",
    "Problem",
    "Proposal",
    "SMCOptions",
    "Task",
    "arm_problem",
    "backward_simulation",
    "compare",
    "differentiate",
    "ess",
    "fit",
    "free_parameters",
    "gauss_newton",
    "gaussian_smoother",
    "genealogy",
    "infer",
    "laplace",
    "load_posterior",
    "mechanics",
    "nuts",
    "open_executor",
    "outer_weights",
    "particle_gibbs",
    "pooled",
    "posterior_linearisation",
    "prepare",
    "process_pool",
    "resample",
    "run_filters",
    "save_posterior",
    "smc",
    "summarise",
    "svi",
    "vsmc",
]
