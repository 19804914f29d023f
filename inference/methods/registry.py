"""All methods by name, each called as :func:`.smc.smc` is: problem in, InferenceData out.

"smc" is M filters of N particles under an outer importance sampler (:mod:`.nested`), with the controlled guide. One
filter alone is its case M = 1.
"""

import time
from collections.abc import Callable
from functools import partial, wraps
from typing import Any

import arviz as az

from invdyn.inference.methods.differentiate import differentiate
from invdyn.inference.methods.laplace import laplace
from invdyn.inference.methods.nuts import nuts
from invdyn.inference.methods.parameters import learn_parameters
from invdyn.inference.methods.particle_gibbs import particle_gibbs
from invdyn.inference.methods.smc import smc
from invdyn.inference.methods.svi import svi
from invdyn.inference.methods.variational_smc import vsmc
from invdyn.inference.parameters.pmmh import pmmh
from invdyn.inference.parameters.smc2 import smc2

Method = Callable[..., az.InferenceData]
"""Called as :func:`.smc.smc` is."""


def timed(method: Method) -> Method:
    """Return ``method`` with the seconds that it took noted in the attributes of its sample_stats."""

    @wraps(getattr(method, "func", method))
    def run(*args: Any, **kwargs: Any) -> az.InferenceData:
        start = time.perf_counter()
        idata = method(*args, **kwargs)
        idata["sample_stats"].attrs["seconds"] = time.perf_counter() - start
        return idata

    return run


METHODS: dict[str, Method] = {
    "smc": timed(partial(smc, guide="controlled")),
    "bootstrap": timed(partial(smc, guide="bootstrap")),
    "laplace": timed(laplace),
    "svi": timed(partial(svi, guide="svi")),
    "svi-markov": timed(partial(svi, guide="svi-markov")),
    "vsmc": timed(vsmc),
    "nuts": timed(nuts),
    "particle-gibbs": timed(particle_gibbs),
    "differentiate": timed(differentiate),
}
OF_ARMS = frozenset({"differentiate"})
"""Methods that need a body; all others take any state-space model."""

PARAMETER_METHODS: dict[str, Method] = {
    "pmmh": timed(partial(learn_parameters, sampler=pmmh)),
    "smc2": timed(partial(learn_parameters, sampler=smc2)),
}
"""Methods of any model whose parameters have priors, which they learn."""

DISTRIBUTED = frozenset({"smc", "bootstrap", "particle-gibbs", "smc2"})
"""Methods that an executor's workers share."""

RESUMED = DISTRIBUTED | {"vsmc"}
"""Methods that keep what is done; of VSMC that is its training."""

WITHOUT_EVIDENCE = frozenset({"nuts", "particle-gibbs", "differentiate"})
"""Methods that cannot weigh one body against another."""
