"""Keypoints that a camera would have seen, computed from measured or simulated joint angles.

Forward kinematics of a planar chain: tip_k = base + Σ_{j≤k} L_j (cos φ_j, sin φ_j) with φ_j = Σ_{i≤j} θ_i.
Angles are interpolated linearly to the camera's times, then white noise is added.
"""

from collections.abc import Sequence

import numpy as np

from .errors import InputError
from .recording import Recording
from .truth import Truth


def keypoints_from_angles(
    source: Recording | Truth,
    lengths: Sequence[float],
    noise_sd: float = 0.0,
    rate: float | None = None,
    seed: int = 0,
    *,
    base: Sequence[float] = (0.0, 0.0),
    keypoint_names: Sequence[str] | None = None,
) -> Recording:
    """A keypoint recording without angles or commands, from which the torque is to be inferred.

    Args:
        source: angles (T, K) rad, Denavit–Hartenberg; NaN stays missing.
        lengths: K link lengths, m.
        noise_sd: standard deviation of each coordinate's noise, m.
        rate: frames a second; by default the source's own times.
        seed: of the noise.
        base: (2,) m, the first joint.
        keypoint_names: K names of the tips; by default the next joint's, and "wrist" for the last.

    Raises:
        InputError: a source without angles, or numbers that do not fit.
    """
    angles = source.angle if isinstance(source, Truth) else source.angles
    if angles is None:
        raise InputError("the recording has no joint angles to make keypoints from")
    if len(lengths) != angles.shape[1]:
        raise InputError(f"{angles.shape[1]} joint angles need as many link lengths, got {len(lengths)}")
    if noise_sd < 0 or (rate is not None and not rate > 0):
        raise InputError(f"noise must not be negative and the rate positive, got {noise_sd} and {rate}")
    time = source.time
    if rate is not None:  # 1e-9 keeps a last frame at the end despite rounding
        frames = np.floor((time[-1] - time[0]) * rate + 1e-9) + 1
        time = np.minimum(time[0] + np.arange(frames) / rate, time[-1])
        angles = np.stack([np.interp(time, source.time, column) for column in angles.T], axis=-1)
    phi = np.cumsum(angles, axis=1)
    links = np.asarray(lengths)[:, None] * np.stack([np.cos(phi), np.sin(phi)], axis=-1)
    tips = np.asarray(base) + np.cumsum(links, axis=1)
    noise = np.random.default_rng(seed).normal(size=tips.shape)
    return Recording(
        time=time,
        keypoints=tips + noise_sd * noise,
        keypoint_names=tuple(keypoint_names or (*source.joint_names[1:], "wrist")),
        name=getattr(source, "name", "recording"),
    )
