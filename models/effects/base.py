"""An effect: something that an ideal rigid body lacks, as parameters with priors and units, and what it changes.

One effect is one class in one file of the same name: ``ViscousFriction`` in ``viscous_friction.py``. It says where it
acts (:attr:`Effect.site`), which parameters it has, and changes one or several *stages* of the simulation. For each it
has a method of the stage's name. All have the same form,

    def stage(self, p, x): ...          p the effect's own parameters by name, (..., 1) each; x as below

and some return x as they leave it, others what they add to it:

    body        x the body's numbers                     → the same
    interval    x the stated time of a step, (..., 1) s  → the time that it really takes
    command     x the command so far                     → Command
    late        x s since the first row, (..., K)        → share, 0 to 1, of earlier commands that still acts
    force       x a Situation                            → generalised force that is added, (..., K) N·m
    pull        the same, of forces on points of the links: a hidden hinge among these feels them too
    answer      the same, of what servos answer to angle and velocity: it loads a motor's gear
    friction    x a Situation                            → largest dry friction at the joint, (..., 1) N·m
    settling    x a Situation                            → times T, ρ of regularised dry friction, (..., 1) s, or None
    inertia     x the number of joints K                 → inertia of the joints' own, (..., K) kg·m²
    points      x a View                                 → where the camera sees the sites, (..., S, d) m
    angles      x a View                                 → what the encoders show, (..., K) rad
    noise       x a View                                 → factor on the sites' standard deviations, (..., S or 1, 1)
    outlier     x a View                                 → error of the tracker: something else is detected
    mistiming   x a View                                 → error of the tracker: another time is detected

:mod:`.effect_context` says what a Situation knows, such as the time, :mod:`..observation.view` the same of a View. A
:class:`.Command` has all rows at once, (..., T, K): many parameter sets come as (..., 1, 1) there, and broadcast too.

Effects act in the order of :attr:`Effect.order`; a force of an order above 0 finds the others in the situation's
``motor``. An effect with states that no sensor shows derives from a class of :mod:`.hidden`. What a diagnosis needs to
know of an effect besides, its words, relatives and credible values, stands in the diagnosis' own catalogue.

Leading dimensions (...) are many parameter sets.
"""

import copy
import math
import re
from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cache
from itertools import pairwise, product
from typing import ClassVar, Self

import torch
from torch import Tensor
from torch.nn.functional import one_hot

from invdyn.models.bodies.protocol import ArticulatedBody
from invdyn.models.effects.command import Command
from invdyn.models.effects.effect_context import Situation
from invdyn.models.effects.scale import Parameter, Scale, Values, change, quantiles
from invdyn.models.observation.view import View

__all__ = [
    "ABRUPT",
    "PREFIX",
    "STAGES",
    "STOPS",
    "Command",
    "Effect",
    "Parameter",
    "Scale",
    "Situation",
    "Values",
    "View",
    "as_variant",
    "change",
    "effect_name",
    "quantiles",
    "rotated",
    "side_of",
    "stages_of",
    "with_entry",
]

PREFIX = "effect."

ABRUPT = 0.006
"""s, sub-step that follows a force that jumps: 35 of 40 recordings with dry friction lose less than 5 nats to 3 ms."""

MOTION = ("body", "interval", "command", "force", "pull", "answer", "friction", "inertia")
"""Stages that change how the body moves."""

STAGES = (*MOTION, "late", "settling", "points", "angles", "noise", "outlier", "mistiming")

PLACES = {"arm": 0, "pair": 2, "keypoints": 2, "stop": 2}
"""How many names say where an effect of a site acts; one for others."""

STOPS = ("upper", "lower")
"""Sides of a joint's range; a stop at the upper one keeps its angle from growing."""


class Effect(ABC):
    """Base of every effect; see the top of the file.

    Args:
        where: names of the joints, link or keypoints at which it acts; none for the whole arm. A form comes last.

    Raises ValueError for another number of places than the effect has, and an unknown form.
    """

    name: str
    """Canonical: by default the class's name in snake case."""
    sensor: ClassVar[str] = ""
    """Of what only sensors see, whose readings it changes: "keypoints", "encoders", or "any". "" moves the arm."""
    site: ClassVar[str] = "joint"
    """"joint", "link", "keypoint", "pair" (of joints), "keypoints" (a pair), "stop" (a joint and a side) or "arm"."""
    planar: ClassVar[bool] = False
    """Whether it needs a chain in the plane: it is written in x and y, or with a link's length."""
    forms: ClassVar[tuple[str, ...]] = ()
    """Other readings of the effect, a word each, which comes after the place, as in ``ClockRate("frames")``."""
    order: float = 0
    """When it acts among others. Of motors, as in MuJoCo: dead zone −4, lag −3, saturation −2, gain −1, delay 0. Of
    what is seen: markers 0, timing 1, geometry of the camera 2."""
    max_substep: float = math.inf
    """s, longest sub-step, where its force jumps within a motion, as dry friction's where a joint reverses."""

    place: tuple[int, ...] = ()
    """Indices of ``where``, once bound to a body."""
    variant: int = 0
    """0 for the ideal law, 1 and more for non-ideal ones, which have more parameters; see :func:`as_variant`."""

    def __init_subclass__(cls) -> None:
        if "name" not in cls.__dict__:
            cls.name = effect_name(cls)

    def __init__(self, *where: str):
        expected = PLACES.get(self.site, 1)
        self.form = where[expected] if self.forms and len(where) == expected + 1 else None
        if self.form not in (None, *self.forms):
            raise ValueError(f"{self.name}: expected a form among {', '.join(self.forms)}, got {self.form!r}")
        if len(where) != expected + (self.form is not None):
            raise ValueError(f"{self.name}: expected {expected} name(s) of where it acts ({self.site}), got {where!r}")
        self.where = where

    @property
    def key(self) -> str:
        """Name and place, "viscous_friction.elbow": its parameters' names begin with "effect." and this."""
        return ".".join([self.name, *self.where])

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(map(repr, self.where))})"

    @classmethod
    def fits(cls, body: ArticulatedBody) -> bool:
        """Whether it can act on a body of this kind, at any place."""
        return not cls.planar or body.is_chain

    def bound(self, body: ArticulatedBody) -> Self:
        """Return the effect with its places looked up in ``body``.

        Raises ValueError for names that it lacks, and for a body of a kind that it does not fit.
        """
        if not self.fits(body):
            kind = "a chain in the plane" if self.planar else "a chain in the plane or a tree in space"
            raise ValueError(f"{self.name}: expected {kind}, got '{body.name}'; leave the effect out")
        return self._bound(body, self.where if self.form is None else self.where[:-1])

    def _bound(self, body: ArticulatedBody, where: Sequence[str]) -> Self:
        where = where[:1] if self.site == "stop" else where
        kind = {"pair": "joint", "keypoints": "keypoint", "stop": "joint"}.get(self.site, self.site)
        names = list(getattr(body, f"{kind}_names", ()))
        if len(set(where)) < len(where):
            raise ValueError(f"{self.name}: expected two different {self.site}, got {', '.join(where)}")
        for name in where:
            if name not in names:
                raise ValueError(f"{self.name}: expected a {self.site} among {', '.join(names)}, got {name!r}")
        other = copy.copy(self)
        other.place = tuple(names.index(name) for name in where)
        return other

    @classmethod
    def everywhere(cls, body: ArticulatedBody, keypoints: Sequence[str]) -> list[Self]:
        """One instance for every place of ``body`` at which the effect can act, in every form.

        ``keypoints`` are those tracked, which what acts on the body does not need; none of a body that it does not fit.
        """
        places: dict[str, list[tuple[str, ...]]] = {
            "arm": [()],
            "joint": [(name,) for name in body.joint_names],
            "pair": list(pairwise(body.joint_names)),
            "stop": list(product(body.joint_names, STOPS)),
            "keypoint": [(name,) for name in (keypoints if cls.sensor else body.keypoint_names)],
            "link": [(name,) for name in body.link_names],
        }
        forms = ((), *((word,) for word in cls.forms))
        return [cls(*place, *form) for form in forms for place in places[cls.site]] if cls.fits(body) else []

    def own(self, values: Tensor) -> Tensor:
        """Of the joints' values (..., K) that of its own joint, (..., 1)."""
        return values[..., self.place[0] : self.place[0] + 1]

    def at_joints(self, value: Tensor, joints: int) -> Tensor:
        """A value (..., 1) at its own joints, all of them where it has no place, and 0 at the others, (..., K)."""
        mine = torch.zeros(joints).index_fill(0, torch.tensor(self.place or range(joints)), 1.0)
        return value * mine.to(value)

    @abstractmethod
    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Priors and units, for a body of this scale; the effect is bound."""


def stages_of(effect: Effect | type[Effect]) -> tuple[str, ...]:
    """Stages that an effect changes; see the top of the file."""
    return tuple(stage for stage in STAGES if hasattr(effect, stage))


def side_of(effect: Effect | type[Effect]) -> str:
    """Where an effect acts: "dynamics" for what moves the arm, "observation" for what only sensors see."""
    return "observation" if effect.sensor else "dynamics"


def as_variant(effect: Effect, number: int | None = None) -> Effect:
    """The same effect in a non-ideal variant of its own class, by number: by default the next one."""
    other = copy.copy(effect)
    other.variant = effect.variant + 1 if number is None else number
    return other


@cache
def effect_name(kind: type) -> str:
    """Name of a class in snake case."""
    return re.sub(r"(?<!^)(?=[A-Z])", "_", kind.__name__).lower()


def with_entry(vector: Tensor, place: int, value: Tensor) -> Tensor:
    """A vector (..., K) with another value (..., 1) at a place."""
    here = one_hot(torch.tensor(place % vector.shape[-1]), vector.shape[-1]).bool()
    return torch.where(here, value, vector)


def rotated(vector: Tensor, angle: Tensor) -> Tensor:
    """Vectors (..., 2) rotated counter-clockwise by an angle (..., 1), rad."""
    (x, y), (cos, sin) = vector.unbind(-1), (angle.cos()[..., 0], angle.sin()[..., 0])
    return torch.stack(torch.broadcast_tensors(cos * x - sin * y, sin * x + cos * y), -1)
