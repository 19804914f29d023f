"""A robot's file in XML, MJCF (<mujoco>) or URDF (<robot>): what it is, its content says, not its name."""

from invdyn.models.bodies import body_mjcf, body_urdf, body_xml
from invdyn.models.bodies.parts import Robot


def of(content: bytes, where: str) -> Robot:
    """The parts of a file's content. Raises `BodyError`, which begins with `where`, as `body_mjcf` and `body_urdf`."""
    root = body_xml.parse(content, where)
    return (body_mjcf if root.tag == "mujoco" else body_urdf).of(root, where)
