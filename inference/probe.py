"""A state-space model's three distributions, evaluated on small batches of states simulated from it.

    one state (D,) with an int t,   a batch (M, N, D) with an int t,   rows (N, K, D) with a LongTensor t (K,)

Event shapes, batch shapes, types, draws and log-densities are compared with what every method relies on: torch
broadcasts what does not fit, so that a wrong shape often yields a wrong number instead of an error.

Shapes: states (…, D). Batches of parameter sets (B, 1, own shape) take states (B, N, D).
"""

from dataclasses import dataclass, field
from textwrap import shorten
from typing import NamedTuple, NoReturn

import torch
from torch import Tensor
from torch.distributions import Distribution, Independent, constraints

from invdyn.models.divergence import Diverged
from invdyn.models.observation.missing import filled, observed_log_prob
from invdyn.models.shapes import common
from invdyn.models.state_space import StateSpaceModel
from invdyn.recordings.errors import InputError, first_line

FILTERS, PARTICLES, STEPS, ROWS = 2, 3, 2, 16
"""Sizes of the simulated batch (M, N), transitions that it is simulated for, and rows K evaluated at once."""

KEEP_DIMENSIONS = "index states from the right, state[..., i], and keep all leading dimensions"
ONE_STATE = "it must take one state (D,) and an int t"
ROWS_AT_ONCE = "t is a LongTensor (K,) there: write inputs[t], torch.where(t == 0, …), not if, range or float(t)"
AS_STATE = "make constants with the state's type, matrix.to(state)"


class ModelError(InputError):
    """A model that does not fit its rows or its method: one line with what was expected, what came, and the fix."""


class _Drawn(NamedTuple):
    """A distribution with a draw and the draw's log-density."""

    distribution: Distribution
    value: Tensor
    density: Tensor


@dataclass(repr=False)
class Probe:
    """States simulated from a model, with the distributions there already checked.

    ``given`` is the type in which the model was given: methods that linearise compute in float64, where initial states
    of that type still do.

    Attributes:
        states: (S, M, N, D) of the first S rows; (S, B, N, D) with B parameter sets.
        transition, emission: distributions at rows (K,) of states (N, K, D), or (N, B, K, D); there is no transition
            where there is one row.
    """

    model: StateSpaceModel
    linearises: bool
    given: torch.dtype
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
        # Methods that linearise hand on states in float64, for any type of the model.
        self.dtype = torch.float64 if self.linearises else model.dtype

        self.sets = self._parameter_sets(first, self._handed_on(drawn.value))
        state = self._start(first, (*(self.sets[:-1] or (FILTERS,)), PARTICLES))
        self.states = state[None]
        self._emission(state, 0, KEEP_DIMENSIONS)
        for t in range(1, min(STEPS, model.num_steps - 1) + 1):
            after = self._transition(state, t, KEEP_DIMENSIONS)
            if model.emission_sees_previous:
                self._emission_given(state, after.value, t, KEEP_DIMENSIONS)
            if t == 1:
                self._check_finite("transition", after)
            if not bool(torch.isfinite(after.value).all()):
                break  # a simulation that runs away is for the method to report, with its row
            state = after.value
            self.states = torch.cat([self.states, state[None]])

        count = min(ROWS, model.num_steps)
        rows = torch.linspace(0, model.num_steps - 1, count, device=model.device).long()
        paths = self._start(first, (PARTICLES, *self.sets[:-1], count))
        self.emission = self._emission(paths, rows, ROWS_AT_ONCE)
        if model.num_steps > 1:
            self.transition = self._transition(paths, rows.clamp_min(1), ROWS_AT_ONCE)
            if model.emission_sees_previous:
                self._emission_given(paths, self.transition.value, rows.clamp_min(1), ROWS_AT_ONCE)

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
        return self._common("transition", *shapes)

    def _common(self, method: str, *shapes: torch.Size) -> torch.Size:
        try:
            return torch.Size(common(*shapes))
        except ValueError:
            got = " and ".join(str(tuple(shape)) for shape in shapes)
            raise self.error(method, "parameter sets of one number B", got, "give all parameters (B, 1, …)") from None

    def _refuse_sets(self, method: str, batch: torch.Size) -> NoReturn:
        expected = "batch shape () for one state, or (B, 1) with B parameter sets"
        raise self.error(method, expected, tuple(batch), KEEP_DIMENSIONS)

    def _transition(self, state: Tensor, t: int | Tensor, fix: str) -> _Drawn:
        drawn = self._evaluated("transition", (state,), t, self.model.state_dim, fix)
        if drawn.value.dtype != state.dtype:
            raise self.error("transition", f"states of type {state.dtype}", drawn.value.dtype, AS_STATE)
        return drawn

    def _emission(self, state: Tensor, t: int | Tensor, fix: str) -> _Drawn:
        return self._observed("emission", (state,), t, fix)

    def _emission_given(self, previous: Tensor, state: Tensor, t: int | Tensor, fix: str) -> _Drawn:
        return self._observed("emission_given", (previous, state), t, fix)

    def _observed(self, method: str, states: tuple[Tensor, ...], t: int | Tensor, fix: str) -> _Drawn:
        drawn = self._evaluated(method, states, t, self.model.observation_dim, fix)
        self._check_finite(method, drawn)
        _, value, density = drawn
        finite = torch.isfinite(value).all(-1)
        if bool((finite & torch.isnan(density)).any()) or (bool(finite.any()) and bool(torch.isinf(density).all())):
            raise self.error(method, "finite log-densities of its own draws", "others", "give it noise")
        return drawn

    def _evaluated(self, method: str, states: tuple[Tensor, ...], t: int | Tensor, width: int, fix: str) -> _Drawn:
        """The distribution at these states: event and batch shape, draws and log-densities as they must be."""
        state = states[-1]
        when = f"t = {t}" if isinstance(t, int) else f"t {tuple(t.shape)}"
        where = f" for states {tuple(state.shape)} at {when}"
        found = self._called(method, (*states, t), where, fix)
        self._check_event(method, found, width)
        batch = self._common(method, state.shape[:-1], self.sets)
        if found.batch_shape != batch:
            got = tuple(found.batch_shape)
            raise self.error(method, f"batch shape {tuple(batch)}{where}", got, f"{fix}, or .expand(state.shape[:-1])")
        return self._drawn(method, found)

    def _called(self, method: str, arguments: tuple, where: str, fix: str) -> Distribution:
        try:
            found = getattr(self.model, method)(*arguments)
        except Diverged:
            raise
        except Exception as error:  # any error of a user's code becomes the one line
            raise self.error(method, f"a distribution{where}", _raised(error), _fix(error) or fix) from error
        if not isinstance(found, Distribution):
            got = "nothing" if found is None else type(found).__name__
            raise self.error(method, "a Pyro distribution", got, "return Normal(…).to_event(1), for example")
        return found

    def _check_event(self, method: str, found: Distribution, width: int) -> None:
        event, batch = tuple(found.event_shape), tuple(found.batch_shape)
        if event == (width,):
            return
        attribute = "observation_dim" if method.startswith("emission") else "state_dim"
        fix = f"return {width} entries, or set {attribute}" if event else "add .to_event(1)"
        raise self.error(method, f"event shape ({width},) = ({attribute},)", f"{event} with batch shape {batch}", fix)

    def _drawn(self, method: str, found: Distribution) -> _Drawn:
        """A draw and its log-density, of the shapes that the distribution says."""
        try:
            value = found.sample()
            density = found.log_prob(value)
        except Exception as error:
            fix = _fix(error) or "correct its sample or log_prob"
            raise self.error(method, "draws and their log-densities", _raised(error), fix) from error
        shape = found.batch_shape + found.event_shape
        if value.shape != shape:
            raise self.error(method, f"draws {tuple(shape)}", tuple(value.shape), "correct its sample")
        if not isinstance(density, Tensor) or density.shape != found.batch_shape or not density.is_floating_point():
            got = tuple(density.shape) if isinstance(density, Tensor) else type(density).__name__
            raise self.error(method, f"log_prob {tuple(found.batch_shape)} of real numbers", got, "sum over the event")
        return _Drawn(found, value, density)

    def _check_finite(self, method: str, drawn: _Drawn) -> None:
        if not bool(torch.isfinite(drawn.value).any()):
            raise self.error(method, "finite draws", "NaN or infinity", "check noise scales and parameters")

    def _start(self, first: Distribution, lead: tuple[int, ...]) -> Tensor:
        """Initial states (*lead, D) in the type that methods hand on."""
        try:
            return self._handed_on(first.expand(torch.Size(lead)).sample())
        except Exception as error:
            expected = f"a distribution that expands to {lead}"
            raise self.error("initial", expected, _raised(error), "correct its expand") from error

    def _handed_on(self, state: Tensor) -> Tensor:
        return state.to(self.dtype) if self.floating else state

    def _check_type(self, state: Tensor) -> None:
        """Initial states of the parameters' type, on their device; integers are of no type."""
        model = self.model
        if state.is_floating_point() and state.dtype not in (model.dtype, self.given):
            expected = f"states of the parameters' type {self.given}"
            raise self.error("initial", expected, state.dtype, "make it with dtype=self.dtype")
        if state.device != model.device:
            expected = f"states on the parameters' device {model.device}"
            raise self.error("initial", expected, state.device, "make it with device=self.device")

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
                raise self.error("emission", f"a density of row {t}, which has gaps", _raised(error), fix) from error
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
            raise self.error("emission", f"rows in its support, {support}", got, fix)

    def error(self, method: str, expected: str, got: object, fix: str) -> ModelError:
        """The one line about a method of the model."""
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
