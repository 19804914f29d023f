"""Bodies out of URDF, by MuJoCo's reader of it: what is only looked at is dropped first, then as :mod:`.body_mjcf`.

Meshes are named by packages that are not here, and a body needs none: inertial elements have its numbers. Frames on
fixed joints are kept, because the last one is the tip.
"""

from pathlib import Path
from xml.etree import ElementTree

from invdyn.models.bodies import body_mjcf
from invdyn.models.bodies.scalars import BodyError


def read(path: str | Path) -> dict:
    """Return name, gravity, base and links of a URDF file; warns and raises as :func:`.body_mjcf.read`."""
    mujoco = body_mjcf.engine(path)
    try:
        robot = ElementTree.fromstring(Path(path).read_bytes())
    except ElementTree.ParseError as error:
        raise BodyError(f"{path}: broken XML: {error}") from error
    if robot.tag != "robot":
        raise BodyError(f"{path}: expected a URDF, with <robot> around it, got <{robot.tag}>")
    for link in robot.iter("link"):
        for seen in [each for tag in ("visual", "collision") for each in link.findall(tag)]:
            if seen.find(".//mesh") is not None:
                link.remove(seen)
    for own in robot.findall("mujoco"):
        robot.remove(own)
    options = {"fusestatic": "false", "discardvisual": "false", "angle": "radian"}
    ElementTree.SubElement(ElementTree.SubElement(robot, "mujoco"), "compiler", options)
    try:
        model = mujoco.MjModel.from_xml_string(ElementTree.tostring(robot, encoding="unicode"))
    except ValueError as error:
        raise BodyError(f"{path}: MuJoCo cannot read it: {' '.join(str(error).split())}") from error
    return body_mjcf.tables(model, str(path))
