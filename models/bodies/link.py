"""One rigid link with its joint, what it may not be, and the order of several; units as in :mod:`.body`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from numbers import Real

import pyro.distributions as dist

from invdyn.models.bodies.inertia import placeholder
from invdyn.models.bodies.joint_parts import JointParts
from invdyn.models.bodies.joints import WORLD, Joint
from invdyn.models.bodies.rotations import UNTURNED, from_rows
from invdyn.models.bodies.scalars import (
    MAX_LENGTH,
    MAX_MASS,
    MAX_NUMBER,
    SMALLEST,
    BodyError,
    Learned,
    Scalar,
    check_name,
    checked,
    checked_scalar,
    checked_scalars,
    nominal,
)

Vector = Sequence[Scalar]


@dataclass(frozen=True, init=False)
class Link:
    """One rigid link and its joint. Its scalars are numbers, scalar Pyro distributions (priors) or `Learned`.

    A `joint` that is a text is a hinge of that name about z. A link with a `length` is a stick along its x axis that
    ends at its `tip`. Of a stick `com` may be one scalar, m along it, and `inertia` one, about its joint's axis z;
    else `com` has 3 and `inertia` 6 scalars. `rotation` has the rows of a matrix. `parts` are what a hinge or a slide
    has besides: friction, a spring, a motor; None for nothing. `load` is a carried point mass whose mass is uncertain,
    with its place: the link's own numbers have it at its mean (:mod:`.load`).

    Raises `BodyError` for parts of another joint, scalars that are not finite or too large for an arm, a mass, length
    or moment that is negative or whose prior allows it, and a rotation that is not right-handed and orthonormal.
    """

    name: str
    joint: Joint
    tip: str | None
    length: Scalar | None
    mass: Scalar
    com: Vector | Scalar | None
    inertia: Vector | Scalar | None
    parts: JointParts | None
    parent: str
    origin: Vector | None
    rotation: Sequence[Sequence[float]]
    sites: Mapping[str, Vector]
    load: tuple[dist.Distribution, tuple[float, ...]] | None

    def __init__(
        self,
        name: str,
        joint: Joint | str,
        tip: str | None = None,
        length: Scalar | None = None,
        mass: Scalar = 0.0,
        com: Vector | Scalar | None = None,
        inertia: Vector | Scalar | None = None,
        parts: JointParts | None = None,
        parent: str = WORLD,
        origin: Vector | None = None,
        rotation: Sequence[Sequence[float]] = UNTURNED,
        sites: Mapping[str, Vector] | None = None,
        load: tuple[dist.Distribution, tuple[float, ...]] | None = None,
    ):
        joint = Joint(joint) if isinstance(joint, str) else joint
        given = (name, joint, tip, length, mass, com, inertia, parts, parent, origin, rotation, sites or {}, load)
        for key, value in zip(fields(self), given, strict=True):
            object.__setattr__(self, key.name, value)
        self._check()

    def _check(self) -> None:
        check_name(self.name, "name of a link")
        where = f"link '{self.name}'"
        check_name(self.parent, f"{where}: parent")
        keep = object.__setattr__
        if self.name == WORLD:
            raise BodyError(f"{where}: expected a name other than '{WORLD}'")
        if not isinstance(self.joint, Joint):
            raise BodyError(f"{where}: expected a joint or its name, got {self.joint!r:.60}")
        if self.parts is not None and self.joint.type not in ("hinge", "slide"):
            raise BodyError(
                f"{where}: expected friction, springs and motors at hinges and slides, got {self.joint.type}"
            )
        what = f"{where}: mass in kg"
        keep(self, "mass", checked_scalar(self.mass, what, smallest=SMALLEST["mass"], largest=MAX_MASS))
        if self.length is not None:
            keep(self, "length", checked(self.length, "length", where))
        if (self.tip is not None) != (self.length is not None):
            raise BodyError(f"{where}: expected length and tip together: the tip is a site at (length, 0, 0)")
        self._check_vectors(where)
        keep(self, "rotation", from_rows(self.rotation, f"{where}: rotation"))
        for name in (*([] if self.tip is None else [self.tip]), *self.sites):
            check_name(name, f"{where}: name of a site")
        sites = {
            name: checked_scalars(at, 3, f"{where}: site '{name}' in m", MAX_LENGTH) for name, at in self.sites.items()
        }
        keep(self, "sites", sites)

    def _check_vectors(self, where: str) -> None:
        """Keep origin, com and inertia as floats, priors or learned scalars. Raises `BodyError`."""
        keep = object.__setattr__
        for key in ("com", "inertia"):
            value = getattr(self, key)
            if value is not None and self.along(key):
                if self.length is None:
                    raise BodyError(f"{where}: one number for {key} is of a link with a length, along it")
                keep(self, key, checked(value, key, where))
        # A base may stand anywhere in the world.
        for key, largest in (("origin", MAX_NUMBER if self.parent == WORLD else MAX_LENGTH), ("com", MAX_LENGTH)):
            if getattr(self, key) is not None and not self.along(key):
                keep(self, key, checked_scalars(getattr(self, key), 3, f"{where}: {key} in m", largest))
        if self.inertia is None or self.along("inertia"):
            return
        what = f"{where}: inertia in kg·m²"
        products = checked_scalars(self.inertia, 6, what)
        moments = [checked_scalar(x, what, smallest=SMALLEST["inertia"]) for x in products[:3]]
        keep(self, "inertia", (*moments, *products[3:]))
        most, mass = max(map(nominal, moments)), nominal(self.mass)
        if mass > 0 and most > mass * MAX_LENGTH**2 and not placeholder(most):
            raise BodyError(
                f"{what}: expected moments as of mass within {MAX_LENGTH:g} m, up to "
                f"{mass * MAX_LENGTH**2:.3g}, got {most:g}; is the unit right?"
            )

    def along(self, quantity: str) -> bool:
        """Whether com or inertia is one scalar, along the stick and about its joint, and no vector."""
        value = getattr(self, quantity)
        return isinstance(value, Real | dist.Distribution | Learned) or getattr(value, "ndim", 1) == 0

    @property
    def points(self) -> dict[str, Vector | None]:
        """All of its sites by name: the tip first, as None, because it is where the length puts it."""
        return ({} if self.tip is None else {self.tip: None}) | dict(self.sites)

    def nominal(self, quantity: str) -> float:
        """A stick's length, mass, com along it or inertia about its joint's axis, as a float.

        Priors stand at their mean, learned ones at their start; com and inertia of none are a uniform rod's.
        """
        value = getattr(self, quantity)
        if value is None and quantity == "com":
            return self.nominal("length") / 2
        if value is None:
            return self.nominal("mass") * self.nominal("length") * self.nominal("length") / 12
        if quantity in ("com", "inertia") and not self.along(quantity):
            value = value[0 if quantity == "com" else 2]
        return nominal(value)


def ordered(links: Sequence[Link], where: str) -> tuple[Link, ...]:
    """Links with parents before their children, else as given. Raises `BodyError` for unknown parents and a cycle."""
    names = {link.name for link in links}
    for link in links:
        if link.parent != WORLD and link.parent not in names:
            raise BodyError(
                f"{where}: link '{link.name}' hangs on '{link.parent}', which is no link; "
                f"links are {', '.join(link.name for link in links)}, and '{WORLD}' is what does not move"
            )
    placed, waiting, known = [], list(links), {WORLD}
    while waiting:
        ready = next((link for link in waiting if link.parent in known), None)
        if ready is None:
            circle = ", ".join(f"'{link.name}' on '{link.parent}'" for link in waiting)
            raise BodyError(f"{where}: expected a tree, but links hang on each other in a circle: {circle}")
        waiting.remove(ready)
        known.add(ready.name)
        placed.append(ready)
    return tuple(placed)
