"""Augmentation of training pictures: rotated, shifted, scaled, brighter, blurred by motion.

Shapes: pictures (N, 3, h, w) of 0 … 255, points (N, P, 2) px. A picture's new pixel x shows the old one at

    A (x − c) + c + t        A a rotation times a scale, c the centre, t a shift

so that a point y of the old picture is seen at A⁻¹(y − c − t) + c.
"""

import math

import torch
import torch.nn.functional as F
from torch import Tensor


def augment(
    pictures: Tensor,
    points: Tensor,
    rng: torch.Generator,
    *,
    angle: float = math.radians(20),
    log_scale: float = 0.2,
    shift: float = 0.08,
    brightness: float = 20.0,
    contrast: float = 0.2,
    blur: float = 0.02,
) -> tuple[Tensor, Tensor]:
    """Pictures and points, each changed independently; `rng` decides how.

    The numbers are half ranges of uniform distributions: of the angle (rad), the logarithm of the scale, the shift and
    the blur's reach (of the picture's longer side), the brightness (of 255) and the contrast (of 1).
    """
    count, _, height, width = pictures.shape
    longest = max(height, width)

    def uniform(*shape: int) -> Tensor:
        return 2 * torch.rand(*shape, generator=rng) - 1

    turn, scale = angle * uniform(count), torch.exp(log_scale * uniform(count))
    move = shift * longest * uniform(count, 2)
    cos, sin = scale * torch.cos(turn), scale * torch.sin(turn)
    A = torch.stack([torch.stack([cos, -sin], -1), torch.stack([sin, cos], -1)], -2)
    centre = torch.tensor([width - 1, height - 1]) / 2
    # affine_grid counts from −1 to 1 across the picture along each axis
    half = torch.tensor([width, height]) / 2
    theta = torch.cat([A * half / half[:, None], (move / half)[..., None]], -1)
    grid = F.affine_grid(theta, list(pictures.shape), align_corners=False)
    changed = F.grid_sample(pictures, grid, padding_mode="reflection", align_corners=False)
    moved = torch.linalg.solve(A, (points - centre - move[:, None]).mT).mT + centre
    changed = _blurred(changed, max(1, round(blur * longest)), rng)
    light = brightness * uniform(count, 1, 1, 1) + brightness / 2 * uniform(count, 3, 1, 1)
    return ((1 + contrast * uniform(count, 1, 1, 1)) * changed + light).clamp(0, 255), moved


def _blurred(pictures: Tensor, reach: int, rng: torch.Generator) -> Tensor:
    """Half of the pictures smeared along a straight line of up to `reach` px to either side."""
    count = len(pictures)
    direction = torch.rand(count, generator=rng) * math.pi
    length = torch.rand(count, generator=rng) * (torch.rand(count, generator=rng) < 0.5) * reach
    offset = torch.arange(-reach, reach + 1.0)
    v, u = torch.meshgrid(offset, offset, indexing="ij")
    cos, sin = torch.cos(direction)[:, None, None], torch.sin(direction)[:, None, None]
    beyond = ((u * cos + v * sin).abs() - length[:, None, None]).clamp(min=0)
    kernel = (1 - torch.sqrt(beyond**2 + (v * cos - u * sin) ** 2)).clamp(min=0)
    kernel = kernel / kernel.sum((-1, -2), keepdim=True)
    # one convolution with a group for each colour of each picture
    wide = F.pad(pictures, (reach,) * 4, mode="reflect")
    smeared = F.conv2d(wide.flatten(0, 1)[None], kernel.repeat_interleave(3, 0)[:, None], groups=3 * count)
    return smeared.reshape(pictures.shape)
