"""What the camera and the encoders see of the arm's angles.

    keypoints   y_p ~ F(tip_p(θ), σ_p s(c))       σ_p = "emission.keypoint_scale" (P,), length unit
    encoders    y_k ~ F(θ_k, σ_k)                 σ_k = "emission.angle_scale" (K,), rad

F is Gaussian, or Student-t with "emission.df" degrees of freedom (1,) for stray detections.
The tracker's confidence c is a monotone covariate and not a probability: the noise grows as
s(c) = exp(γ (1 − rank(c)) + δ (c⁺ − c) / (c⁺ − c⁻)), with γ = "emission.confidence_slope" and
δ = "emission.confidence_drop", (P,) ≥ 0. rank(c) in (0, 1] is c's place among that keypoint's own
confidences, which most of the differences between good rows follow; c⁻ and c⁺ are the least and the
greatest of them, so that a few rows with a c far below all others can be as good as lost (e^δ)
while the rows just above them in order stay sure. c may be of any scale.

An observation row is the keypoints' coordinates, keypoint by keypoint, then the angles:
(O,) with O = 2 P + K_encoders. NaN is missing.
"""

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch
from pyro.distributions import Chi2, Distribution, Normal, StudentT
from scipy.stats import rankdata
from torch import Tensor

from invdyn.models.mistakes import Shift, Stray, Swap
from invdyn.models.mixture import MistakenRows
from invdyn.models.shapes import join

FAMILIES = ("gaussian", "student_t")


class Emission:
    """Emission of a planar chain.

    Args:
        tips: indices (P,) of the links whose tips are tracked, in the recording's order.
        num_encoders: K when joint angles are observed too, else 0.
        family: "gaussian" or "student_t".
        confidence: (T, P) the tracker's confidence, or None.

    Raises ValueError for an unknown family, or when nothing would be observed.
    """

    def __init__(
        self,
        tips: Sequence[int],
        num_encoders: int = 0,
        family: str = "gaussian",
        confidence: np.ndarray | None = None,
    ):
        if family not in FAMILIES:
            raise ValueError(f"expected a noise family among {', '.join(FAMILIES)}, got {family!r}")
        if not tips and not num_encoders:
            raise ValueError("expected at least one tracked tip or encoder, got none")
        self.tips = list(tips)
        self.num_encoders = num_encoders
        self.family = family
        self.doubt = None if confidence is None else torch.as_tensor(1 - _rank(confidence))
        self.drop = None if confidence is None else torch.as_tensor(_drop(confidence))
        self.doubt_itself = None if confidence is None else torch.as_tensor(1 - np.nan_to_num(confidence, nan=1.0))

    @property
    def size(self) -> int:
        """O, the length of an observation row."""
        return 2 * len(self.tips) + self.num_encoders

    def to(self, device: torch.device | str) -> "Emission":
        """The same with all that a row needs on ``device``."""
        if self.doubt is None:
            return self
        other = copy.copy(self)
        for name in ("doubt", "drop", "doubt_itself"):
            setattr(other, name, getattr(self, name).to(device))
        return other

    def doubted(self, t: int | Tensor, q: Tensor) -> Tensor | None:
        """1 − c of the confidence c at row ``t``, (..., K) as the angles q are, 0 where untracked or not said.

        None where no confidence is known.
        """
        if self.doubt_itself is None:
            return None
        doubt = self.doubt_itself[t].to(q)
        every = [doubt.new_zeros(doubt.shape[:-1])] * q.shape[-1]
        for k, own in zip(self.tips, doubt.unbind(-1), strict=True):
            every[k] = own
        return torch.stack(every, -1)

    def defaults(self, keypoint_scale: float, angle_scale: float = 1e-3) -> dict[str, Tensor]:
        """Starting parameters: the noise sd of a keypoint (length unit) and of an encoder (rad)."""
        parameters: dict[str, Tensor] = {}
        if self.tips:
            parameters["emission.keypoint_scale"] = torch.full((len(self.tips),), keypoint_scale)
            if self.doubt is not None:
                parameters["emission.confidence_slope"] = torch.full((len(self.tips),), 0.1)
                parameters["emission.confidence_drop"] = torch.zeros(len(self.tips))
        if self.num_encoders:
            parameters["emission.angle_scale"] = torch.full((self.num_encoders,), angle_scale)
        if self.family == "student_t":
            parameters["emission.df"] = torch.full((1,), 4.0)
        return {name: value.double() for name, value in parameters.items()}

    def distribution(
        self,
        tips: Tensor,
        q: Tensor,
        t: int | Tensor,
        parameters: Mapping[str, Tensor],
        noise: Callable[[Tensor], Tensor] | None = None,
        mistakes: Sequence[Stray | Swap | Shift] = (),
    ) -> Distribution:
        """Distribution of row ``t``: tips (..., K, 2) and angles q (..., K) → event shape (O,).

        ``noise`` maps the standard deviations of all tips' coordinates (..., K, 2), 1 where none is tracked, to others;
        ``mistakes`` make the keypoints a mixture (:mod:`.mixture`), with tips for their numbers.

        Raises ValueError for mistakes of Student-t noise, which has its own account of stray detections.
        """
        mean, scale = [], []
        if self.tips:
            # Entry by entry: a list of indices would be sent to the device in each row.
            mean.append(torch.stack([tips[..., k, :] for k in self.tips], -2).flatten(-2))
            sd = self._keypoint_scale(t, parameters).repeat_interleave(2, -1)
            if noise is not None:
                every = [sd.new_ones(*sd.shape[:-1], 2)] * tips.shape[-2]
                for k, own in zip(self.tips, sd.unflatten(-1, (-1, 2)).unbind(-2), strict=True):
                    every[k] = own
                sd = noise(torch.stack(every, -2))
                sd = torch.stack([sd[..., k, :] for k in self.tips], -2).flatten(-2)
            scale.append(sd)
        if self.num_encoders:
            mean.append(q)
            scale.append(parameters["emission.angle_scale"])
        loc, scales = join(*mean), join(*scale)
        if mistakes:
            return self._mistaken(loc, scales, mistakes)
        if self.family == "student_t":
            return _UncheckedStudentT(parameters["emission.df"], loc, scales).to_event(1)
        return Normal(loc, scales, validate_args=False).to_event(1)

    def _mistaken(self, loc: Tensor, scale: Tensor, mistakes: Sequence[Stray | Swap | Shift]) -> Distribution:
        if self.family != "gaussian":
            raise ValueError(f"expected gaussian noise under outliers and swaps, got {self.family!r}; drop one of them")
        strays = [self._of_tips(mistake) for mistake in mistakes if isinstance(mistake, Stray)]
        swaps = [
            replace(mistake, one=self.tips.index(mistake.one), other=self.tips.index(mistake.other))
            for mistake in mistakes
            if isinstance(mistake, Swap)
        ]
        shift = next((self._of_tips(mistake) for mistake in mistakes if isinstance(mistake, Shift)), None)
        return MistakenRows(loc, scale, len(self.tips), strays, swaps, shift)

    def _of_tips(self, mistake: Stray | Shift) -> Stray | Shift:
        """The tracked ones of all tips' widths."""
        sizes = {name: value for name, value in vars(mistake).items() if name != "rate" and value.shape[-2] > 1}
        return replace(mistake, **{n: torch.stack([v[..., k, :] for k in self.tips], -2) for n, v in sizes.items()})

    def _keypoint_scale(self, t: int | Tensor, parameters: Mapping[str, Tensor]) -> Tensor:
        scale = parameters["emission.keypoint_scale"]
        if self.doubt is None:
            return scale
        by_order = parameters["emission.confidence_slope"] * self.doubt[t].to(scale)
        return scale * torch.exp(by_order + parameters["emission.confidence_drop"] * self.drop[t].to(scale))


class _UncheckedStudentT(StudentT):
    """Student-t noise whose parameters (..., O) nobody checks.

    torch's own class has the χ² inside it checked whatever ``validate_args`` says: the host would wait in each row.
    """

    def __init__(self, df: Tensor, loc: Tensor, scale: Tensor):
        self.df, self.loc, self.scale = torch.broadcast_tensors(df, loc, scale)
        self._chi2 = Chi2(self.df, validate_args=False)
        torch.distributions.Distribution.__init__(self, self.df.shape, validate_args=False)

    def expand(self, batch_shape, _instance=None):
        """See :class:`torch.distributions.Distribution`."""
        return super().expand(batch_shape, self._get_checked_instance(_UncheckedStudentT, _instance))


def _rank(confidence: np.ndarray) -> np.ndarray:
    """Each entry's rank among its column's finite ones, in (0, 1]; a missing confidence ranks lowest."""
    filled = np.where(np.isfinite(confidence), confidence, -np.inf)
    return rankdata(filled, method="max", axis=0) / len(filled)


def _drop(confidence: np.ndarray) -> np.ndarray:
    """How far each entry lies below its column's greatest, of the column's range: in [0, 1]; 1 where it is missing."""
    known = np.isfinite(confidence)
    least = np.where(known, confidence, np.inf).min(axis=0)
    greatest = np.where(known, confidence, -np.inf).max(axis=0)
    apart = greatest > least  # False in a column of one value, or of none
    fall = np.where(known & apart, greatest - confidence, 0.0) / np.where(apart, greatest - least, 1.0)
    return np.where(known, fall, 1.0)
