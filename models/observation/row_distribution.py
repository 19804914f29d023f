"""Distributions of observation rows that account for missing entries, and for their Gaussian fit, by themselves."""

from abc import abstractmethod

from pyro.distributions import TorchDistribution
from torch import Tensor
from torch.distributions import constraints


class RowDistribution(TorchDistribution):
    """Base class; event shape (O,). :mod:`.missing` calls their methods, and computes the same for torch's own classes.

    Each has ``loc`` (..., O), the row without mistakes, about which methods linearise.
    """

    support = constraints.real_vector
    has_rsample = False
    arg_constraints: dict = {}  # noqa: RUF012

    @abstractmethod
    def log_prob(self, value: Tensor) -> Tensor:
        """Log-density (...) over the entries of rows (..., O) that are not NaN."""

    @abstractmethod
    def gaussian_rows(self, value: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """W (..., O) or (..., O, O), ỹ (..., O) and c (...) with log p(y) ≈ −½|W (ỹ − h)|² + c in the row's middle h.

        The value and the slope in h are equal at ``loc``; rows of W are 0 for what is missing.
        """
