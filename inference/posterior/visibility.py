"""Which coordinates of a body in space its keypoints do not tell, row by row.

A row's sensors tell a small turn dq by J dq / σ. J (O, K) are the slopes of what is seen in it: tracked sites, m/rad,
pixels, px/rad, and encoders. Each is over its noise σ, which for pixels includes what lasts of a tracker's error. Of J
/ σ = U diag(w) Vᵀ a direction v_i is known to 1 / w_i rad. Where that is more than ``UNSEEN_SD`` the direction is not
seen, and a coordinate is not where such directions make up most of it: the twist of a last link, or of a straight arm,
and a joint without keypoints beyond it. What a posterior says there is the prior's: its torque's stationary law and its
start, which are proper, keep it bounded.

Shapes: rows (T, O), K coordinates.
"""

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.functional import jvp

from invdyn.models.observation.observation import Observation

UNSEEN_SD = 0.5
"""rad (m of slides) to which one row must tell a direction for it to be seen."""


def visibility(model: Any, observations: Tensor, angle: Tensor) -> tuple[np.ndarray, np.ndarray]:
    """Smallest singular value (T,) of the seen sites' Jacobian, m/rad, and which coordinates are not seen, (T, K) bool.

    Of a ``model`` in poses ``angle`` (T, K), with rows ``observations`` (T, O).
    """
    observation: Observation = model.observation
    rows, K = observations.detach().cpu(), angle.shape[-1]
    slopes, sharp = [], []
    jacobian = model.dynamics.jacobian(angle, model.body_parameters())
    if (keypoints := observation.keypoints) is not None:
        own = keypoints.tracked(jacobian.flatten(-2)).unflatten(-1, (-1, K)).flatten(-3, -2)
        own = torch.where(torch.isfinite(rows[:, observation.part(keypoints)]).unsqueeze(-1), own, 0.0)
        scale = _first(model.parameters["emission.keypoint_scale"]).repeat_interleave(model.body.dimensions, -1)
        slopes.append(own)
        sharp.append(own / scale.unsqueeze(-1))
    if (pixels := observation.pixels) is not None:
        seen = torch.isfinite(observation.of(pixels, rows))
        by_one = seen.all(-1).any(-2)[..., None, None]  # camera at least, of P sites
        slopes.append(torch.where(by_one, jacobian[..., list(pixels.sites), :, :], 0.0).flatten(-3, -2))
        points = model.dynamics.keypoints(angle, model.body_parameters())
        # Twice in reverse: where shapes broadcast, forward mode would import torch's compiler first, for a second.
        shown = [jvp(pixels.about, points, along)[1] for along in jacobian.unbind(-1)]
        own = torch.where(seen.flatten(1).unsqueeze(-1), torch.stack(shown, -1), 0.0)
        scale = _first(model.parameters["emission.pixel_scale"], 2)
        if pixels.lasting:
            scale = scale.hypot(_first(model.parameters["emission.bias_scale"], 2))
        sharp.append(own / scale.repeat_interleave(2, -1).flatten().unsqueeze(-1))
    if (encoders := observation.encoders) is not None:
        read = torch.isfinite(rows[:, observation.part(encoders)]).to(angle)
        sharp.append(torch.diag_embed(read / _first(model.parameters["emission.angle_scale"])))
    smallest = np.linalg.svd(torch.cat(slopes, -2).numpy(), compute_uv=False) if slopes else np.zeros((len(rows), K))
    smallest = smallest[:, -1] if smallest.shape[-1] == K else np.zeros(len(rows))
    _, w, v = np.linalg.svd(torch.cat(sharp, -2).numpy()) if sharp else (0, np.zeros((len(rows), 0)), np.eye(K)[None])
    w = np.concatenate([w, np.zeros((len(rows), K - w.shape[1]))], -1)
    share = ((w < 1 / UNSEEN_SD)[..., None] * v**2).sum(-2)
    return smallest, share > 0.5  # more of a coordinate lies in unseen directions than in others


def _first(values: Tensor, axes: int = 1) -> Tensor:
    """A parameter of so many ``axes``, of many sets (..., own shape) that of the first."""
    return values.reshape(-1, *values.shape[-axes:])[0]


def unseen_lines(unseen: np.ndarray, names: tuple[str, ...]) -> list[str]:
    """A sentence for each coordinate that is not seen (T, K) in some of the rows."""
    lines = []
    for name, share in zip(names, unseen.mean(0), strict=True):
        if share >= 0.99:
            lines.append(f"{name}: no keypoint tells it: what is said of its motion and torque is the prior")
        elif share > 0.01:
            lines.append(f"{name}: no keypoint tells it in {share:.0%} of the rows: there the prior speaks")
    return lines
