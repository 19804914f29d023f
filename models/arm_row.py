"""The arm's mechanics from one row to the next: E[x_t | x_{t−1}] in sub-steps.

Within a row the torque process moves on a straight line from z to its mean one row later, under a command that is held
or moves as the motors make it. Effects act in the order

    motors, forces, inertias of the joints    as the integrator asks for them
    dry friction                              once a sub-step, at its mean about a stop: :mod:`.effects.dry_friction`
    a hidden hinge                            has a step of its own: :mod:`.effects.hidden`
    bristles                                  the same: :mod:`.effects.bristles`
    what follows the arm                      from one row to the next, after it

Shapes: states (..., D), joint quantities (..., K).
"""

from dataclasses import replace

from torch import Tensor

from invdyn.models.body import BodyParameters
from invdyn.models.dynamics import dynamics_for
from invdyn.models.effects.composition import own_values
from invdyn.models.effects.situation import Situation
from invdyn.models.integrators import INTEGRATORS
from invdyn.models.shapes import join

Clock = tuple[Tensor, Tensor]
"""A row's time, and that since the first one, s, (..., 1)."""


class ArmRow:
    """One row of :class:`.ArmModel`, which has the body, torque, effects, command, clocks and parameters used here."""

    def transition_mean(self, state: Tensor, t: int | Tensor) -> Tensor:
        """E[x_t | x_{t−1} = state], shape (..., D)."""
        z, q, qd = self.split(state)
        dt, body = self._step(t), self.body_parameters()
        parts = self.substeps_taken
        z, hidden = z[..., : self.torque_size], z[..., self.torque_size :]
        z_next = self.torque.mean(z, dt, self.parameters)
        joints, clock, interval = self.body.num_joints, self._clock(t - 1), self._interval(t)
        start, change = z[..., :joints], (z_next - z)[..., :joints]
        if self.command is not None:
            mean, slope = (row.to(state) for row in self.motors.row(t))
            start, change = start + mean - slope / 2, change + slope

        def smooth(q: Tensor, qd: Tensor, s: float | Tensor) -> tuple[Tensor, Tensor | None, Situation | None]:
            return self._smooth(q, qd, start + s * change, body, clock, s * interval, dt / parts)

        if self.effects.hinge:
            p, hinge = own_values(self.effects.hinge, self.parameters), self.effects.hinge
            links, whole = hinge.chain(p, body), dynamics_for(joints + 1)

            def net(q: Tensor, qd: Tensor, s: float | Tensor) -> tuple[Tensor, Tensor | None]:
                return self._rubbed(*smooth(q, qd, s))

            def pull(angles: Tensor, rates: Tensor, s: float | Tensor) -> Tensor | float:
                if not self.effects.pulls:
                    return 0.0
                here = self._now(
                    hinge.turned(angles), hinge.turned(rates), start, body, clock, s * interval, dt / parts
                )
                bent = replace(here, q=angles, qd=rates, body=links, dynamics=whole, split=hinge.place[0])
                rigid = self.effects.pull(self.parameters, here)
                return self.effects.pull(self.parameters, bent) - hinge.on_joints(rigid)

            return join(z_next, *hinge.step(p, body, net, pull, self.dynamics, hidden, q, qd, dt, parts))

        if self.effects.bristles:

            def moving(q: Tensor, qd: Tensor, s: float, bent: Tensor) -> tuple[Tensor, Tensor]:
                torque, own, _ = smooth(q, qd, s)
                now = self._now(q, qd, start + s * change, body, clock, s * interval, dt / parts)
                friction, rate = self._bending(bent, now)
                torque, own = self._rubbed(torque + friction, own, now)
                return self.dynamics.forward(q, qd, torque, body, own), rate

            return join(z_next, *self.effects.bristles.step(moving, hidden, q, qd, dt, parts))

        def integrate(q: Tensor, qd: Tensor, begun: float, share: float, steps: int) -> tuple[Tensor, Tensor]:
            """``steps`` sub-steps that are a ``share`` of the row, under the dry friction at their beginning."""
            held, off, first = 0.0, None, None
            if self.effects.has_friction:
                torque, own, now = smooth(q, qd, begun)
                held, off, first = self.effects.friction(self.parameters, now, torque, own, held=True)

            def acceleration(q: Tensor, qd: Tensor, s: float) -> Tensor:
                if first is not None and not s:
                    return first
                torque, own, _ = smooth(q, qd, begun + share * s)
                return self.dynamics.forward(q, qd, torque + held, body, own)

            q, qd = INTEGRATORS[self.integrator](acceleration, q, qd, share * dt, steps)
            return (q if off is None else q + off), qd

        before, spans = (q, qd), parts if self.effects.has_friction else 1
        for i in range(spans):
            q, qd = integrate(q, qd, i / spans, 1 / spans, parts // spans)
        if self.effects.follower:
            p, follower = own_values(self.effects.follower, self.parameters), self.effects.follower
            hidden = follower.follow(p, hidden, before, (q, qd), body, dt)
        return join(z_next, hidden, q, qd)

    def _smooth(
        self,
        q: Tensor,
        qd: Tensor,
        motor: Tensor,
        body: BodyParameters,
        clock: Clock,
        passed: Tensor | float,
        step: Tensor,
    ) -> tuple[Tensor, Tensor | None, Situation | None]:
        """Torque of motors and effects but dry friction, and the joints' own inertias, (..., K); the situation.

        So many seconds ``passed`` after the row whose ``clock`` it is.
        """
        if not self.effects:
            return motor, None, None
        own = self.effects.inertia(self.parameters, self.body.num_joints)
        if not (self.effects.has_force or self.effects.has_friction):
            return motor, own, None
        now = self._now(q, qd, motor, body, clock, passed, step)
        return motor + self.effects.force(self.parameters, now), own, now

    def _now(
        self,
        q: Tensor,
        qd: Tensor,
        motor: Tensor,
        body: BodyParameters,
        clock: Clock,
        passed: Tensor | float,
        step: Tensor,
    ) -> Situation:
        """The moment so many seconds ``passed`` after the row whose ``clock`` it is."""
        time, elapsed = (reading + passed for reading in clock)
        return Situation(q, qd, motor, time, elapsed, step, body, self.dynamics)

    def _clock(self, t: int | Tensor) -> Clock:
        time, elapsed = (clock[t].to(self.dtype).unsqueeze(-1) for clock in (self.time, self._elapsed))
        return time, elapsed

    def _rubbed(self, torque: Tensor, own: Tensor | None, now: Situation | None) -> tuple[Tensor, Tensor | None]:
        """All torques, and the joints' own inertias."""
        if self.effects.has_friction:
            torque = torque + self.effects.friction(self.parameters, now, torque, own)[0]
        return torque, own

    def _bending(self, bent: Tensor, now: Situation) -> tuple[Tensor, Tensor]:
        """Friction through bristles that are ``bent`` (..., 1), (..., K) N·m, and how fast they bend, rad/s."""
        bristles, p = self.effects.bristles, own_values(self.effects.bristles, self.parameters)
        j = bristles.place[0]
        friction, rate = bristles.bending(p, bent, now.qd[..., j : j + 1], bristles.level(p, now), now.step)
        return now.at(j, friction), rate

    def _under(self, state: Tensor, t: int | Tensor, body: BodyParameters, command: Tensor | None) -> Tensor:
        """θ̈ at row ``t`` in ``state`` under a ``command``, (..., K); no hidden hinge moves."""
        z, q, qd = self.split(state)
        torque = z[..., : self.body.num_joints]
        torque = torque if command is None else torque + command
        step = self._interval(t) / self.substeps_taken
        motor = torque
        torque, own, now = self._smooth(q, qd, motor, body, self._clock(t), 0.0, step)
        if self.effects.bristles:
            now = self._now(q, qd, motor, body, self._clock(t), 0.0, step)
            torque = torque + self._bending(z[..., self.torque_size :], now)[0]
        torque, own = self._rubbed(torque, own, now)
        return self.dynamics.forward(q, qd, torque, body, own)

    def acceleration(self, state: Tensor, t: int | Tensor, body: BodyParameters) -> Tensor:
        """θ̈ at row ``t`` in ``state``, (..., K), under the mean of the commands before and after it, which may jump."""
        if self.command is None:
            return self._under(state, t, body, None)
        (before, rising), (after, slope) = (
            [value.to(state) for value in self.motors.row(row)] for row in (_since_the_first(t), t + 1)
        )
        return self._under(state, t, body, (before + rising / 2 + after - slope / 2) / 2)

    def _ahead(self, state: Tensor, t: int | Tensor, body: BodyParameters, seconds: Tensor) -> Tensor:
        """θ so many ``seconds`` τ (..., 1) after row ``t``, (..., K), to third order: q + τ q̇ + ½ τ² q̈(τ/3).

        ½ τ² q̈ stands for ∫₀^τ (τ − s) q̈ ds, whose weight has its middle at τ/3; the command, which jumps, has its own.
        """
        z, q, qd = self.split(state)
        command = None if self.command is None else self.motors.ahead(self.time[t], seconds)
        bent = self._under(state, t, body, command)
        third = join(z, q + seconds / 3 * qd + seconds**2 / 18 * bent, qd + seconds / 3 * bent)
        return q + seconds * qd + seconds**2 / 2 * self._under(third, t, body, command)

    def _interval(self, t: int | Tensor) -> Tensor:
        return self.dt[t].to(self.dtype).unsqueeze(-1)

    def late(self, t: int | Tensor) -> Tensor | None:
        """Sd (..., K), N·m, of what motors that act late still do in the step into row ``t`` and nobody was told.

        None where there are none, or where a recording begins with what it knows.
        """
        if not (self.effects.has_late and self.torque.underway):
            return None
        begun = self._since[t - 1].to(self.dtype).unsqueeze(-1)
        share = self.effects.late(self.parameters, begun, self.body.num_joints)
        return share * self.torque.unsettled(self._step(t), self.parameters)

    @property
    def substeps_taken(self) -> int:
        """Integrator steps per row: ``substeps``, or more where an effect's force jumps."""
        return max(self.substeps, self._abrupt)

    def _step(self, t: int | Tensor) -> Tensor:
        """What a row's interval really takes, s."""
        dt = self._interval(t)
        return self.effects.interval(self.parameters, dt) if self.effects else dt


def _since_the_first(t: int | Tensor) -> int | Tensor:
    """The row that led into row ``t``; of the first one, which none did, the one that leads on."""
    return t.clamp_min(1) if isinstance(t, Tensor) else max(t, 1)
