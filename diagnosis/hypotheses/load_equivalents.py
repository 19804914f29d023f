"""The payload that an error of the last link's numbers may be.

A point mass m at the tip changes mass, centre of mass and inertia of the last link together,

    Δmass = m,    Δcom = m (l − c)/(M + m),    ΔI = (l − c)² M m/(M + m)

so that it is a special case of an error of all three, but on no straight line; in space nearly one, whose moments
change by one factor. Of a posterior N(μ, Σ) of these the
nearest load is that of the least (Δ(m) − μ)ᵀ Σ⁻¹ (Δ(m) − μ).
"""

import numpy as np
import torch
from scipy.optimize import minimize_scalar

from invdyn.diagnosis.problem.cause import FittedHypothesis
from invdyn.diagnosis.problem.unknowns import upper_bound
from invdyn.models.effects.inertial_error import InertialError
from invdyn.models.effects.payload import Payload
from invdyn.models.effects.scale import Scale


def nearest_load(cause: FittedHypothesis, error: InertialError, payload: Payload, scale: Scale) -> tuple[float, float]:
    """Mass, kg, of the ``payload`` nearest to one of a cause's effects, an ``error`` of the last link, and how far.

    In standard deviations of what was found. Both effects are bound.
    """
    places = [cause.names.index(f"{error.key}.{p.name}") for p in error.parameters(scale)]
    found, covariance = cause.mean[places], cause.covariance[np.ix_(places, places)]
    unit = 1 / np.sqrt(np.diag(covariance))
    precision = np.linalg.pinv(covariance * np.outer(unit, unit), hermitian=True)

    def off(mass: float) -> float:
        loaded = payload.body({"mass": torch.tensor([mass], dtype=torch.float64)}, scale.body)
        apart = (np.array(error.between(scale.body, loaded)) - found) * unit
        return float(apart @ precision @ apart)

    (parameter,) = payload.parameters(scale)
    most = upper_bound(parameter)
    best = minimize_scalar(off, bounds=(0.0, most), method="bounded", options={"xatol": 1e-5 * most})
    return float(best.x), float(np.sqrt(max(best.fun, 0.0)))
