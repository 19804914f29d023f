"""What particle filters carry: their result, its history, and Pyro's particle state for many filters at once."""

import math
from dataclasses import dataclass, field

import torch
from pyro.infer.smcfilter import SMCState
from torch import Tensor


@dataclass
class FilterResult:
    """What a run leaves. M filters, N particles, T rows, of which the last W were kept.

    Attributes:
        log_evidence: (M,) log p̂(y_{0:T}), float64.
        log_evidence_increment: (T, M) log p̂(y_t | y_{0:t}) under the twisted targets.
        ess: (T, M) effective sample size before resampling.
        resampled: (T, M) bool, whether row t's particles were resampled after weighting.
        states: (W, M, N, D) particles of the last W rows, before resampling.
        log_weights: (W, M, N) their normalised log-weights.
        log_twist: (W, M, N) log ψ̃_t(x_t), to be subtracted for the untwisted filter; or None.
        ancestors: (W, M, N) index at the row before of each particle's parent (row 0: itself).
    """

    log_evidence: Tensor
    log_evidence_increment: Tensor
    ess: Tensor
    resampled: Tensor
    states: Tensor
    log_weights: Tensor
    log_twist: Tensor | None
    ancestors: Tensor


@dataclass
class History:
    """The last ``keep`` rows, and one number per row and filter for all of them."""

    keep: int
    increments: list[Tensor] = field(default_factory=list)
    ess: list[Tensor] = field(default_factory=list)
    resampled: list[Tensor] = field(default_factory=list)
    rows: list[tuple[Tensor, ...]] = field(default_factory=list)

    def add_row(self, row: tuple[Tensor, ...]) -> None:
        """Remember a row, and forget the oldest beyond ``keep``."""
        self.rows.append(row)
        if len(self.rows) > self.keep:
            self.rows.pop(0)


class FilterState(SMCState):
    """Pyro's particle state with any number of leading batch dimensions, (M, N) or (N,)."""

    def __init__(self, batch: tuple[int, ...]):
        super().__init__(batch[-1])
        self._batch = tuple(batch)
        self._log_weights = torch.full(batch, -math.log(batch[-1]), dtype=torch.float64)

    def __setitem__(self, key, value):
        """Store a tensor whose leading dimensions are the batch; guides may not write."""
        if self._locked:
            raise RuntimeError("a guide cannot write to the particles' state: only the model can")
        if not isinstance(value, Tensor) or tuple(value.shape[: len(self._batch)]) != self._batch:
            shape = tuple(value.shape) if isinstance(value, Tensor) else type(value).__name__
            raise ValueError(f"expected state[{key!r}] to begin with dimensions {self._batch}, got {shape}")
        dict.__setitem__(self, key, value)

    def _resample(self, index: Tensor) -> None:
        for key, value in self.items():
            dict.__setitem__(self, key, take(value, index))


def take(value: Tensor, index: Tensor) -> Tensor:
    """Particles (…, N, *rest) at ``index`` (…, N)."""
    rest = value.shape[index.ndim :]
    expanded = index.reshape(*index.shape, *([1] * len(rest))).expand(*index.shape, *rest)
    return value.gather(index.ndim - 1, expanded)
