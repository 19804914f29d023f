"""What an effect is: something that an ideal rigid body lacks, as Pyro parameters and the hooks that it changes.

An effect is one file and one class, named as in the catalogue (:mod:`.catalogue`). It says where it acts: a joint, a
link, a keypoint, a pair of joints or the whole arm. It says which parameters it has, each with prior, unit and the
value at which it is absent. It overrides those hooks that it changes; the others pass on what they are given.

    body       the body's numbers                                   its own named tuple → the same
    command    what the motors make of the command                  Command → Command
    force      a generalised force on the joints, N·m               Situation → (..., K)
    friction   how large dry friction at its joint can get, N·m     Situation → (..., 1)
    inertia    a joint's own inertia, on the diagonal, kg·m²        → (..., K)
    interval   the time that a step really takes, s                 (...) → (...)
    points     where the camera sees the sites, m                    View → (..., S, d)
    angles     what the encoders show, rad                          View → (..., K)
    noise      the keypoints' standard deviations, m                View, (..., S, d) → (..., S, d)
    mistake    what the tracker gets wrong now and then             → Outlier, Swap, Shift or None

An effect with a coordinate of its own that nobody sees is a :class:`.hidden.HiddenHinge`.

Parameters reach the hooks as tensors (..., 1) by their own names. Leading dimensions are many parameter sets, as
everywhere in this room, so that joint quantities (..., K) broadcast.
"""

import copy
import math
import re
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from functools import cache
from itertools import pairwise
from typing import Any, ClassVar, Self

import torch
from torch import Tensor
from torch.nn.functional import one_hot

from invdyn.models.bodies.body import Body
from invdyn.models.bodies.protocol import ArticulatedBody
from invdyn.models.effects.command import Command
from invdyn.models.effects.effect_context import Situation
from invdyn.models.effects.parameter import Parameter, Values
from invdyn.models.effects.scale import Scale
from invdyn.models.observation.tracker_errors import Outlier, Shift, Swap
from invdyn.models.observation.view import View

PREFIX = "effect."

ABRUPT = 0.006
"""s, sub-step that follows a force that jumps: 35 of 40 recordings with dry friction lose less than 5 nats to 3 ms."""

MARGIN = 4.0
"""Standard deviations by which a parameter may be off where it is asked whether values are credible."""

DYNAMICS = ("body", "command", "force", "friction", "inertia", "interval")
"""Hooks that have a part in the dynamics."""


class Effect(ABC):
    """Base of every effect; see the top of the file.

    Args:
        where: names of the joints, link or keypoint at which it acts; none for the whole arm.

    Raises ValueError for another number of places than the effect has.
    """

    side: ClassVar[str] = "dynamics"
    """"dynamics" for what moves the arm, "observation" for what only sensors see."""
    sensor: ClassVar[str] = "keypoints"
    """Of one on the observation side, whose readings it changes: "keypoints", "encoders", or "any" sensor's."""
    site: ClassVar[str] = "joint"
    """"joint", "link", "keypoint", "pair" (of joints), "keypoints" (a pair) or "arm"."""
    planar: ClassVar[bool] = False
    """Whether it is of a chain in the plane: it speaks of x and y, or of a link's length."""
    needs_command: ClassVar[bool] = False
    """Whether it changes a commanded torque, and nothing without one."""
    of_targets: ClassVar[bool] = False
    """Of one that needs a command, whether it happens to a servo's target as to a torque, such as a delay."""
    order: ClassVar[int] = 0
    """Hooks are called in this order. Of the motors, as in MuJoCo: dead zone −4, lag −3, saturation −2, gain −1, and a
    delay, which may come at any place, 0; of what is seen: markers 0, timing 1, geometry of the camera 2."""

    phrase: ClassVar[str] = ""
    """Its name in a sentence, such as "viscous friction"; see :attr:`words`."""
    meaning: ClassVar[str] = ""
    """What it is, in half a sentence."""
    form_words: ClassVar[Mapping[str, str]] = {}
    """What its other readings are, by their word in :attr:`forms`, and its softer form, by a parameter of that."""
    shown_by: ClassVar[str] = ""
    """The recording that brings it out and nothing like it."""
    edges: ClassVar[Mapping[str, tuple[float, str]]] = {}
    """Of what :meth:`described` reports, by name, the size at which it is cut, and what one as large as that means."""
    twins: ClassVar[Mapping[str, Mapping[str, str]]] = {}
    """Effects, by name, that stand in for it exactly: its parameters, by name, and theirs of the same value."""

    pulls: ClassVar[bool] = False
    """Whether its force acts on points of the links, so that a hidden hinge among them feels it too."""

    located: ClassVar[tuple[str, ...]] = ()
    """Parameters that a recording itself suggests values of, such as when a push began; any grid is a makeshift."""

    dated: ClassVar[bool] = False
    """Whether its parameters tell when something happened in one recording, which another of the same arm does not
    share: a push, the phase in which a base shakes, how warm a joint was at first."""

    longest: ClassVar[float] = math.inf
    """s, longest sub-step, where its force jumps within a motion, as dry friction's where a joint turns around."""
    softens: ClassVar[bool] = False
    """Whether it has a softer form, with more parameters."""
    steady: ClassVar[bool] = False
    """Whether its dry friction, where it has any, is the same at all speeds and loads."""
    forms: ClassVar[tuple[str, ...]] = ()
    """Other readings of the effect, a word each, which comes after the place, as in ``ClockRate("frames")``: under the
    same name, and with a key of their own."""

    contains: ClassVar[Mapping[str, Mapping[str, str]]] = {}
    """Effects, by name, that are a special case of it at the same place: with these of its parameters, by name, at the
    values of theirs. A search follows them from there."""

    filed: ClassVar[Mapping[str, str]] = {}
    """Parameters, by name, that add to a number which a body's file may give its joint, by the name of that
    (:class:`..bodies.joint_parts.JointParts`)."""

    place: tuple[int, ...] = ()
    """Indices of ``where``, once bound to a body."""
    soft: bool = False
    """Whether it is the softer form of itself; see :meth:`softened`."""

    def __init__(self, *where: str):
        expected = {"arm": 0, "pair": 2, "keypoints": 2}.get(self.site, 1)
        self.form = where[expected] if self.forms and len(where) == expected + 1 else None
        if self.form not in (None, *self.forms):
            raise ValueError(f"{self.name}: expected a form among {', '.join(self.forms)}, got {self.form!r}")
        if len(where) != expected + (self.form is not None):
            raise ValueError(f"{self.name}: expected {expected} name(s) of where it acts ({self.site}), got {where!r}")
        self.where = where

    @property
    def name(self) -> str:
        """The canonical name, the class's in snake case."""
        return effect_name(type(self))

    @property
    def key(self) -> str:
        """Name and place, "viscous_friction.elbow": its parameters' names begin with "effect." and this."""
        return ".".join([self.name, *self.where])

    @property
    def prefix(self) -> str:
        """What the names of its parameters begin with in a model."""
        return f"{PREFIX}{self.key}."

    @property
    def softness(self) -> int:
        """How many forms softer than the ideal one it is."""
        return int(self.soft)

    drives: ClassVar[bool] = False
    """Whether its force is a motor's, as a servo's answer is: friction under load counts it."""

    @property
    def yields(self) -> bool:
        """Whether its force takes what all other forces press into it."""
        return False

    @property
    def moves(self) -> bool:
        """Whether any of its hooks has a part in the dynamics."""
        return any(getattr(type(self), hook) is not getattr(Effect, hook) for hook in DYNAMICS)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(map(repr, self.where))})"

    def bound(self, body: ArticulatedBody) -> Self:
        """Return the effect with its places looked up in ``body``.

        Raises ValueError for names that it lacks, and for a body of a kind that it does not fit.
        """
        if not self.fits(body):
            raise ValueError(f"{self.name}: expected {self.of_body}, got '{body.name}'; leave the effect out")
        return self._bound(body, self.where if self.form is None else self.where[:-1])

    def _bound(self, body: ArticulatedBody, where: Sequence[str]) -> Self:
        names = {
            "joint": body.joint_names,
            "pair": body.joint_names,
            "link": body.link_names,
            "keypoint": body.keypoint_names,
            "keypoints": body.keypoint_names,
            "arm": (),
        }[self.site]
        if len(set(where)) < len(where):
            raise ValueError(f"{self.name}: expected two different {self.site}, got {', '.join(where)}")
        for name in where:
            if name not in names:
                raise ValueError(f"{self.name}: expected a {self.site} among {', '.join(names)}, got {name!r}")
        other = copy.copy(self)
        other.place = tuple(list(names).index(name) for name in where)
        return other

    @classmethod
    def fits(cls, body: ArticulatedBody) -> bool:
        """Whether it can act on a body of this kind, wherever."""
        return not cls.planar or isinstance(body, Body)

    @property
    def of_body(self) -> str:
        """What kind of body it fits, in words."""
        return "a chain in the plane" if self.planar else "a chain in the plane or a tree in space"

    @classmethod
    def everywhere(cls, body: ArticulatedBody, keypoints: Sequence[str]) -> list[Self]:
        """One instance for every place of ``body`` at which the effect can act, in every form; ``keypoints`` are those
        tracked.
        """
        if not cls.fits(body):
            return []
        places: dict[str, list[tuple[str, ...]]] = {
            "arm": [()],
            "pair": list(pairwise(body.joint_names)),
            "keypoint": [(name,) for name in keypoints],
            "link": [(name,) for name in body.link_names],
        }
        joints: list[tuple[str, ...]] = [(name,) for name in body.joint_names]
        return [
            cls(*place, *form)
            for form in ((), *((word,) for word in cls.forms))
            for place in places.get(cls.site, joints)
        ]

    @abstractmethod
    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Priors and units, for a body of this scale; the effect is bound."""

    def described(self, values: Values) -> dict[str, tuple[Tensor, str]]:
        """What to report of parameter values, name → (value, unit), where it is not the parameters themselves."""
        return {}

    def credible(self, mean: Mapping[str, float], sd: Mapping[str, float], scale: Scale) -> bool:
        """Whether parameters that were found, by name, mean what the effect's name says.

        A spring whose rest is turns away is a constant torque: such values tell of something that the catalogue lacks.
        The effect is bound.
        """
        return True

    def tellable(self, commanded: bool, confident: bool) -> bool:
        """Whether a recording could show it: one with known commands, one with the tracker's confidences."""
        return commanded or not self.needs_command

    def softened(self) -> Self | None:
        """The same effect, at the same place and under the same key, without some idealisation; None if it has none.

        With more parameters, it is looked for where the ideal form leaves something.
        """
        if self.soft or not self.softens:
            return None
        other = copy.copy(self)
        other.soft = True
        return other

    def as_soft(self, ideal: Mapping[str, float]) -> dict[str, float]:
        """Parameters with which the softer form is much like the ``ideal`` one with its, by name."""
        return dict(ideal)

    def starts_of(self, other: "Effect", values: Mapping[str, float], scale: Scale) -> Sequence[Mapping[str, float]]:
        """Parameters that another effect, which much of this one with its ``values`` is taken for, may begin from.

        None if the other looks like something else. Both are bound.
        """
        return ()

    # -- hooks ---------------------------------------------------------------------------------
    def body(self, p: Values, body: Any) -> Any:
        """The body's numbers."""
        return body

    def command(self, p: Values, command: Command) -> Command:
        """What the motors make of the command."""
        return command

    def late(self, p: Values, elapsed: Tensor, joints: int) -> Tensor | None:
        """Share, (..., K) from 0 to 1, of what motors were told before a recording that still acts after ``elapsed`` s.

        None for motors that act at once.
        """
        return None

    def force(self, p: Values, now: Situation) -> Tensor | None:
        """Generalised force on the joints, (..., K) N·m, or None."""
        return None

    def friction(self, p: Values, now: Situation) -> Tensor | None:
        """Largest dry friction at the effect's joint, (..., 1) N·m, or None; see :mod:`.dry_friction`."""
        return None

    def settling(self, p: Values) -> tuple[Tensor, Tensor] | None:
        """Times T and ρ of soft dry friction, (..., 1) s each; None for a joint that stops at once and does not creep.

        Friction brings its joint to rest with time constant T. There the joint creeps with ρ times the acceleration
        that pushes it.
        """
        return None

    def inertia(self, p: Values, joints: int) -> Tensor | None:
        """Inertia of the joints' own, (..., K) kg·m², or None."""
        return None

    def interval(self, p: Values, dt: Tensor) -> Tensor:
        """The time that a step really takes, s, (..., 1)."""
        return dt

    def points(self, p: Values, view: View) -> Tensor:
        """Where the camera sees the tips, (..., S, d) m; ``view.points`` is what earlier effects made of them."""
        return view.points

    def angles(self, p: Values, view: View) -> Tensor:
        """What the encoders show, (..., K) rad; ``view.angles`` is what earlier effects made of them."""
        return view.angles

    def noise(self, p: Values, view: View, sd: Tensor) -> Tensor:
        """Standard deviation of each tip's coordinates, (..., S, d) m."""
        return sd

    def mistake(self, p: Values, view: View) -> Outlier | Swap | Shift | None:
        """What the tracker gets wrong now and then; see :mod:`invdyn.models.observation.tracker_errors`."""
        return None


@cache
def effect_name(kind: type) -> str:
    """Canonical name of an effect's class: its name in snake case."""
    return re.sub(r"(?<!^)(?=[A-Z])", "_", kind.__name__).lower()


def with_entry(vector: Tensor, place: int, value: Tensor) -> Tensor:
    """A vector (..., K) with another value (..., 1) at a place."""
    here = one_hot(torch.tensor(place % vector.shape[-1]), vector.shape[-1]).bool()
    return torch.where(here, value, vector)


def rotated(vector: Tensor, angle: Tensor) -> Tensor:
    """Vectors (..., 2) turned counter-clockwise by an angle (..., 1), rad."""
    (x, y), (cos, sin) = vector.unbind(-1), (angle.cos()[..., 0], angle.sin()[..., 0])
    return torch.stack(torch.broadcast_tensors(cos * x - sin * y, sin * x + cos * y), -1)
