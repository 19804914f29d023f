"""What drives a body: commands, and what its motors make of them.

A command (T, K) N·m is constant from each row to the next, or between finer times of its own. Effects on motors,
such as a gain or a delay, make another of it, a straight line within each row (:mod:`invdyn.models.effects.command`).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
import torch
from torch import Tensor

from invdyn.models.articulated.timeline import Row, Timeline
from invdyn.models.effects.command import Command
from invdyn.models.effects.composition import Composition


@dataclass(frozen=True, eq=False)
class Drive:
    """Known torques.

    Attributes:
        command: (T, K) N·m, of each row the mean until the next; None without a command.
        finer: the same as it was given at other times than the rows', or None.
    """

    command: Tensor | None = None
    finer: Command | None = None

    @classmethod
    def held(cls, command: np.ndarray | Tensor | None, shape: tuple[int, int]) -> Self:
        """A command of ``shape`` (T, K) that is constant within rows, or none. Raises ValueError for another shape."""
        if command is None:
            return cls()
        given = torch.as_tensor(np.asarray(command, dtype=np.float64))
        if given.shape != shape:
            raise ValueError(f"expected a command of shape {shape}, got {given.shape}")
        return cls(given)

    def driven_by(self, time: Tensor, torque: Tensor, rows: Tensor) -> Self:
        """Under a command (C, K) N·m, constant between times (C,) s, for rows at times ``rows`` (T,)."""
        finer = Command.held(time, torque).to(rows.device)
        return replace(self, command=finer.onto(rows).mean, finer=finer)

    def to(self, device: torch.device) -> "Drive":
        """The same on ``device``."""
        if self.command is None or self.command.device == device:
            return self
        return Drive(self.command.to(device), None if self.finer is None else self.finer.to(device))


@dataclass(frozen=True, eq=False)
class Motors:
    """What motors with these parameters make of a command; computed once, at first use."""

    drive: Drive
    timeline: Timeline
    effects: Composition
    parameters: Mapping[str, Tensor]
    joints: int
    dtype: torch.dtype

    @property
    def commanded(self) -> bool:
        """Whether there is a command."""
        return self.drive.command is not None

    @cached_property
    def made(self) -> Command:
        """The command as the actuators make it; zero without a command."""
        time, given = self.timeline.time, self.drive.command
        torque = time.new_zeros(len(time), self.joints) if given is None else given
        held = self.drive.finer or Command.held(time, torque)
        if self.effects.changes("command"):
            # In float64, as times are long and steps short, in states of either type.
            held = self.effects.command({name: value.double() for name, value in self.parameters.items()}, held)
        held = held if held.time is time else held.onto(time)
        return Command(held.time, held.mean.to(self.dtype), held.slope.to(self.dtype))

    def about(self, t: Row, like: Tensor) -> Tensor | None:
        """The mean of the commands before and after row ``t``, which may jump there, (..., K); None without any."""
        if not self.commanded:
            return None
        (before, rising), (after, slope) = (
            [value.to(like) for value in self.made.row(row)] for row in (_since_the_first(t), t + 1)
        )
        return (before + rising / 2 + after - slope / 2) / 2

    def ahead(self, t: Row, seconds: Tensor) -> Tensor | None:
        """What of a command moves the body within ``seconds`` (..., 1) of row ``t``; see :meth:`Command.ahead`."""
        return self.made.ahead(self.timeline.time[t], seconds) if self.commanded else None

    def between(self, t: Row, first: Tensor, last: Tensor, like: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and slope of the command from ``first`` to ``last`` s after row ``t``; zeros as ``like`` without any."""
        if not self.commanded:
            return torch.zeros_like(like), torch.zeros_like(like)
        mean, slope = self.made.between(self.timeline.time[t], first, last)
        return mean, slope


@dataclass(frozen=True)
class RowDrive:
    """What drives a body from one row to the next.

    Attributes:
        start, change: N·m, (..., K): torque of process and motors, start + s change, 0 ≤ s ≤ 1.
        body: its numbers as the effects leave them.
        clock: of the row in which it begins.
        interval, dt: s, (..., 1), what the row is said to last, and what it lasts.
        parts: sub-steps.
        unknown, drift: of start and change the torque process's part; None, where servos need no command.
        carried: b̈ of a base that moves and its change within the row, m/s², (..., d) each; None of one at rest.
    """

    start: Tensor
    change: Tensor | float
    body: Any
    clock: tuple[Tensor, Tensor]
    interval: Tensor
    dt: Tensor
    parts: int
    unknown: Tensor | None = None
    drift: Tensor | float = 0.0
    carried: tuple[Tensor, Tensor | float] | None = None

    def commanded(self, s: float | Tensor) -> Tensor:
        """Of :meth:`motor` what was commanded."""
        torque = self.motor(s)
        return torque if self.unknown is None else torque - self.unknown - s * self.drift

    def motor(self, s: float | Tensor) -> Tensor:
        """The torque a share ``s`` of the row after its start."""
        return self.start + s * self.change


def _since_the_first(t: Row) -> Row:
    """The row before row ``t``; of the first row, the one after it."""
    return t.clamp_min(1) if isinstance(t, Tensor) else max(t, 1)
