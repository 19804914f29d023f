"""Bodies out of files and into them, of any format that is known; for the formats see each one's own file."""

import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Self

from invdyn.models.bodies import (
    body_chain,
    body_mjcf,
    body_osim,
    body_toml,
    body_tree,
    body_urdf,
    body_xml,
)
from invdyn.models.bodies.body_toml import LOAD
from invdyn.models.bodies.inertia import Moment, placeholder_warning
from invdyn.models.bodies.joints import Joint
from invdyn.models.bodies.link import Link
from invdyn.models.bodies.load import loaded
from invdyn.models.bodies.parts import is_planar_chain
from invdyn.models.bodies.protocol import ArticulatedBody
from invdyn.models.bodies.scalars import BodyError, nominal
from invdyn.models.bodies.tree_parameters import vector_of
from invdyn.models.bodies.whole_file import read_whole


class FromFiles(ArticulatedBody):
    """What of a :class:`.Body` has to do with files."""

    links: Sequence[Link]
    uncertainty: Mapping[str, float]
    exact: bool

    @classmethod
    def load(cls, path: "str | Path | Any", *, filmed: bool = True, dimensions: int | None = None) -> Self:
        """Read a body file: MJCF (<mujoco>), URDF (<robot>), OpenSim's (.osim) or TOML; the content says which.

        A ``mujoco.MjSpec`` or ``MjModel`` is read as its MJCF file would be.

        A robot's file of hinges about one of the axes x, y and z, without a branch, is a chain in the plane, unless
        ``dimensions`` is 3, as where a recording shows it in space; then every site of its file is a keypoint. A chain
        in the plane has its centres of mass on the lines of its joints: a robot that has one off them, and is not
        ``filmed`` in a plane, is a tree, and a warning (UserWarning) says so.

        An OpenSim model is a body in space, with the coordinates of its own motions (.mot) and markers.

        Raises `BodyError`, which names the file and what to do, or `OSError` if it cannot be read.
        """
        if isinstance(path, str | Path):
            content = read_whole(path, body_xml.MOST_BYTES)
            if not body_xml.is_xml(content):
                return cls.from_tables(body_toml.parse(content, str(path)), path)
            root = body_xml.parse(content, str(path))
            robot = {"mujoco": body_mjcf, body_xml.OSIM: body_osim}.get(root.tag, body_urdf).of(root, str(path))
        else:
            robot, path = body_mjcf.of_compiled(path, "the robot"), "robot"
        if dimensions is None:
            dimensions = 2 if robot.angles_are_free and is_planar_chain(robot.parts) else 3
            if dimensions == 2 and not filmed and (off := body_chain.masses_off_line(robot, str(path))):
                words = f"in the plane it would leave out {'; '.join(off)}"
                warnings.warn(f"{path}: taken as a body in space; {words}", stacklevel=2)
                dimensions = 3
        tables = (body_chain if dimensions == 2 else body_tree).tables(robot, str(path))
        return cls._of(tables, dimensions, path)

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
            kind: Any = cls
            body: Self = (kind.planar if dimensions == 2 else kind)(**{"exact": False, **own})
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
        exact = self.exact and not (self.uncertainty or self.has_priors)
        body_toml.write(path, self.name, self.dimensions, self.gravity, self.links, self.uncertainty, exact)


def _link(table: dict) -> Link:
    own, joint = {key: value for key, value in table.items() if key != LOAD}, table["joint"]
    return loaded(Link(**own | {"joint": Joint(**joint) if isinstance(joint, dict) else joint}), table.get(LOAD))
