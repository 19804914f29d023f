"""How well chains mix, by ArviZ's rank-normalised R-hat and effective sample sizes.

Vehtari, Gelman, Simpson, Carpenter & Bürkner (2021), "Rank-normalization, folding, and localization".
"""

import arviz as az
import numpy as np
import xarray as xr


def mixing(draws: np.ndarray) -> dict[str, float]:
    """Largest R-hat, smallest bulk and tail effective sample size of any entry of draws (M, R, …)."""
    # ArviZ's own conversion warns of more chains than draws, which is what batched chains are.
    data = xr.Dataset({"x": (["chain", "draw", *(f"dim_{k}" for k in range(draws.ndim - 2))], draws)})
    return {
        "r_hat": float(az.rhat(data)["x"].max()),
        "ess_bulk": float(az.ess(data, method="bulk")["x"].min()),
        "ess_tail": float(az.ess(data, method="tail")["x"].min()),
    }
