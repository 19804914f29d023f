"""Missing observations drop out of the likelihood.

An entry of y that is NaN contributes no term: it is masked in an independent emission and
marginalised out of a correlated Gaussian one. It is never filled in. A :class:`RowDistribution` does so by itself.
"""

import math
from abc import abstractmethod

import pyro
import torch
from pyro.distributions import Distribution, MultivariateNormal, TorchDistribution
from torch import Tensor
from torch.distributions import Independent, constraints


class RowDistribution(TorchDistribution):
    """Base of rows, event shape (O,), that leave out missing entries by themselves; torch's own classes do not.

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


def observe(name: str, emission: Distribution, observation: Tensor) -> None:
    """Condition on ``observation`` (O,) at the Pyro site ``name``; no site if all of it is missing."""
    seen = ~torch.isnan(observation)
    if bool(seen.all()):
        pyro.sample(name, emission, obs=observation)
    elif bool(seen.any()):
        if isinstance(emission, RowDistribution):
            pyro.sample(name, emission, obs=observation)  # which leaves out missing entries itself
        elif isinstance(emission, Independent):
            pyro.sample(name, emission.base_dist.mask(seen).to_event(1), obs=filled(emission, observation, seen))
        else:
            pyro.sample(name, _marginal(emission, seen), obs=observation[seen])


def observed_log_prob(emission: Distribution, observation: Tensor, seen: Tensor | None = None) -> Tensor:
    """Log p(y | x) over the entries that were seen; shape is the emission's batch shape.

    ``observation`` (..., O) broadcasts against the emission. A correlated emission takes one
    row (O,), or rows (T, O) against a batch shape that ends in T. ``seen``, of the observation's shape, are the entries
    that are not missing; with it an independent emission needs no synchronisation with the device.
    """
    if seen is None:
        seen = ~torch.isnan(observation)
        if bool(seen.all()):
            return emission.log_prob(observation)
    if isinstance(emission, RowDistribution):
        return emission.log_prob(observation)
    if isinstance(emission, Independent):
        return (emission.base_dist.log_prob(filled(emission, observation, seen)) * seen).sum(-1)
    if observation.ndim == 1:
        if not bool(seen.any()):
            return emission.loc.new_zeros(emission.batch_shape)
        return _marginal(emission, seen).log_prob(observation[seen])
    rows = [
        observed_log_prob(MultivariateNormal(loc, scale_tril=tril), y)
        for loc, tril, y in zip(
            emission.loc.unbind(-2), emission.scale_tril.unbind(-3), observation.unbind(-2), strict=True
        )
    ]
    return torch.stack(rows, -1)


def filled(emission: Independent, observation: Tensor, seen: Tensor) -> Tensor:
    """``observation`` with a value inside the emission's support where not ``seen``, to be masked.

    Its log-density and gradient are finite: NaN or infinity would come through the mask.
    """
    return torch.where(seen, observation, _value_inside(emission.base_dist, observation))


def _value_inside(base: Distribution, like: Tensor) -> Tensor:
    """A value in the support of each entry, far from the limits of continuous ones; of the type of ``like``."""
    support = base.support
    if isinstance(support, type(constraints.real)):
        # A heavy-tailed Student-t has no mean.
        return base.mean.detach().nan_to_num()
    zero = torch.zeros(base.batch_shape, dtype=like.dtype, device=like.device)
    if support.is_discrete:
        return zero + getattr(support, "lower_bound", 0)
    try:
        return torch.distributions.transform_to(support)(zero).detach()
    except NotImplementedError:  # a support of no standard kind, as of a mixture
        return base.mean.detach()


def _marginal(emission: Distribution, seen: Tensor) -> MultivariateNormal:
    if not isinstance(emission, torch.distributions.MultivariateNormal):
        raise TypeError(
            f"expected an independent or MultivariateNormal emission where entries are missing, got {emission}"
        )
    covariance = emission.covariance_matrix[..., seen, :][..., seen]
    return MultivariateNormal(emission.loc[..., seen], covariance_matrix=covariance)


def is_gaussian(emission: Distribution) -> bool:
    """Whether :func:`gaussian_rows` fits log p(y | ·) exactly, and not only its value and gradient."""
    base = emission.base_dist if isinstance(emission, Independent) else emission
    return isinstance(base, torch.distributions.Normal | torch.distributions.MultivariateNormal)


def gaussian_rows(emission: Distribution, observation: Tensor) -> tuple[Tensor, Tensor]:
    """Whitening W (..., O, O or O diagonal as vector) and log-normaliser of a Gaussian fit to log p(y | ·).

    Near the emission's mean h the log-density is −½|W (y − h)|² + c. For a Gaussian this is
    exact. For Student-t, W is that of iteratively reweighted least squares,
    w = (ν + 1)/(ν + r²)/σ², which has the same value and gradient in h; so have the rows of a
    mixture, with y as :func:`explained` returns it. Missing entries get zero rows. Returns W as
    (..., O) for independent emissions and mixtures that shift no row, (..., O, O) otherwise, and c with shape (...).

    Raises TypeError for other families.
    """
    seen = ~torch.isnan(observation)
    if isinstance(emission, RowDistribution):
        whitening, _, constant = emission.gaussian_rows(observation)
        return whitening, constant
    if isinstance(emission, torch.distributions.MultivariateNormal):
        return _correlated_rows(emission, observation, seen)
    base = emission.base_dist if isinstance(emission, Independent) else emission
    if isinstance(base, torch.distributions.Normal):
        whitening = seen / base.scale
        constant = -(torch.log(base.scale) + 0.5 * math.log(2 * math.pi)) * seen
    elif isinstance(base, torch.distributions.StudentT):
        residual = torch.where(seen, (observation - base.loc) / base.scale, 0.0)
        weight = (base.df + 1) / (base.df + residual**2)
        whitening = seen * weight.sqrt() / base.scale
        filled = torch.where(seen, observation, base.loc)
        constant = (base.log_prob(filled) + 0.5 * weight * residual**2) * seen
    else:
        raise TypeError(f"expected a Normal, StudentT or MultivariateNormal emission, got {emission}")
    return whitening, constant.sum(-1)


def explained(emission: Distribution, observation: Tensor) -> Tensor:
    """The rows (..., O) that :func:`gaussian_rows` compares with the emission's mean: the observed ones but for swaps.

    There a detection contributes to each keypoint in the share in which that one explains it.
    """
    return emission.gaussian_rows(observation)[1] if isinstance(emission, RowDistribution) else observation


def times(whitening: Tensor, rows: Tensor) -> Tensor:
    """W times rows (..., O, D), W as :func:`gaussian_rows` has it."""
    return whitening @ rows if whitening.ndim == rows.ndim else whitening.unsqueeze(-1) * rows


def _correlated_rows(emission: MultivariateNormal, observation: Tensor, seen: Tensor) -> tuple[Tensor, Tensor]:
    size = observation.shape[-1]
    covariance = emission.covariance_matrix
    pair = seen.unsqueeze(-1) & seen.unsqueeze(-2)
    # Missing entries become independent unit ones, whose rows are then struck out.
    covariance = torch.where(pair, covariance, torch.eye(size, dtype=covariance.dtype))
    tril = torch.linalg.cholesky(covariance)
    whitening = torch.linalg.solve_triangular(tril, torch.diag_embed(seen.to(covariance.dtype)), upper=False)
    constant = -torch.log(tril.diagonal(dim1=-2, dim2=-1)).sum(-1)
    return whitening, constant - 0.5 * math.log(2 * math.pi) * seen.sum(-1, dtype=constant.dtype)
