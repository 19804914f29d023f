"""What is seen of a body at a row: its sites in its state, what effects make of them, and the sensors' distribution.

Effects on what is seen may need how the body moves about the row: its accelerations, and where its joints are so many
seconds τ later, to third order,

    θ(t + τ) ≈ θ + τ θ̇ + ½ τ² θ̈(t + τ/3),

where ½ τ² θ̈ stands for ∫₀^τ (τ − s) θ̈ ds, whose weight has its middle at τ/3; the command, which jumps, has its own.
A servo answers within less time than that: with one, what comes later is integrated. What came earlier stays third
order, as a damper's past grows without bounds.

Shapes: states (..., D), joint quantities (..., K), sites (..., S, d), rows (..., O).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from pyro.distributions import Distribution
from torch import Tensor

from invdyn.models.articulated.drive import Motors, RowDrive
from invdyn.models.articulated.moving_base import MovingBase
from invdyn.models.articulated.state import StateLayout
from invdyn.models.articulated.step import Mechanics
from invdyn.models.articulated.timeline import Row, Timeline
from invdyn.models.observation.observation import Observation
from invdyn.models.observation.view import View
from invdyn.models.shapes import join

LATER = 3
"""Stretches that a time ahead of a row is integrated in, of as many sub-steps as a row: latencies are of some rows."""


@dataclass(frozen=True, eq=False)
class ObservationModel:
    """A body with its drive before sensors.

    Attributes:
        layout: of its states.
        parts: sub-steps that a row is integrated in.
        base: that moves, or None.
    """

    mechanics: Mechanics
    motors: Motors
    timeline: Timeline
    observation: Observation
    layout: StateLayout
    parts: int
    base: MovingBase | None = None

    def emission(self, state: Tensor, t: Row) -> Distribution:
        """Distribution of row ``t`` given its ``state``; event shape (O,)."""
        return self.observation.predict(self.view(state, t), t, self.mechanics.parameters)

    def view(self, state: Tensor, t: Row) -> View:
        """Row ``t`` as effects leave it to the sensors."""
        unseen, q, qd = self.layout.split(state)
        z, hidden, memory = self.layout.parted(unseen)
        effects, parameters, dynamics = self.mechanics.effects, self.mechanics.parameters, self.mechanics.dynamics
        body = self.mechanics.body_parameters()
        points = effects.sites(parameters, dynamics, q, hidden, body)
        base = None if self.base is None else self.base.parted(z[..., -self.base.size :])
        if base is not None:
            points = points + base[0].unsqueeze(-2)

        def angles_after(seconds: Tensor) -> Tensor:
            return self._ahead(state, t, body, seconds)

        def ahead(seconds: Tensor) -> Tensor:
            moved = dynamics.keypoints(angles_after(seconds), body) - dynamics.keypoints(q, body)
            if base is not None:
                moved = moved + (seconds * base[1] + seconds**2 / 2 * base[2]).unsqueeze(-2)
            return moved

        def acceleration() -> Tensor:
            return self.acceleration(state, t, body)

        def clock() -> Tensor:
            return self.timeline.elapsed[t].to(state).unsqueeze(-1)

        view = View(q, qd, points, q, body, dynamics, acceleration, angles_after, ahead, clock, base=base)
        view.memory = memory if self.layout.memory else None
        return self._as_seen(view, parameters, t) if effects.seen else view

    def _as_seen(self, view: View, parameters: Mapping[str, Tensor], t: Row) -> View:
        effects, keypoints = self.mechanics.effects, self.observation.keypoints
        if keypoints is not None:
            view.doubt = keypoints.doubted(t, view.q, view.points.shape[-2])
        angles = effects.angles(parameters, view) if self.observation.encoders else view.q
        view = effects.points(parameters, view)
        if effects.changes("noise"):
            view.noise = lambda sd: effects.noise(parameters, view, sd)
        view.angles, view.mistakes = angles, effects.mistakes(parameters, view)
        return view

    def acceleration(self, state: Tensor, t: Row, body: Any) -> Tensor:
        """θ̈ at row ``t`` in ``state``, (..., K), under the mean of the commands before and after it, which may jump."""
        return self._under(state, t, body, self.motors.about(t, state))

    def _ahead(self, state: Tensor, t: Row, body: Any, seconds: Tensor) -> Tensor:
        """θ so many ``seconds`` (..., 1) after row ``t``, (..., K)."""
        if not self.mechanics.effects.has_servo:
            return self.to_third_order(state, t, body, seconds)
        before = self.to_third_order(state, t, body, seconds.clamp_max(0.0))
        return torch.where(seconds > 0, self._integrated(state, t, body, seconds.clamp_min(0.0)), before)

    def _integrated(self, state: Tensor, t: Row, body: Any, seconds: Tensor) -> Tensor:
        """The same of ``seconds`` that are not negative, in ``LATER`` stretches with a straight command each."""
        unseen, q, qd = self.layout.split(state)
        z, *pieces = self.layout.parted(unseen)[:2]
        unknown, dtype = z[..., : self.layout.joints], self.motors.dtype
        interval, clock = self.timeline.interval(t, dtype), self.timeline.clock(t, dtype)
        for stretch in range(LATER):
            ends = stretch * seconds / LATER, (stretch + 1) * seconds / LATER
            mean, slope = self.motors.between(t, *ends, unknown)
            drive = RowDrive(
                unknown + mean - slope / 2,
                slope,
                body,
                clock,
                interval,
                seconds / LATER,
                self.parts,
                unknown,
                carried=self._carried(z),
            )
            *pieces, q, qd = self.mechanics.step(drive, join(*pieces), q, qd)
        return q

    def to_third_order(self, state: Tensor, t: Row, body: Any, seconds: Tensor) -> Tensor:
        """The same by the formula at the top of the file."""
        z, q, qd = self.layout.split(state)
        command = self.motors.ahead(t, seconds)
        bent = self._under(state, t, body, command)
        third = join(z, q + seconds / 3 * qd + seconds**2 / 18 * bent, qd + seconds / 3 * bent)
        return q + seconds * qd + seconds**2 / 2 * self._under(third, t, body, command)

    def _under(self, state: Tensor, t: Row, body: Any, command: Tensor | None) -> Tensor:
        """θ̈ at row ``t`` in ``state`` under a ``command``, (..., K); no hidden hinge moves."""
        unseen, q, qd = self.layout.split(state)
        z, hidden, _ = self.layout.parted(unseen)
        unknown = z[..., : self.layout.joints]
        torque = unknown if command is None else unknown + command
        interval, clock = self.timeline.interval(t, self.motors.dtype), self.timeline.clock(t, self.motors.dtype)
        carried = self._carried(z)
        drive = RowDrive(torque, 0.0, body, clock, interval, interval, self.parts, unknown, carried=carried)
        return self.mechanics.under(drive, hidden, q, qd)

    def _carried(self, z: Tensor) -> tuple[Tensor, float] | None:
        """The base's acceleration at a row, which stays."""
        return None if self.base is None else (self.base.parted(z[..., -self.base.size :])[2], 0.0)
