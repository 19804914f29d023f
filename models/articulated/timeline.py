"""The rows' clocks: when each row is, how long its step lasts, and since when what came before it is known.

Shapes: T rows; of a row's clocks (..., 1), which broadcast with joint quantities.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
import torch
from torch import Tensor

Row = int | Tensor
"""Number of a row, or of many."""
SAME = 1e-6
"""Of a step by which others may differ and count as equal to it: less than clocks are exact to."""


@dataclass(frozen=True, eq=False)
class Timeline:
    """A time grid.

    Attributes:
        time: (T,) s, increasing.
        dt: (T,) s; dt[t] is the step that ends at row t. Row 0 has none and stands for the stationary law.
        elapsed: (T,) s since the first row.
        since: (T,) s since what acted before is known: the first row of a recording, or of its commands.
        restarts: rows (T,) at which another recording starts; None where there is one.
        middle: (T, K) rad, angles about which it may start there.
    """

    time: Tensor
    dt: Tensor
    elapsed: Tensor
    since: Tensor
    restarts: Tensor | None = None
    middle: Tensor | None = None

    @classmethod
    def of(cls, time: Sequence[float] | np.ndarray | Tensor) -> Self:
        """The grid of increasing times (T,), s. Raises ValueError for others."""
        grid = torch.as_tensor(np.ascontiguousarray(time, dtype=np.float64))
        if grid.ndim != 1 or len(grid) < 2 or bool((grid.diff() <= 0).any()):
            raise ValueError("expected at least two strictly increasing times, in seconds")
        intervals, elapsed = grid.diff(), grid - grid[0]
        return cls(grid, torch.cat([intervals.median().reshape(1), intervals]), elapsed, elapsed)

    @cached_property
    def regular(self) -> bool:
        """Whether all steps are equal."""
        return bool(((self.dt - self.dt[0]).abs() <= SAME * self.dt[0]).all())

    def to(self, device: torch.device) -> "Timeline":
        """The same on ``device``; itself where it is there."""
        if self.time.device == device:
            return self
        clocks = {name: each.to(device) for name, each in vars(self).items() if isinstance(each, Tensor)}
        moved = replace(self, **clocks)
        moved.__dict__["regular"] = self.regular  # looked at where numbers are at hand
        return moved

    def known_from(self, begin: Tensor) -> Self:
        """The grid where commands are known from the time ``begin``, s."""
        return replace(self, since=self.time - begin.to(self.time))

    def restarted_at(self, rows: Sequence[int], angle: Tensor) -> Self:
        """The grid of several recordings one after another: at ``rows`` (R,) one starts, about ``angle`` (R, K) rad."""
        first = torch.zeros(len(self.time), dtype=torch.bool)
        middle = torch.zeros(len(self.time), angle.shape[-1], dtype=torch.float64)
        first[list(rows)], middle[list(rows)] = True, angle.double()
        first, middle = first.to(self.time.device), middle.to(self.time.device)
        began = torch.where(first, self.time, -torch.inf).cummax(0).values
        return replace(self, restarts=first, middle=middle, since=torch.minimum(self.since, self.time - began))

    def interval(self, t: Row, dtype: torch.dtype) -> Tensor:
        """What the step into row ``t`` is said to last, s, (..., 1)."""
        return self.dt[t].to(dtype).unsqueeze(-1)

    def clock(self, t: Row, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
        """Row ``t``'s time and that since the first row, s, (..., 1)."""
        time, elapsed = (clock[t].to(dtype).unsqueeze(-1) for clock in (self.time, self.elapsed))
        return time, elapsed
