"""How it is learned: guides, filters, smoothing, hyperparameters, and the posterior as InferenceData."""

from invdyn.inference.affine import Affine, Corrected
from invdyn.inference.bootstrap import Bootstrap
from invdyn.inference.checkpoint import Checkpoint
from invdyn.inference.compare import Comparison, compare
from invdyn.inference.controlled import Controlled
from invdyn.inference.differentiate import differentiate
from invdyn.inference.distribute import LostWork
from invdyn.inference.executors import open_executor, process_pool
from invdyn.inference.gauss_newton import GaussianSmoother, gauss_newton
from invdyn.inference.infer import infer
from invdyn.inference.initialise import Problem, arm_problem
from invdyn.inference.laplace import GaussianChain, laplace
from invdyn.inference.marginal_likelihood import Fit, Free, fit
from invdyn.inference.mcmc import nuts
from invdyn.inference.mechanics import mechanics
from invdyn.inference.methods import METHODS
from invdyn.inference.nested import OuterWeights, outer_weights
from invdyn.inference.particle_filter import ParticleFilter
from invdyn.inference.particle_gibbs import particle_gibbs
from invdyn.inference.particles import FilterResult
from invdyn.inference.posterior import load_posterior, pooled, save_posterior, summarise
from invdyn.inference.posterior_linearisation import posterior_linearisation
from invdyn.inference.proposal import Proposal
from invdyn.inference.resampling import RESAMPLERS, ess, resample
from invdyn.inference.smc import SMCOptions, gaussian_smoother, run_filters, smc
from invdyn.inference.smoothing import backward_simulation, genealogy
from invdyn.inference.svi import svi
from invdyn.inference.task import Task, free_parameters, prepare
from invdyn.inference.variational_smc import vsmc
from invdyn.inference.vsmc import VSMC_ELBO

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
