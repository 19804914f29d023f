"""How well chains mix, by ArviZ's rank-normalised R-hat and effective sample sizes.

Vehtari, Gelman, Simpson, Carpenter & Bürkner (2021), "Rank-normalization, folding, and localization".
"""

import arviz as az
import numpy as np
import xarray as xr

MIN_DRAWS = 4
"""Of a chain: ArviZ halves it, and a half needs a variance."""


def mixing(draws: np.ndarray) -> dict[str, float]:
    """Largest R-hat, smallest bulk and tail effective sample size of any entry of draws (M, R, …).

    NaN for fewer than 4 draws, and R-hat for one chain: of so few ArviZ logs lines of its own.
    """
    if draws.shape[1] < MIN_DRAWS:
        return dict.fromkeys(("r_hat", "ess_bulk", "ess_tail"), float("nan"))
    # ArviZ's own conversion warns of more chains than draws, which is what batched chains are.
    data = xr.Dataset({"x": (["chain", "draw", *(f"dim_{k}" for k in range(draws.ndim - 2))], draws)})
    return {
        "r_hat": float(az.rhat(data)["x"].max()) if draws.shape[0] > 1 else float("nan"),
        "ess_bulk": float(az.ess(data, method="bulk")["x"].min()),
        "ess_tail": float(az.ess(data, method="tail")["x"].min()),
    }
