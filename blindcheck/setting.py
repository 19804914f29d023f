"""What cases of one kind of body have in common in every engine: bodies, motions, sensors. Those of the plane."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from invdyn.blindcheck.motion import IN_THE_PLANE, Habits, between, random_body
from invdyn.models import Body


@dataclass(frozen=True)
class Style:
    """What a recording has: the base's keypoint; encoders and their noise, rad; a share of missing frames; keypoints.

    `counted`: whether d′ counts what the encoders show; `thorough`: as a setting's, where it is given.
    """

    base: bool
    encoder: float | None
    missing: float
    filmed: bool = True
    counted: bool = False
    thorough: tuple[int, int] | None = None


@dataclass(frozen=True)
class Setting:
    """One kind of body.

    Attributes:
        bodies: (generator, what the effects need, their names, whether it is passive) → a body, and what its file says.
        style: (generator, effects' names) → what the recording has.
        habits: how it is moved.
        thorough: steps at most, and how often windows double, where d′ looks for states: see `initial_state_fit`.
        described: a body → its numbers, as they stand in the answer; "gravity" and "base" among them.
    """

    bodies: Callable[..., tuple[Any, Any]]
    style: Callable[[np.random.Generator, Sequence[str]], Style]
    habits: Habits
    described: Callable[[Any], dict]
    thorough: tuple[int | None, int | None] = (None, None)


def planar_bodies(
    rng: np.random.Generator, needs: Sequence[str], names: Sequence[str], passive: bool
) -> tuple[Body, Body]:
    """A chain of one to three links; one in eight lies level, and of one in eight the file is 2 % off."""
    two = "two joints" in needs
    joints = int(rng.choice([2, 3] if two else [1, 2, 3], p=[0.75, 0.25] if two else [0.15, 0.65, 0.2]))
    horizontal = not passive and "gravity" not in needs and rng.random() < 0.12
    body = random_body(rng, joints, horizontal)
    return body, _measured(rng, body) if rng.random() < 0.12 else body


def _measured(rng: np.random.Generator, body: Body) -> Body:
    """The body as its file has it: masses and what follows known to 2 %, and said so."""
    off = {
        key: [link.nominal(key) * float(np.exp(0.02 * rng.standard_normal())) for link in body.links]
        for key in ("mass", "com", "inertia")
    }
    return replace(body.with_values(**off), uncertainty=dict.fromkeys(off, 0.02))


def _planar_style(rng: np.random.Generator, names: Sequence[str]) -> Style:
    base, encoders = bool(rng.random() < 0.5), bool(rng.random() < 0.15) or "encoder_offset" in names
    return Style(
        base=base,
        encoder=float(f"{10 ** rng.uniform(-3.5, -2.5):.2g}") if encoders else None,
        missing=float(rng.uniform(0.01, 0.05)) if rng.random() < 0.3 else 0.0,
    )


def of_robot(rng: np.random.Generator) -> Style:
    """A robot's log: encoders of .1 to 1 mrad, and no camera."""
    return Style(False, float(f"{between(rng, 1e-4, 1e-3):.2g}"), 0.0, filmed=False, counted=True, thorough=(0, 0))


def _planar_numbers(body: Body) -> dict:
    numbers = {key: [link.nominal(key) for link in body.links] for key in ("length", "mass", "com", "inertia")}
    return numbers | {"gravity": list(body.gravity), "base": list(body.base)}


PLANE = Setting(planar_bodies, _planar_style, IN_THE_PLANE, _planar_numbers)
