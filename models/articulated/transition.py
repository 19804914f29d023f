"""How a state moves from one row to the next: the law of x_0, and of x_t given x_{t−1}.

    z' = E[z_t | z],   (hidden, θ, θ̇)' = one row of the mechanics,   x_t ~ N(·, diag(L Lᵀ, sds²))

with L of the torque process, and sds "noise.hidden.<effect>", "noise.angle" and "noise.velocity". Sensors' states go on
as those say (:class:`.sensor.SensorWithStates`). Where another
recording starts, x_t does not follow from the row before.

Shapes: states (..., D), torques z (..., Z), joint quantities (..., K).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from pyro.distributions import Distribution
from torch import Tensor

from invdyn.models.articulated.drive import Motors, RowDrive
from invdyn.models.articulated.moving_base import OnMovingBase
from invdyn.models.articulated.state import StateLayout
from invdyn.models.articulated.step import Mechanics
from invdyn.models.articulated.timeline import Row, Timeline
from invdyn.models.observation.observation import Observation
from invdyn.models.shapes import by_column, join
from invdyn.models.torques import TorqueProcess


@dataclass(frozen=True, eq=False)
class Transition:
    """A body under its drive and a torque process.

    Attributes:
        layout: of its states.
        parts: sub-steps that a row is integrated in.
        observation: whose sensors may have states.
    """

    mechanics: Mechanics
    motors: Motors
    timeline: Timeline
    torque: TorqueProcess
    layout: StateLayout
    parts: int
    observation: Observation

    def initial(self) -> Distribution:
        """z_0 stationary, θ_0 and θ̇_0 Gaussian; event shape (D,)."""
        p = self.mechanics.parameters
        return self._initial(p["initial.angle"], p["initial.velocity"], p["initial.angle_scale"])

    def following(self, state: Tensor, t: Row) -> Distribution:
        """x_t given x_{t−1} = ``state``; event shape (D,)."""
        p = self.mechanics.parameters
        root = self._torque_noise(t)
        if (late := self.late(t)) is not None:
            root = torch.hypot(root, late)
        memory = self.observation.transition_sd(self._lasts(t), p) if self.layout.memory else []
        sds = self._with_hidden("noise.hidden", memory, p["noise.angle"], p["noise.velocity"])
        moved = self.layout.gaussian(self.mean(state, t), root, sds)
        if self.timeline.restarts is None or self.timeline.middle is None:
            return moved
        # As the first row is, within about half a turn of some angles.
        middle = self.timeline.middle[t]
        first = self._initial(middle, torch.zeros_like(middle), torch.full_like(middle, np.pi))
        return self.layout.one_or_other(self.timeline.restarts[t], first, moved)

    def mean(self, state: Tensor, t: Row) -> Tensor:
        """E[x_t | x_{t−1} = state]."""
        unseen, q, qd = self.layout.split(by_column(state))
        z, hidden, memory = self.layout.parted(unseen)
        z_next = self.torque.mean(z, self._torque_lasts(t), self.mechanics.parameters)
        *bent, q_next, qd_next = self.mechanics.step(self._driven(z, z_next, t), hidden, q, qd)
        if self.layout.memory:
            bent += self.observation.next_mean(memory, self._lasts(t), self.mechanics.parameters)
        return join(z_next, *bent, q_next, qd_next)

    def late(self, t: Row) -> Tensor | None:
        """Sd (..., K), N·m, of what motors that act late still do in the step into row ``t``, which no command says.

        None where there are none, or where a recording begins with what it knows.
        """
        effects, p = self.mechanics.effects, self.mechanics.parameters
        if not (effects.changes("late") and self.torque.underway):
            return None
        elapsed = self.timeline.since[t - 1].to(self.motors.dtype).unsqueeze(-1)
        return effects.late(p, elapsed, self.layout.joints) * self.torque.unsettled(self._lasts(t), p)

    def _driven(self, z: Tensor, z_next: Tensor, t: Row) -> RowDrive:
        joints, dtype = self.layout.joints, self.motors.dtype
        start, change = unknown, drift = z[..., :joints], (z_next - z)[..., :joints]
        if self.motors.commanded:
            mean, slope = (row.to(z) for row in self.motors.made.row(t))
            start, change = start + mean - slope / 2, change + slope
        times = self.timeline.clock(t - 1, dtype), self.timeline.interval(t, dtype), self._lasts(t)
        carried = None
        if isinstance(self.torque, OnMovingBase):
            (*_, before), (*_, after) = (self.torque.base.parted(self.torque.parted(each)[1]) for each in (z, z_next))
            carried = before, after - before
        return RowDrive(start, change, self.mechanics.body_parameters(), *times, self.parts, unknown, drift, carried)

    def _initial(self, angle: Tensor, velocity: Tensor, angle_scale: Tensor) -> Distribution:
        p = self.mechanics.parameters
        root = self.torque.stationary(self.timeline.interval(0, self.motors.dtype), p)
        sds = self._with_hidden(
            "initial.hidden", self.observation.initial_sd(p), angle_scale, p["initial.velocity_scale"]
        )
        return self.layout.gaussian(self.layout.at_rest(angle, velocity), root, sds)

    def _lasts(self, t: Row) -> Tensor:
        """What a row's interval really takes, s, (..., 1)."""
        dt, effects = self.timeline.interval(t, self.motors.dtype), self.mechanics.effects
        return effects.through("interval", self.mechanics.parameters, dt)

    @property
    def _of_rows(self) -> bool:
        """Whether the torque's matrices are computed row by row: they are cheap, or rows differ in length."""
        return self.torque.diagonal or not self.timeline.regular

    def _torque_lasts(self, t: Row) -> Tensor:
        """The same for the torque's matrices, (..., 1): of one row for all, where they are equal."""
        return self._lasts(t if self._of_rows else 0)

    def _torque_noise(self, t: Row) -> Tensor:
        """Root of the torque's noise over a row; kept where it is that of all rows, and no parameter learns by it."""
        p = self.mechanics.parameters
        found = self.__dict__.get("kept_noise")
        if found is None:
            found = self.torque.noise(self._torque_lasts(t), p)
            if not self._of_rows and not any(value.requires_grad for value in p.values()):
                self.__dict__["kept_noise"] = found
        return found

    def _with_hidden(self, name: str, memory: Sequence[Tensor], angle: Tensor, velocity: Tensor) -> Tensor:
        own = (self.mechanics.parameters[f"{name}.{each.key}"] for each in self.mechanics.effects.hidden)
        return join(*own, *memory, angle, velocity)
