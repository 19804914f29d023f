"""Dynamics of a planar chain: the programs of a tree whose hinges are parallel, traced from the chain's own numbers.

The plane is x–y of the tree and all hinges are about z. A link's length places the next joint and its tip; its com
lies along x, and of its moments of inertia only that about z enters:

    com (c, 0, 0)     inertia zz     position of joint k (length of link k−1, 0, 0)     tip (length, 0, 0)

Left out of programs are a base at the origin and a gravity along −y, where they are so.
All chains of as many joints share one object, and with it the machine code. Interface, shapes, units: `interface.py`.
"""

from collections.abc import Mapping
from functools import cache

import numpy as np
from torch import Tensor

from invdyn.models.bodies.body import planar_body
from invdyn.models.bodies.link import Link
from invdyn.models.bodies.planar import BodyParameters
from invdyn.models.dynamics.spatial.dynamics import SpatialDynamics
from invdyn.models.dynamics.spatial.frames import Entry
from invdyn.models.dynamics.traced.compiled import PAYS
from invdyn.models.dynamics.traced.expressions import Graph, Scalar

ALONG = {"com": "com", "sites": "length"}
"""Vectors of the tree that lie along a link: the number of the chain that is their x."""


class PlanarDynamics(SpatialDynamics):
    """A planar chain of K links, with p its `BodyParameters`; sites are the K tips, d is 2.

    Raises `ValueError` unless `num_joints` is a whole number ≥ 1.
    """

    def __init__(self, num_joints: int, compile_after: float = PAYS):
        if isinstance(num_joints, bool) or not isinstance(num_joints, int) or num_joints < 1:
            raise ValueError(f"expected a whole number of joints ≥ 1, got {num_joints!r}")
        unit = [Link(f"link{k}", f"joint{k}", f"tip{k}", length=1.0, mass=1.0) for k in range(num_joints)]
        super().__init__(planar_body("chain", unit), compile_after, rotors=True)

    def __reduce__(self) -> tuple:
        """By its number of joints: programs are traced again, once for all copies that come to a process."""
        return planar_dynamics, (self.num_joints,)

    def reach(self, p: BodyParameters) -> Tensor:
        """Sum of the links' lengths, m."""
        return p.length.sum()

    def levers(self, p: BodyParameters) -> Tensor:
        """The links' lengths: a link's angle is seen by its ends."""
        return p.length

    def _entry(self, graph: Graph, known: Mapping[str, np.ndarray]) -> Entry:
        own = super()._entry(graph, known)

        def entry(field: str, *place: int) -> Scalar:
            link, axis = place[0], place[-1]
            if field == "mass":
                return own("mass", link)
            if field == "gravity":
                return own("gravity", axis) if axis < 2 else 0.0
            if field == "rotation":
                return float(place[1] == axis)
            if field == "inertia":
                return own("inertia", link) if axis == 2 else 0.0
            if field == "position" and link == 0:
                return own("base", axis) if axis < 2 else 0.0
            if axis:
                return 0.0
            return own("length", link - 1) if field == "position" else own(ALONG[field], link)

        return entry


@cache
def planar_dynamics(num_joints: int) -> PlanarDynamics:
    """The `PlanarDynamics` of so many joints, one for all models of a process. Raises as the class does."""
    return PlanarDynamics(num_joints)
