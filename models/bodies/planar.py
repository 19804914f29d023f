"""Chains of sticks in the plane: their own, shorter numbers, and what their links may not be. Units as in :mod:`.body`.

Link k begins at joint k and ends at its tip, where joint k+1 sits; all hinges are about z, and the plane is x–y. A
link has a `length` m, `mass` kg, `com` m from the joint along the link (default length/2) and an `inertia` kg·m² about
the centre of mass (default mass·length²/12, a uniform rod). Files: `body_toml.py`.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from torch import Tensor

from invdyn.models.bodies.inertia import placeholder
from invdyn.models.bodies.joints import WORLD, Joint
from invdyn.models.bodies.link import Link
from invdyn.models.bodies.rotations import UNTURNED
from invdyn.models.bodies.scalars import QUANTITIES, SMALLEST, BodyError, checked
from invdyn.models.bodies.tree_parameters import TreeParameters

MOST_LINKS = 100  # an arm has seven, a snake robot thirty
MAX_COM = 3.0  # lengths from the joint; farther out it is a slip of the unit, not a counterweight
MAX_GYRATION = 20.0  # lengths, √(inertia/mass): a rod has 0.29, one with a geared rotor some; in kg·cm² it has 29
FOLLOWING = ("com", "inertia")  # quantities that follow from length and mass where a link leaves them out


class BodyParameters(NamedTuple):
    """The numbers of a chain of K links as tensors; leading dimensions are many parameter sets.

    `length`, `mass`, `com`, `inertia` (..., K); `gravity`, `base` (..., 2). Units at the top of this file.
    """

    length: Tensor
    mass: Tensor
    com: Tensor
    inertia: Tensor
    gravity: Tensor
    base: Tensor

    def to(self, *args: Any, **kwargs: Any) -> "BodyParameters":
        """Return them with `Tensor.to(*args, **kwargs)` applied to every tensor."""
        return BodyParameters(*(value.to(*args, **kwargs) for value in self))


def in_plane(p: TreeParameters) -> BodyParameters:
    """The numbers of a tree that is such a chain."""
    base = p.position[..., 0, :2]
    return BodyParameters(p.sites[..., 0], p.mass, p.com[..., 0], p.inertia[..., 2], p.gravity[..., :2], base)


def check_chain(links: Sequence[Link], where: str) -> None:
    """Raise `BodyError`, which begins with ``where``, unless the links are a chain of sticks on hinges about z.

    And for more than a hundred; a name of two places; a length or mass that is not positive; a centre of mass more than
    three lengths from the joint; an inertia as of mass more than twenty lengths away that is no placeholder; and a link
    that has neither com nor inertia to resist a torque.
    """
    if len(links) > MOST_LINKS:
        raise BodyError(f"{where}: expected at most {MOST_LINKS} links, got {len(links)}")
    joints = [link.joint.name for link in links]
    for place, link in enumerate(links):
        label = f"{where}: link '{link.name}'"
        plain = link.joint == Joint(link.joint.name) and link.rotation == UNTURNED and not link.sites
        placed = link.parent == (links[place - 1].name if place else WORLD) and (place == 0 or link.origin is None)
        if link.length is None or not plain or not placed:
            raise BodyError(
                f"{label}: expected a stick, of a length and a tip, on a hinge about z at the tip of the one before; "
                "a body of 3 dimensions takes any other"
            )
        # a keypoint is called after the joint that it shows, so one name cannot mean two places
        if link.tip in joints and joints.index(link.tip) != place + 1:
            raise BodyError(f"{where}: '{link.tip}' is the tip of one link but the joint of another, elsewhere")
        _check_stick(link, f"link '{link.name}'")


def _check_stick(link: Link, where: str) -> None:
    for key in QUANTITIES:
        value = getattr(link, key)
        if value is not None and key in FOLLOWING and not link.along(key):
            raise BodyError(f"{where}: expected one number for {key} in the plane, got {value!r:.60}")
        if value is not None:
            checked(value, key, where)
    length, mass, com, inertia = (link.nominal(key) for key in QUANTITIES)
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
