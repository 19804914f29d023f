"""The contract between a state-space model, its rows and a method, checked once before anything runs.

A :class:`StateSpaceModel` gives three distributions. Torch broadcasts what does not fit, so that a wrong shape often
yields a wrong number instead of an error. Here each distribution is evaluated on small batches of simulated states,

    one state (D,) with an int t,   a batch (M, N, D) with an int t,   rows (K, D) with a LongTensor t (K,),

and its event shape, batch shape, type, draws and log-densities are compared with what every method relies on. Methods
state further preconditions by name (:data:`NEEDS`).

A model is checked once: copies with other parameter values of the same shapes (:meth:`.StateSpaceModel.replace`,
:meth:`.StateSpaceModel.to`) inherit the result, copies with any other attribute do not. No random number of the
caller is used.

Shapes: observations (T, O), states (…, D). Batches of parameter sets (B, 1, own shape) take states (B, N, D).
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import cached_property
from textwrap import shorten
from typing import Any, NamedTuple, NoReturn

import numpy as np
import torch
from torch import Tensor
from torch.distributions import Distribution, Independent, constraints

from invdyn.inference.execution.seeds import seeded
from invdyn.models.divergence import Diverged
from invdyn.models.observation.missing import filled, gaussian_rows, observed_log_prob
from invdyn.models.state_space import StateSpaceModel, gaussian_moments
from invdyn.recordings.errors import InputError, first_line

FILTERS, PARTICLES, STEPS, ROWS = 2, 3, 3, 16
"""Sizes of the simulated batch (M, N), transitions that it is simulated for, and rows K evaluated at once."""

SAME = 1e-6
"""Relative difference up to which two covariances are equal."""

INHERITED = "_checked"
"""Attribute that holds the result of a check: the model's attributes then, and what was checked."""

KEEP_DIMENSIONS = "index states from the right, state[..., i], and keep all leading dimensions"
ONE_STATE = "it must take one state (D,) and an int t"
ROWS_AT_ONCE = "t is a LongTensor (K,) there: write inputs[t], torch.where(t == 0, …), not if, range or float(t)"
AS_STATE = "make constants with the state's type, matrix.to(state)"


class ModelError(InputError):
    """A model that does not fit its rows or its method: one line with what was expected, what came, and the fix."""


def check_model(model: StateSpaceModel, observations: Any, *, needs: Iterable[str] = ()) -> Tensor:
    """Check a model against its rows; return the observations (T, O) in the model's dtype, on its device.

    Args:
        model: any state-space model, with or without parameters.
        observations: (T, O) numbers, NaN where missing: a tensor, an array, or nested lists; of integers, too. Rows
            (T,) are taken for one column where ``observation_dim`` is 1.
        needs: preconditions of the method, names in :data:`NEEDS`. Methods that linearise compute in float64.

    Raises ModelError, one line, for whatever does not fit; ValueError for an unknown need.
    """
    needs = frozenset(needs)
    if unknown := needs - set(NEEDS):
        raise ValueError(f"expected needs among {', '.join(NEEDS)}, got {', '.join(sorted(unknown))}")
    _check_attributes(model)
    rows = _rows(model, observations)
    device = next((value.device for value in model.parameters.values()), rows.device)
    with torch.no_grad(), seeded(0, device):
        return _checked(model, rows, needs)


def _checked(model: StateSpaceModel, rows: Tensor, needs: frozenset[str]) -> Tensor:
    shapes = tuple(value.shape for value in model.parameters.values())
    types = tuple(value.dtype for value in model.parameters.values())
    gaps = bool(torch.isnan(rows).any())
    key = (shapes, types, model.state_dim, model.observation_dim, model.num_steps, gaps)
    known = _known(model)
    if key in known and needs <= known[key]:
        return rows.to(dtype=model.dtype, device=model.device)

    _check_parameters(model)
    linearises = bool(needs & LINEARISING)
    subject = model.to(dtype=torch.float64, device="cpu") if linearises else model
    simulated = _Simulated(subject, linearises)
    rows = rows.to(dtype=model.dtype, device=model.device)
    simulated.check_rows(rows.to(dtype=simulated.dtype, device=subject.device))
    for name, need in NEEDS.items():
        if name in needs:
            need(simulated)
    if simulated.any_row_fits:  # otherwise other rows are checked again
        known[key] = known.get(key, frozenset()) | needs
    return rows


# -- what was checked before -----------------------------------------------------------------------
def _known(model: StateSpaceModel) -> dict[Any, frozenset[str]]:
    """Results of earlier checks of a model with these attributes, but for parameter values; a new dict for another."""
    kind, own = type(model), vars(model)
    now = {
        name: value
        for name, value in own.items()
        if name not in ("parameters", "priors", "learned", INHERITED)
        and not isinstance(getattr(kind, name, None), cached_property)
    }
    before, known = own.get(INHERITED, ({}, {}))
    if not (before.keys() == now.keys() and all(_same(before[name], value) for name, value in now.items())):
        known = {}
    own[INHERITED] = now, known
    return known


def _same(one: object, other: object) -> bool:
    return one is other or (isinstance(one, int | float | str) and one == other)


# -- attributes, parameters, rows ------------------------------------------------------------------
def _check_attributes(model: StateSpaceModel) -> None:
    if not isinstance(model, StateSpaceModel):
        raise ModelError(f"model: expected a StateSpaceModel, got {type(model).__name__}: subclass it")
    name = type(model).__name__
    for attribute in ("state_dim", "observation_dim", "num_steps"):
        value = getattr(model, attribute, None)
        if not isinstance(value, int) or value < 1:
            raise ModelError(f"{name}.{attribute}: expected a whole number above 0, got {value!r}: set it in the class")
    parameters = getattr(model, "parameters", None)
    if not isinstance(parameters, dict):
        got = "none" if parameters is None else type(parameters).__name__
        raise ModelError(f"{name}.parameters: expected a dict, got {got}: call super().__init__({{…}})")
    for key, value in parameters.items():
        if not isinstance(value, Tensor):
            got = type(value).__name__
            raise ModelError(f"{name}.parameters[{key!r}]: expected a tensor, got {got}: use torch.tensor(…)")


def _check_parameters(model: StateSpaceModel) -> None:
    """Finite numbers of one floating type on one device."""
    label = f"{type(model).__name__}.parameters"
    devices = {str(value.device) for value in model.parameters.values()}
    if len(devices) > 1:
        raise ModelError(f"{label}: expected one device, got {' and '.join(sorted(devices))}: use model.to(device=…)")
    types = {str(value.dtype) for value in model.parameters.values() if value.is_floating_point()}
    if len(types) > 1:
        raise ModelError(f"{label}: expected one type, got {' and '.join(sorted(types))}: use model.to(torch.float64)")
    for key, value in model.parameters.items():
        if not bool(torch.isfinite(value).all()):
            raise ModelError(f"{label}[{key!r}]: expected finite numbers, got NaN or infinity: give it a value")


def _rows(model: StateSpaceModel, observations: Any) -> Tensor:
    """Observations as a tensor (T, O), of a type of their own."""
    steps, width = model.num_steps, model.observation_dim
    wanted = f"observations: expected rows ({steps}, {width}) = (num_steps, observation_dim)"
    try:
        rows = observations if isinstance(observations, Tensor) else torch.as_tensor(np.asarray(observations))
    except (TypeError, ValueError) as error:
        got = type(observations).__name__
        raise ModelError(f"{wanted} of numbers, got {got}: give a tensor or an array, NaN where missing") from error
    if rows.is_complex():
        raise ModelError(f"{wanted} of real numbers, got {rows.dtype}: use their real and imaginary parts")
    if rows.ndim == 1 and width == 1:
        rows = rows.unsqueeze(-1)
    if rows.ndim != 2 or rows.shape[-1] != width:
        raise ModelError(f"{wanted}, got shape {tuple(rows.shape)}: one row a time step, one column an entry")
    if len(rows) != steps:
        raise ModelError(f"{wanted}, got {len(rows)} rows: set num_steps, or cut the rows")
    if not rows.is_floating_point():
        rows = rows.double()
    if bool((infinite := torch.isinf(rows).any(-1)).any()):
        row = int(infinite.int().argmax())
        raise ModelError(f"observations: expected finite numbers, got infinity in row {row}: mark missing ones by NaN")
    return rows


# -- the three distributions on simulated states ---------------------------------------------------
class _Drawn(NamedTuple):
    """A distribution with a draw and the draw's log-density."""

    distribution: Distribution
    value: Tensor
    density: Tensor


@dataclass(repr=False)
class _Simulated:
    """States simulated from a model, with the distributions there already checked.

    Attributes:
        states: (S, M, N, D) of the first S rows; (S, B, N, D) with B parameter sets.
        transition, emission: distributions at rows (K,) of states (N, K, D), or (N, B, K, D); there is no transition
            where there is one row.
    """

    model: StateSpaceModel
    linearises: bool
    states: Tensor = field(init=False)
    transition: _Drawn | None = field(init=False, default=None)
    emission: _Drawn = field(init=False)
    any_row_fits: bool = field(init=False, default=True)

    def __post_init__(self) -> None:
        model = self.model
        first = self._called("initial", (), "", "give it the shapes of the parameters")
        self._check_event("initial", first, model.state_dim)
        drawn = self._drawn("initial", first)
        self._check_type(drawn.value)
        self._check_finite("initial", drawn)
        self.floating = drawn.value.is_floating_point()
        # Methods that linearise hand on states in float64, whatever the model's type.
        self.dtype = torch.float64 if self.linearises else model.dtype

        self.sets = self._parameter_sets(first, self._handed_on(drawn.value))
        state = self._start(first, (*(self.sets[:-1] or (FILTERS,)), PARTICLES))
        self.states = state[None]
        self._emission(state, 0, KEEP_DIMENSIONS)
        for t in range(1, min(STEPS, model.num_steps - 1) + 1):
            after = self._transition(state, t, KEEP_DIMENSIONS)
            if t == 1:
                self._check_finite("transition", after)
            if not bool(torch.isfinite(after.value).all()):
                break  # a simulation that runs away is for the method to report, with its row
            state = after.value
            self._emission(state, t, KEEP_DIMENSIONS)
            self.states = torch.cat([self.states, state[None]])

        count = min(ROWS, model.num_steps)
        rows = torch.linspace(0, model.num_steps - 1, count, device=model.device).long()
        paths = self._start(first, (PARTICLES, *self.sets[:-1], count))
        self.emission = self._emission(paths, rows, ROWS_AT_ONCE)
        if model.num_steps > 1:
            self.transition = self._transition(paths, rows.clamp_min(1), ROWS_AT_ONCE)

    def _parameter_sets(self, first: Distribution, state: Tensor) -> torch.Size:
        """Batch shape of the parameters, () or (B, 1): that of all three distributions at one state of each set."""
        if first.batch_shape[-1:] not in ((), (1,)):
            self._refuse_sets("initial", first.batch_shape)
        shapes = [first.batch_shape]
        for method, t, width in (("emission", 0, "observation_dim"), ("transition", 1, "state_dim")):
            if t < self.model.num_steps:
                found = self._called(method, (state, t), f" for states {tuple(state.shape)} at t = {t}", ONE_STATE)
                self._check_event(method, found, getattr(self.model, width))
                shapes.append(found.batch_shape)
                if shapes[-1][-1:] not in ((), (1,)):
                    self._refuse_sets(method, shapes[-1])
        return torch.broadcast_shapes(*shapes)

    def _refuse_sets(self, method: str, batch: torch.Size) -> NoReturn:
        expected = "batch shape () for one state, or (B, 1) with B parameter sets"
        raise self._error(method, expected, tuple(batch), KEEP_DIMENSIONS)

    def _transition(self, state: Tensor, t: int | Tensor, fix: str) -> _Drawn:
        drawn = self._evaluated("transition", state, t, self.model.state_dim, fix)
        if drawn.value.dtype != state.dtype:
            raise self._error("transition", f"states of type {state.dtype}", drawn.value.dtype, AS_STATE)
        return drawn

    def _emission(self, state: Tensor, t: int | Tensor, fix: str) -> _Drawn:
        drawn = self._evaluated("emission", state, t, self.model.observation_dim, fix)
        self._check_finite("emission", drawn)
        _, value, density = drawn
        finite = torch.isfinite(value).all(-1)
        if bool((finite & torch.isnan(density)).any()) or (bool(finite.any()) and bool(torch.isinf(density).all())):
            raise self._error("emission", "finite log-densities of its own draws", "others", "give it noise")
        return drawn

    def _evaluated(self, method: str, state: Tensor, t: int | Tensor, width: int, fix: str) -> _Drawn:
        """The distribution at these states: event and batch shape, draws and log-densities as they must be."""
        when = f"t = {t}" if isinstance(t, int) else f"t {tuple(t.shape)}"
        where = f" for states {tuple(state.shape)} at {when}"
        found = self._called(method, (state, t), where, fix)
        self._check_event(method, found, width)
        batch = torch.broadcast_shapes(state.shape[:-1], self.sets)
        if found.batch_shape != batch:
            got = tuple(found.batch_shape)
            raise self._error(method, f"batch shape {tuple(batch)}{where}", got, f"{fix}, or .expand(state.shape[:-1])")
        return self._drawn(method, found)

    def _called(self, method: str, arguments: tuple, where: str, fix: str) -> Distribution:
        try:
            found = getattr(self.model, method)(*arguments)
        except Diverged:
            raise
        except Exception as error:  # whatever a user's code raises becomes the one line
            raise self._error(method, f"a distribution{where}", _raised(error), _fix(error) or fix) from error
        if not isinstance(found, Distribution):
            got = "nothing" if found is None else type(found).__name__
            raise self._error(method, "a Pyro distribution", got, "return Normal(…).to_event(1), for example")
        return found

    def _check_event(self, method: str, found: Distribution, width: int) -> None:
        event, batch = tuple(found.event_shape), tuple(found.batch_shape)
        if event == (width,):
            return
        attribute = "observation_dim" if method == "emission" else "state_dim"
        fix = f"return {width} entries, or set {attribute}" if event else "add .to_event(1)"
        raise self._error(method, f"event shape ({width},) = ({attribute},)", f"{event} with batch shape {batch}", fix)

    def _drawn(self, method: str, found: Distribution) -> _Drawn:
        """A draw and its log-density, of the shapes that the distribution says."""
        try:
            value = found.sample()
            density = found.log_prob(value)
        except Exception as error:
            fix = _fix(error) or "correct its sample or log_prob"
            raise self._error(method, "draws and their log-densities", _raised(error), fix) from error
        shape = found.batch_shape + found.event_shape
        if value.shape != shape:
            raise self._error(method, f"draws {tuple(shape)}", tuple(value.shape), "correct its sample")
        if not isinstance(density, Tensor) or density.shape != found.batch_shape or not density.is_floating_point():
            got = tuple(density.shape) if isinstance(density, Tensor) else type(density).__name__
            raise self._error(method, f"log_prob {tuple(found.batch_shape)} of real numbers", got, "sum over the event")
        return _Drawn(found, value, density)

    def _check_finite(self, method: str, drawn: _Drawn) -> None:
        if not bool(torch.isfinite(drawn.value).any()):
            raise self._error(method, "finite draws", "NaN or infinity", "check noise scales and parameters")

    def _start(self, first: Distribution, lead: tuple[int, ...]) -> Tensor:
        """Initial states (*lead, D) in the type that methods hand on."""
        try:
            return self._handed_on(first.expand(torch.Size(lead)).sample())
        except Exception as error:
            expected = f"a distribution that expands to {lead}"
            raise self._error("initial", expected, _raised(error), "correct its expand") from error

    def _handed_on(self, state: Tensor) -> Tensor:
        return state.to(self.dtype) if self.floating else state

    def _check_type(self, state: Tensor) -> None:
        """Initial states of the parameters' type, on their device; integers are of no type."""
        model = self.model
        if state.is_floating_point() and state.dtype != model.dtype:
            expected = f"states of the parameters' type {model.dtype}"
            raise self._error("initial", expected, state.dtype, "make it with dtype=self.dtype")
        if state.device != model.device:
            expected = f"states on the parameters' device {model.device}"
            raise self._error("initial", expected, state.device, "make it with device=self.device")

    def check_rows(self, observations: Tensor) -> None:
        """Rows with gaps have a likelihood, and entries lie where the emission's family has one."""
        model = self.model
        seen = ~torch.isnan(observations)
        some = seen.any(-1) & ~seen.all(-1)
        if bool(some.any()):
            t = int(some.int().argmax())
            try:
                observed_log_prob(model.emission(self.states[0], t), observations[t])
            except Exception as error:
                fix = "use Normal(…).to_event(1), another independent family, or MultivariateNormal"
                raise self._error("emission", f"a density of row {t}, which has gaps", _raised(error), fix) from error
        if (support := _support(self.emission.distribution)) is None:
            return
        self.any_row_fits = False
        every = torch.arange(model.num_steps, device=model.device)
        emission = model.emission(self._start(model.initial(), (*self.sets[:-1], model.num_steps)), every)
        values = filled(emission, observations, seen) if isinstance(emission, Independent) else observations
        fits = (emission.support.check(values) | ~seen.any(-1)).reshape(-1, model.num_steps).all(0)
        if not bool(fits.all()) and (support.is_discrete or emission._validate_args):
            row = int((~fits).int().argmax())
            got = f"{observations[row].tolist()} in row {row}"
            fix = "correct the row, take another family, or pass validate_args=False if its limits follow the state"
            raise self._error("emission", f"rows in its support, {support}", got, fix)

    def _error(self, method: str, expected: str, got: object, fix: str) -> ModelError:
        return ModelError(f"{type(self.model).__name__}.{method}: expected {expected}, got {got}: {fix}")


def _raised(error: Exception) -> str:
    return f"{type(error).__name__} ({shorten(first_line(error), 120)})"


def _fix(error: Exception) -> str | None:
    """The fix of an error that tells its cause by itself."""
    if "satisfy the constraint" in str(error):
        return "check noise scales and parameters"
    if "dtype" in str(error) or "scalar type" in str(error):
        return AS_STATE
    return "correct the method" if isinstance(error, NameError | AttributeError | KeyError) else None


def _support(emission: Distribution) -> constraints.Constraint | None:
    """Support of an entry, or None where all real numbers are in it, or it does not say."""
    try:
        support = emission.support
    except NotImplementedError:
        return None
    while isinstance(support, type(constraints.real_vector)):
        support = support.base_constraint
    return None if support is None or isinstance(support, type(constraints.real)) else support


# -- preconditions of methods ----------------------------------------------------------------------
def _continuous_state(simulated: _Simulated) -> None:
    if not simulated.floating:
        got = "draws of an integer type"
        raise simulated._error("initial", "a continuous state", got, "use the bootstrap guide")


def _gaussian_transition(simulated: _Simulated) -> None:
    _continuous_state(simulated)
    model = simulated.model
    after = simulated.transition and simulated.transition.distribution
    for method, found in (("initial", model.initial()), ("transition", after)):
        try:
            if found is not None:
                gaussian_moments(found)
        except TypeError:
            fix = "use the bootstrap guide"
            wanted = "Normal(…).to_event(1) or MultivariateNormal"
            raise simulated._error(method, wanted, type(found).__name__, fix) from None


def _constant_covariance(simulated: _Simulated) -> None:
    _gaussian_transition(simulated)
    if simulated.model.num_steps == 1:
        return
    _, root = gaussian_moments(simulated.model.transition(simulated.states, 1))
    covariance = root @ root.mT
    first = covariance[:1, ..., :1, :, :]
    sd = first.diagonal(dim1=-2, dim2=-1).sqrt()
    if bool(((covariance - first).abs() > SAME * sd.unsqueeze(-1) * sd.unsqueeze(-2)).any()):
        expected = "a covariance that does not depend on the state"
        raise simulated._error("transition", expected, "one that does", "use the bootstrap guide")


def _gaussian_emission(simulated: _Simulated) -> None:
    try:
        gaussian_rows(simulated.emission.distribution, simulated.emission.value)
    except TypeError as error:
        fix = "use the bootstrap guide"
        raise simulated._error("emission", "a Gaussian approximation", first_line(error), fix) from None


def _informative_mean(simulated: _Simulated) -> None:
    emission = simulated.emission.distribution
    base = getattr(emission, "base_dist", emission)
    mean = base.loc if hasattr(base, "loc") else base.mean
    if not bool((mean != mean[:1]).any()):
        expected, got = "a mean that depends on the state", "the same mean for all states"
        raise simulated._error("emission", expected, got, "use the bootstrap guide, which sees scales too")


def _transition_density(simulated: _Simulated) -> None:
    if simulated.transition is None:
        return
    _, value, density = simulated.transition
    if bool((torch.isfinite(value).all(-1) & ~torch.isfinite(density)).any()):
        got = "NaN or infinity, as where a state has no noise"
        raise simulated._error("transition", "a finite log-density of its own draws", got, NO_DENSITY)


NO_DENSITY = 'use genealogy, or SMCOptions(smoothing="genealogy"), which needs none, or give every state noise'

NEEDS: dict[str, Callable[[_Simulated], None]] = {
    "continuous_state": _continuous_state,
    "gaussian_transition": _gaussian_transition,
    "constant_covariance": _constant_covariance,
    "gaussian_emission": _gaussian_emission,
    "informative_mean": _informative_mean,
    "transition_density": _transition_density,
}
"""Preconditions by name, in the order in which they are checked:

* ``continuous_state``: states are real numbers;
* ``gaussian_transition``: ``initial`` and ``transition`` are Normal or MultivariateNormal;
* ``constant_covariance``: and the transition's covariance does not depend on the state;
* ``gaussian_emission``: :func:`.missing.gaussian_rows` has a Gaussian approximation of the emission;
* ``informative_mean``: the emission's mean depends on the state;
* ``transition_density``: the transition has a finite density wherever it draws.
"""

LINEARISING = {"gaussian_transition", "constant_covariance", "gaussian_emission", "informative_mean"}
"""Needs of methods that linearise, which compute on the CPU in float64."""
