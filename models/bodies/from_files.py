"""Bodies out of files and into them, of any format that is known; for the formats see each one's own file.

A link of a file may carry a load, a point mass of M kg at a. With the link's mass m, centre of mass c and inertia I
about it,

    m' = m + M     c' = (m c + M a) / m'     I' = I + m s(c − c') + M s(a − c'),   s(r) = |r|² 1 − r rᵀ

Of a stick in the plane a and c are numbers along it, and s(r) = r².
"""

import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, Self

import numpy as np

from invdyn.models.bodies import (
    body_chain,
    body_mjcf,
    body_osim,
    body_toml,
    body_tree,
    body_urdf,
    body_xml,
    planar,
)
from invdyn.models.bodies.body_toml import LOAD
from invdyn.models.bodies.inertia import Moment, placeholder_warning, six, tensor
from invdyn.models.bodies.joints import Joint
from invdyn.models.bodies.link import Link
from invdyn.models.bodies.parts import is_planar_chain
from invdyn.models.bodies.protocol import ArticulatedBody
from invdyn.models.bodies.scalars import BodyError, check_keys, nominal, number
from invdyn.models.bodies.tree_parameters import vector_of
from invdyn.models.bodies.whole_file import read_whole


class FromFiles(ArticulatedBody):
    """What of a :class:`.Body` has to do with files."""

    links: Sequence[Link]
    uncertainty: Mapping[str, float]

    @classmethod
    def load(cls, path: str | Path, *, filmed: bool = True, dimensions: int | None = None) -> Self:
        """Read a body file: MJCF (<mujoco>), URDF (<robot>), OpenSim's (.osim) or TOML; the content says which.

        A robot's file of hinges about one of the axes x, y and z, without a branch, is a chain in the plane, unless
        ``dimensions`` is 3, as where a recording shows it in space; then every site of its file is a keypoint. A chain
        in the plane has its centres of mass on the lines of its joints: a robot that has one off them, and is not
        ``filmed`` in a plane, is a tree, and a warning (UserWarning) says so.

        An OpenSim model is a body in space, with the coordinates of its own motions (.mot) and markers.

        Raises `BodyError`, which names the file and what to do, or `OSError` if it cannot be read.
        """
        content = read_whole(path, body_xml.MOST_BYTES)
        if not body_xml.is_xml(content):
            return cls.from_tables(body_toml.parse(content, str(path)), path)
        root = body_xml.parse(content, str(path))
        robot = {"mujoco": body_mjcf, body_xml.OSIM: body_osim}.get(root.tag, body_urdf).of(root, str(path))
        if dimensions is None:
            dimensions = 2 if robot.angles_are_free and is_planar_chain(robot.parts) else 3
            if dimensions == 2 and not filmed and (off := body_chain.masses_off_line(robot, str(path))):
                words = f"in the plane it would leave out {'; '.join(off)}"
                warnings.warn(f"{path}: taken as a body in space; {words}", stacklevel=2)
                dimensions = 3
        tables = (body_chain if dimensions == 2 else body_tree).tables(robot, str(path))
        return cls._of(tables | {"exact": False}, dimensions, path)

    @classmethod
    def from_toml(cls, path: str | Path) -> Self:
        """Read a body file. Raises `BodyError`, which names the file, or `OSError` if it cannot be read."""
        return cls.from_tables(body_toml.parse(read_whole(path, body_xml.MOST_BYTES), str(path)), path)

    @classmethod
    def from_tables(cls, tables: dict, path: str | Path) -> Self:
        """The body of a TOML file's tables; dimensions = 3 says a tree. See `load`."""
        return cls._of(*body_toml.of(tables, str(path)), path)

    @classmethod
    def _of(cls, tables: dict, dimensions: int, path: str | Path) -> Self:
        try:
            own = tables | {"links": [_link(link) for link in tables["links"]]}
            exact = own.pop("exact", True)
            body = cls(**(planar.chained(**own) if dimensions == 2 else own) | {"exact": exact})
        except BodyError as error:
            raise BodyError(f"{path}: {error}") from error
        if strange := placeholder_warning(body.largest_moments()):
            warnings.warn(f"{path}: {strange}", UserWarning, stacklevel=3)
        return body

    def largest_moments(self) -> Iterator[Moment]:
        """Of each link that states them, the largest about an axis through its centre of mass."""
        for link in self.links:
            if self.is_chain:
                yield Moment(link.name, link.nominal("inertia"), link.nominal("mass"), link.nominal("length"))
            elif (inertia := vector_of(link, "inertia")) is not None:
                inner = [other.origin for other in self.links if other.parent == link.name]
                ends = [vector_of(link, "com"), *link.sites.values(), *inner]
                far = [math.hypot(*map(nominal, end)) for end in ends if end is not None]
                length = 0.0 if link.length is None else nominal(link.length)
                yield Moment(link.name, max(map(nominal, inertia[:3])), nominal(link.mass), max([length, *far]))

    def to_toml(self, path: str | Path) -> None:
        """Write a body file that `from_toml` reads back.

        Raises `BodyError` for priors that no file can express (all but log-normal), `OSError` for no place.
        """
        body_toml.write(path, self.name, self.dimensions, self.gravity, self.links, self.uncertainty)


def _link(table: dict) -> Link:
    own, joint = {key: value for key, value in table.items() if key != LOAD}, table["joint"]
    return loaded(Link(**own | {"joint": Joint(**joint) if isinstance(joint, dict) else joint}), table.get(LOAD))


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
