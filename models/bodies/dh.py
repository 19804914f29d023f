"""Serial arms out of a table of Denavit and Hartenberg.

Two conventions are in use; both turn about, or shift along, the z axes:

    standard   frame i at the far end of link i:   A_i = Rz(θ) Tz(d) Tx(a) Rx(α)
    modified   frame i at the joint of link i:     A_i = Rx(α) Tx(a) Rz(θ) Tz(d)     (Craig; most data sheets)

A hinge adds its coordinate to θ, a slide to d. J. J. Craig, Introduction to Robotics (2005), chapter 3; B. Siciliano
and others, Robotics (2009), section 2.8. Inertial numbers are meant in frame i of the convention.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from invdyn.models.bodies.body import Body
from invdyn.models.bodies.inertia import six, tensor
from invdyn.models.bodies.joints import WORLD, Joint
from invdyn.models.bodies.link import Link
from invdyn.models.bodies.rotations import LETTERS, about, numbers
from invdyn.models.bodies.scalars import BodyError, number


class Row(NamedTuple):
    """One row: `a` and `d` m, `alpha` and `theta` rad, the latter two being offsets where the joint moves them."""

    a: float
    alpha: float
    d: float
    theta: float = 0.0
    type: str = "hinge"


@dataclass(frozen=True)
class Inertial:
    """`mass` kg, `com` (3,) m and `inertia` (6,) kg·m² of a link in its frame of Denavit and Hartenberg."""

    mass: float
    com: Sequence[float] = (0.0, 0.0, 0.0)
    inertia: Sequence[float] = (0.0,) * 6


def from_dh(
    name: str,
    rows: Sequence[Row],
    inertials: Sequence[Inertial],
    convention: str = "modified",
    gravity: Sequence[float] = (0.0, 0.0, -9.81),
    tip: str = "tip",
) -> Body:
    """Return the arm of a table: links link1 …, joints joint1 …, and a site at the origin of the last frame.

    Raises `BodyError` for another convention than "standard" or "modified", rows and inertials that differ in number,
    joints other than hinges and slides, and what `Body` refuses.
    """
    if convention not in ("standard", "modified"):
        raise BodyError(f"a table of Denavit and Hartenberg: expected standard or modified, got {convention!r:.40}")
    if len(rows) != len(inertials):
        raise BodyError(f"a table of {len(rows)} rows: expected as many inertials, got {len(inertials)}")
    links: list[Link] = []
    R, p = np.eye(3), np.zeros(3)  # the place of the next joint in the frame of the link before
    for place, (row, own) in enumerate(zip(rows, inertials, strict=True), 1):
        where = f"row {place} of a table of Denavit and Hartenberg"
        a, alpha, d, theta = (number(value, where) for value in row[:4])
        if row.type not in ("hinge", "slide"):
            raise BodyError(f"{where}: expected a hinge or a slide, got {row.type!r:.40}")
        com = numbers(own.com, 3, f"{where}: com in m")
        inertia = tensor(numbers(own.inertia, 6, f"{where}: inertia in kg·m²"))
        turn, rise, lean, reach = about(LETTERS["z"], theta), LETTERS["z"] * d, about(LETTERS["x"], alpha), [a, 0, 0]
        if convention == "modified":
            R, p = R @ lean, p + R @ reach
            placed = R @ turn, p + R @ rise
            R, p = np.eye(3), np.zeros(3)
        else:
            placed = R @ turn, p
            R, p = lean, rise + np.array(reach)
            com, inertia = p + R @ com, R @ inertia @ R.T
        links.append(
            Link(
                name=f"link{place}",
                joint=Joint(f"joint{place}", row.type),
                parent=f"link{place - 1}" if links else WORLD,
                origin=placed[1].tolist(),
                rotation=placed[0].tolist(),
                mass=own.mass,
                com=com.tolist(),
                inertia=six(inertia).tolist(),
                sites={tip: p.tolist()} if place == len(rows) else {},
            )
        )
    return Body(name, links, gravity)
