"""A load that a link carries: a point mass at a place of its own.

    m' = m + M     c' = (m c + M a) / m'     I' = I + m s(c − c') + M s(a − c'),   s(r) = |r|² 1 − r rᵀ

with the link's mass m, centre of mass c and inertia I about it, and a load of M kg at a. Of a stick in the plane a and
c are numbers along it, and s(r) = r².
"""

from dataclasses import fields
from typing import Any

import numpy as np

from invdyn.models.bodies.inertia import six, tensor
from invdyn.models.bodies.link import Link
from invdyn.models.bodies.scalars import BodyError, check_keys, number


def loaded(link: Link, load: Any) -> Link:
    """The link with a file's ``load = {mass = kg, at = m or [x, y, z]}``; the same without one.

    Raises `BodyError` for another table, a mass that is not positive, a place that is not of the link's kind, and a
    link whose mass, centre of mass or inertia is a prior, learned, or in space not stated.
    """
    if load is None:
        return link
    where = f"link '{link.name}': load"
    if not isinstance(load, dict) or set(load) != {"mass", "at"}:
        if isinstance(load, dict):
            check_keys(load, ("mass", "at"), where)
        raise BodyError(f"{where}: expected {{mass = kg, at = m along the link}}, got {load!r:.60}")
    mass = number(load["mass"], f"{where}: mass in kg")
    if not mass > 0:
        raise BodyError(f"{where}: expected a positive mass in kg, got {mass:g}")
    at: Any
    com: Any
    inertia: Any
    own = [link.mass, link.com, link.inertia]
    if not all(value is None or _is_known(value) for value in own):
        raise BodyError(f"{where}: expected numbers as the link's own mass, com and inertia, got a prior or a start")
    if isinstance(load["at"], list | tuple):
        if (
            len(load["at"]) != 3
            or link.com is None
            or link.inertia is None
            or link.along("com")
            or link.along("inertia")
        ):
            raise BodyError(
                f"{where}: expected at as one number along a stick, or [x, y, z] of a link with com and inertia"
            )
        at = np.array([number(x, f"{where}: at in m") for x in load["at"]])
        com, inertia = np.array(link.com, float), tensor(np.array(link.inertia, float))
    else:
        if link.length is None:
            raise BodyError(f"{where}: expected at as [x, y, z] of a link without a length, got {load['at']!r:.40}")
        at = number(load["at"], f"{where}: at in m")
        com, inertia = link.nominal("com"), link.nominal("inertia")
    before = link.nominal("mass")
    total = before + mass
    centre = (before * com + mass * at) / total
    moved = inertia + before * _about(com - centre) + mass * _about(at - centre)
    new = (float(centre), float(moved)) if np.ndim(centre) == 0 else (centre.tolist(), six(moved).tolist())
    given = {each.name: getattr(link, each.name) for each in fields(link)}
    return Link(**given | {"mass": total, "com": new[0], "inertia": new[1]})


def _is_known(value: Any) -> bool:
    return all(isinstance(x, int | float) for x in (value if isinstance(value, tuple | list) else (value,)))


def _about(place: Any) -> Any:
    """s(r)."""
    return place**2 if np.ndim(place) == 0 else place @ place * np.eye(3) - np.outer(place, place)
