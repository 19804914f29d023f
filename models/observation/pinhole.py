"""Projection of points of a scene into the pictures of C cameras, differentiable and batched: plain tensors in and out.

    x = R X + t,   (a, b) = (x, y) / z,   r² = a² + b²,   d = 1 + k1 r² + k2 r⁴ + k3 r⁶
    u = fx (a d + 2 p1 a b + p2 (r² + 2 a²)) + cx,   v = fy (b d + p1 (r² + 2 b²) + 2 p2 a b) + cy

Brown, "Close-range camera calibration", Photogrammetric Engineering 37, 1971, in OpenCV's order k1, k2, p1, p2, k3.
Fisheye lenses: d = ϑ (1 + k1 ϑ² + k2 ϑ⁴ + k3 ϑ⁶ + k4 ϑ⁸) / r with ϑ = atan r (Kannala and Brandt, IEEE PAMI 28, 2006).
Metres in, pixels out. The readers of calibrations project with numpy, in a room that this one does not know; a test
holds both to OpenCV. :mod:`.pixels` is the sensor.
"""

from typing import NamedTuple

import torch
from torch import Tensor


class PinholeCameras(NamedTuple):
    """C cameras.

    Attributes:
        focal: (C, 2) fx, fy, px.
        center: (C, 2) cx, cy, px.
        distortion: (C, 5) k1, k2, p1, p2, k3; of a fisheye lens k1, k2, k3, k4 and one that is not used.
        rotation: (C, 3, 3), scene to camera.
        translation: (C, 3), m.
        limit: (C,) largest r up to which the distortion rises; infinity where it always does.
        fisheye: (C,) bool, or None when no lens is one.
    """

    focal: Tensor
    center: Tensor
    distortion: Tensor
    rotation: Tensor
    translation: Tensor
    limit: Tensor
    fisheye: Tensor | None = None

    def to(self, device: torch.device | str, dtype: torch.dtype) -> "PinholeCameras":
        """The same there, in another precision."""
        fisheye = None if self.fisheye is None else self.fisheye.to(device)
        focal, center, distortion, rotation, translation, limit = (each.to(device, dtype) for each in self[:6])
        return PinholeCameras(focal, center, distortion, rotation, translation, limit, fisheye)


def moved(cameras: PinholeCameras, turn: Tensor, shift: Tensor) -> PinholeCameras:
    """Cameras with poses off by rotation vectors ``turn`` (…, C, 3) rad and ``shift`` (…, C, 3) m in their frames.

    x = exp([turn]×) (R X + t) + shift
    """
    x, y, z = turn.unbind(-1)
    zero = torch.zeros_like(x)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).unflatten(-1, (3, 3))
    by = torch.linalg.matrix_exp(cross)
    translation = (by @ cameras.translation.unsqueeze(-1)).squeeze(-1) + shift
    return cameras._replace(rotation=by @ cameras.rotation, translation=translation)


def project(cameras: PinholeCameras, points: Tensor, each: bool = False) -> tuple[Tensor, Tensor]:
    """Points (…, P, 3) → pixels (…, C, P, 2), and which of them are in front of the camera, within its limit (…, C, P).

    Those that are not have NaN, and their gradient is zero: what is not seen has no influence. With ``each`` every
    camera has points of its own, (…, C, P, 3). Poses may have leading dimensions that broadcast.
    """
    law = "...cij,...cpj->...cpi" if each else "...cij,...pj->...cpi"
    local = torch.einsum(law, cameras.rotation, points) + cameras.translation[..., None, :]
    depth = local[..., 2]
    ahead = depth > 0
    plane = local[..., :2] / torch.where(ahead, depth, 1.0)[..., None]
    seen = ahead & (plane.detach().square().sum(-1) <= cameras.limit[:, None].square())
    # A point that is not seen is moved onto the axis before the lens: NaN times zero would be NaN in its gradient.
    distorted = _distort(torch.where(seen[..., None], plane, 0.0), cameras)
    pixels = cameras.focal[:, None] * distorted + cameras.center[:, None]
    return torch.where(seen[..., None], pixels, torch.nan), seen


def _distort(plane: Tensor, cameras: PinholeCameras) -> Tensor:
    """(…, C, P, 2) of the plane z = 1 → distorted, by each camera's own law."""
    a, b = plane.unbind(-1)
    k1, k2, p1, p2, k3 = (each[:, None] for each in cameras.distortion.unbind(-1))
    r2 = a * a + b * b
    d = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    distorted = torch.stack(
        (a * d + 2 * p1 * a * b + p2 * (r2 + 2 * a * a), b * d + p1 * (r2 + 2 * b * b) + 2 * p2 * a * b), -1
    )
    if cameras.fisheye is None:
        return distorted
    return torch.where(cameras.fisheye[:, None, None], plane * _fisheye(r2, cameras.distortion)[..., None], distorted)


def _fisheye(r2: Tensor, distortion: Tensor) -> Tensor:
    """Factor d of a fisheye lens; near the axis by its series, whose gradient is finite where the root's is not."""
    k1, k2, k3, k4, _ = (each[:, None] for each in distortion.unbind(-1))
    near = r2 < 1e-8
    r = torch.where(near, 1.0, r2).sqrt()
    t2 = r.atan() ** 2
    d = r.atan() * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4)))) / r
    return torch.where(near, 1 + (k1 - 1 / 3) * r2, d)
