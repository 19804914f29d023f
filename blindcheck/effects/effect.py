"""An effect as the blind check simulates it: where it acts, its units, how large it is drawn, and what installs it.

A mechanism of the dynamics is one function with the decorator :func:`mechanism`. An effect on what sensors show is
declared by :func:`sensor_effect`, and `camera` and `encoders` simulate it. `EFFECTS` has all, in the order of
declaration.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from invdyn.blindcheck.scene import Scene
from invdyn.blindcheck.simulator import World, set_part

Size = Callable[[np.random.Generator, Scene, int, float], dict]
"""Draw of parameters: (generator, scene, place, strength) → name → value."""


@dataclass(frozen=True)
class Injected:
    """One effect.

    Attributes:
        name: of the catalogue.
        site: "joint", "link", "keypoint" or "arm".
        units: of every parameter, "1" where it has none; non-ideal forms have the last ones besides.
        size: draws the parameters.
        install: called with world, place (none of the whole arm) and the parameters by name; None for what sensors
            show.
        needs: what a case with it must have: "command", "gravity", "clock" (known torque), "two joints",
            "encoders".
    """

    name: str
    site: str
    units: Mapping[str, str]
    size: Size
    install: Callable[..., None] | None
    needs: tuple[str, ...]


EFFECTS: dict[str, Injected] = {}


def mechanism(*, units: Mapping[str, str], size: Size, site: str = "joint", needs: tuple[str, ...] = ()) -> Callable:
    """Decorate the function that installs an effect of the dynamics; its name is the effect's."""

    def tell(install: Callable[..., None]) -> Callable[..., None]:
        EFFECTS[install.__name__] = Injected(install.__name__, site, units, size, install, needs)
        return install

    return tell


def sensor_effect(*, units: Mapping[str, str], site: str = "arm", needs: tuple[str, ...] = ()) -> Callable:
    """Decorate the function that draws an effect on what sensors show; its name is `_` and the effect's."""

    def tell(size: Size) -> Size:
        name = size.__name__.removeprefix("_")
        EFFECTS[name] = Injected(name, site, units, size, None, needs)
        return size

    return tell


def set_joint(world: World, joint: int, **attributes: Any) -> None:
    """Set attributes of the hinge that a joint's motor drives, as mjSpec calls them."""
    world.on_spec(lambda spec: set_part(spec.joint(world.pieces[world.hinge(joint)].hinge), attributes))


def set_motor(world: World, joint: int, **attributes: Any) -> None:
    """Set attributes of a joint's motor, as mjSpec calls them."""
    world.on_spec(lambda spec: set_part(spec.actuator(world.pieces[world.hinge(joint)].hinge), attributes))
