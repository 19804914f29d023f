"""Backlash between a motor and its joint: a gap ψ that is free within ±width/2.

The motor turns a rotor of half the link's own inertia about its centre of mass, taken from the link, so that without
backlash nothing is changed; ψ is how far the link is ahead of it. What a joint has of its own, motor, friction, spring,
stop and inertia, is on the rotor's side, and knows of its angle and velocity alone. Each short sub-step is either

    closed   at an end of the gap, with the stop pushing: the rigid arm, ψ at rest
    free     the motor drives the rotor alone; a gap that would leave its ends strikes a stop, and keeps momentum:
             with M the mass matrix, Δrates = −(1 + e) M⁻¹e_ψ ψ̇ / (e_ψᵀ M⁻¹ e_ψ)

Stops are stiff springs, critically damped: what strikes one at v leaves as soon as that no longer pushes, after 2/ω in
v (1 − ωt) exp(−ωt), with e = exp(−2) of its speed. A slow impact, in which that would not show, gives nothing back,
so that few of them end each bounce.

Where contact begins or ends a sub-step ends with it (event location: Hairer, Nørsett & Wanner, "Solving Ordinary
Differential Equations I", II.6; :mod:`invdyn.models.dynamics.integrators`), and the rest of that is a sub-step of
its own: through contacts, too, errors fall with the fourth power of the sub-step. Left to its end they fell with
the first, which cost one recording of 259 rows 98 nats. More contacts than a row has room for do wait for
the end (Moreau's time-stepping) and give nothing back. Such an impact was earlier by the time that the gap took to
become too wide. Δangles = the same of that excess, in place of (1 + e) ψ̇, keeps the centre of inertia.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial

import torch
from pyro.distributions import Exponential
from torch import Tensor

from invdyn.models.bodies.planar import BodyParameters
from invdyn.models.dynamics.integrators import Passage, rk4
from invdyn.models.dynamics.interface import Dynamics
from invdyn.models.effects.base import Parameter, Scale, Values
from invdyn.models.effects.hidden import Halves, HiddenHinge, Row, substeps_for
from invdyn.models.shapes import join, joined_by_column

ROTOR_SHARE = 0.5  # of a link's inertia: what a motor's rotor is without an armature in the file
WIDTHS = tuple(0.003 * 1.7**n for n in range(9))
"""rad."""
PASSAGE_FREQUENCY = 20.0
"""Hz, of an oscillation that the sub-steps would follow; crossing a gap takes some hundredths of a second."""
RESTITUTION, SLOW = math.exp(-2), 0.05
"""e; and rad/s, of the gap in an impact that gives nothing back."""
CONTACTS = 4
"""That begin or end within a row and end a sub-step."""


class Backlash(HiddenHinge):
    """Backlash of a gear at a joint, ``width`` from stop to stop.

    Slow reversals of the load distinguish it from Coulomb friction.
    """

    forgets = True

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Width, rad: a gear's is some hundredths at most, a worn joint's has no such limit."""
        return (Parameter("width", "rad", Exponential(1 / 0.06), 0.0, WIDTHS),)

    def hidden_scale(self, scale: Scale) -> tuple[float, float]:
        """Anywhere in a typical gap, slowly."""
        return 0.01, 0.05 * scale.speed[self.place[0]]

    def halves(self, p: Values, length: Tensor, mass: Tensor, com: Tensor, inertia: Tensor) -> Iterable[Halves]:
        """A rotor without length and mass before the link."""
        rotor = torch.where(inertia > 0, ROTOR_SHARE * inertia, 0.01 * mass * com**2)
        none = torch.zeros_like(length)
        return (none, length), (none, mass), (none, com), (rotor, inertia - rotor)

    def all_hinges(self, q: Tensor, hinge: Tensor) -> Tensor:
        """The joint's angle is the rotor's and the gap's together."""
        j = self.place[0]
        return joined_by_column(q[..., :j], q[..., j : j + 1] - hinge, hinge, q[..., j + 1 :])

    def gathered(self, angles: Tensor) -> tuple[Tensor, Tensor]:
        """The inverse of :meth:`all_hinges`."""
        j = self.place[0]
        rotor, hinge = angles[..., j : j + 1], angles[..., j + 1 : j + 2]
        return joined_by_column(angles[..., :j], rotor + hinge, angles[..., j + 2 :]), hinge

    def own_angles(self, angles: Tensor) -> Tensor:
        """The rotor's, as what a joint has of its own is on the motor's side of the gap."""
        j = self.place[0]
        return joined_by_column(angles[..., : j + 1], angles[..., j + 2 :])

    def rigid(self, p: Values) -> Tensor:
        """No width."""
        return p["width"] <= 0

    def bent(self, p: Values, row: Row, hidden: Tensor, q: Tensor, qd: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """One row; see :meth:`HiddenHinge.bent`."""
        arm, dt = _Mechanics(self, row, self.whole(q), self.chain(p, row.body)), row.dt
        j, half, parts = self.place[0], p["width"] / 2, substeps_for(dt, PASSAGE_FREQUENCY, row.parts)
        psi, rate = hidden[..., :1].clamp(-half, half), hidden[..., 1:]
        taken = torch.zeros_like(psi)  # sub-steps; what ends one early leaves the rest of it to the next
        loosened = taken > 0
        for left in reversed(range(parts + CONTACTS)):
            started = taken.floor()
            going, room = started < parts, parts - started <= left
            s, part = taken / parts, torch.where(going, started + 1 - taken, 0.0) / parts
            h, angles, rates = part * dt, self.all_hinges(q, psi), self.all_hinges(qd, rate)

            held = _within(partial(arm.held, psi), q, qd, s, part)
            rigid_motion = Passage(q, qd, held(q, qd, 0.0), *rk4(held, q, qd, h), h)
            ends = rigid_motion.x1, rigid_motion.v1
            push = arm.push(psi, q, qd, rigid_motion.a0, s)
            pushes = ((psi <= -half) & (rate <= 0) & (push > 0)) | ((psi >= half) & (rate >= 0) & (push < 0))
            pushes = pushes & ~loosened  # what is left of the push where it ended
            later = arm.push(psi, *ends, held(*ends, 1.0), s + part)
            loosened = pushes & (push * later < 0) & room
            release = torch.where(loosened, push / torch.where(loosened, push - later, 1.0), 1.0)
            q_held, qd_held = rigid_motion.until(release, loosened)

            free = _within(arm.free, angles, rates, s, part)
            motion = Passage(angles, rates, free(angles, rates, 0.0), *rk4(free, angles, rates, h), h)
            gap, speed = (each[..., j + 1, None] for each in (motion.x1, motion.v1))
            struck = ((gap > half) & (speed > 0)) | ((gap < -half) & (speed < 0))
            hit, stop = struck & ~pushes & room, half * gap.sign()
            contact = motion.only(j + 1).reaches(stop, hit)
            angles, rates = motion.until(contact, hit)
            answer = arm.impact(angles, rates, s + contact * part)
            over, speed = angles[..., j + 1, None] - stop, rates[..., j + 1, None]
            q_free, gap = self.gathered(torch.where(struck, angles - answer * over, angles))
            back = torch.where(hit & (speed.abs() > SLOW), 1 + RESTITUTION, 1.0)
            qd_free, rate_free = self.gathered(torch.where(struck, rates - back * answer * speed, rates))

            gap = torch.where(pushes, psi, torch.where(struck, stop, gap).clamp(-half, half))
            joints = torch.where(pushes, q_held, q_free), torch.where(pushes, qd_held, qd_free)
            after = (*joints, gap, torch.where(pushes, 0.0, rate_free))
            q, qd, psi, rate = (torch.where(going, *each) for each in zip(after, (q, qd, psi, rate), strict=True))
            early = taken + release * contact * parts * part
            taken = torch.where(loosened | hit, early, torch.where(going, started + 1, taken))
            if bool((taken >= parts).all()):
                break
        return join(psi, rate), q, qd


@dataclass(frozen=True)
class _Mechanics:
    """An arm with backlash: what moves it while a stop holds, while none does, and as one strikes."""

    hinge: Backlash
    row: Row
    whole: Dynamics
    links: BodyParameters

    def held(self, psi: Tensor, q: Tensor, qd: Tensor, s: float | Tensor) -> Tensor:
        """q̈ (..., K) with the gap at ψ."""
        hinge = self.hinge
        angles, rates = hinge.all_hinges(q, psi), hinge.all_hinges(qd, torch.zeros_like(psi))
        torque, own = self.row.net(hinge.own_angles(angles), qd, s)
        pulled = self.row.pull(angles, rates, s)
        torque = torque + (hinge.own_angles(pulled) if isinstance(pulled, Tensor) else pulled)
        return self.row.rigid.forward(q, qd, torque, self.row.body, own)

    def free(self, angles: Tensor, rates: Tensor, s: float | Tensor) -> Tensor:
        """Accelerations (..., K + 1) of the hinges."""
        hinge = self.hinge
        torque, own = self.row.net(hinge.own_angles(angles), hinge.own_angles(rates), s)
        turning = hinge.on_joints(torque) + self.row.pull(angles, rates, s)
        return self.whole.forward(angles, rates, turning, self.links, hinge.on_joints(own))

    def push(self, psi: Tensor, q: Tensor, qd: Tensor, qdd: Tensor, s: float | Tensor) -> Tensor:
        """Torque (..., 1) that a stop would have to give for the gap to stay as it is."""
        still = torch.zeros_like(psi)
        hinges = self.hinge.all_hinges
        angles, rates = hinges(q, psi), hinges(qd, still)
        needed = self.whole.inverse(angles, rates, hinges(qdd, still), self.links) - self.row.pull(angles, rates, s)
        return needed[..., self.hinge.place[0] + 1, None]

    def impact(self, angles: Tensor, rates: Tensor, s: float | Tensor) -> Tensor:
        """Changes (..., K + 1) of the hinges' rates by an impulse that changes the gap's by one."""
        hinge, unit = self.hinge, torch.zeros_like(angles)
        unit[..., hinge.place[0] + 1] = 1.0
        own = hinge.on_joints(self.row.net(hinge.gathered(angles)[0], hinge.gathered(rates)[0], s)[1])
        answer = self.whole.response(angles, unit, self.links, own)
        return answer / answer[..., hinge.place[0] + 1, None]


def _within(
    acceleration: Callable[..., Tensor], x: Tensor, v: Tensor, s: Tensor, part: Tensor
) -> Callable[..., Tensor]:
    """An acceleration (x, ẋ, s) within a sub-step that begins at ``s`` in (x, v) and is a ``part`` of the row."""
    first = acceleration(x, v, s)
    return lambda x, v, share: acceleration(x, v, s + share * part) if share else first
