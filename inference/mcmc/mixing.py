"""How well chains mix, by ArviZ's rank-normalised R-hat and effective sample sizes.

Vehtari, Gelman, Simpson, Carpenter & Bürkner (2021), "Rank-normalization, folding, and localization".
"""

import arviz as az
import numpy as np
import xarray as xr


def mixing(torque: np.ndarray) -> dict[str, float]:
    """Largest R-hat, smallest bulk and tail effective sample size of any entry of draws (chain, draw, …)."""
    # ArviZ's own conversion warns of more chains than draws, which is what batched chains are.
    data = xr.Dataset({"torque": (["chain", "draw", *(f"dim_{k}" for k in range(torque.ndim - 2))], torque)})
    return {
        "r_hat": float(az.rhat(data)["torque"].max()),
        "ess_bulk": float(az.ess(data, method="bulk")["torque"].min()),
        "ess_tail": float(az.ess(data, method="tail")["torque"].min()),
    }
