"""Distributions of observation rows that account for missing entries, and for their Gaussian fit, by themselves."""

from abc import abstractmethod

from pyro.distributions import TorchDistribution
from torch import Tensor
from torch.distributions import constraints


class RowDistribution(TorchDistribution):
    """Base of them; event shape (O,). :mod:`.missing` asks them, where it does the rest itself for torch's own."""

    support = constraints.real_vector
    has_rsample = False
    arg_constraints: dict = {}  # noqa: RUF012

    loc: Tensor
    """(..., O) the row without mistakes, about which methods linearise."""

    @abstractmethod
    def log_prob(self, value: Tensor) -> Tensor:
        """Log-density (...) over the entries of rows (..., O) that are not NaN."""

    @abstractmethod
    def gaussian_rows(self, value: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """W (..., O) or (..., O, O), ỹ (..., O) and c (...) with log p(y) ≈ −½|W (ỹ − h)|² + c in the row's middle h.

        The value and the slope in h are equal at ``loc``; rows of W are 0 for what is missing.
        """
