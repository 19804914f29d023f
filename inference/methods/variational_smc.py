"""Variational SMC as a method: learns the guide and the parameters' posterior, then weighs what it has learned.

The bound of :class:`.vsmc.VSMC_ELBO` with the free parameters φ = log(θ/θ_start) drawn from q,

    L = E_q(φ) [ log p̂_φ(y) + log p(φ) − log q(φ) ] ≤ log p(y),       q = N(m, S),  p = N(0, diag sd²)

begins where :func:`.marginal_likelihood.fit` ends: m and S are Laplace's there, with the whole covariance. The
filter's guide is the controlled one of each φ that is drawn, with a smoother of its own, plus a learned correction that
all φ share (:class:`.affine.Corrected`); what the smoother owes to φ is not differentiated, which costs nothing where
the guide is exact. Steps are taken in the coordinates u of φ = m₀ + S₀^½ u, where one learning rate suits all.

A bound prefers a q that is too narrow, and the posterior may be bent. So q is only the proposal of what is reported:
filter m gets its own φ_m, from Student's t of q's location and scale, and the outer sampler weighs

    W_m ∝ p̂_{φ_m}(y) p(φ_m) / q(φ_m),

importance weights of (φ_m, path): pooled draws integrate the parameters out, and their intervals are right even where
q is not. The outer ESS says how good q is.

A direction of φ that the data hardly narrow, such as torque scale against mass, is named in the attributes: see
:func:`unidentified`.

Shapes: P free parameters, M filters.
"""

import json
import math
from collections.abc import Sequence

import arviz as az
import pyro
import torch
from torch import Tensor

from invdyn.inference.execution.checkpoint import Checkpoint
from invdyn.inference.execution.distribute import inside
from invdyn.inference.execution.progress import Progress, stage
from invdyn.inference.execution.seeds import seeded
from invdyn.inference.filters.filtering import SMCOptions
from invdyn.inference.fitting.log_parameters import Free
from invdyn.inference.methods.vsmc_learner import AtParameters
from invdyn.inference.methods.vsmc_parameters import OverParameters
from invdyn.inference.posterior.problem import StateSpaceProblem


def vsmc(
    problem: StateSpaceProblem,
    *,
    free: Sequence[Free] = (),
    options: SMCOptions | None = None,
    start: Tensor | None = None,
    seed: int = 0,
    settings: dict | None = None,
    progress: Progress | None = None,
    checkpoint: Checkpoint | None = None,
    steps: int = 60,
    learning_rate: float = 0.02,
) -> az.InferenceData:
    """Train the guide, and the posterior of the ``free`` parameters; then run the trained filters.

    Args are those of :func:`.smc.smc`, and:

    - problem: model and observations; the model's parameters are the centre of the free ones' prior.
    - free: parameters to learn; without any, the guide alone is trained, at the model's parameters.
    - options: sizes of the filters that are reported; training has 4 of at most 50 particles.
    - checkpoint: keeps the training, and continues from there.
    - steps, learning_rate: of Adam; the rate falls tenfold over the steps. The guide's correction has thousands of
      entries and learns at a tenth of the rate. Training that did not raise the bound of a pilot run is undone.

    Each chain is one filter; with ``free`` it has parameters of its own, which become variables of the posterior
    ("length", "mass", "com", "inertia" of a body, others by their dotted names). The evidence is an unbiased estimate,
    the parameters integrated out. The attributes of sample_stats hold "vsmc_bound", the mean over filters of what
    the log of that estimates, its standard error "vsmc_bound_sd", "vsmc_gain", what training raised it by in the pilot
    run (0: undone), and "unidentified", a JSON list.

    Raises KeyError for a parameter that the model does not have, SMCFailed when filters lose the observations.
    """
    options = options or SMCOptions()

    with seeded(seed, options.device), pyro.get_param_store().scope():
        kind = OverParameters if free else AtParameters
        learner = kind(problem, free, options, start, stage(progress, "fit"))
        gain = learner.train(steps, learning_rate, stage(progress, "train"), inside(checkpoint, "vsmc"))
        with torch.no_grad():
            idata, found = learner.posterior(seed, settings or {}, stage(progress, "filter"), stage(progress, "smooth"))
    each = idata["sample_stats"]["log_evidence"].values
    error = each.std(ddof=1) / math.sqrt(len(each)) if len(each) > 1 else math.nan
    idata["sample_stats"].attrs |= {
        "unidentified": json.dumps(found, ensure_ascii=False),
        "vsmc_bound": float(each.mean()),
        "vsmc_bound_sd": float(error),
        "vsmc_gain": gain,
    }
    return idata
