"""What particle filters carry: their result, its history, and Pyro's particle state for many filters at once."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

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
        before: makes the same of the rows before these W, where all rows are smoothed in windows.
    """

    log_evidence: Tensor
    log_evidence_increment: Tensor
    ess: Tensor
    resampled: Tensor
    states: Tensor
    log_weights: Tensor
    log_twist: Tensor | None
    ancestors: Tensor
    before: "Callable[[], FilterResult] | None" = field(default=None, kw_only=True)

    @property
    def rows(self) -> int:
        """Number of rows whose particles are there, or can be made."""
        return len(self.states) if self.before is None else len(self.ess)

    def backwards(self) -> Iterator[tuple[Tensor, Tensor, Tensor | None, Tensor]]:
        """States, log-weights, log-twist and ancestors of those rows, from the last one."""
        some: FilterResult | None = self
        while some is not None:
            for k in range(len(some.states) - 1, -1, -1):
                twist = None if some.log_twist is None else some.log_twist[k]
                yield some.states[k], some.log_weights[k], twist, some.ancestors[k]
            some = some.before and some.before()

    def of_filters(self, own: Tensor | slice, log_evidence: Tensor) -> "FilterResult":
        """What is known, particles aside, of the filters ``own``, with other log-evidences (M,)."""
        numbers = {name: getattr(self, name)[:, own] for name in ("log_evidence_increment", "ess", "resampled")}
        return replace(self, log_evidence=log_evidence[own], **numbers)

    def cpu(self) -> "FilterResult":
        """The same on the CPU, where paths are smoothed in float64, as the smoother is."""

        def moved(name: str) -> Any:
            value = getattr(self, name)
            if callable(value):
                return lambda: value().cpu()
            return value if value is None else value.cpu()

        return FilterResult(**{field.name: moved(field.name) for field in fields(self)})


def joined(results: Sequence[FilterResult]) -> FilterResult:
    """All filters of several runs over the same rows, as of one."""

    def combined(name: str) -> Any:
        values = [getattr(result, name) for result in results]
        return None if values[0] is None else torch.cat(values, 0 if name == "log_evidence" else 1)

    return FilterResult(**{field.name: combined(field.name) for field in fields(FilterResult)})


class History:
    """One number per row and filter, and the last ``keep`` rows of particles, in tensors made once.

    Nothing is allocated row by row: over ten thousand rows small leftovers would pin the heap apart.
    """

    def __init__(self, rows: int, keep: int, filters: int, device: torch.device | str):
        self.first = rows - keep
        self.increment = torch.empty(rows, filters, dtype=torch.float64, device=device)
        self.ess = torch.empty_like(self.increment)
        self.resampled = torch.empty(rows, filters, dtype=torch.bool, device=device)
        self.keep_from(self.first, keep)

    def keep_from(self, first: int, count: int) -> None:
        """Keep ``count`` rows from this one on, and no longer those before."""
        self.first, self._keep = first, count
        self._kept: list[Tensor] = []

    def note(self, t: int, increment: Tensor, ess: Tensor, resampled: Tensor) -> None:
        """Row t's evidence increment, ESS and whether it was resampled, (M,) each."""
        for whole, value in zip((self.increment, self.ess, self.resampled), (increment, ess, resampled), strict=True):
            whole[t].copy_(value)

    def keep_row(self, t: int, x: Tensor, log_weights: Tensor, parents: Tensor, log_twist: Tensor | None) -> None:
        """Row t's particles, if it is one of those to keep."""
        if not 0 <= t - self.first < self._keep:
            return
        # Integers hold no log-weights.
        weights = log_weights.to(x.dtype) if x.is_floating_point() else log_weights
        pieces = [x, weights, parents.to(torch.int32)]
        pieces += [] if log_twist is None else [log_twist]
        if not self._kept:
            self._kept = [piece.new_empty(self._keep, *piece.shape) for piece in pieces]
        for whole, piece in zip(self._kept, pieces, strict=True):
            whole[t - self.first] = piece

    def result(self, log_evidence: Tensor, before: Callable[[], FilterResult] | None = None) -> FilterResult:
        """All of it."""
        states, log_weights, ancestors, *twist = self._kept or [torch.empty(0)] * 3
        return FilterResult(
            log_evidence=log_evidence,
            log_evidence_increment=self.increment,
            ess=self.ess,
            resampled=self.resampled,
            states=states,
            log_weights=log_weights,
            log_twist=twist[0] if twist else None,
            ancestors=ancestors,
            before=before,
        )


class FilterState(SMCState):
    """Pyro's particle state with any number of leading batch dimensions, (M, N) or (N,)."""

    def __init__(self, batch: tuple[int, ...]):
        super().__init__(batch[-1])
        self._batch = tuple(batch)
        self._log_weights = torch.full(batch, -math.log(batch[-1]), dtype=torch.float64)

    def __setitem__(self, key: str, value: Tensor) -> None:
        """Store a tensor whose leading dimensions are the batch; guides may not write."""
        if self._locked:
            raise RuntimeError("a guide cannot write to the particles' state: only the model can")
        if not isinstance(value, Tensor) or tuple(value.shape[: len(self._batch)]) != self._batch:
            shape = tuple(value.shape) if isinstance(value, Tensor) else type(value).__name__
            raise ValueError(f"expected state[{key!r}] to begin with dimensions {self._batch}, got {shape}")
        dict.__setitem__(self, key, value)

    def _replace(self, values: dict[str, Tensor], log_weights: Tensor) -> None:
        """Put in resampled values of the same keys, and the weights."""
        dict.update(self, values)
        self._log_weights = log_weights


def take(value: Tensor, index: Tensor) -> Tensor:
    """Particles (…, N, …) at ``index`` (…, N), stored as they were."""
    batch = index.ndim
    if value.ndim == batch + 1 and value.shape[-1] > 1 and value.stride(-1) != 1:  # entry by entry, as compiled rows do
        return value.movedim(-1, 0).gather(-1, index.expand(value.shape[-1], *index.shape)).movedim(0, -1)
    # One long list of particles: a gather with an index for each number takes four times as long.
    start = torch.arange(0, index.numel(), index.shape[-1], device=index.device).reshape(*index.shape[:-1], 1)
    chosen = value.flatten(0, batch - 1).index_select(0, (index + start).flatten())
    return chosen.unflatten(0, index.shape)


def take_at(states: Tensor, index: Tensor) -> Tensor:
    """States (M, N, D) at any number of indices (M, R) → (M, R, D)."""
    return states.gather(-2, index.unsqueeze(-1).expand(*index.shape, states.shape[-1]))
