"""How far a tracked point lies from where the model expects it: which of a film's pictures to label next.

Of keypoint p at time t, with mean m and covariance C of its posterior predictive draws, the surprise is Mahalanobis'
distance

    d² = (y − m)ᵀ C⁻¹ (y − m)

A picture has that of its most surprising keypoint.
"""

import arviz as az
import numpy as np

from invdyn.inference import pooled
from invdyn.recordings import InputError


def surprise(idata: az.InferenceData) -> np.ndarray:
    """Of each row (T,); −∞ where nothing is observed. Raises InputError for a posterior without keypoints."""
    if "position" not in idata["observed_data"] or "posterior_predictive" not in idata.groups():
        raise InputError("this posterior observed no keypoints, so that none of them can surprise")
    observed = idata["observed_data"]["position"].transpose("time", "keypoint", "space").values
    predicted = pooled(idata, group="posterior_predictive")["position"]
    draws = predicted.transpose("sample", "time", "keypoint", "space").values
    mean = draws.mean(0)
    apart = draws - mean
    covariance = np.einsum("ntki,ntkj->tkij", apart, apart) / (len(draws) - 1)
    smallest = 1e-9 * np.trace(covariance, axis1=-2, axis2=-1).max() + 1e-300
    covariance = covariance + smallest * np.eye(covariance.shape[-1])
    error = observed - mean
    distance = np.sqrt((error * np.linalg.solve(covariance, error[..., None])[..., 0]).sum(-1))
    return np.where(np.isfinite(distance), distance, -np.inf).max(-1, where=np.isfinite(distance), initial=-np.inf)
