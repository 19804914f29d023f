"""Joints: how a link may move against its parent, as a row of elementary hinges and slides.

A joint's frame is placed in its parent link's frame; the link's own frame is the joint's, moved, and then rotated by a
constant `reference` (none, mostly). Types, with their coordinates (rad, m):

    hinge        a turn about `axis`                          slide        a shift along `axis`
    universal    turns about the two letters of `chart`, "zy" is yaw and then pitch, as the paper's arm has
    ball         turns about the three letters of `chart`, "zyx" is yaw, pitch, roll
    translation  shifts along x, y and z                      free         those, and then a ball's turns
    fixed        none: the link is lumped with its parent

Each turn is about the axis as the turns before have moved it.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from invdyn.models.bodies.rotations import LETTERS, UNTURNED, from_rows, unit
from invdyn.models.bodies.scalars import BodyError, check_name

COORDINATES = {"hinge": 1, "slide": 1, "universal": 2, "ball": 3, "translation": 3, "free": 6, "fixed": 0}
CHARTS = {"universal": "zy", "ball": "zyx", "free": "zyx"}
TURNS = {"x": "roll", "y": "pitch", "z": "yaw"}
WORLD = "world"
"""What a link's parent is called where it hangs on nothing that moves."""


class Motion(NamedTuple):
    """One coordinate: `turns` says whether a turn about the axis, rad, or a shift along it, m."""

    name: str
    axis: np.ndarray
    turns: bool


@dataclass(frozen=True)
class Joint:
    """One joint; types and meanings at the top of this file. `reference` has rows of a rotation, `axis` length 1.

    Raises `BodyError` for a blank name, an unknown type, an axis that is not of unit length, a reference that is no
    rotation, and a chart that the type cannot have.
    """

    name: str
    type: str = "hinge"
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    chart: str = ""
    reference: tuple[tuple[float, ...], ...] = UNTURNED

    def __post_init__(self) -> None:
        check_name(self.name, "name of a joint")
        where = f"joint '{self.name}'"
        if not isinstance(self.type, str) or self.type not in COORDINATES:
            raise BodyError(f"{where}: expected a type of {', '.join(COORDINATES)}, got {self.type!r:.40}")
        axis = unit(self.axis, 3, f"{where}: axis")
        object.__setattr__(self, "axis", tuple(axis.tolist()))
        object.__setattr__(self, "reference", from_rows(self.reference, f"{where}: reference"))
        object.__setattr__(self, "chart", self._checked_chart(where))

    def _checked_chart(self, where: str) -> str:
        usual = CHARTS.get(self.type, "")
        if not self.chart:
            return usual
        letters = list(self.chart) if isinstance(self.chart, str) else []
        apart = all(one != other for one, other in pairwise(letters))
        if len(letters) != len(usual) or not usual or set(letters) - set("xyz") or not apart:
            wanted = f"{len(usual)} letters of x, y and z, no two equal in a row" if usual else "none"
            raise BodyError(f"{where}: a {self.type} joint's chart: expected {wanted}, got {self.chart!r:.40}")
        return self.chart

    def motions(self) -> list[Motion]:
        """Its coordinates, in the order in which they act."""
        if self.type in ("hinge", "slide"):
            return [Motion(self.name, np.array(self.axis), self.type == "hinge")]
        shifts = "xyz" if self.type in ("translation", "free") else ""
        turns = [TURNS[letter] for letter in self.chart]
        if len(set(turns)) < len(turns):
            turns = [f"turn{place}" for place in range(1, len(turns) + 1)]
        return [
            *(Motion(f"{self.name}_{letter}", LETTERS[letter], False) for letter in shifts),
            *(
                Motion(f"{self.name}_{turn}", LETTERS[letter], True)
                for turn, letter in zip(turns, self.chart, strict=True)
            ),
        ]
