"""A body's mechanics from one row to the next, in sub-steps: its dynamics, what effects add, and the integrator.

Within a row the torque process moves on a straight line from z to its mean one row later, under a command that
is constant or moves as the motors make it (:class:`.drive.RowDrive`). Effects act in the order

    motors, forces, inertias of the joints    as the integrator asks for them
    a base that moves                         as gravity −b̈ more, at the same moments
    dry friction                              once a sub-step, at its mean about a stop: :mod:`.effects.dry_friction`
    a hidden hinge                            has a step of its own: :mod:`.effects.hidden`
    bristles                                  the same: :mod:`.effects.regularised_friction`
    what follows the body                     from one row to the next, after it

Shapes: joint quantities (..., K), all hidden states of effects (..., H).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from torch import Tensor

from invdyn.models.articulated.drive import RowDrive
from invdyn.models.bodies.protocol import ArticulatedBody
from invdyn.models.dynamics.integrators import INTEGRATORS
from invdyn.models.dynamics.interface import Dynamics
from invdyn.models.effects.composition import Composition, own_values
from invdyn.models.effects.effect_context import Situation
from invdyn.models.effects.hidden import HiddenHinge, Motion, Row, tip_motion
from invdyn.models.effects.regularised_friction import BristleFriction


@dataclass(frozen=True, eq=False)
class Mechanics:
    """A body with effects and parameters.

    Attributes:
        body: as it was given.
        dynamics: of it.
        effects: bound to it.
        integrator: a name among ``INTEGRATORS``.
        numbers: named tuple of the body's numbers.
        parameters: of the model, the body's and the effects' among them.
    """

    body: ArticulatedBody
    dynamics: Dynamics
    effects: Composition
    integrator: str
    numbers: type[Any]
    parameters: Mapping[str, Tensor]

    @property
    def given(self) -> Any:
        """The body's numbers as the parameters have them."""
        return self.numbers(*(self.parameters[f"body.{name}"] for name in self.numbers._fields))

    def body_parameters(self) -> Any:
        """The body's numbers; those that follow from others do, effects come last."""
        learned = any(value.requires_grad for value in self.parameters.values())
        return self._followed_numbers() if learned else self._known_numbers

    @cached_property
    def _known_numbers(self) -> Any:
        """One object for all rows, by which dynamics know that they have met it."""
        return self._followed_numbers()

    def _followed_numbers(self) -> Any:
        return self.effects.through("body", self.parameters, self.body.completed(self.given))

    def step(self, drive: RowDrive, hidden: Tensor, q: Tensor, qd: Tensor) -> list[Tensor]:
        """Hidden states, in pieces, q and q̇ one row later."""
        own = self.effects.shares(hidden)
        mover = self.effects.hinge or self.effects.bristles
        before = own[mover.key] if mover else hidden[..., :0], q, qd
        bent, *moved = after = self._moved(drive, *before)
        return [bent, *self._followed(drive, own, before, after), *moved]

    def under(self, drive: RowDrive, hidden: Tensor, q: Tensor, qd: Tensor) -> Tensor:
        """θ̈ (..., K) where a row begins; no hidden hinge moves."""
        torque, own, now = self.smooth(drive, q, qd, 0.0)
        if bristles := self.effects.bristles:
            now = self.now(drive, q, qd, 0.0)
            bent = self.effects.shares(hidden)[bristles.key]
            torque = torque + self._bending(bristles, bent, now)[0]
        torque, own = self.with_friction(torque, own, now)
        return self.dynamics.forward(q, qd, torque, drive.body, own)

    def _moved(self, drive: RowDrive, bent: Tensor, q: Tensor, qd: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The hidden states, if there are any, that have a part in it, q and q̇ one row later."""
        if self.effects.hinge:
            return self._hinged(self.effects.hinge, drive, bent, q, qd)
        if self.effects.bristles:
            return self._bristling(self.effects.bristles, drive, bent, q, qd)
        return bent, *self._integrated(drive, q, qd)

    def _followed(self, drive: RowDrive, own: dict[str, Tensor], *ends: tuple[Tensor, Tensor, Tensor]) -> list[Tensor]:
        """What follows the body, one row later, between ``ends`` (hidden states that move it, q, q̇) of the row."""
        if not self.effects.followers:
            return []
        before, after = (self._tip_motion(drive, *end) for end in ends)
        following = ((each, own_values(each, self.parameters)) for each in self.effects.followers)
        return [each.follow(p, own[each.key], before, after, drive.dt) for each, p in following]

    def _tip_motion(self, drive: RowDrive, bent: Tensor, q: Tensor, qd: Tensor) -> Motion:
        """What the tips do in a state."""
        if hinge := self.effects.hinge:
            return hinge.tip_motion(own_values(hinge, self.parameters), q, qd, bent, drive.body)
        return tip_motion(q, qd, drive.body)

    def _integrated(self, drive: RowDrive, q: Tensor, qd: Tensor) -> tuple[Tensor, Tensor]:
        """The body one row later; dry friction is constant within sub-steps."""
        spans = drive.parts if self.effects.changes("friction") else 1
        for i in range(spans):
            q, qd = self._span(drive, q, qd, i / spans, 1 / spans, drive.parts // spans)
        return q, qd

    def _span(
        self, drive: RowDrive, q: Tensor, qd: Tensor, start: float, share: float, steps: int
    ) -> tuple[Tensor, Tensor]:
        """``steps`` sub-steps that are a ``share`` of the row, under the dry friction at their beginning."""
        held: Tensor | float = 0.0
        off = first = None
        if self.effects.changes("friction"):
            torque, own, now = self.smooth(drive, q, qd, start)
            assert now is not None  # effects ask for it
            held, off, first = self.effects.friction(self.parameters, now, torque, own, held=True)

        def acceleration(q: Tensor, qd: Tensor, s: float) -> Tensor:
            if first is not None and not s:
                return first
            torque, own, _ = self.smooth(drive, q, qd, start + share * s)
            return self.dynamics.forward(q, qd, torque + held, drive.body, own)

        q, qd = INTEGRATORS[self.integrator](acceleration, q, qd, share * drive.dt, steps)
        return (q if off is None else q + off), qd

    def _hinged(
        self, hinge: HiddenHinge, drive: RowDrive, hidden: Tensor, q: Tensor, qd: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """A hidden hinge's angle and rate, q and q̇ one row later."""
        p = own_values(hinge, self.parameters)
        links, whole = hinge.chain(p, drive.body), hinge.whole(q)

        def net(q: Tensor, qd: Tensor, s: float | Tensor) -> tuple[Tensor, Tensor | None]:
            return self.with_friction(*self.smooth(drive, q, qd, s))

        def pull(angles: Tensor, rates: Tensor, s: float | Tensor) -> Tensor | float:
            if not self.effects.changes("pull"):
                return 0.0
            here = self.now(drive, hinge.own_angles(angles), hinge.own_angles(rates), s)
            bent = replace(here, q=angles, qd=rates, body=links, dynamics=whole, split=hinge.place[0])
            rigid = self.effects.pull(self.parameters, here)
            return self.effects.pull(self.parameters, bent) - hinge.on_joints(rigid)

        row = Row(drive.body, self.dynamics, net, pull, drive.dt, drive.parts)
        return hinge.step(p, row, hidden, q, qd)

    def _bristling(
        self, bristles: BristleFriction, drive: RowDrive, hidden: Tensor, q: Tensor, qd: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """How far bristles are bent, q and q̇ one row later."""

        def moving(q: Tensor, qd: Tensor, s: float, bent: Tensor) -> tuple[Tensor, Tensor]:
            torque, own, _ = self.smooth(drive, q, qd, s)
            now = self.now(drive, q, qd, s)
            friction, rate = self._bending(bristles, bent, now)
            torque, own = self.with_friction(torque + friction, own, now)
            return self.dynamics.forward(q, qd, torque, drive.body, own), rate

        return bristles.step(moving, hidden, q, qd, drive.dt, drive.parts)

    def smooth(
        self, drive: RowDrive, q: Tensor, qd: Tensor, s: float | Tensor
    ) -> tuple[Tensor, Tensor | None, Situation | None]:
        """Torque of motors and effects but dry friction, and the joints' own inertias, (..., K); the situation.

        A share ``s`` of the row after its start.
        """
        if not self.effects:
            return self._driven(drive, q, s), None, None
        own = self.effects.inertia(self.parameters, self.body.num_joints)
        if not (self.effects.has_force or self.effects.changes("friction")):
            return self._driven(drive, q, s), own, None
        now = self.now(drive, q, qd, s)
        return now.motor + self.effects.force(self.parameters, now) + self._carried(drive, q, s), own, now

    def _driven(self, drive: RowDrive, q: Tensor, s: float | Tensor) -> Tensor:
        """The torque of motors, and what a base that moves adds."""
        return drive.motor(s) + self._carried(drive, q, s)

    def _carried(self, drive: RowDrive, q: Tensor, s: float | Tensor) -> Tensor | float:
        """The load of the gravity −b̈ in a moving base's frame, as a torque, (..., K) N·m."""
        if drive.carried is None:
            return 0.0
        start, change = drive.carried
        return self.dynamics.uniform_load(q, start + s * change, drive.body)

    def now(self, drive: RowDrive, q: Tensor, qd: Tensor, s: float | Tensor) -> Situation:
        """The moment a share ``s`` of the row after its start."""
        time, elapsed = (reading + s * drive.interval for reading in drive.clock)
        step = drive.dt / drive.parts
        motor, commanded = drive.motor(s), drive.commanded(s) if self.effects.has_servo else None
        return Situation(q, qd, motor, time, elapsed, step, drive.body, self.dynamics, commanded=commanded)

    def with_friction(self, torque: Tensor, own: Tensor | None, now: Situation | None) -> tuple[Tensor, Tensor | None]:
        """All torques, and the joints' own inertias."""
        if self.effects.changes("friction"):
            assert now is not None  # effects ask for it
            torque = torque + self.effects.friction(self.parameters, now, torque, own)[0]
        return torque, own

    def _bending(self, bristles: BristleFriction, bent: Tensor, now: Situation) -> tuple[Tensor, Tensor]:
        """Friction through bristles that are ``bent`` (..., 1), (..., K) N·m, and how fast they bend, rad/s."""
        p = own_values(bristles, self.parameters)
        j = bristles.place[0]
        level = bristles.level(p, self.effects.driven(self.parameters, now))
        friction, rate = bristles.bending(p, bent, now.qd[..., j : j + 1], level, now.step)
        return now.at(j, friction), rate
