"""All methods by name, each called as :func:`.smc.smc` is: problem in, InferenceData out."""

import time
from collections.abc import Callable
from functools import partial, wraps

import arviz as az

from invdyn.inference.differentiate import differentiate
from invdyn.inference.laplace import laplace
from invdyn.inference.mcmc import nuts
from invdyn.inference.smc import smc
from invdyn.inference.svi import svi

Method = Callable[..., az.InferenceData]
"""Called as :func:`.smc.smc` is."""


def timed(method: Method) -> Method:
    """Return ``method`` with the seconds that it took noted in the attributes of its sample_stats."""

    @wraps(getattr(method, "func", method))
    def run(*args, **kwargs) -> az.InferenceData:
        begun = time.perf_counter()
        idata = method(*args, **kwargs)
        idata["sample_stats"].attrs["seconds"] = time.perf_counter() - begun
        return idata

    return run


METHODS: dict[str, Method] = {
    "smc": timed(partial(smc, guide="controlled")),
    "bootstrap": timed(partial(smc, guide="bootstrap")),
    "laplace": timed(laplace),
    "svi": timed(partial(svi, guide="svi")),
    "svi-markov": timed(partial(svi, guide="svi-markov")),
    "nuts": timed(nuts),
    "differentiate": timed(differentiate),
}
WITHOUT_EVIDENCE = frozenset({"nuts", "differentiate"})
"""Methods that cannot weigh one body against another."""
