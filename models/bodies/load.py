"""A load that a link carries: a point mass at a place of its own (:meth:`.point_mass.Inertia.loaded`).

Of a stick in the plane its place, as the centre of mass, is a number along it.
"""

from dataclasses import replace
from typing import Any

import torch

from invdyn.models.bodies.link import Link
from invdyn.models.bodies.point_mass import Inertia
from invdyn.models.bodies.scalars import BodyError, check_keys, nominal, number


def loaded(link: Link, load: Any) -> Link:
    """The link with a file's ``load = {mass = kg, at = m or [x, y, z]}``; the same without one.

    An uncertain mass stands at its mean, and `Link.load` keeps it. Raises `BodyError` for another table, a mass that is
    not positive, a place that is not of the link's kind, and a link whose mass, centre of mass or inertia is a prior,
    learned, or in space not stated.
    """
    if load is None:
        return link
    where = f"link '{link.name}': load"
    if not isinstance(load, dict) or set(load) != {"mass", "at"}:
        if isinstance(load, dict):
            check_keys(load, ("mass", "at"), where)
        raise BodyError(f"{where}: expected {{mass = kg, at = m along the link}}, got {load!r:.60}")
    uncertain = isinstance(load["mass"], torch.distributions.Distribution)
    mass = nominal(load["mass"]) if uncertain else number(load["mass"], f"{where}: mass in kg")
    if not mass > 0:
        raise BodyError(f"{where}: expected a positive mass in kg, got {mass:g}")
    own = [link.mass, link.com, link.inertia]
    if not all(value is None or _is_known(value) for value in own):
        raise BodyError(f"{where}: expected numbers as the link's own mass, com and inertia, got a prior or a start")
    several = isinstance(load["at"], list | tuple)
    at = tuple(number(x, f"{where}: at in m") for x in (load["at"] if several else [load["at"]]))
    sticks = [getattr(link, key) is None or link.along(key) for key in ("com", "inertia")]
    if (any(sticks) or len(at) != 3) if several else link.length is None:
        raise BodyError(
            f"{where}: expected at as one number along a stick, or [x, y, z] of a link with com and inertia, "
            f"got {load['at']!r:.40}"
        )
    return replace(carrying(link, mass, at), load=(load["mass"], at) if uncertain else None)


def carrying(link: Link, mass: float, at: tuple[float, ...]) -> Link:
    """The link with a point mass, kg, at a place, m: 1 number along a stick, else 3; a negative mass takes one off."""
    stick = len(at) == 1
    com, inertia = ((link.nominal(key),) if stick else getattr(link, key) for key in ("com", "inertia"))
    own = Inertia(*(torch.tensor(value, dtype=torch.float64) for value in ((link.nominal("mass"),), com, inertia)))
    new = own.loaded(torch.tensor([mass], dtype=torch.float64), torch.tensor(at, dtype=torch.float64))
    com, inertia = (value.item() if stick else value.tolist() for value in (new.com, new.moments))
    return replace(link, mass=new.mass.item(), com=com, inertia=inertia)


def _is_known(value: Any) -> bool:
    return all(isinstance(x, int | float) for x in (value if isinstance(value, tuple | list) else (value,)))
