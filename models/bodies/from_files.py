"""Bodies out of files, by tables with one for each link: what chains in the plane and trees in space read alike."""

import warnings
from abc import ABC, abstractmethod
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Self

from invdyn.models.bodies import body_mjcf, body_urdf
from invdyn.models.bodies.parts import Robot
from invdyn.models.bodies.placeholders import Moment, told
from invdyn.models.bodies.scalars import BodyError


class FromFiles(ABC):
    """Base of bodies that are made as ``cls(links=[...], **tables)``."""

    @staticmethod
    @abstractmethod
    def link_of(table: dict) -> Any:
        """A link, of its table."""

    @staticmethod
    @abstractmethod
    def tables_of(robot: Robot, where: str) -> dict:
        """Those of a robot's parts. Raises `BodyError`, which begins with ``where``, for a body of another kind."""

    @abstractmethod
    def largest_moments(self) -> Iterable[Moment]:
        """The largest of each link."""

    @classmethod
    def from_mjcf(cls, path: str | Path) -> Self:
        """Read a file of MuJoCo's format (extra `robots`); see `body_mjcf`, and `from_robot` for what it may hold.

        Warns of what the file has and rigid links lack. Raises `BodyError`, which names the file, or `OSError`.
        """
        return cls.from_robot(body_mjcf.read(path), path)

    @classmethod
    def from_urdf(cls, path: str | Path) -> Self:
        """Read a file of URDF; warns and raises as `from_mjcf`."""
        return cls.from_robot(body_urdf.read(path), path)

    @classmethod
    def from_robot(cls, robot: Robot, path: str | Path) -> Self:
        """The body of a file's parts, in the plane a chain of hinges (`body_chain`), else any tree (`body_tree`)."""
        return cls._of(cls.tables_of(robot, str(path)), path)

    @classmethod
    def _of(cls, tables: dict, path: str | Path) -> Self:
        try:
            body = cls(**tables | {"links": [cls.link_of(link) for link in tables["links"]]})
        except BodyError as error:
            raise BodyError(f"{path}: {error}") from error
        if strange := told(body.largest_moments()):
            warnings.warn(f"{path}: {strange}", UserWarning, stacklevel=3)
        return body
