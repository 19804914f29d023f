"""One rigid link of a tree in space with its joint, and the order of several; units as in :mod:`.tree`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from invdyn.models.bodies.joint_parts import JointParts
from invdyn.models.bodies.joints import WORLD, Joint
from invdyn.models.bodies.placeholders import placeholder
from invdyn.models.bodies.rotations import UNTURNED, from_rows
from invdyn.models.bodies.scalars import (
    LARGEST,
    LARGEST_LENGTH,
    LARGEST_MASS,
    SMALLEST,
    BodyError,
    Scalar,
    check_name,
    checked_scalar,
    checked_scalars,
    nominal,
)

Vector = Sequence[Scalar]


@dataclass(frozen=True)
class SpatialLink:
    """One rigid link and its joint. Its scalars are numbers, scalar Pyro distributions (priors) or `Learned`.

    `rotation` has the rows of a matrix. `parts` are what a hinge or a slide has besides: friction, a spring, a motor;
    None for nothing. Raises `BodyError` for parts of another joint, scalars that are not finite or too large for an
    arm, a mass, length or moment that is negative or whose prior allows it, and a rotation that is not right-handed
    and orthonormal.
    """

    name: str
    joint: Joint
    parent: str = WORLD
    origin: Vector | None = None
    rotation: Sequence[Sequence[float]] = UNTURNED
    mass: Scalar = 0.0
    com: Vector | None = None
    inertia: Vector | None = None
    length: Scalar | None = None
    tip: str | None = None
    sites: Mapping[str, Vector] = field(default_factory=dict)
    parts: JointParts | None = None

    def __post_init__(self) -> None:
        check_name(self.name, "name of a link")
        where = f"link '{self.name}'"
        check_name(self.parent, f"{where}: parent")
        if self.name == WORLD or not isinstance(self.joint, Joint):
            raise BodyError(f"{where}: expected a name other than '{WORLD}' and a Joint")
        if self.parts is not None and self.joint.type not in ("hinge", "slide"):
            raise BodyError(
                f"{where}: expected friction, springs and motors at hinges and slides, got {self.joint.type}"
            )
        keep = object.__setattr__
        what = f"{where}: mass in kg"
        keep(self, "mass", checked_scalar(self.mass, what, smallest=SMALLEST["mass"], largest=LARGEST_MASS))
        # A base may stand anywhere in the world.
        for key, largest in (("origin", LARGEST if self.parent == WORLD else LARGEST_LENGTH), ("com", LARGEST_LENGTH)):
            if getattr(self, key) is not None:
                keep(self, key, checked_scalars(getattr(self, key), 3, f"{where}: {key} in m", largest))
        if self.inertia is not None:
            what = f"{where}: inertia in kg·m²"
            products = checked_scalars(self.inertia, 6, what)
            moments = [checked_scalar(x, what, smallest=SMALLEST["inertia"]) for x in products[:3]]
            keep(self, "inertia", (*moments, *products[3:]))
            most, mass = max(map(nominal, moments)), nominal(self.mass)
            if mass > 0 and most > mass * LARGEST_LENGTH**2 and not placeholder(most):
                raise BodyError(
                    f"{what}: expected moments as of mass within {LARGEST_LENGTH:g} m, up to "
                    f"{mass * LARGEST_LENGTH**2:.3g}, got {most:g}; is the unit right?"
                )
        if self.length is not None:
            what = f"{where}: length in m"
            smallest = SMALLEST["length"]
            length = checked_scalar(self.length, what, positive=True, smallest=smallest, largest=LARGEST_LENGTH)
            keep(self, "length", length)
        if (self.tip is not None) != (self.length is not None):
            raise BodyError(f"{where}: expected length and tip together: the tip is a site at (length, 0, 0)")
        keep(self, "rotation", from_rows(self.rotation, f"{where}: rotation"))
        for name in (*([] if self.tip is None else [self.tip]), *self.sites):
            check_name(name, f"{where}: name of a site")
        sites = {
            name: checked_scalars(at, 3, f"{where}: site '{name}' in m", LARGEST_LENGTH)
            for name, at in self.sites.items()
        }
        keep(self, "sites", sites)

    @property
    def points(self) -> dict[str, Vector | None]:
        """All of its sites by name: the tip first, as None, because it is where the length puts it."""
        return ({} if self.tip is None else {self.tip: None}) | dict(self.sites)


def ordered(links: Sequence[SpatialLink], where: str) -> tuple[SpatialLink, ...]:
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
