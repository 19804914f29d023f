"""A file in XML, MJCF (<mujoco>), URDF (<robot>) or OpenSim's: what it is, its content says, not its name."""

from invdyn.models.bodies import body_mjcf, body_osim, body_urdf, body_xml
from invdyn.models.bodies.parts import Robot


def of(content: bytes, where: str) -> Robot:
    """The parts of a file's content. Raises `BodyError`, which begins with `where`, as the reader of its kind does."""
    root = body_xml.parse(content, where)
    return {"mujoco": body_mjcf, body_xml.OSIM: body_osim}.get(root.tag, body_urdf).of(root, where)
