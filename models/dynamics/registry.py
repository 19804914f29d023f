"""Which dynamics a body has: one line for each kind of body.

@dynamics_for.register
def _(body: MyBody, engine: str = "traced") -> Dynamics: ...
"""

from functools import singledispatch

from invdyn.models.bodies.body import Body
from invdyn.models.bodies.protocol import ArticulatedBody
from invdyn.models.dynamics.interface import Dynamics
from invdyn.models.dynamics.planar import planar_dynamics
from invdyn.models.dynamics.spatial.dynamics import SpatialDynamics
from invdyn.models.dynamics.symbolic import SymbolicDynamics

ENGINES = ("traced", "symbolic")


@singledispatch
def dynamics_for(body: ArticulatedBody, engine: str = "traced") -> Dynamics:
    """Return the `Dynamics` of a body: by traced programs, or, of a planar chain, by SymPy's "symbolic" equations.

    Raises `TypeError` for a kind of body that has none here, `ValueError` for another engine or a
    body that it does not take.
    """
    raise TypeError(f"expected a body whose dynamics are known, got {body!r:.60}: register them by dynamics_for")


@dynamics_for.register
def _(body: Body, engine: str = "traced") -> Dynamics:
    if engine not in ENGINES:
        raise ValueError(f"expected dynamics among {', '.join(ENGINES)}, got {engine!r}")
    if engine == "symbolic":
        if not body.is_chain:
            raise ValueError(f"body '{body.name}': symbolic dynamics are those of a planar chain: leave dynamics out")
        return SymbolicDynamics(body.num_joints)
    if body.is_chain:
        return planar_dynamics(body.num_joints)
    return SpatialDynamics(body)
