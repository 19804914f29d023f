"""Numbers of the body that are not known exactly, which every cause leaves free.

A body states priors of its numbers, or relative standard deviations. Entries of a number are counted flat: link 2's com
along y, of a number (L, 3), is entry 7.
"""

from dataclasses import dataclass

from pyro.distributions import Distribution

from invdyn.models import ArticulatedBody, Body
from invdyn.models.bodies.inertia import NAMES
from invdyn.models.bodies.joint_parts import PARTS
from invdyn.models.bodies.protocol import AXES
from invdyn.models.bodies.scalars import UNITS

GEOMETRY = frozenset({"length", "position", "sites"})
"""Numbers that say where points are, however they move."""
IN_SPACE = {"position": "m", "sites": "m"}
WORDS = {"position": "origin", "sites": "place"}
"""What numbers are called where a user reads them, if otherwise."""


@dataclass(frozen=True)
class Uncertain:
    """A number of the body that is not known exactly: entry ``link`` of ``quantity`` ("mass", "damping"), N(mean, sd²).

    In the plane an entry is a link or a joint. ``place`` is its name, ``what`` that of the number there, in ``unit``;
    ``signed`` says whether it may be negative.
    """

    quantity: str
    link: int
    mean: float
    sd: float
    place: str
    what: str
    unit: str
    signed: bool = False

    @property
    def name(self) -> str:
        """Such as "body.mass.0"."""
        return f"body.{self.quantity}.{self.link}"


def uncertain_numbers(body: ArticulatedBody) -> tuple[Uncertain, ...]:
    """The body's numbers that it states an uncertainty or a prior of, and what is as uncertain because they are.

    Those are priors of its scalars, numbers that it calls uncertain, and joints' own; none of a body of another kind.
    """
    return (*_of_links(body), *_of_joints(body)) if isinstance(body, Body) else ()


def _of_links(body: Body) -> list[Uncertain]:
    """Priors of scalars. Of a chain in the plane a moment of inertia that is left out follows the mass.

    One that is written as a number would stay as it is however heavy the link: it is taken to be known as well as the
    mass is, relatively, and no better. In space moments that are numbers stay.
    """
    free, found = body.with_uncertainty(), list[Uncertain]()
    for name, entry, given in free.scalars():
        size = 1 if body.is_chain else {"mass": 1, "inertia": 6}.get(name, 3)
        if isinstance(given, Distribution):
            known = given.mean.item(), given.stddev.item()
        elif body.is_chain and name == "inertia" and isinstance(given, float) and given > 0:
            if not isinstance(mass := free.links[entry].mass, Distribution):
                continue
            known = given, given * float(mass.stddev / mass.mean)
        else:
            continue
        place = (body.keypoint_names if name == "sites" else body.link_names)[entry // size]
        axis = ("", *AXES, *NAMES)[0 if size == 1 else (1 if size == 3 else 4) + entry % size]
        what = "_".join(filter(None, (WORDS.get(name, name), axis)))
        signed = name == "com" if body.is_chain else name in body.signed
        found.append(Uncertain(name, entry, *known, place, what, (UNITS | IN_SPACE)[name], signed))
    return found


def _of_joints(body: Body) -> list[Uncertain]:
    """What the file gives joints and calls uncertain, relatively, of all joints or of one."""
    found = []
    for k, (joint, parts) in enumerate(zip(body.joint_names, body.joint_parts, strict=True)):
        for part, unit in PARTS.items():
            value = getattr(parts, part)
            sd = value * body.uncertainty.get(f"{part}.{joint}", body.uncertainty.get(part, 0.0))
            if sd > 0:
                found.append(Uncertain(part, k, value, sd, joint, part, unit))
    return found
