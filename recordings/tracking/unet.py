"""A small U-Net that turns a picture into one heat map a keypoint, and the subpixel place of a map's peak.

Ronneberger, Fischer, Brox (MICCAI 2015): a ladder of halved resolutions down, and up again with skips across. Maps have
half the picture's resolution. Each is the logarithm, up to a constant, of the keypoint's distribution over places:

    p(cell) = softmax(map)          over all cells of a map

The place is that of the most probable cell, refined by the mean of p over the cells around it (soft-argmax), which is a
fraction of a cell; its mass is p of those cells together.

Shapes: pictures (N, 3, h, w) normalised; maps (N, P, ⌈h/2⌉, ⌈w/2⌉); cell (r, c) has its centre at v = 2r + ½,
u = 2c + ½ px.
"""

from collections.abc import Sequence
from itertools import pairwise

import torch
import torch.nn.functional as F
from torch import Tensor, nn

STRIDE = 2  # px of the picture, a pixel of the map
REFINE_CELLS = 4  # on each side of a peak


class UNet(nn.Module):
    """Channels `widths` from the finest level to the coarsest; P maps."""

    def __init__(self, maps: int, widths: Sequence[int] = (16, 24, 32, 48, 64)):
        super().__init__()
        self.stem = _block(3, widths[0], STRIDE)
        pairs = list(pairwise(widths))
        self.down = nn.ModuleList([nn.Sequential(_block(a, b, 2), _block(b, b)) for a, b in pairs])
        self.up = nn.ModuleList([_block(b + a, a) for a, b in pairs])
        self.head = nn.Conv2d(widths[0], maps, 1)

    def forward(self, pictures: Tensor) -> Tensor:
        """Maps of pictures."""
        levels = [self.stem(pictures)]
        for down in self.down:
            levels.append(down(levels[-1]))
        y = levels.pop()
        for up in reversed(self.up):
            across = levels.pop()
            y = F.interpolate(y, size=across.shape[2:], mode="bilinear", align_corners=False)
            y = up(torch.cat([y, across], 1))
        return self.head(y)


def activations(size: Sequence[int], widths: Sequence[int], maps: int) -> int:
    """Bytes, at most, of what a network has in memory for one picture of `size` (h, w) px, in float32.

    A picture and its normalised copies have nine channels. On the way up level l, which has 4⁻⁽ˡ⁺¹⁾ of the picture's
    cells, joins its own channels and those of the next level; maps exist three times, as values, logarithms and sums.
    """
    cells = 9.0
    for level, (own, next_one) in enumerate(zip(widths, [*widths[1:], 0], strict=True)):
        cells += (3 * own + 2 * next_one + (3 * maps if level == 0 else 0)) / 4 ** (level + 1)
    return round(4 * size[0] * size[1] * cells)


def targets(points: Tensor, shape: tuple[int, int], sd: float) -> Tensor:
    """(N, P, R, C) normalised Gaussian maps of points (N, P, 2) px; zero where a point is missing or outside.

    `shape` is (R, C), `sd` the standard deviation, px.
    """
    v, u = (STRIDE * torch.arange(n, dtype=points.dtype) + 0.5 for n in shape)
    squares = [(axis - points[..., i, None]) ** 2 for i, axis in ((0, u), (1, v))]
    bell = torch.exp(-(squares[0][..., None, :] + squares[1][..., :, None]) / (2 * sd**2)).nan_to_num(0.0)
    total = bell.sum((-1, -2), keepdim=True)
    return torch.where(total > 0.5, bell / total.clamp(min=1e-12), 0.0)


def peaks(maps: Tensor) -> tuple[Tensor, Tensor]:
    """Places (N, P, 2) px, u and v, of maps' peaks, and their masses (N, P)."""
    rows, columns = maps.shape[-2:]
    probability = maps.flatten(2).softmax(-1)
    best = probability.argmax(-1)
    r, c = best // columns, best % columns
    steps = torch.arange(-REFINE_CELLS, REFINE_CELLS + 1)
    near_r = (r[..., None] + steps)[..., :, None]
    near_c = (c[..., None] + steps)[..., None, :]
    inside = (near_r >= 0) & (near_r < rows) & (near_c >= 0) & (near_c < columns)
    cells = near_r.clamp(0, rows - 1) * columns + near_c.clamp(0, columns - 1)
    around = probability.gather(-1, cells.flatten(2)).reshape(cells.shape) * inside
    mass = around.sum((-1, -2))
    mean_r = r + (around.sum(-1) * steps).sum(-1) / mass
    mean_c = c + (around.sum(-2) * steps).sum(-1) / mass
    return STRIDE * torch.stack([mean_c, mean_r], -1) + 0.5, mass


def _block(channels: int, out: int, stride: int = 1) -> nn.Module:
    convolution = nn.Conv2d(channels, out, 3, stride, 1, bias=False)
    return nn.Sequential(convolution, nn.BatchNorm2d(out), nn.ReLU(inplace=True))
