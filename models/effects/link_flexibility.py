"""A link that bends: a hidden hinge ψ at half its length, with a spring and a damper, −k ψ − d ψ̇.

The parts have shares π and 1 − π of length and mass. Their centres lie s apart, and a straight link has the inertia
that it had as one piece. For a uniform rod s = length/2, and the parts share I − π (1 − π) m s² as π³ to (1 − π)³. For
a link with less inertia s is smaller. π = ½; only the non-ideal variant learns where it bends.

A spring stiffer than the sub-steps can follow acts as the stiffest that they can; an infinite one is no hinge at all.
"""

import math
from collections.abc import Iterable

import torch
from pyro.distributions import LogNormal, Uniform
from torch import Tensor

from invdyn.models.dynamics.integrators import rk4
from invdyn.models.effects.base import Parameter, Scale, Values
from invdyn.models.effects.hidden import Halves, HiddenHinge, Row, substeps_for
from invdyn.models.shapes import join, joined_by_column

FREQUENCIES = (5.0, 7.0, 10.0, 14.0, 20.0, 30.0)
"""Hz, of the outer half and what it carries, swinging on the spring with the inner half held."""
FASTEST = 60.0
"""Hz, of the modes that the sub-steps are made for; with the inner half free they are about twice as fast."""
HALF, EDGE = 0.5, 0.05
"""Share of the link before the hinge, and the least there is on either side of it."""


class LinkFlexibility(HiddenHinge):
    """A link that swings about its own middle.

    Commands past its resonance distinguish it from a delay.
    """

    site = "link"

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Stiffness k, N·m/rad, and damping d, N·m·s/rad; in the variant the hinge's position π, a pure number."""
        inertia = self._carried(scale)
        grid = tuple(inertia * (2 * math.pi * f) ** 2 for f in FREQUENCIES)
        middle = inertia * (2 * math.pi * 10.0) ** 2
        damping = 0.2 * math.sqrt(middle * inertia)
        return (
            Parameter("stiffness", "N·m/rad", LogNormal(math.log(middle), 1.1), math.inf, grid),
            Parameter("damping", "N·m·s/rad", LogNormal(math.log(0.6 * damping), 1.0), None, (0.3 * damping, damping)),
            *((Parameter("position", "1", Uniform(EDGE, 1 - EDGE), None, (0.25, HALF, 0.75)),) if self.variant else ()),
        )

    def hidden_scale(self, scale: Scale) -> tuple[float, float]:
        """Twice as far as the typical torque bends a link of 10 Hz, and as fast as it then swings."""
        bend = 2 * scale.torque[self.place[0]] / (self._carried(scale) * (2 * math.pi * 10.0) ** 2)
        bend = min(bend, 0.3)
        return bend, bend * 2 * math.pi * 10.0

    def _carried(self, scale: Scale) -> float:
        """Inertia beyond the hinge about it, stretched out, kg·m²."""
        k, links = self.place[0], self.chain({}, scale.body)
        start = torch.cat([links.length.new_zeros(1), links.length[k + 1 :].cumsum(0)[:-1]])
        reach = start + links.com[k + 1 :]
        return (links.inertia[k + 1 :] + links.mass[k + 1 :] * reach**2).sum().item()

    def halves(self, p: Values, length: Tensor, mass: Tensor, com: Tensor, inertia: Tensor) -> Iterable[Halves]:
        """The two parts in place of the link."""
        inner = p.get("position", torch.full_like(length, HALF))
        outer, both = 1 - inner, inner * (1 - inner)
        apart = torch.minimum(length / 2, (0.8 * inertia / mass / both).sqrt())
        rest = (inertia - mass * both * apart**2) / (inner**3 + outer**3)
        lengths, masses = (inner * length, outer * length), (inner * mass, outer * mass)
        coms = com - outer * apart, com + inner * (apart - length)
        return lengths, masses, coms, (inner**3 * rest, outer**3 * rest)

    def all_hinges(self, q: Tensor, hinge: Tensor) -> Tensor:
        """The hinge's angle stands after its link's joint."""
        k = self.place[0]
        return joined_by_column(q[..., : k + 1], hinge, q[..., k + 1 :])

    def gathered(self, angles: Tensor) -> tuple[Tensor, Tensor]:
        """The inverse of :meth:`all_hinges`."""
        k = self.place[0]
        return joined_by_column(angles[..., : k + 1], angles[..., k + 2 :]), angles[..., k + 1 : k + 2]

    def rigid(self, p: Values) -> Tensor:
        """An infinite stiffness."""
        return torch.isinf(p["stiffness"])

    def bent(self, p: Values, row: Row, hidden: Tensor, q: Tensor, qd: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """One row; see :meth:`HiddenHinge.bent`."""
        links = self.chain(p, row.body)
        whole = self.whole(q)
        parts = substeps_for(row.dt, FASTEST, row.parts)
        angles = self.all_hinges(q, hidden[..., :1])
        stiffness, damping = self._resolved(p, whole.inertia_matrix(angles, links), row.dt / parts)

        def bending(angles: Tensor, rates: Tensor, s: float) -> Tensor:
            (q, hinge), (qd, rate) = self.gathered(angles), self.gathered(rates)
            torque, own = row.net(q, qd, s)
            turning = self.all_hinges(torque, -stiffness * hinge - damping * rate) + row.pull(angles, rates, s)
            return whole.forward(angles, rates, turning, links, self.on_joints(own))

        angles, rates = rk4(bending, angles, self.all_hinges(qd, hidden[..., 1:]), row.dt, parts)
        (q, hinge), (qd, rate) = self.gathered(angles), self.gathered(rates)
        return join(hinge, rate), q, qd

    def _resolved(self, p: Values, inertia: Tensor, step: Tensor) -> tuple[Tensor, Tensor]:
        """Stiffness and damping, no larger than sub-steps of this length, s, are stable with."""
        k = self.place[0] + 1
        unit = torch.zeros_like(inertia[..., :1])
        unit[..., k, 0] = 1.0
        mobility = torch.linalg.solve(inertia, unit)[..., k, :]
        stiffness = torch.where(torch.isinf(p["stiffness"]), 0.0, p["stiffness"])
        return stiffness.minimum((1.5 / step) ** 2 / mobility), p["damping"].minimum(0.7 / step / mobility)
