"""Numbers of the body that are not known exactly, which every cause leaves free: by kind of body.

A body states priors of its numbers, or relative standard deviations. Entries of a number are counted flat: link 2's com
along y, of a number (L, 3), is entry 7.
"""

from dataclasses import dataclass
from functools import singledispatch

from pyro.distributions import Distribution

from invdyn.models import ArticulatedBody, Body, Tree
from invdyn.models.bodies.scalars import QUANTITIES

GEOMETRY = frozenset({"length", "position", "sites"})
"""Numbers that say where points are, whatever moves them."""


@dataclass(frozen=True)
class Uncertain:
    """A number of the body that is not known exactly: entry ``link`` of ``quantity`` ("mass"), N(mean, sd²).

    ``signed`` says whether it may be negative. In the plane an entry is a link.
    """

    quantity: str
    link: int
    mean: float
    sd: float
    signed: bool = False

    @property
    def name(self) -> str:
        """Such as "body.mass.0"."""
        return f"body.{self.quantity}.{self.link}"


@singledispatch
def uncertain_numbers(body: ArticulatedBody) -> tuple[Uncertain, ...]:
    """The body's numbers that it states an uncertainty or a prior of, and what is as uncertain because they are.

    None of a body of another kind.
    """
    return ()


@uncertain_numbers.register
def _(body: Body) -> tuple[Uncertain, ...]:
    """A moment of inertia that is left out follows the mass.

    One that is written as a number would stay as it is however heavy the link: it is taken to be known as well as the
    mass is, relatively, and no better.
    """
    found = []
    for k, link in enumerate(body.with_uncertainty().links):
        given = {quantity: getattr(link, quantity) for quantity in QUANTITIES}
        priors = {quantity: prior for quantity, prior in given.items() if isinstance(prior, Distribution)}
        own = [Uncertain(name, k, p.mean.item(), p.stddev.item(), name == "com") for name, p in priors.items()]
        moment = link.nominal("inertia")
        if "mass" in priors and isinstance(given["inertia"], float) and moment > 0:
            own.append(Uncertain("inertia", k, moment, moment * float(priors["mass"].stddev / priors["mass"].mean)))
        found += own
    return tuple(found)


@uncertain_numbers.register
def _(body: Tree) -> tuple[Uncertain, ...]:
    """Priors of its scalars; moments that are numbers stay as they are."""
    return tuple(
        Uncertain(name, entry, prior.mean.item(), prior.stddev.item(), name in body.signed)
        for name, entry, prior in body.scalars()
        if isinstance(prior, Distribution)
    )
