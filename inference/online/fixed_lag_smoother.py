"""States with their uncertainty a fixed lag behind rows as they come: a Gauss–Newton smoother over a moving window.

Sibley, Matthies & Sukhatme (2010), "Sliding window filter with application to planetary landing"; Särkkä & Svensson
(2023), "Bayesian Filtering and Smoothing", chapters 10 and 13. With L rows of lag, the window holds the last rows
k … t, and what the rows before it say of its first state,

    p(x_k | y_{0:k}) ≈ N(m_k, P_k)        (rows 0 … k − 1),

so that a step of Gauss–Newton (:mod:`.smoothing.linearisation`) on the window, from the path so far and the predicted
x_t, gives the smoother's mean and covariance of every state of it, given all rows up to t. That of row t − L is the
answer. Then the first row is marginalised: with its linearisation, x_k is updated by y_k and moved on,

    N(m_{k+1}, P_{k+1}) = ∫ N(x_{k+1}; f(x_k), Q) N(x_k; m_k, P_k) p(y_k | x_k) dx_k / p(y_k | y_{0:k}).

Of a linear-Gaussian model this is the exact smoother p(x_{t−L} | y_{0:t+1}). Otherwise each row is linearised again
with each later row in the window, and then no more.

What row t comes with, against what was predicted of it, is the innovation; standardised,

    z_t = C⁻¹ (y_t − h(x̂_t)),   C Cᵀ = R + H (F P Fᵀ + Q) Hᵀ,   z_t ~ N(0, I) while the model holds.

Shapes: states D, entries of a row O. All in float64; memory and the work for a row do not grow with their number.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from pyro.distributions import Distribution
from torch import Tensor

from invdyn.inference.contract import ModelError, check_model
from invdyn.inference.smoothing.gauss_newton import gauss_newton, solve
from invdyn.inference.smoothing.linearisation import Linearisation, differences, emission_mean, nudges_of, seen_rows
from invdyn.inference.smoothing.square_root import (
    apply,
    conditional,
    eliminate,
    forward_covariance,
    forward_mean,
    square,
)
from invdyn.models.divergence import Diverged, Singular
from invdyn.models.state_space import StateSpaceModel, gaussian_moments

WINDOW = 6
"""Rows of the window at least: a state that no single row shows, such as a torque, needs several to be linearised."""
MAX_SHIFT, MAX_STEPS = 3.0, 3
"""A row's steps of Gauss–Newton end when none moves a state by that many of its standard deviations, or after these."""
RAN_AWAY = (Diverged, Singular, FloatingPointError, np.linalg.LinAlgError)

WithInputs = Callable[[Any, np.ndarray], StateSpaceModel]
"""From a model of T rows and their inputs (T, I) to the model that has them."""


@dataclass(frozen=True)
class Smoothed:
    """State of row t given all rows up to ``last``.

    Attributes:
        t, last: row numbers.
        mean, covariance: (D,) and (D, D).
        innovation: (O,) standardised, of row t when it came; NaN where nothing was seen, and before the start.
        inputs: (I,) of row t, or None.
    """

    t: int
    last: int
    mean: np.ndarray
    covariance: np.ndarray
    innovation: np.ndarray
    inputs: np.ndarray | None = None

    @property
    def sd(self) -> np.ndarray:
        """Standard deviations (D,)."""
        return np.sqrt(np.diagonal(self.covariance))


@dataclass
class Counts:
    """What became of rows: ``rows`` answered, ``lost`` ones that never came, ``late`` beyond use, ``doubled``.

    ``restarts`` is how often the window had to start again, because its path ran away.
    """

    rows: int = 0
    lost: int = 0
    late: int = 0
    doubled: int = 0
    restarts: int = 0


class FixedLagSmoother:
    """Fixed-lag smoother: rows in by :meth:`add`, states of the rows ``lag`` before out.

    Args:
        model: with continuous states and Gaussian transitions. Rows beyond its last are as its last one; the start
            is found on all of its rows, so let it have few, but as many as the window.
        lag: L, rows.
        with_inputs: how rows' inputs, such as commands, come into the model; None where there are none.
        at_start: the model that suits the rows (T, O) of its start, such as one whose prior is about the pose there.

    Raises ValueError for a negative lag or too few rows of the model, and ModelError for a model that cannot be
    linearised.
    """

    def __init__(
        self,
        model: StateSpaceModel,
        lag: int,
        *,
        with_inputs: WithInputs | None = None,
        at_start: Callable[[Any, Tensor], StateSpaceModel] | None = None,
    ):
        self.size = max(lag + 1, WINDOW)
        if lag < 0 or model.num_steps <= self.size:
            raise ValueError(
                f"expected a lag of 0 rows or more, and a model of more than {self.size} rows, "
                f"got {lag} and {model.num_steps}"
            )
        nothing = torch.full((model.num_steps, model.observation_dim), torch.nan)
        check_model(model, nothing, needs=("gaussian_transition", "emission_of_state"))
        self.model, self.lag = model.to(dtype=torch.float64, device="cpu"), lag
        self.with_inputs, self.at_start = with_inputs, at_start
        self.forget()

    def forget(self) -> None:
        """Forget all rows, and count from 0 again."""
        self.counts = Counts()
        self._begin(0)

    def _begin(self, first: int) -> None:
        """An empty window, whose first row is to be number ``first``."""
        self._first = self._due = first
        self._rows: list[np.ndarray] = []
        self._inputs: list[np.ndarray | None] = []
        self._innovations: list[np.ndarray] = []
        self._path = self._ahead = torch.zeros(0)
        self._covariance = np.zeros(0)

    @property
    def next(self) -> int:
        """Number of the row after the last one that came."""
        return self._first + len(self._rows)

    def add(self, t: int, y: np.ndarray | Tensor, inputs: np.ndarray | None = None) -> list[Smoothed]:
        """Take row ``t``, y (O,) with NaN where missing, and return the states that are due.

        Rows that are passed over count as lost, and are taken as missing. A row that comes after its successors
        still counts while it is in the window. Raises ModelError for a row of another length.
        """
        y = torch.as_tensor(y).detach().cpu().double().numpy().copy()
        if y.shape != (self.model.observation_dim,):
            raise ModelError(f"rows: expected row {t} of shape ({self.model.observation_dim},), got {y.shape}")
        if t < self.next:
            self._belated(t, y, inputs)
            return []
        if not self._rows:
            if np.isnan(y).all():
                return []  # nothing to start from
            self._begin(t)
        found = []
        while self.next < t:
            self.counts.lost += 1
            found += self._append(np.full_like(y, np.nan), self._inputs[-1])
        return found + self._append(y, inputs)

    def finish(self) -> list[Smoothed]:
        """The states of the last rows, given all rows: no row is to come."""
        if self._rows and not len(self._path):
            try:
                self._start()
            except RAN_AWAY:
                return []
        return self._answers(self.next) if self._rows else []

    def restart(self, first: int) -> list[Smoothed]:
        """End as :meth:`finish` does, and start again with row ``first``."""
        found = self.finish()
        self.counts.restarts += bool(self._rows)
        self._begin(first)
        return found

    def _belated(self, t: int, y: np.ndarray, inputs: np.ndarray | None) -> None:
        """A row whose number has been passed: what of it is new fills the window."""
        if t < self._first or not self._rows:
            self.counts.late += 1
            return
        row = self._rows[t - self._first]
        if (known := ~np.isnan(row)).any():
            self.counts.doubled += 1
        else:
            self.counts.lost -= 1
            if inputs is not None:
                self._inputs[t - self._first] = inputs
        row[~known] = y[~known]

    def _append(self, y: np.ndarray, inputs: np.ndarray | None) -> list[Smoothed]:
        self._rows.append(y)
        self._inputs.append(inputs)
        self._innovations.append(np.full(len(y), np.nan))
        try:
            if not len(self._path):
                if len(self._rows) < self.size:
                    return []
                self._start()
            else:
                self._follow()
        except RAN_AWAY:
            self.counts.restarts += 1
            self._begin(self.next)
            return []
        found = self._answers(self.next - self.lag)
        while len(self._rows) >= self.size:
            self._marginalise()
        return found

    def _start(self) -> None:
        """The path of the first window, by Gauss–Newton from scratch."""
        rows = np.full((self.model.num_steps, self.model.observation_dim), np.nan)
        rows[: len(self._rows)] = self._rows
        if self.at_start is not None:
            self.model = self.at_start(self.model, torch.as_tensor(rows))
        smoother = gauss_newton(self._with_inputs(), torch.as_tensor(rows))
        self._path = smoother.path[: len(self._rows)]
        self._prior, self._nudges = gaussian_moments(self.model.initial()), nudges_of(self.model)
        self._step()

    def _follow(self) -> None:
        """The path with one more row."""
        before, self._path = self._covariance[-1], torch.cat([self._path, self._ahead[None]])
        linear = self._step()
        F, L, E = linear.F[-1], linear.L[-1], linear.E[-1]
        noise = np.eye(len(E)) + E @ (F @ before @ F.T + square(L)) @ E.T
        innovation = np.linalg.solve(np.linalg.cholesky(noise), linear.e[-1] - E @ linear.a[-1])
        if linear.rows is not None and linear.rows.E is None:
            innovation[np.isnan(self._rows[-1])] = np.nan
        self._innovations[-1] = innovation

    def _step(self) -> Linearisation:
        """Steps of Gauss–Newton over the window; returns the first linearisation, where a new row is as predicted."""
        first: Linearisation | None = None
        for _ in range(MAX_STEPS):
            linear, ahead, onward = self._linearised()
            first = first or linear
            factors = solve(linear)
            shift = forward_mean(factors, linear.m0)
            if not np.isfinite(shift).all():
                raise Diverged("the path of the window runs away")
            self._covariance = forward_covariance(factors)
            self._linear, self._about = linear, self._path
            self._path = self._path + torch.as_tensor(shift)
            self._ahead = ahead + onward @ torch.as_tensor(shift[-1])
            sd = np.sqrt(np.diagonal(self._covariance, axis1=-2, axis2=-1))
            if (np.abs(shift) <= MAX_SHIFT * sd).all():
                break
        assert first is not None
        return first

    def _answers(self, before: int) -> list[Smoothed]:
        """States of the rows that are due, up to number ``before``."""
        found = []
        for t in range(self._due, before):
            k = t - self._first
            mean, covariance = self._path[k].numpy().copy(), self._covariance[k]
            found.append(Smoothed(t, self.next - 1, mean, covariance, self._innovations[k], self._inputs[k]))
        self.counts.rows += len(found)
        self._due = max(self._due, before)
        return found

    def _marginalise(self) -> None:
        """Leave the first row out, and keep what it and those before say of the next."""
        linear, dim = self._linear, self.model.state_dim
        E, e = linear.E[0], linear.e[0]
        if len(E) < dim:  # zero rows say nothing
            E, e = np.pad(E, [(0, dim - len(E)), (0, 0)]), np.pad(e, (0, dim - len(e)))
        R, B, r, _, _ = eliminate(E, e, linear.L[0])
        gain, offset, root = conditional(R, B, r, linear.L[0])
        mean = apply(linear.F[0], apply(gain, linear.m0) + offset) + linear.a[0]
        both = np.concatenate([linear.F[0] @ root, linear.L[1]], -1)
        root = np.asarray(np.linalg.qr(both.T, mode="r")).T
        self._prior = self._about[1] + torch.as_tensor(mean), torch.as_tensor(root)
        self._path, self._covariance = self._path[1:], self._covariance[1:]
        for each in (self._rows, self._inputs, self._innovations):
            del each[0]
        self._first += 1

    @torch.no_grad()
    def _linearised(self) -> tuple[Linearisation, Tensor, Tensor]:
        """The model along the window's path, by one evaluation of all its rows; the last row's next state, and slopes.

        The state after the last row is needed when the next one comes, and costs nothing more here.
        """
        count, roots = len(self._path), list[Tensor]()
        model, rows = self._with_inputs(), torch.arange(count)
        rows = rows if self.with_inputs is not None else rows + max(self._first, 0)  # a clock may go back
        last, (nudges, central) = model.num_steps - 1, self._nudges
        independent, shown = model.independent_sensor_states or ([], [])
        view = _Window(model, rows.clamp(max=last))

        def transition(x: Tensor) -> Tensor:
            mean, root = gaussian_moments(model.transition(x, (rows + 1).clamp(max=last)))
            roots[:] = [root.expand(*x.shape, x.shape[-1])[-1]]
            return mean

        following, F = differences(transition, self._path, nudges, independent, independent, central)
        seen = seen_rows(view, self._path, torch.as_tensor(np.array(self._rows)))
        H = self._path.new_zeros(count, 0, len(nudges))
        if seen.E is None:
            _, H = differences(
                lambda x: emission_mean(view, x, torch.arange(count)), self._path, nudges, independent, shown, central
            )
        mean, first = self._prior
        linear = Linearisation(
            F=F[:-1].numpy(),
            a=(following[:-1] - self._path[1:]).numpy(),
            L=torch.cat([first[None], roots[0][:-1]]).numpy(),
            E=seen.on_state(H).numpy(),
            e=seen.e,
            m0=(mean - self._path[0]).numpy(),
            log_constant=seen.log_constant,
            rows=seen,
        )
        return linear, following[-1], F[-1]

    def _with_inputs(self) -> StateSpaceModel:
        """The model in which the window's rows, from its first, have their inputs."""
        if self.with_inputs is None:
            return self.model
        known = [each for each in self._inputs if each is not None]
        if len(known) < len(self._inputs):
            raise ValueError("expected inputs with every row, as the model has some, got a row without")
        rest = self.model.num_steps - len(known)
        return self.with_inputs(self.model, np.pad(np.array(known), [(0, rest), (0, 0)], mode="edge"))


class _Window(StateSpaceModel):
    """A model whose rows are some of another's."""

    def __init__(self, model: StateSpaceModel, rows: Tensor):
        super().__init__(model.parameters)
        self.model, self.rows, self.num_steps = model, rows, len(rows)
        self.state_dim, self.observation_dim = model.state_dim, model.observation_dim
        self.emission_about_mean = model.emission_about_mean

    def initial(self) -> Distribution:
        return self.model.initial()

    def transition(self, state: Tensor, t: int | Tensor) -> Distribution:
        return self.model.transition(state, self.rows[t])

    def emission(self, state: Tensor, t: int | Tensor) -> Distribution:
        return self.model.emission(state, self.rows[t])
