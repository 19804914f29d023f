"""A person's limb by height, mass and sex: segments of de Leva (1996), with how far people differ as uncertainty.

De Leva P. (1996), "Adjustments to Zatsiorsky–Seluyanov's segment inertia parameters", J. Biomech. 29, 1223–1230, table
4: of 15 women (1.735 m) and 100 men (1.741 m) between joint centres. Of a segment, per cent of the whole body's mass,
of the segment's length from the joint nearer to the trunk, and of its length; the length in mm at these heights:

    mass m, centre of mass c, radius of gyration k about the transverse axis, length L

    m_s = m · mass     L_s = L · height / 1.735 (1.741)     com = c L_s     I = m_s (k L_s)²

A shank ends at the lateral malleolus, a hand at the third knuckle. What lies beyond the last link moves with it: a
forearm has the hand in line, and a shank has the foot at the ankle. Moments about the other axis across a segment are
somewhat larger, of a hand by up to a half.

The table states no sd. Masses of one person differ from such a table by some 10 %, centres of mass by some 5 %
(`RELATIVE_SD`), and lengths by so much that they are learned from the recording, beginning at the table's.
"""

from collections.abc import Sequence
from typing import NamedTuple

from invdyn.models.bodies.body import Body, planar_body
from invdyn.models.bodies.link import Link
from invdyn.models.bodies.scalars import BodyError, Learned


class Segment(NamedTuple):
    """Mass, centre of mass, radius of gyration (%), and length (mm), as at the top of this file."""

    mass: float
    com: float
    gyration: float
    length: float


HEIGHT = {"f": 1.735, "m": 1.741}  # m
TABLE = {
    "f": {
        "upper_arm": Segment(2.55, 57.54, 26.0, 275.1),
        "forearm": Segment(1.38, 45.59, 25.7, 264.3),
        "hand": Segment(0.56, 74.74, 45.4, 78.0),
        "thigh": Segment(14.78, 36.12, 36.4, 368.5),
        "shank": Segment(4.81, 44.16, 26.7, 432.3),
        "foot": Segment(1.29, 40.14, 27.9, 228.3),
    },
    "m": {
        "upper_arm": Segment(2.71, 57.72, 26.9, 281.7),
        "forearm": Segment(1.62, 45.74, 26.5, 268.9),
        "hand": Segment(0.61, 79.00, 51.3, 86.2),
        "thigh": Segment(14.16, 40.95, 32.9, 422.2),
        "shank": Segment(4.33, 44.59, 24.9, 434.0),
        "foot": Segment(1.37, 44.15, 24.5, 258.1),
    },
}
LIMBS = {
    "arm": (("upper_arm", "shoulder", "elbow"), ("forearm", "elbow", "wrist")),
    "arm_and_hand": (("upper_arm", "shoulder", "elbow"), ("forearm", "elbow", "wrist"), ("hand", "wrist", "knuckle")),
    "leg": (("thigh", "hip", "knee"), ("shank", "knee", "ankle")),
}
"""Links of each limb, with joint and tip."""
BEYOND = {"forearm": "hand", "shank": "foot"}
RELATIVE_SD = {"mass": 0.1, "com": 0.05}
"""Relative standard deviations."""
TALLEST, HEAVIEST = (0.4, 2.8), (2.0, 650.0)
"""m and kg, of all people."""


def person(
    height: float,
    mass: float,
    sex: str,
    limb: str = "arm",
    load: float = 0.0,
    gravity: Sequence[float] = (0.0, -9.81),
    keypoints: Sequence[str] = (),
) -> Body:
    """A limb of a person, in the plane.

    Args:
        height: m.
        mass: of the whole body, kg.
        sex: "f" or "m": of whom the table's numbers are taken.
        limb: "arm" (shoulder, elbow, wrist), "arm_and_hand" (and the third knuckle), or "leg" (hip, knee, ankle).
        load: kg, at the centre of mass of the hand or, of a leg, at the ankle.
        gravity: (2,) m/s².
        keypoints: what the links' tips are called, from the trunk outwards; by default as above.

    Raises `BodyError` for another sex or limb, another number of keypoints, and a height or mass that no person has.
    """
    if sex not in TABLE:
        raise BodyError(f"expected sex as f or m, got {sex!r:.40}")
    if limb not in LIMBS:
        raise BodyError(f"expected a limb among {', '.join(LIMBS)}, got {limb!r:.40}")
    for what, value, (least, most), unit in (("height", height, TALLEST, "m"), ("mass", mass, HEAVIEST, "kg")):
        if not least <= value <= most:
            raise BodyError(
                f"expected a person's {what} from {least:g} to {most:g} {unit}, got {value:g}: check the unit"
            )
    if not 0 <= load <= HEAVIEST[1]:
        raise BodyError(f"expected a load from 0 to {HEAVIEST[1]:g} kg, got {load:g}")
    links, tips = [], [tip for *_, tip in LIMBS[limb]]
    if len(keypoints) not in (0, len(tips)):
        raise BodyError(f"expected {len(tips)} keypoints, as {', '.join(tips)}, got {', '.join(keypoints)}")
    for (name, joint, tip), called in zip(LIMBS[limb], keypoints or tips, strict=True):
        carried = load if tip == tips[-1] else None
        links.append(_link(name, joint, called, height / HEIGHT[sex], mass, TABLE[sex], carried))
    words = f"{limb.replace('_', ' ')} of a person of {height:g} m and {mass:g} kg ({sex})"
    return planar_body(words, links, gravity=gravity, uncertainty=RELATIVE_SD)


def _link(
    name: str, joint: str, tip: str, scale: float, mass: float, table: dict[str, Segment], load: float | None
) -> Link:
    """A link of a person of ``mass`` whose lengths are ``scale`` times the table's; the last one has a ``load``."""
    parts = [_part(table[name], scale, mass)]
    length = scale * table[name].length / 1000
    place = parts[0][1]
    if load is not None and name in BEYOND:
        own, com, inertia = _part(table[BEYOND[name]], scale, mass)
        place = length + (com if BEYOND[name] == "hand" else 0.0)
        parts.append((own, place, inertia))
    if load:
        parts.append((load, place, 0.0))
    total = sum(part for part, _, _ in parts)
    centre = sum(part * com for part, com, _ in parts) / total
    moment = sum(inertia + part * (com - centre) ** 2 for part, com, inertia in parts)
    return Link(name, joint, tip, Learned(length), total, centre, moment)


def _part(segment: Segment, scale: float, mass: float) -> tuple[float, float, float]:
    """Mass kg, centre of mass m from its joint, moment about that kg·m²."""
    length, own = scale * segment.length / 1000, segment.mass / 100 * mass
    return own, segment.com / 100 * length, own * (segment.gyration / 100 * length) ** 2
