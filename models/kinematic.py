"""A body that moves by chance: forward kinematics of coordinates that walk, watched by sensors. No force is inferred.

Biderman et al. (2020), the analysis of the mouse. Of order 1 coordinates walk, of order 2 (the default) velocities do,

    1:  q' = q + s √δ η                     2:  q̇' = q̇ + s √δ η,   q' = q + ∫ q̇ dt

with s = "walk.scale" (K,), rad/√s or rad/s/√s (m of slides), and y ~ observation(q). Of order 2 the covariance of a
step is the integral's own, s² [[δ³/3, δ²/2], [δ²/2, δ]]: frames may be missing or irregular.

State x = q, or (q, q̇). Lengths, or other numbers of the body, may be learned, as in :class:`.ArmModel`, whose start,
"initial.…", and sensors, "emission.…", these are.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Self

import numpy as np
import torch
from pyro.distributions import Distribution, Normal
from torch import Tensor

from invdyn.models.articulated.arm import ArmModel
from invdyn.models.articulated.defaults import Value, WrongValue, joint_numbers, of_coordinates, shaped
from invdyn.models.articulated.start import joint_angle_sd
from invdyn.models.articulated.timeline import Row, Timeline
from invdyn.models.bodies.protocol import ArticulatedBody
from invdyn.models.dynamics.registry import dynamics_for
from invdyn.models.gaussian import by_root
from invdyn.models.kinematics import AGILITY, joint_angle_candidates
from invdyn.models.observation.keypoints import Keypoints
from invdyn.models.observation.observation import Observation
from invdyn.models.observation.view import View
from invdyn.models.shapes import join
from invdyn.models.state_space import StateSpaceModel

ORDERS = (1, 2)  # angles walk, or velocities
LIVELY = AGILITY[len(AGILITY) // 2]
"""s to begin with, rad/s/√s of order 2; a tenth of that of order 1."""


class KinematicModel(StateSpaceModel):
    """Coordinates of an articulated body that walk, seen by sensors.

    Args:
        body: a chain in the plane, or any :class:`.ArticulatedBody`.
        time: (T,) s, increasing; need not be regular.
        observation: what is observed; by default keypoints at all sites.
        order: 1 or 2, see the top of the file.
        parameters: values that replace the defaults, by dotted name, each broadcastable to its own shape.

    Raises ValueError for another order, times that do not increase, a parameter of the wrong shape, sensors that the
    body has no place for, and those whose errors last; KeyError for an unknown parameter.
    """

    emission_about_mean = True

    def __init__(
        self,
        body: ArticulatedBody,
        time: Sequence[float] | np.ndarray | Tensor,
        observation: Observation | None = None,
        *,
        order: int = 2,
        parameters: Mapping[str, Value] | None = None,
    ):
        if order not in ORDERS:
            raise WrongValue(f"expected a walk of order 1 or 2, got {order!r}")
        self.body, self.dynamics, self.order = body, dynamics_for(body), order
        self.observation = (observation or Observation(Keypoints(range(len(body.keypoint_names))))).bound(body)
        if self.observation.states:
            last = ", ".join(each.name for each in self.observation.with_states)
            raise WrongValue(f"expected sensors whose errors do not last, as a walk has no states for them, got {last}")
        self.timeline = Timeline.of(time)
        self.num_steps = len(self.timeline.time)
        self.observation_dim = self.observation.size
        self.state_dim = order * body.num_joints
        numbers = body.parameters()
        self._numbers = type(numbers)
        super().__init__(
            {
                **{f"body.{name}": value for name, value in numbers._asdict().items()},
                **of_coordinates(body.num_joints, {"walk.scale": LIVELY if order == 2 else LIVELY / 10}),
                **self.observation.defaults(self.dynamics.reach(numbers).item()),
            }
        )
        self.parameters = self.with_values(parameters or {}).parameters

    @classmethod
    def of(cls, model: ArmModel, order: int = 2) -> Self:
        """The kinematic model of an arm's body, rows, sensors and start."""
        shared = ("body.", "initial.", "emission.")
        parts = joint_numbers(model.body)
        own = {n: value for n, value in model.parameters.items() if n.startswith(shared) and n not in parts}
        return cls(model.body, model.time, model.observation, order=order, parameters=own)

    @property
    def time(self) -> Tensor:
        """(T,) s."""
        return self.timeline.time

    @property
    def unconstrained(self) -> frozenset[str]:
        """Parameters that may be negative."""
        return frozenset({"initial.angle", "initial.velocity", *(f"body.{name}" for name in self.body.signed)})

    @property
    def _given(self) -> Any:
        return self._numbers(*(self.parameters[f"body.{name}"] for name in self._numbers._fields))

    def body_parameters(self) -> Any:
        """The body's numbers, each (..., own shape), those that follow from others too."""
        return self.body.completed(self._given)

    def with_values(self, values: Mapping[str, Value]) -> Self:
        """Other parameter values, each broadcastable to its own shape. Raises as the class does."""
        return self.replace(**shaped(values, self.parameters))

    def replace(self, **values: Tensor) -> Self:
        """Other parameter values; see :meth:`StateSpaceModel.replace`."""
        other = super().replace(**values)
        if other.device != other.timeline.time.device:
            other.timeline, other.observation = self.timeline.to(other.device), self.observation.to(other.device)
        return other

    def sampled(self) -> Self:
        """Draw the body's priors and every other Pyro site; see :meth:`StateSpaceModel.sampled`."""
        drawn = self.body.drawn(self._given)
        return self.replace(**{f"body.{name}": value for name, value in drawn.items()})._sampled()

    def split(self, state: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """State (..., D) → torque states, none (..., 0), coordinates and velocities (..., K), zero of order 1."""
        K = self.body.num_joints
        q = state[..., :K]
        return state[..., :0], q, state[..., K:] if self.order == 2 else torch.zeros_like(q)

    # -- the three distributions -----------------------------------------------------------------
    def initial(self) -> Distribution:
        """Coordinates, and velocities, Gaussian; event shape (D,)."""
        p, names = self.parameters, ("initial.angle", "initial.velocity")[: self.order]
        mean, sd = (join(*(p[name + suffix] for name in names)) for suffix in ("", "_scale"))
        return Normal(mean, sd, validate_args=False).to_event(1)

    def transition(self, state: Tensor, t: Row) -> Distribution:
        """x_t given x_{t−1} = ``state`` (..., D); event shape (D,)."""
        dt, scale = self.timeline.dt[t].to(state).unsqueeze(-1), self.parameters["walk.scale"]
        step = scale * dt.sqrt()
        if self.order == 1:
            return Normal(state, step.expand_as(state), validate_args=False).to_event(1)
        _, q, qd = self.split(state)
        K = q.shape[-1]
        # The square root of the covariance at the top of the file, coordinates first.
        tril = state.new_zeros(*step.shape[:-1], 2 * K, 2 * K)
        diagonal = torch.arange(K, device=state.device)
        tril[..., diagonal, diagonal] = step * dt / 3**0.5
        tril[..., K + diagonal, diagonal] = step * 3**0.5 / 2
        tril[..., K + diagonal, K + diagonal] = step / 2
        return by_root(join(q + dt * qd, qd), tril)

    def emission(self, state: Tensor, t: Row) -> Distribution:
        """What sensors show in row ``t`` given x_t = ``state``; event shape (O,)."""
        _, q, qd = self.split(state)
        body, dynamics = self.body_parameters(), self.dynamics

        def angles_after(seconds: Tensor) -> Tensor:
            return q + seconds * qd

        def ahead(seconds: Tensor) -> Tensor:
            return dynamics.keypoints(angles_after(seconds), body) - points

        def clock() -> Tensor:
            return self.timeline.elapsed[t].to(state).unsqueeze(-1)

        points = dynamics.keypoints(q, body)
        view = View(q, qd, points, q, body, dynamics, lambda: torch.zeros_like(q), angles_after, ahead, clock)
        return self.observation.predict(view, t, self.parameters)

    # -- a start for linearisation -----------------------------------------------------------------
    def initial_paths(self, observations: Tensor) -> Tensor:
        """Paths (C, T, D) through smoothed inverse kinematics; see :mod:`.kinematics`."""
        numbers = self.body_parameters()
        numbers = type(numbers)(*(value.detach().cpu().double() for value in numbers))
        time, sd = self.time.cpu().numpy(), joint_angle_sd(self, numbers)
        candidates = joint_angle_candidates(self.body, time, observations, self.observation, numbers, sd)
        if candidates is None:
            return super().initial_paths(observations)
        pieces = [candidates, np.gradient(candidates, time, axis=1)][: self.order]
        return torch.as_tensor(np.concatenate(pieces, -1)).to(dtype=self.dtype, device=self.device)
