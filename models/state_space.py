"""Hidden Markov models as three Pyro distributions.

    x_0 ~ initial(),   x_t ~ transition(x_{t-1}, t),   y_t ~ emission(x_t, t),   t = 0 … T−1

Where y_t depends on x_{t-1} too (leverage, observed increments), a model also gives ``emission_given``.
A model variant is a subclass that gives these three; everything else follows from them here,
once for all models: ``init``/``step`` for :class:`pyro.infer.SMCFilter`, the whole sequence
under :func:`pyro.markov` for SVI and MCMC, simulation, and the joint log-density.

Shapes: states (..., D); observations (T, O) with NaN where nothing was seen; ``t`` is the row
being entered, an int or a LongTensor that broadcasts against the state's batch shape (so that
all rows can be evaluated in one call).
"""

import copy
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, MutableMapping
from typing import Self

import pyro
import torch
from pyro.distributions import Distribution
from torch import Tensor
from torch.distributions import Independent, MultivariateNormal, Normal, constraints

from invdyn.models.observation.missing import observe, observed_log_prob
from invdyn.models.seeds import seeded


class UnknownParameter(KeyError):
    """The name of a parameter that a model does not have; the message names those that it has."""


class StateSpaceModel(ABC):
    """A hidden Markov model with a Gaussian-noise or general transition.

    ``parameters`` maps a dotted name ("torque.scale") to a tensor (..., own shape); leading
    dimensions are many parameter sets at once and must broadcast against the states' batch
    shape. ``priors`` maps such names to Pyro distributions; ``learned`` lists the names that
    become ``pyro.param`` in :meth:`sequence`.
    """

    state_dim: int
    observation_dim: int
    num_steps: int
    state_names: tuple[str, ...] = ()
    """Names of the states, for results; by number where there are none."""
    observation_names: tuple[str, ...] = ()
    """Names of the observed numbers of a row."""
    roots: frozenset[str] = frozenset()
    """Parameters that are lower-triangular square roots."""

    def __init__(self, parameters: Mapping[str, Tensor] | None = None):
        self.parameters: dict[str, Tensor] = dict(parameters or {})
        self.priors: dict[str, Distribution] = {}
        self.learned: tuple[str, ...] = ()

    # -- what a variant writes -----------------------------------------------------------------
    @abstractmethod
    def initial(self) -> Distribution:
        """Distribution of x_0, event shape (D,)."""

    @abstractmethod
    def transition(self, state: Tensor, t: int | Tensor) -> Distribution:
        """Distribution of x_t given x_{t−1} = ``state`` (..., D), event shape (D,)."""

    @abstractmethod
    def emission(self, state: Tensor, t: int | Tensor) -> Distribution:
        """Distribution of y_t given x_t = ``state`` (..., D), event shape (O,)."""

    def emission_given(self, previous: Tensor, state: Tensor, t: int | Tensor) -> Distribution:
        """Distribution of y_t given x_{t−1} = ``previous`` and x_t = ``state``, (..., D) each; rows t ≥ 1.

        By default y_t depends on x_t alone. A model with leverage, or with observed increments, overrides this, and
        its ``emission`` is that of row 0. Filters, simulation, the joint density and paths' samplers weigh by it;
        methods that linearise the emission refuse such a model.
        """
        return self.emission(state, t)

    def row_emission(self, previous: Tensor | None, state: Tensor, t: int | Tensor) -> Distribution:
        """Distribution of y_t of any row: by :meth:`emission` at row 0, which has no ``previous`` state."""
        return self.emission(state, t) if previous is None else self.emission_given(previous, state, t)

    @property
    def emission_sees_previous(self) -> bool:
        """Whether y_t depends on x_{t−1} too: the class overrides :meth:`emission_given`."""
        return type(self).emission_given is not StateSpaceModel.emission_given

    # -- what helps Gauss–Newton to start, overridden where more is known ------------------------
    def initial_paths(self, observations: Tensor) -> Tensor:
        """Candidate paths (C, T, D) to linearise at first; by default the prior mean, constant."""
        mean = gaussian_mean(self.initial()).detach()
        return mean.expand(1, len(observations), -1).clone()

    def relaxed(self, amount: float) -> Self:
        """Return a model with relaxed dynamics, from 1 (relaxed) to 0 (itself): a homotopy for stiff models."""
        return self

    @property
    def independent_sensor_states(self) -> tuple[list[int], list[int]] | None:
        """States by number, and the entry of a row that each of them shows in, its own; or None.

        Each evolves by itself, linearly, moves no other state, and is added to what its entry shows: their slopes are
        a number each, which one nudge of all of them tells.
        """
        return None

    emission_about_mean: bool = False
    """Whether linearising methods take the emission's noise as it is along a path, although it may depend on the state:
    a row then informs the state through the emission's mean alone."""

    contact_states: slice | None = None
    """States that the others drive by jumps, which tangents pass by: Gauss–Newton takes them :mod:`.fixed_point`,
    and all slopes by differences."""

    nonsmooth: bool = False
    """Whether the transition's mean has kinks, as contacts make them: smoothers then fit lines over the posterior under
    relaxed noise (:mod:`invdyn.inference.smoothing.statistical_homotopy`), and take no tangents."""

    steps_per_row: float = 1.0
    """How many steps of a simulation a row's transition takes: so many times fewer particles are affordable."""

    # -- parameters ----------------------------------------------------------------------------
    @property
    def unconstrained(self) -> frozenset[str]:
        """Parameters that may be negative; all others, as by default, are positive or square roots of covariances."""
        return frozenset()

    @property
    def dtype(self) -> torch.dtype:
        """Floating type of the parameters; of initial states where there are none, float64 where those are integers."""
        for value in self.parameters.values():
            if value.is_floating_point():
                return value.dtype
        state = self._any_initial_state()
        return state.dtype if state.is_floating_point() else torch.float64

    @property
    def device(self) -> torch.device:
        """Device of the parameters, or of initial states where there are none."""
        return next(iter(self.parameters.values())).device if self.parameters else self._any_initial_state().device

    @torch.no_grad()
    def _any_initial_state(self) -> Tensor:
        with seeded(0):
            return self.initial().sample()

    def replace(self, **values: Tensor) -> Self:
        """Return the model with other parameter values: ``model.replace(**{"torque.scale": s})``.

        Raises UnknownParameter (a KeyError), naming the known ones, for a parameter that the model does not have.
        """
        other = copy.copy(self)
        other.parameters = self._replaced(values)
        return other

    def _replaced(self, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """All parameters, with other values for some; raises KeyError as :meth:`replace` says."""
        self.check_names(values)
        return {**self.parameters, **values}

    def check_names(self, names: Iterable[str]) -> None:
        """Raise UnknownParameter, naming the known ones, for a parameter that the model does not have."""
        if unknown := set(names) - set(self.parameters):
            raise UnknownParameter(
                f"no parameter {', '.join(sorted(unknown))}; this model has {', '.join(sorted(self.parameters))}"
            )

    def with_priors(self, **priors: Distribution) -> Self:
        """Return the model in which these parameters are sampled by :meth:`sequence`."""
        self.check_names(priors)
        other = copy.copy(self)
        other.priors = {**self.priors, **priors}
        return other

    def learn(self, names: Iterable[str]) -> Self:
        """Return the model in which these parameters are ``pyro.param`` in :meth:`sequence`."""
        names = tuple(names)
        self.check_names(names)
        other = copy.copy(self)
        other.learned = names
        return other

    def to(self, dtype: torch.dtype | None = None, device: torch.device | str | None = None) -> Self:
        """Return the model with its parameters in another floating dtype or on another device."""
        return self.replace(
            **{
                name: value.to(dtype=dtype if value.is_floating_point() else None, device=device)
                for name, value in self.parameters.items()
            }
        )

    def sampled(self) -> Self:
        """Draw priors and look up learned parameters, as Pyro sites; return the model that has them."""
        return self._sampled()

    def _sampled(self) -> Self:
        drawn = {name: pyro.sample(name, prior) for name, prior in self.priors.items()}
        for name in self.learned:
            # A copy: Pyro would otherwise optimise the model's own tensor in place.
            start = self.parameters[name].detach().clone()
            drawn[name] = pyro.param(name, start, constraint=self._constraint(name))
        return self.replace(**drawn) if drawn else self

    def _constraint(self, name: str) -> constraints.Constraint:
        if name in self.roots:
            return constraints.lower_cholesky
        return constraints.real if name in self.unconstrained else constraints.positive

    # -- pyro.infer.SMCFilter ------------------------------------------------------------------
    def init(self, state: MutableMapping[str, Tensor], observation: Tensor | None = None) -> None:
        """First step for :class:`pyro.infer.SMCFilter`; writes ``state["x"]`` (..., D)."""
        state["x"] = pyro.sample("x_0", self.initial())
        if observation is not None:
            observe("y_0", self.emission(state["x"], 0), observation)

    def step(self, state: MutableMapping[str, Tensor], t: int, observation: Tensor | None = None) -> None:
        """Step into row ``t`` for :class:`pyro.infer.SMCFilter`; reads and writes ``state["x"]``."""
        previous = state["x"]
        state["x"] = pyro.sample(f"x_{t}", self.transition(previous, t))
        if observation is not None:
            observe(f"y_{t}", self.emission_given(previous, state["x"], t), observation)

    # -- SVI and MCMC --------------------------------------------------------------------------
    def sequence(self, observations: Tensor | None = None) -> Tensor:
        """Return the whole sequence (..., T, D) as one Pyro model under ``pyro.markov``.

        Sites: ``x_0`` … ``x_{T−1}`` and, for rows where anything was seen, ``y_t``. Without
        ``observations`` the y_t are sampled too.
        """
        model = self.sampled()
        state = pyro.sample("x_0", model.initial())
        previous, path = None, []
        for t in pyro.markov(range(self.num_steps)):
            if t > 0:
                previous, state = state, pyro.sample(f"x_{t}", model.transition(state, t))
            emission = model.row_emission(previous, state, t)
            if observations is None:
                pyro.sample(f"y_{t}", emission)
            else:
                observe(f"y_{t}", emission, observations[t])
            path.append(state)
        return torch.stack(path, dim=-2)

    # -- simulation and density ----------------------------------------------------------------
    @torch.no_grad()
    def simulate(self, batch_shape: tuple[int, ...] = (), *, seed: int | None = None) -> tuple[Tensor, Tensor]:
        """Draw states (..., T, D) and observations (..., T, O) from the prior; by torch's global seed without one."""
        with seeded(seed, self.device):
            state = self.initial().expand(torch.Size(batch_shape)).sample()
            states, observations = [state], [self.emission(state, 0).sample()]
            for t in range(1, self.num_steps):
                previous, state = state, self.transition(state, t).sample()
                states.append(state)
                observations.append(self.emission_given(previous, state, t).sample())
        return torch.stack(states, -2), torch.stack(observations, -2)

    def log_joint(self, path: Tensor, observations: Tensor) -> Tensor:
        """Log p(x_{0:T}, y_{0:T}), shape (...), of paths (..., T, D); missing entries drop out."""
        rows = torch.arange(path.shape[-2], device=path.device)
        total = self.initial().log_prob(path[..., :1, :]).squeeze(-1)
        if len(rows) > 1:
            total = total + self.transition(path[..., :-1, :], rows[1:]).log_prob(path[..., 1:, :]).sum(-1)
        return total + self.log_likelihood(path, observations).sum(-1)

    def log_likelihood(self, path: Tensor, observations: Tensor) -> Tensor:
        """Log p(y_t | x_{0:T}) by row, (..., T), along paths (..., T, D); missing entries drop out."""
        if not self.emission_sees_previous:
            return observed_log_prob(self._emissions(path)[0], observations)
        first, onward = self._emissions(path)
        rows = observations[..., :1, :], observations[..., 1:, :]
        return torch.cat([observed_log_prob(first, rows[0]), observed_log_prob(onward, rows[1])], -1)

    def sample_observations(self, path: Tensor) -> Tensor:
        """Draw observations (..., T, O) along paths (..., T, D)."""
        return torch.cat([emission.sample() for emission in self._emissions(path)], -2)

    def _emissions(self, path: Tensor) -> list[Distribution]:
        """Of all rows at once; of row 0 and of the others, where these depend on the state before."""
        rows = torch.arange(path.shape[-2], device=path.device)
        if not self.emission_sees_previous:
            return [self.emission(path, rows)]
        onward = self.emission_given(path[..., :-1, :], path[..., 1:, :], rows[1:])
        return [self.emission(path[..., :1, :], rows[:1]), onward]


def gaussian_moments(distribution: Distribution) -> tuple[Tensor, Tensor]:
    """Mean (..., D) and a square root L of the covariance (..., D, D), LLᵀ = Q, of a Gaussian.

    Raises TypeError for anything but a Normal made independent over its last dimension or a
    MultivariateNormal: methods that linearise need Gaussian transition noise.
    """
    if isinstance(distribution, MultivariateNormal):
        return distribution.loc, distribution.scale_tril
    base = distribution.base_dist if isinstance(distribution, Independent) else distribution
    if isinstance(base, Normal) and len(distribution.event_shape) == 1:
        return base.loc, torch.diag_embed(base.scale)
    raise TypeError(
        f"expected Normal(...).to_event(1) or MultivariateNormal, got {distribution}; "
        "use the bootstrap guide for a transition that is not Gaussian"
    )


def gaussian_mean(distribution: Distribution) -> Tensor:
    """Mean (..., D) of a Gaussian, without building its covariance."""
    return getattr(distribution, "base_dist", distribution).loc
