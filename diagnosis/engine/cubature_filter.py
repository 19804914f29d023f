"""The cubature Kalman filter of a model on MuJoCo's engine, under several sizes of the residual torque at once.

I. Arasaratnam & S. Haykin, "Cubature Kalman filters", IEEE Trans. Automatic Control 54, 2009: over N(m, P), P = S Sᵀ,
means and slopes are fitted at the 2D points m ± √D S_i, so that a contact within reach counts by its share of them,

    f̄ = mean f(m ± √D S_i),   F = [f_i+ − f_i−]/(2√D) S⁻¹,   V = scatter that F leaves,   P' = F P Fᵀ + V Vᵀ + Q .

The controls are known and encoders are sharp, so that P is narrow: no path has to be found first. Innovations whitened
by their own covariance, w_t = S_t^{-1/2} (y_t − ŷ_t), tell the evidence, Σ_t log N(w_t; 0, I) − ½ log |S_t|.

A change of a number of the model moves the predicted state by columns c with the same gains K,

    w'_t = −S_t^{-1/2} H_t c_t,     c_{t+1} = F_t (I − K_t H_t) c_t + g_t,     g_t = ∂f(m_t)/∂ν .

Shapes: T rows, D states, O observations, G sizes, J numbers.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from invdyn.models import EngineModel
from invdyn.models.divergence import Diverged, diverging
from invdyn.models.state_space import gaussian_moments


@dataclass(frozen=True)
class Filtered:
    """What the filter makes of a recording.

    Attributes:
        innovations: (G, T, O) whitened, zero where missing.
        log_det: (G, T) ½ log |S_t| of what was seen.
        mean, sd: (G, T, D) given the rows up to each.
        whitening, gain, slope: (T, G, O, O), (T, G, D, O) and (T, G, O, D): S^{-1/2}, K and H.
        transition: (T − 1, G, D, D) F.
    """

    innovations: np.ndarray
    log_det: np.ndarray
    mean: np.ndarray
    sd: np.ndarray
    whitening: np.ndarray
    gain: np.ndarray
    slope: np.ndarray
    transition: np.ndarray

    @classmethod
    def joined(cls, parts: Sequence["Filtered"]) -> "Filtered":
        """Of recordings one after the other, from each to the next of which nothing is carried over."""
        if len(parts) == 1:
            return parts[0]
        by_row = {
            name: np.concatenate([getattr(each, name) for each in parts]) for name in ("whitening", "gain", "slope")
        }
        by_size = {
            name: np.concatenate([getattr(each, name) for each in parts], 1)
            for name in ("innovations", "log_det", "mean", "sd")
        }
        return cls(**by_size, **by_row, transition=apart([each.transition for each in parts]))

    def columns(self, inputs: np.ndarray) -> np.ndarray:
        """What inputs g (T − 1, G, D, J) change in the whitened innovations, (G, T, O, J)."""
        count, sizes, dim, numbers = inputs.shape
        out = np.empty((count + 1, sizes, self.whitening.shape[-1], numbers))
        own = np.zeros((sizes, dim, numbers))
        for t in range(count + 1):
            seen = self.slope[t] @ own
            out[t] = -self.whitening[t] @ seen
            if t < count:
                own = self.transition[t] @ (own - self.gain[t] @ seen) + inputs[t]
        return out.swapaxes(0, 1)


def apart(steps: Sequence[np.ndarray]) -> np.ndarray:
    """Arrays (T_r − 1, …) of steps between rows, one after the other, with zeros for the steps between recordings."""
    between = np.zeros_like(steps[0][:1])
    return np.concatenate([each for own in steps for each in (between, own)])[1:]


@diverging()
def cubature_filter(model: EngineModel, observations: np.ndarray, sizes: np.ndarray) -> Filtered:
    """Filter ``observations`` (T, O), NaN where missing, of a model whose residual has a size of one.

    Raises Diverged where the simulation runs away.
    """
    rows, width = observations.shape
    dim, drive, count = model.state_dim, model.torque_size, len(sizes)
    scale = np.ones((count, dim))
    scale[:, :drive] = sizes[:, None]
    first, spread = (each.numpy() for each in gaussian_moments(model.initial()))
    mean, root = np.tile(first.reshape(-1, dim)[0], (count, 1)), scale[:, :, None] * spread.reshape(-1, dim, dim)[0]
    covariance = root @ root.swapaxes(-1, -2)
    shape = (rows, count)
    innovation, log_det = np.zeros((*shape, width)), np.zeros(shape)
    means, sds = np.zeros((*shape, dim)), np.zeros((*shape, dim))
    whitening, gain = np.zeros((*shape, width, width)), np.zeros((*shape, dim, width))
    slopes, transitions = np.zeros((*shape, width, dim)), np.zeros((rows - 1, count, dim, dim))
    for t in range(rows):
        seen = np.flatnonzero(np.isfinite(observations[t]))
        if len(seen):
            points, root = _points(mean, covariance)
            emission = model.emission(torch.as_tensor(points), t)
            base = getattr(emission, "base_dist", emission)
            sd = np.broadcast_to(base.scale.numpy(), (*points.shape[:-1], width))[0, 0, seen]
            expected, H, V = _fitted(base.loc.numpy()[..., seen], root)
            S = H @ covariance @ H.swapaxes(-1, -2) + V + np.diag(sd**2)
            lower = np.linalg.cholesky(S)
            inverse = np.linalg.inv(lower)
            K = covariance @ H.swapaxes(-1, -2) @ inverse.swapaxes(-1, -2) @ inverse
            off = observations[t, seen] - expected
            innovation[t][:, seen] = (inverse @ off[..., None])[..., 0]
            log_det[t] = np.log(np.diagonal(lower, axis1=-2, axis2=-1)).sum(-1)
            whitening[t][:, seen[:, None], seen] = inverse
            gain[t][:, :, seen], slopes[t][:, seen] = K, H
            mean = mean + (K @ off[..., None])[..., 0]
            left = np.eye(dim) - K @ H
            covariance = left @ covariance @ left.swapaxes(-1, -2) + K @ (V + np.diag(sd**2)) @ K.swapaxes(-1, -2)
        means[t], sds[t] = mean, np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
        if t < rows - 1:
            points, root = _points(mean, covariance)
            moved, noise = gaussian_moments(model.transition(torch.as_tensor(points), t + 1))
            step = scale[:, :, None] * noise.numpy().reshape(-1, dim, dim)[0]
            mean, F, V = _fitted(moved.numpy(), root)
            covariance = F @ covariance @ F.swapaxes(-1, -2) + V + step @ step.swapaxes(-1, -2)
            transitions[t] = F
        if not (np.isfinite(mean).all() and np.isfinite(covariance).all()):
            raise Diverged(f"the simulation runs away from the recording at {float(model.time[t]):.3g} s")
    innovation, means, sds = (each.swapaxes(0, 1) for each in (innovation, means, sds))
    return Filtered(innovation, log_det.T, means, sds, whitening, gain, slopes, transitions)


def _points(mean: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points (2D, G, D) about means (G, D), opposite ones D apart, and roots (G, D, D); a floor keeps these regular."""
    dim = mean.shape[-1]
    sd = np.sqrt(np.maximum(np.diagonal(covariance, axis1=-2, axis2=-1), 1e-24))
    correlation = covariance / (sd[:, :, None] * sd[:, None, :])
    root = sd[:, :, None] * np.linalg.cholesky((correlation + correlation.swapaxes(-1, -2)) / 2 + 1e-9 * np.eye(dim))
    off = np.sqrt(dim) * np.moveaxis(root, -1, 0)
    return np.concatenate([mean + off, mean - off]), root


def _fitted(values: np.ndarray, root: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of values (2D, G, P) at points: mean (G, P), slope (G, P, D) and the covariance (G, P, P) that it leaves."""
    dim = root.shape[-1]
    plus, minus = values[:dim], values[dim:]
    middle = (plus + minus) / 2
    average = middle.mean(0)
    odd = np.moveaxis(plus - minus, 0, -1) / (2 * np.sqrt(dim))
    slope = np.linalg.solve(root.swapaxes(-1, -2), odd.swapaxes(-1, -2)).swapaxes(-1, -2)
    even = np.moveaxis(middle - average, 0, -1) / np.sqrt(dim)
    return average, slope, even @ even.swapaxes(-1, -2)
