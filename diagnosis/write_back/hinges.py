"""Where a body's joints stand in a file that MuJoCo compiled (``mujoco.MjModel``)."""

from typing import Any


def hinge(model: Any, name: str) -> int:
    """The number of a body's joint; one without a name in the file is called by its number there, from 1."""
    return [model.joint(j).name or f"joint{j + 1}" for j in range(model.njnt)].index(name)


def actuators_of(model: Any, joint: int) -> list[int]:
    """Numbers of the actuators whose target is that joint."""
    return [a for a in range(model.nu) if int(model.actuator_trnid[a, 0]) == joint]
