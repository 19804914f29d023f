"""What simulates reality: worlds, mechanisms, and the camera that films them. `ENGINES` has them by name.

Engines of a kind of bodies share names, places, units and usual sizes of effects, bodies, motions and answers.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from typing import Any

import numpy as np

from invdyn.blindcheck import camera
from invdyn.blindcheck import effects as injected
from invdyn.blindcheck.effects import EFFECTS, Injected
from invdyn.blindcheck.pinocchio.forms import MECHANISMS as FORMS
from invdyn.blindcheck.pinocchio.forms import drawn_form
from invdyn.blindcheck.pinocchio.simulator import World as SecondWorld
from invdyn.blindcheck.setting import PLANE, Setting
from invdyn.blindcheck.simulator import World
from invdyn.blindcheck.tracker import noise_law
from invdyn.blindcheck.trees import SPACE
from invdyn.blindcheck.unlisted_effects import UNLISTED
from invdyn.blindcheck.world import Trajectory


@dataclass(frozen=True)
class Engine:
    """One generator of reality.

    Attributes:
        name: for the command line and in the answers.
        package: that simulates it; its module is imported under `module`.
        setting: the kind of bodies, and what their cases have in common.
        effects: those of the catalogue that it simulates, by name.
        world: a body → a world that mechanisms change and that then runs: see `simulator.World`.
        unlisted: effects outside the catalogue, by name, called with a world, a generator, a scene and a joint.
        film: (trajectory, true times, effects, noise, seed) → points; see `camera.film`.
        noise_law: the tracker's law of a reality's seed, in a word.
    """

    name: str
    package: str
    module: str
    setting: Setting
    effects: Mapping[str, Injected]
    world: Callable[[Any], Any]
    unlisted: Mapping[str, Callable[..., dict]]
    film: Callable[..., np.ndarray]
    noise_law: Callable[[Sequence[int]], str]

    @property
    def version(self) -> str:
        """Of its package. Raises PackageNotFoundError without it."""
        return f"{self.name} {version(self.package)}"


def film_of_any_law(
    trajectory: Trajectory, time: np.ndarray, effects: Sequence[camera.Effect], noise: float, seed: Sequence[int]
) -> np.ndarray:
    """`camera.film` with a tracker whose noise has the law of the reality's seed."""
    return camera.film(trajectory, time, effects, noise, seed, noise_law(seed))


MUJOCO = Engine(
    "mujoco",
    "mujoco",
    "mujoco",
    PLANE,
    EFFECTS,
    World,
    UNLISTED,
    camera.film,
    lambda seed: "normal",
)
IN_SPACE = replace(
    MUJOCO,
    name="mujoco-in-space",
    setting=SPACE,
    effects=injected.IN_SPACE,
    # a weight on a hinge of its own would count among the tree's
    unlisted={name: each for name, each in UNLISTED.items() if name != "sloshing_payload"},
)
PINOCCHIO = Engine(
    "pinocchio",
    "pin",
    "pinocchio",
    PLANE,
    {
        name: replace(each, size=partial(drawn_form, name), install=FORMS.get(name, each.install))
        for name, each in EFFECTS.items()
    },
    SecondWorld,
    UNLISTED,
    film_of_any_law,
    noise_law,
)
ENGINES = {engine.name: engine for engine in (MUJOCO, PINOCCHIO, IN_SPACE)}
"""By name; the first is the default."""
