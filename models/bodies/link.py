"""One rigid link of a planar chain, and what it may not be; lengths, masses and units as in :mod:`.body`."""

import math
from dataclasses import dataclass

from invdyn.models.bodies.joint_parts import JointParts
from invdyn.models.bodies.placeholders import placeholder
from invdyn.models.bodies.scalars import QUANTITIES, SMALLEST, BodyError, Scalar, check_name, checked, nominal

MAX_COM = 3.0  # lengths from the joint; farther out it is a slip of the unit, not a counterweight
MAX_GYRATION = 20.0  # lengths, √(inertia/mass): a rod has 0.29, one with a geared rotor some; in kg·cm² it has 29


@dataclass(frozen=True)
class Link:
    """One rigid link. Each of its scalars is a number, a scalar Pyro distribution (its prior) or `Learned`.

    `parts` are what its joint has besides the hinge: friction, a spring, a motor; None for nothing.

    Raises `BodyError` for a scalar that is not finite, a length or mass that is not positive or too large for an arm,
    a negative inertia, a prior that allows such, a centre of mass more than three lengths from the joint, an inertia
    as of mass more than twenty lengths away that is no placeholder, and a link that has neither com nor inertia to
    resist a torque.
    """

    name: str
    joint: str
    tip: str
    length: Scalar
    mass: Scalar
    com: Scalar | None = None
    inertia: Scalar | None = None
    parts: JointParts | None = None

    def __post_init__(self) -> None:
        for key in ("name", "joint", "tip"):
            check_name(getattr(self, key), f"{key} of a link")
        where = f"link '{self.name}'"
        for key in QUANTITIES:
            value = getattr(self, key)
            if value is not None or key in ("length", "mass"):
                object.__setattr__(self, key, checked(value, key, where))
        length, mass, com, inertia = (self.nominal(key) for key in QUANTITIES)
        if abs(com) > MAX_COM * length:
            raise BodyError(
                f"{where}: expected com within {MAX_COM:g} lengths of the joint, {MAX_COM * length:g} m, "
                f"got {com:g} m; are both in metres?"
            )
        if inertia > mass * (MAX_GYRATION * length) ** 2 and not placeholder(inertia):
            raise BodyError(
                f"{where}: expected an inertia as of mass within {MAX_GYRATION:g} lengths, up to "
                f"{mass * (MAX_GYRATION * length) ** 2:.3g} kg·m², got {inertia:g}; is it in kg·m²?"
            )
        about_joint = inertia + mass * com * com
        if not math.isfinite(about_joint):
            raise BodyError(f"{where}: its moment about the joint is too large for a number; are the units SI?")
        if about_joint < SMALLEST["inertia"]:
            raise BodyError(f"{where}: com and inertia are both 0, or nearly so: nothing would resist a torque")

    def nominal(self, quantity: str) -> float:
        """Return a scalar as a float: priors at their mean, learned ones at their start, defaults filled."""
        value = getattr(self, quantity)
        if value is not None:
            return nominal(value)
        if quantity == "com":
            return self.nominal("length") / 2
        return self.nominal("mass") * self.nominal("length") * self.nominal("length") / 12
