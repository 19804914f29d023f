"""An effect that is there: drawn, put into a world or before the camera, and written as an answer."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from invdyn.blindcheck.camera import Effect
from invdyn.blindcheck.effects import EFFECTS, OBSERVATIONS
from invdyn.blindcheck.engine import MUJOCO, Engine
from invdyn.blindcheck.scene import Scene
from invdyn.blindcheck.unlisted_effects import UNLISTED
from invdyn.models import Body

CATALOGUE = tuple(EFFECTS)
FIRST = ("payload", "inertial_error")  # change a link as a whole, so before another cuts it


@dataclass(frozen=True)
class Present:
    """One effect: its place counted from 0, or None, and how large; those outside the catalogue draw from `seed`."""

    name: str
    place: int | None
    parameters: dict
    seed: int | None = None


def drawn(
    rng: np.random.Generator, name: str, s: Scene, strength: float, engine: Engine = MUJOCO, place: int | None = None
) -> Present:
    """Draw where an effect is, if its `place` is not given, and how large, for a scene."""
    if place is None and site_of(name) != "arm":
        place = int(rng.integers(name == "joint_coupling", s.body.num_joints))
    if name in UNLISTED:
        return Present(name, place, {}, int(rng.integers(2**31)))
    size = engine.effects[name].size(rng, s, place or 0, strength)
    return Present(name, place, {key: float(value) for key, value in size.items()})


def site_of(name: str) -> str:
    """Where an effect acts: "joint", "link", "keypoint" or "arm"; those outside the catalogue act at a joint."""
    return EFFECTS[name].site if name in EFFECTS else "joint"


def world_with(body: Body, present: Sequence[Present], s: Scene, engine: Engine = MUJOCO) -> Any:
    """A world of a body with these effects of the dynamics."""
    world = engine.world(body)
    for each in sorted(present, key=lambda e: e.name not in FIRST):
        if each.name in UNLISTED:
            install = engine.unlisted[each.name]
            each.parameters.update(install(world, np.random.default_rng(each.seed), s, each.place or 0))
        elif (mechanism := engine.effects[each.name].install) is not None:
            where = () if each.place is None else (each.place,)
            mechanism(world, *where, **each.parameters)
    return world


def pace(present: Sequence[Present]) -> float:
    """How many times too fast the clock runs that stamps the rows."""
    return next((e.parameters["rate"] for e in present if e.name == "clock_rate"), 1.0)


def shown_by_sensors(present: Sequence[Present]) -> list[Effect]:
    """Those that camera and encoders have to know, as they take them."""
    return [(e.name, e.place, e.parameters) for e in present if e.name in OBSERVATIONS]


def named(each: Present, body: Body, engine: Engine = MUJOCO) -> dict:
    """The answer's entry of one effect, with the names and units of the catalogue, but for how visible it is.

    Of an engine's own form, parameters that the catalogue has no units for stand in `form`.
    """
    units, form = engine.effects[each.name].units if each.name in engine.effects else None, {}
    parameters = {}
    for name, value in _as_written(each).items():
        if units is not None and name not in units:
            form[name] = value
        else:
            parameters[name] = {"value": value if units else value[0], "unit": units[name] if units else value[1]}
    entry: dict[str, Any] = {"effect": each.name, "side": "observation" if each.name in OBSERVATIONS else "dynamics"}
    if each.place is not None:
        kind = site_of(each.name)
        names = {"link": [link.name for link in body.links], "keypoint": body.keypoint_names, "joint": body.joint_names}
        entry[kind] = names[kind][each.place]
        if each.name == "joint_limit":
            entry["stop"] = "upper" if each.parameters["side"] > 0 else "lower"
        if each.name == "joint_coupling":
            entry["partner"] = body.joint_names[each.place - 1]
        if each.name == "label_swap":
            entry["partner"] = body.keypoint_names[each.place - 1 if each.place else 1]
    interval = [each.parameters["start"], each.parameters["stop"]] if each.name == "external_push" else None
    return entry | ({"form": form} if form else {}) | {"parameters": parameters, "interval": interval}


def _as_written(each: Present) -> dict:
    """Parameters with what is free in them settled: phases within half a turn of 0, a base's larger amplitude > 0."""
    parameters = dict(each.parameters)
    if each.name == "base_motion":
        sizes = [parameters["amplitude_x"], parameters["amplitude_y"]]
        if max(sizes, key=abs) < 0:
            parameters |= {"amplitude_x": -sizes[0], "amplitude_y": -sizes[1], "phase": parameters["phase"] + np.pi}
    if "phase" in parameters and each.name not in UNLISTED:
        parameters["phase"] = float(np.remainder(parameters["phase"] + np.pi, 2 * np.pi) - np.pi)
    return parameters
