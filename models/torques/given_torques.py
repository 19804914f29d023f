"""The whole state of a torque process at the last row, given the torques of all rows.

z is a linear-Gaussian chain, of which the torques τ_t = H z_t, H = (I 0), are known without error. A Kalman filter
without observation noise then gives z_T | τ_{0:T} ~ N(m, P); Särkkä, Bayesian Filtering and Smoothing (2013), theorem
4.2. With S = H P Hᵀ and G = P Hᵀ S⁻¹, each row has

    m ← m + G (τ_t − H m),    P ← (I − G H) P (I − G H)ᵀ

P and G are the same for all paths of torques. Where the arm is moved by τ alone, nothing else tells of z.
"""

import torch
from torch import Tensor

from invdyn.models.torques.base import Parameters, TorqueProcess


def given_torques(
    process: TorqueProcess, torques: Tensor, time: Tensor, parameters: Parameters
) -> tuple[Tensor, Tensor]:
    """Means (S, Z) and the common covariance (Z, Z) of z in the last row.

    Args:
        process: linear and Gaussian in z (``torques_suffice``).
        torques: (S, T, K) N·m, S paths.
        time: (T,) s.
        parameters: (K,) each, of the process.
    """
    joints = torques.shape[-1]
    size, like = process.size(joints), torques[0, 0]
    identity = torch.eye(size, dtype=like.dtype)
    intervals = torch.diff(time)
    root = process.stationary(intervals[0], parameters)
    mean, covariance = like.new_zeros(len(torques), size), root @ root.mT
    for row in range(len(time)):
        if row:
            propagator = process.mean(identity, intervals[row - 1], parameters).mT
            root = process.noise(intervals[row - 1], parameters)
            mean = mean @ propagator.mT
            covariance = propagator @ covariance @ propagator.mT + root @ root.mT
        gain = torch.linalg.solve(covariance[:joints, :joints], covariance[:joints]).mT
        left = identity.clone()
        left[:, :joints] -= gain
        mean = mean + (torques[:, row] - mean[:, :joints]) @ gain.mT
        covariance = left @ covariance @ left.mT
    return mean, covariance
