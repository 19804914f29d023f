"""Play between a motor and its joint: a gap ψ that is free within ±width/2.

The motor turns a rotor of half the link's own inertia about its centre of mass, taken from the link, so that without
play nothing is changed; ψ is how far the link is ahead of it. What a joint has of its own, motor, friction, spring,
stop and inertia, is on the rotor's side, and knows of its angle and velocity alone. Time-stepping after Moreau: each
short sub-step is either

    held     at an end of the gap, with the stop pushing: the rigid arm, ψ at rest
    free     the motor drives the rotor alone; a gap that the sub-step would leave ends at its stop, in a plastic
             impact: with M the mass matrix, Δrates = −M⁻¹ e_ψ ψ̇ / (e_ψᵀ M⁻¹ e_ψ), and as the impact was
             earlier by as long as the gap took for what it is too wide, Δangles = the same of that in place of ψ̇

which keeps momentum and the centre of inertia, and is stable however hard the stops are.
"""

import torch
from pyro.distributions import Exponential
from torch import Tensor

from invdyn.models.body import BodyParameters
from invdyn.models.dynamics import Dynamics, dynamics_for
from invdyn.models.effects.base import Parameter, Values
from invdyn.models.effects.hidden import HiddenHinge, Net, Pull, split_link, substeps_for
from invdyn.models.effects.scale import Scale
from invdyn.models.integrators import rk4
from invdyn.models.shapes import join

ROTOR_SHARE = 0.5
WIDTHS = tuple(0.003 * 1.7**n for n in range(9))
"""rad."""
SHORTEST = 40.0
"""Hz, of an oscillation that the sub-steps would follow; crossing a gap takes some hundredths of a second."""


class Backlash(HiddenHinge):
    """Play of a gear at a joint, ``width`` from stop to stop.

    Told apart from Coulomb friction by slow reversals of the load.
    """

    forgets = True

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Width, rad: a gear's is some hundredths at most, a worn joint's has no such limit."""
        return (Parameter("width", "rad", Exponential(1 / 0.06), 0.0, WIDTHS),)

    def hidden_scale(self, scale: Scale) -> tuple[float, float]:
        """Anywhere in a typical gap, slowly."""
        return 0.01, 0.05 * scale.speed[self.place[0]]

    def chain(self, p: Values, body: BodyParameters) -> BodyParameters:
        """A rotor without length and mass before the link."""
        j = self.place[0]
        length, mass, com, inertia = (value[..., j : j + 1] for value in body[:4])
        rotor = torch.where(inertia > 0, ROTOR_SHARE * inertia, 0.01 * mass * com**2)
        none = torch.zeros_like(length)
        return body._replace(
            length=split_link(body.length, j, none, length),
            mass=split_link(body.mass, j, none, mass),
            com=split_link(body.com, j, none, com),
            inertia=split_link(body.inertia, j, rotor, inertia - rotor),
        )

    def spread(self, q: Tensor, hinge: Tensor) -> Tensor:
        """The joint's angle is the rotor's and the gap's together."""
        j = self.place[0]
        return join(q[..., :j], q[..., j : j + 1] - hinge, hinge, q[..., j + 1 :])

    def gathered(self, angles: Tensor) -> tuple[Tensor, Tensor]:
        """The inverse of :meth:`spread`."""
        j = self.place[0]
        rotor, hinge = angles[..., j : j + 1], angles[..., j + 1 : j + 2]
        return torch.cat([angles[..., :j], rotor + hinge, angles[..., j + 2 :]], -1), hinge

    def turned(self, angles: Tensor) -> Tensor:
        """The rotor's, as what a joint has of its own is on the motor's side of its play."""
        j = self.place[0]
        return torch.cat([angles[..., : j + 1], angles[..., j + 2 :]], -1)

    def step(
        self,
        p: Values,
        body: BodyParameters,
        net: Net,
        pull: Pull,
        rigid: Dynamics,
        hidden: Tensor,
        q: Tensor,
        qd: Tensor,
        dt,
        n: int,
    ) -> tuple[Tensor, Tensor, Tensor]:
        """One row; see :meth:`HiddenHinge.step`."""
        j, links, whole = self.place[0], self.chain(p, body), dynamics_for(q.shape[-1] + 1)
        half = p["width"] / 2
        parts = substeps_for(dt, SHORTEST, n)
        none = half <= 0
        psi, rate, tight = hidden[..., :1].clamp(-half, half), hidden[..., 1:], None

        def held(q, qd, s):
            angles, rates = self.spread(q, psi), self.spread(qd, torch.zeros_like(psi))
            torque, own = net(self.turned(angles), qd, s)
            pulled = pull(angles, rates, s)
            torque = torque + (self.turned(pulled) if isinstance(pulled, Tensor) else pulled)
            return rigid.forward(q, qd, torque, body, own)

        def free(angles, rates, s):
            torque, own = net(self.turned(angles), self.turned(rates), s)
            turning = self.on_joints(torque) + pull(angles, rates, s)
            return whole.forward(angles, rates, turning, links, self.on_joints(own))

        if bool(none.any()):
            tight = (torch.zeros_like(hidden), *rk4(held, q, qd, dt, n))
            if bool(none.all()):
                return tight
        for i in range(parts):
            # what the stop would have to give for the gap to stay as it is
            qdd = held(q, qd, i / parts)

            def rigidly(x, v, s, i=i, begun=qdd):
                return held(x, v, (i + s) / parts) if s else begun

            def freely(x, v, s, i=i):
                return free(x, v, (i + s) / parts)

            still = torch.zeros_like(qdd[..., :1])
            rigid_motion = [self.spread(value, gap) for value, gap in ((q, psi), (qd, still), (qdd, still))]
            needed = whole.inverse(*rigid_motion, links) - pull(*rigid_motion[:2], i / parts)
            push = needed[..., j + 1, None]
            pushes = ((psi <= -half) & (rate <= 0) & (push > 0)) | ((psi >= half) & (rate >= 0) & (push < 0))
            q_held, qd_held = rk4(rigidly, q, qd, dt / parts)

            angles, rates = rk4(freely, self.spread(q, psi), self.spread(qd, rate), dt / parts)
            q_free, gap = self.gathered(angles)
            speed = rates[..., j + 1, None]
            struck = ((gap > half) & (speed > 0)) | ((gap < -half) & (speed < 0))
            unit = torch.zeros_like(rates)
            unit[..., j + 1] = 1.0
            own = self.on_joints(net(q_free, qd, (i + 1) / parts)[1])
            answer = whole.response(angles, unit, links, own)
            answer = answer / answer[..., j + 1, None]
            # The impact was earlier than the sub-step's end, by as long as the gap takes for what it is too wide.
            over = gap - gap.clamp(-half, half)
            q_free, gap = self.gathered(torch.where(struck, angles - answer * over, angles))
            qd_free, rate_free = self.gathered(torch.where(struck, rates - answer * speed, rates))

            q, qd = torch.where(pushes, q_held, q_free), torch.where(pushes, qd_held, qd_free)
            psi = torch.where(pushes, psi, gap).clamp(-half, half)
            rate = torch.where(pushes, torch.zeros_like(rate), rate_free)
        loose = (join(psi, rate), q, qd)
        if tight is None:
            return loose
        return tuple(torch.where(none, rigid, own) for rigid, own in zip(tight, loose, strict=True))
