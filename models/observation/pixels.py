"""The likelihood of pixels, and the lasting error of a tracker in one view: plain tensors in and out.

    y_cp ~ t_ν(π_c(X_p) + b_cp, σ_cp),   in the plane:
    log p = log ν/(2π ν σ²) − (ν + 2)/2 · log(1 + |y − π − b|²/(ν σ²))

(the two-dimensional Student-t, whose Γ((ν + 2)/2)/Γ(ν/2) is ν/2). σ is the caller's σ_cp s(confidence), px. A tracker's
error in one view is not white: it sits beside the joint for as long as the limb is seen from there. b_cp, one for each
camera, keypoint and axis of the picture, is an Ornstein–Uhlenbeck process of standard deviation β and correlation time
ℓ, exact over any step:

    b′ = a b + β √(1 − a²) η,   a = exp(−δ/ℓ),   b₀ ~ N(0, β²)

Where no pixel was tracked there is no term. Where one was and the model says that the camera cannot see the point, the
pixel is of something else: uniform over the picture. No sensor uses this yet.
"""

import math

import torch
from torch import Tensor


def pixel_log_likelihood(
    pixels: Tensor,
    predicted: Tensor,
    scale: Tensor,
    freedom: Tensor | float,
    area: Tensor,
    bias: Tensor | None = None,
) -> Tensor:
    """Log density of each pixel, (…, C, P); 0 where there is none. Sum over the last two axes for a row's.

    Args:
        pixels: (…, C, P, 2), NaN where missing.
        predicted: (…, C, P, 2) as `pinhole.project` gives it, NaN where the camera cannot see the point.
        scale: σ, px, broadcast against (…, C, P).
        freedom: ν; infinity is a Gaussian.
        area: (C,) of the pictures, px².
        bias: (…, C, P, 2) px, or None for none.
    """
    tracked = torch.isfinite(pixels).all(-1)
    seen = torch.isfinite(predicted).all(-1)
    both = tracked & seen
    # Before the difference, since NaN times zero would be NaN in a gradient.
    miss = torch.where(both[..., None], pixels, 0.0) - torch.where(both[..., None], predicted, 0.0)
    if bias is not None:
        miss = miss - bias
    square = miss.square().sum(-1) / scale.square()
    freedom = torch.as_tensor(freedom, dtype=pixels.dtype, device=pixels.device)
    finite = torch.where(torch.isinf(freedom), 1.0, freedom)
    tails = torch.where(torch.isinf(freedom), 0.5 * square, 0.5 * (finite + 2) * torch.log1p(square / finite))
    inside = -math.log(2 * math.pi) - 2 * torch.log(scale) - tails
    return torch.where(both, inside, torch.where(tracked, -torch.log(area)[:, None], 0.0))


def bias_transition(bias: Tensor, step: Tensor | float, correlation_time: Tensor, sd: Tensor) -> tuple[Tensor, Tensor]:
    """Mean and standard deviation of the next bias, both as `bias` (…, C, P, 2), px.

    Args:
        bias: the present one.
        step: δ, s.
        correlation_time: ℓ, s, broadcast against the bias.
        sd: β, px, likewise; also the standard deviation of the first one, about 0.
    """
    ratio = torch.as_tensor(step, dtype=bias.dtype, device=bias.device) / correlation_time
    mean = torch.exp(-ratio) * bias
    # 1 − a², without the digits that a difference near 0 would lose
    return mean, (sd * torch.sqrt(-torch.expm1(-2 * ratio))).expand_as(bias)
