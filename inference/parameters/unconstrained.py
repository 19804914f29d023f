"""Parameters with priors as one real vector z, and the model at many such vectors at once.

    θ = T(z),     log p(z) = log p(θ) + log |dT/dz|,     T the bijection from the reals to the prior's support

(Carpenter et al. 2017, "Stan: a probabilistic programming language", §2.7; ``torch.distributions.biject_to``). All
samplers of this room move z, where no step leaves the support.

Shapes: P entries of z; M parameter sets z (M, P); parameters of the model (M, 1, own shape), which broadcast against
states (M, N, D) of M filters with N particles each.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Generic, TypeVar

import pyro
import torch
from torch import Tensor
from torch.distributions import biject_to

from invdyn.inference.contract import check_model
from invdyn.inference.execution.seeds import seeded
from invdyn.models.state_space import StateSpaceModel
from invdyn.recordings import InputError
from invdyn.recordings.errors import first_line

M = TypeVar("M", bound=StateSpaceModel)
"""The class of the model, which is kept."""

PROBE_SETS, PROBE_PARTICLES = 2, 3
"""Sizes with which a model's shapes are checked; different, so that no wrong axis fits by chance."""


class UnconstrainedParameters(Generic[M]):
    """The parameters of ``model`` that have priors, as vectors z (..., P).

    Attributes:
        model: whose type the parameters get; z is in float64.
        names: of the parameters, in the order of z.
        shapes: own shape of each prior's draw, batch and event dimensions together.
        size: P.

    Raises InputError when the model has no priors, when a prior is discrete or has a support without a bijection, or
    when the model does not take many parameter sets at once.
    """

    def __init__(self, model: M):
        if not model.priors:
            raise InputError("expected a model with priors, got none: model.with_priors(**{name: distribution})")

        self.model = model
        self.names = tuple(model.priors)
        self.priors = dict(model.priors)
        self.shapes = {name: prior.shape() for name, prior in self.priors.items()}
        self._transforms = {name: _bijection(name, prior.support) for name, prior in self.priors.items()}

        # The vector's own shape may differ from the draw's: a simplex of K has K − 1 free entries.
        self._free = {name: self._transforms[name].inverse_shape(torch.Size(self.shapes[name])) for name in self.names}
        self._sizes = [self._free[name].numel() for name in self.names]
        self.size = sum(self._sizes)
        self._scalar_padding = 1
        self._check_batch()

    def draw(self, shape: tuple[int, ...]) -> Tensor:
        """Draws z, ``(*shape, P)``, from the prior, by torch's global generator."""
        pieces = []
        for name in self.names:
            theta = self.priors[name].sample(torch.Size(shape)).double()
            pieces.append(self._transforms[name].inv(theta).reshape(*shape, -1))
        return torch.cat(pieces, -1)

    def values(self, z: Tensor) -> dict[str, Tensor]:
        """Parameters (..., own shape) by name at z (..., P)."""
        return {name: self._transforms[name](piece) for name, piece in self._split(z)}

    def log_prior(self, z: Tensor) -> Tensor:
        """Log-density (...) of z (..., P), the Jacobian included; −∞ where it is not a number."""
        total = z.new_zeros(z.shape[:-1])
        with unvalidated():
            for name, piece in self._split(z):
                theta = self._transforms[name](piece)
                terms = self.priors[name].log_prob(theta), self._transforms[name].log_abs_det_jacobian(piece, theta)
                for term in terms:
                    total = total + term.double().reshape(*z.shape[:-1], -1).sum(-1)
        return total.nan_to_num(nan=-torch.inf, posinf=-torch.inf, neginf=-torch.inf)

    def at(self, z: Tensor) -> M:
        """The model at each row of z (M, P) at once."""
        return self._replaced(self.values(z))

    def _replaced(self, values: dict[str, Tensor]) -> M:
        batch = {}
        for name, value in values.items():
            own = self.model.parameters[name].ndim
            # A prior of fewer dimensions than its parameter is shared by all entries.
            padding = own - (value.ndim - 1) if own else self._scalar_padding
            shaped = value.reshape(len(value), 1, *[1] * padding, *value.shape[1:])
            batch[name] = shaped.to(self.model.parameters[name])
        return self.model.replace(**batch)

    def _split(self, z: Tensor) -> Iterator[tuple[str, Tensor]]:
        for name, piece in zip(self.names, z.split(self._sizes, -1), strict=True):
            yield name, piece.reshape(*z.shape[:-1], *self._free[name])

    # -- whether the model takes many sets at once -----------------------------------------------
    def _check_batch(self) -> None:
        """Compare the model at two parameter sets at once with each by itself, on densities of a few states.

        A parameter that is a number may be meant for states (..., D) or for batches (...): what fits is used.
        """
        with seeded(0):
            values = self.values(self.draw((PROBE_SETS,)))
            single = [
                self.model.replace(**{name: self._alone(name, value[m]) for name, value in values.items()})
                for m in range(PROBE_SETS)
            ]
            with unvalidated():
                x = torch.stack([each.initial().expand(torch.Size((PROBE_PARTICLES,))).sample() for each in single])
                y = single[0].emission(x[0], 0).sample()[0]
                expected = torch.stack([_log_densities(each, own, y) for each, own in zip(single, x, strict=True)], 1)
                failures = []
                for self._scalar_padding in (1, 0):
                    try:
                        found = _log_densities(self._replaced(values), x, y)
                    except Exception as error:  # a model of one's own may fail in any way
                        failures.append(first_line(error))
                        continue
                    if torch.allclose(found, expected, rtol=1e-3, atol=1e-3, equal_nan=True):
                        return
                    failures.append("other densities than one set by itself")
        shapes = {name: (PROBE_SETS, 1, *self.model.parameters[name].shape) for name in self.names}
        raise InputError(
            f"expected a model that takes many parameter sets at once, of shapes {shapes} for states {tuple(x.shape)}, "
            f"got {failures[0]}: give each parameter a last dimension that fits the state's, such as (1,)"
        )

    def _alone(self, name: str, value: Tensor) -> Tensor:
        """One set's value with as many dimensions as the model's parameter has."""
        own = self.model.parameters[name]
        return value.reshape([1] * (own.ndim - value.ndim) + list(value.shape)).to(own)


def checked(model: M, observations: Any) -> tuple[UnconstrainedParameters[M], Tensor]:
    """The parameters of a model with priors, and its rows (T, O) in the model's type, both checked.

    Raises InputError as :func:`.check_model` and :class:`UnconstrainedParameters` do.
    """
    observations = check_model(model, observations)
    return UnconstrainedParameters(model), observations


def _log_densities(model: StateSpaceModel, x: Tensor, y: Tensor) -> Tensor:
    """Log-densities (3, ...) of states x (..., D) at rows 0 and 1, and of y (O,) given them."""
    batch = x.shape[:-1]
    terms = [model.initial().expand(torch.Size(batch)).log_prob(x), model.emission(x, 0).log_prob(y)]
    if model.num_steps > 1:
        terms.append(model.transition(x, 1).log_prob(x))
    wrong = [tuple(term.shape) for term in terms if term.shape != batch]
    if wrong:
        raise ValueError(f"log-densities of shape {wrong[0]} for states {tuple(x.shape)}")
    return torch.stack([term.double() for term in terms])


def _bijection(name: str, support: object) -> torch.distributions.Transform:
    try:
        return biject_to(support)
    except NotImplementedError:
        raise InputError(
            f"prior of {name}: expected a continuous distribution, got the support {support}: "
            "use one on the reals, the positive numbers, an interval or a simplex"
        ) from None


@contextmanager
def unvalidated() -> Iterator[None]:
    """Distributions with impossible arguments give NaN, which counts as zero likelihood, instead of an error."""
    with pyro.validation_enabled(False):
        yield
