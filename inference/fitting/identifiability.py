"""Which directions among parameters the data do not tell apart."""

import numpy as np
import torch
from torch import Tensor

from invdyn.inference.fitting.log_parameters import LogParameters


def unidentified(parameters: LogParameters, phi: Tensor, log_weights: Tensor, min_share: float = 0.25) -> list[dict]:
    """Directions of φ in which the posterior is nearly as wide as the prior, widest first.

    Args:
        parameters: the free ones, P of them.
        phi: (M, P) draws.
        log_weights: (M,).
        min_share: share of the prior's variance above which a direction counts as not identified: by default, the
            data halve its sd at best.

    Each is {"direction": exponents by label, the largest one 1, "relation": such as
    "body.mass[0] ∝ torque.scale[0]", "variance_share": posterior over prior variance}: moving along it multiplies
    each θ by a common factor to the power of its exponent, and the data hardly mind.
    """
    weights = torch.softmax(log_weights.double(), 0)
    whitened = phi.double() / torch.as_tensor(parameters.sd)
    whitened = whitened - weights @ whitened
    shares, axes = np.linalg.eigh((whitened.mT @ (weights.unsqueeze(-1) * whitened)).numpy())
    found = []
    for share, axis in zip(shares[::-1], axes.T[::-1], strict=True):
        if share < min_share:
            continue
        powers = axis * parameters.sd
        powers = powers / powers[np.abs(powers).argmax()]
        direction = {
            label: round(float(power), 3)
            for label, power in zip(parameters.labels, powers, strict=True)
            if abs(power) > 0.1
        }
        relation = " ∝ ".join(label if power > 0 else f"1/{label}" for label, power in direction.items())
        found.append({"direction": direction, "relation": relation, "variance_share": round(float(share), 3)})
    return found
