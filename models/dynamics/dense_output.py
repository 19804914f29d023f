"""Motion within an integrator's step, and when it passes a stop.

The polynomial of fourth order in τ = t / h, from 0 to 1, with x, ẋ, ẍ at 0 and x, ẋ at 1 (Hairer, Nørsett & Wanner,
"Solving Ordinary Differential Equations I", II.6, dense output by Hermite interpolation):

    x(τ) = x₀ + τ h ẋ₀ + ½ τ² h² ẍ₀ + τ³ (4 Δ − E) + τ⁴ (E − 3 Δ),
    Δ = x₁ − x₀ − h ẋ₀ − ½ h² ẍ₀,   E = h (ẋ₁ − ẋ₀ − h ẍ₀)

Shapes: (..., K); h and τ (..., 1). rad, rad/s, rad/s², s.
"""

from typing import NamedTuple

import torch
from torch import Tensor

ITERATIONS = 5
"""Of Newton's method, which doubles the digits with each."""


class Passage(NamedTuple):
    """A step's motion between its ends."""

    x0: Tensor
    v0: Tensor
    a0: Tensor
    x1: Tensor
    v1: Tensor
    h: Tensor

    def at(self, share: Tensor) -> tuple[Tensor, Tensor]:
        """The motion x and its h ẋ at ``share`` = τ."""
        v0, a0, v1 = self.h * self.v0, self.h**2 * self.a0, self.h * self.v1
        off, turned = self.x1 - self.x0 - v0 - a0 / 2, v1 - v0 - a0
        third, fourth = 4 * off - turned, turned - 3 * off
        x = self.x0 + share * (v0 + share * (a0 / 2 + share * (third + share * fourth)))
        return x, v0 + share * (a0 + share * (3 * third + 4 * share * fourth))

    def until(self, share: Tensor, where: Tensor) -> tuple[Tensor, Tensor]:
        """The motion x and its ẋ at ``share`` = τ in the rows ``where``; at the end elsewhere."""
        x, moved = self.at(share)
        return torch.where(where, x, self.x1), torch.where(where, moved / torch.where(where, self.h, 1.0), self.v1)

    def only(self, coordinate: int) -> "Passage":
        """Of one coordinate, (..., 1)."""
        x0, v0, a0, x1, v1 = (each[..., coordinate : coordinate + 1] for each in self[:-1])
        return Passage(x0, v0, a0, x1, v1, self.h)

    def reaches(self, stop: Tensor, where: Tensor) -> Tensor:
        """τ (..., 1) at which one coordinate, which ends beyond ``stop``, last passes it; one but for ``where``.

        By Newton's method from the end back: where the coordinate speeds up no step is too long, and where it slows
        down the first one at most.
        """
        share = torch.ones_like(stop)
        for left in reversed(range(ITERATIONS)):
            # The last step alone has all of its slope.
            with torch.set_grad_enabled(torch.is_grad_enabled() and not left):
                x, v = self.at(share)
                share = share - torch.where(where, (x - stop) / torch.where(where & (v != 0), v, 1.0), 0.0)
                share = share.clamp(0, 1)
        return share
