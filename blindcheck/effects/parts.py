"""Parts of a `World` that mechanisms set: hinges, motors. Joints count from 0 at the base."""

from typing import Any

from invdyn.blindcheck.simulator import World, set_part


def set_joint(world: World, joint: int, **attributes: Any) -> None:
    """Set attributes of the hinge that a joint's motor drives, as mjSpec calls them."""
    world.on_spec(lambda spec: set_part(spec.joint(world.pieces[world.hinge(joint)].hinge), attributes))


def set_motor(world: World, joint: int, **attributes: Any) -> None:
    """Set attributes of a joint's motor, as mjSpec calls them."""
    world.on_spec(lambda spec: set_part(spec.actuator(world.pieces[world.hinge(joint)].hinge), attributes))
