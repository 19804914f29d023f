"""Which dynamics a body has: one line for each kind of body.

@dynamics_for.register
def _(body: MyBody) -> Dynamics: ...
"""

from functools import singledispatch

from invdyn.models.bodies.body import Body
from invdyn.models.bodies.protocol import ArticulatedBody
from invdyn.models.bodies.scalars import BodyError
from invdyn.models.bodies.tree import Tree
from invdyn.models.dynamics.interface import Dynamics
from invdyn.models.dynamics.planar import PlanarDynamics
from invdyn.models.dynamics.planar_recursive import RecursiveDynamics
from invdyn.models.dynamics.planar_symbolic import MAX_SYMBOLIC, PAYS, symbolic_dynamics


@singledispatch
def dynamics_for(body: ArticulatedBody) -> Dynamics:
    """Return the `Dynamics` of a body.

    Raises `TypeError` for a kind of body that has none here, `BodyError` for a tree with driven joints.
    """
    raise TypeError(f"expected a body whose dynamics are known, got {body!r:.60}: register them by dynamics_for")


@dynamics_for.register
def _(body: Body) -> PlanarDynamics:
    return planar_dynamics(body.num_joints)


@dynamics_for.register
def _(body: Tree) -> Dynamics:
    from invdyn.models.dynamics.spatial.dynamics import SpatialDynamics

    if body.driven_names:
        raise BodyError(
            f"body '{body.name}': expected no driven joints, got {', '.join(body.driven_names)}: a model has no motion "
            "to give them yet; SpatialDynamics takes one"
        )
    return SpatialDynamics(body)


def planar_dynamics(num_joints: int) -> PlanarDynamics:
    """Return the dynamics of a planar chain: symbolic for 1 to 4 joints, recursive for more.

    Raises `ValueError` unless `num_joints` is a whole number ≥ 1.
    """
    if num_joints in range(1, MAX_SYMBOLIC + 1):
        return symbolic_dynamics(num_joints, PAYS)
    return RecursiveDynamics(num_joints)
