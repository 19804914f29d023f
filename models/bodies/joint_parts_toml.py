"""Joints' parts in a body's TOML: keys of a link, and its motor as a table.

damping = 0.1            friction = 0.05        armature = 0.01        stiffness = 2.0        rest = 0.3
motor = {kind = "position", gain = 40.0, stiffness = 40.0, damping = 1.0, low = -5.0, high = 5.0}
"""

from dataclasses import fields

from invdyn.models.bodies.joint_parts import NOTHING, NUMBERS, JointParts, Motor
from invdyn.models.bodies.scalars import BodyError, check_keys

SAID = (*NUMBERS, "sign", "zero", "step", "late")
KEYS = (*SAID, "motor")


def taken(link: dict, where: str) -> JointParts | None:
    """A link's keys that are its joint's parts, taken out of it; None of none. Raises `BodyError`."""
    given = {key: link.pop(key) for key in KEYS if key in link}
    if not given:
        return None
    try:
        if "motor" in given:
            motor = given["motor"]
            if not isinstance(motor, dict):
                raise BodyError(f"expected motor as a table, such as {{low = -5.0, high = 5.0}}, got {motor!r:.60}")
            check_keys(motor, [each.name for each in fields(Motor)], f"{where}: motor")
            if motor.get("kind") == "position":
                motor = {"stiffness": motor.get("gain", 1.0), **motor}
            given["motor"] = Motor(**motor)
        return JointParts(**given)
    except BodyError as error:
        text = str(error)
        raise BodyError(text if text.startswith(where) else f"{where}: {text}") from None


def table(parts: JointParts | None) -> dict:
    """The keys of a link that say the same; those that stand as they would without are left out."""
    if parts is None:
        return {}
    found = {key: getattr(parts, key) for key in SAID if getattr(parts, key) != getattr(NOTHING, key)}
    if parts.motor is not None:
        plain = Motor()
        said = {each.name: getattr(parts.motor, each.name) for each in fields(Motor)}
        found["motor"] = {key: value for key, value in said.items() if key == "kind" or value != getattr(plain, key)}
        if parts.motor.kind == "position":
            found["motor"]["stiffness"] = parts.motor.stiffness
    return found
