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

from dataclasses import dataclass, replace

from torch import Tensor

from invdyn.models.bodies.body import BodyParameters
from invdyn.models.dynamics.integrators import INTEGRATORS
from invdyn.models.dynamics.interface import dynamics_for
from invdyn.models.effects.composition import own_values
from invdyn.models.effects.effect_context import Situation
from invdyn.models.effects.hidden import Row, tip_motion
from invdyn.models.shapes import by_column, join

Clock = tuple[Tensor, Tensor]
"""A row's time, and that since the first one, s, (..., 1)."""


@dataclass(frozen=True)
class Drive:
    """What drives an arm from one row to the next.

    Attributes:
        start, change: N·m, (..., K): torque of process and motors, start + s change, 0 ≤ s ≤ 1.
        body: the links as the effects leave them.
        clock: of the row in which it begins.
        interval, dt: s, (..., 1), what the row is said to last, and what it lasts.
        parts: sub-steps.
    """

    start: Tensor
    change: Tensor | float
    body: BodyParameters
    clock: Clock
    interval: Tensor
    dt: Tensor
    parts: int

    def motor(self, s: float | Tensor) -> Tensor:
        """The torque a share ``s`` of the row after it has begun."""
        return self.start + s * self.change


class ArmRow:
    """One row of :class:`.ArmModel`, which has the body, torque, effects, command, clocks and parameters used here."""

    def transition_mean(self, state: Tensor, t: int | Tensor) -> Tensor:
        """E[x_t | x_{t−1} = state], shape (..., D)."""
        z, q, qd = self.split(by_column(state))
        z, hidden = z[..., : self.torque_size], z[..., self.torque_size :]
        z_next = self.torque.mean(z, self._step(t), self.parameters)
        drive = self._drive(z, z_next, t)
        own = self.effects.shares(hidden)
        mover = self.effects.hinge or self.effects.bristles
        before = own[mover.key] if mover else hidden[..., :0], q, qd
        bent, *moved = after = self._moved(drive, *before)
        return join(z_next, bent, *self._followed(drive, own, before, after), *moved)

    def _moved(self, drive: Drive, bent: Tensor, q: Tensor, qd: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The hidden states, if there are any, that have a part in it, q and q̇ one row later."""
        if self.effects.hinge:
            return self._hinged(drive, bent, q, qd)
        if self.effects.bristles:
            return self._bristling(drive, bent, q, qd)
        return bent, *self._integrated(drive, q, qd)

    def _followed(self, drive: Drive, own: dict[str, Tensor], *ends: tuple[Tensor, Tensor, Tensor]) -> list[Tensor]:
        """What follows the arm, one row later, between ``ends`` (hidden states that move it, q, q̇) of the row."""
        if not self.effects.followers:
            return []
        hinge, motions = self.effects.hinge, []
        for bent, q, qd in ends:
            if hinge:
                motions.append(hinge.tip_motion(own_values(hinge, self.parameters), q, qd, bent, drive.body))
            else:
                motions.append(tip_motion(q, qd, drive.body))
        following = ((each, own_values(each, self.parameters)) for each in self.effects.followers)
        return [each.follow(p, own[each.key], *motions, drive.dt) for each, p in following]

    def _drive(self, z: Tensor, z_next: Tensor, t: int | Tensor) -> Drive:
        joints = self.body.num_joints
        start, change = z[..., :joints], (z_next - z)[..., :joints]
        if self.command is not None:
            mean, slope = (row.to(z) for row in self.motors.row(t))
            start, change = start + mean - slope / 2, change + slope
        times = self._clock(t - 1), self._interval(t), self._step(t)
        return Drive(start, change, self.body_parameters(), *times, self.substeps_taken)

    def _integrated(self, drive: Drive, q: Tensor, qd: Tensor) -> tuple[Tensor, Tensor]:
        """The arm one row later; dry friction is held within sub-steps."""
        spans = drive.parts if self.effects.has_friction else 1
        for i in range(spans):
            q, qd = self._span(drive, q, qd, i / spans, 1 / spans, drive.parts // spans)
        return q, qd

    def _span(
        self, drive: Drive, q: Tensor, qd: Tensor, begun: float, share: float, steps: int
    ) -> tuple[Tensor, Tensor]:
        """``steps`` sub-steps that are a ``share`` of the row, under the dry friction at their beginning."""
        held, off, first = 0.0, None, None
        if self.effects.has_friction:
            torque, own, now = self._smooth(drive, q, qd, begun)
            held, off, first = self.effects.friction(self.parameters, now, torque, own, held=True)

        def acceleration(q: Tensor, qd: Tensor, s: float) -> Tensor:
            if first is not None and not s:
                return first
            torque, own, _ = self._smooth(drive, q, qd, begun + share * s)
            return self.dynamics.forward(q, qd, torque + held, drive.body, own)

        q, qd = INTEGRATORS[self.integrator](acceleration, q, qd, share * drive.dt, steps)
        return (q if off is None else q + off), qd

    def _hinged(self, drive: Drive, hidden: Tensor, q: Tensor, qd: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """A hidden hinge's angle and rate, q and q̇ one row later."""
        p, hinge = own_values(self.effects.hinge, self.parameters), self.effects.hinge
        links, whole = hinge.chain(p, drive.body), dynamics_for(self.body.num_joints + 1)

        def net(q: Tensor, qd: Tensor, s: float | Tensor) -> tuple[Tensor, Tensor | None]:
            return self._rubbed(*self._smooth(drive, q, qd, s))

        def pull(angles: Tensor, rates: Tensor, s: float | Tensor) -> Tensor | float:
            if not self.effects.pulls:
                return 0.0
            here = self._now(drive, hinge.turned(angles), hinge.turned(rates), s)
            bent = replace(here, q=angles, qd=rates, body=links, dynamics=whole, split=hinge.place[0])
            rigid = self.effects.pull(self.parameters, here)
            return self.effects.pull(self.parameters, bent) - hinge.on_joints(rigid)

        row = Row(drive.body, self.dynamics, net, pull, drive.dt, drive.parts)
        return hinge.step(p, row, hidden, q, qd)

    def _bristling(self, drive: Drive, hidden: Tensor, q: Tensor, qd: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """How far bristles are bent, q and q̇ one row later."""

        def moving(q: Tensor, qd: Tensor, s: float, bent: Tensor) -> tuple[Tensor, Tensor]:
            torque, own, _ = self._smooth(drive, q, qd, s)
            now = self._now(drive, q, qd, s)
            friction, rate = self._bending(bent, now)
            torque, own = self._rubbed(torque + friction, own, now)
            return self.dynamics.forward(q, qd, torque, drive.body, own), rate

        return self.effects.bristles.step(moving, hidden, q, qd, drive.dt, drive.parts)

    def _smooth(
        self, drive: Drive, q: Tensor, qd: Tensor, s: float | Tensor
    ) -> tuple[Tensor, Tensor | None, Situation | None]:
        """Torque of motors and effects but dry friction, and the joints' own inertias, (..., K); the situation.

        A share ``s`` of the row after it has begun.
        """
        if not self.effects:
            return drive.motor(s), None, None
        own = self.effects.inertia(self.parameters, self.body.num_joints)
        if not (self.effects.has_force or self.effects.has_friction):
            return drive.motor(s), own, None
        now = self._now(drive, q, qd, s)
        return now.motor + self.effects.force(self.parameters, now), own, now

    def _now(self, drive: Drive, q: Tensor, qd: Tensor, s: float | Tensor) -> Situation:
        """The moment a share ``s`` of the row after it has begun."""
        time, elapsed = (reading + s * drive.interval for reading in drive.clock)
        step = drive.dt / drive.parts
        return Situation(q, qd, drive.motor(s), time, elapsed, step, drive.body, self.dynamics)

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
        interval = self._interval(t)
        drive = Drive(torque, 0.0, body, self._clock(t), interval, interval, self.substeps_taken)
        torque, own, now = self._smooth(drive, q, qd, 0.0)
        if self.effects.bristles:
            now = self._now(drive, q, qd, 0.0)
            bent = self.effects.shares(z[..., self.torque_size :])[self.effects.bristles.key]
            torque = torque + self._bending(bent, now)[0]
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
