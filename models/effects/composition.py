"""Several effects on one arm: what they make of each stage together (:mod:`.base`)."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial, reduce
from typing import Any

import torch
from torch import Tensor

from invdyn.models.dynamics.interface import Dynamics
from invdyn.models.effects.base import MOTION, PREFIX, STAGES, Effect, stages_of
from invdyn.models.effects.command import Command
from invdyn.models.effects.dry_friction import dry_friction
from invdyn.models.effects.effect_context import Situation
from invdyn.models.effects.hidden import Follower, Hidden, HiddenHinge
from invdyn.models.effects.regularised_friction import BristleFriction
from invdyn.models.observation.view import Outlier, Shift, Swap, View

PARTS = 8
"""Lines that stand for each row of a command that lags and is changed further."""
FORCES = ("force", "pull", "answer")
"""Stages that add a force; an effect has one of them at most."""
SEEN = ("points", "angles", "noise", "outlier", "mistiming")
"""Stages of what sensors see."""

Acting = tuple[Effect, Callable[[Any], Any]]
"""An effect, and one of its stages as a function of x alone."""


class NotTogether(ValueError):
    """Effects that no model has at once."""


class Composition:
    """Bound effects and the parameters that a model has for them.

    Args:
        effects: in any order; they act by :attr:`Effect.order`.
        filed: parts of the simulation itself, which change stages as effects do: they come first, have the body's
            parameters, and iterating over a composition leaves them out.

    Raises NotTogether for an effect twice at a place, and for two whose hidden states move the arm; ValueError for one
    that changes nothing.
    """

    def __init__(self, effects: tuple[Effect, ...] = (), filed: tuple[Effect, ...] = ()):
        keys = [effect.key for effect in effects]
        if twice := {key for key in keys if keys.count(key) > 1}:
            raise NotTogether(f"expected each effect once at a place, got {', '.join(sorted(twice))} twice")
        for effect in effects:
            if not stages_of(effect) and not isinstance(effect, Hidden):
                raise ValueError(f"{effect.name}: expected a method named {', '.join(STAGES)}, got none of these")
        self.effects, self.filed = tuple(sorted(effects, key=lambda effect: effect.order)), filed
        effects = self._acting = tuple(sorted((*filed, *effects), key=lambda effect: effect.order))
        self._changing = {stage: [effect for effect in effects if hasattr(effect, stage)] for stage in STAGES}
        self._forcing = [(effect, stage) for effect in effects for stage in FORCES if hasattr(effect, stage)]
        self.has_force = bool(self._forcing)
        self.has_servo = any(hasattr(effect, "answer") for effect in filed)
        self.max_substep = min((effect.max_substep for effect in effects), default=math.inf)
        self.abrupt = self.max_substep < math.inf
        self.has_changing_friction = not all(getattr(e, "steady", False) for e in self._changing["friction"])
        # What one makes of a row is a curve, which another may cut within the row.
        self.parts = PARTS if self.changes("late") and len(self._changing["command"]) > 1 else 1
        self.seen = any(self.changes(stage) for stage in SEEN)
        hidden = [effect for effect in effects if isinstance(effect, Hidden)]
        movers = [effect for effect in hidden if not isinstance(effect, Follower)]
        if len(movers) > 1:
            both = " and ".join(effect.key for effect in movers)
            raise NotTogether(f"expected at most one effect whose hidden states move the arm, got {both}")
        mover = movers[0] if movers else None
        self.hinge = mover if isinstance(mover, HiddenHinge) else None
        self.bristles = mover if isinstance(mover, BristleFriction) else None
        self.followers = sorted((each for each in hidden if isinstance(each, Follower)), key=lambda each: each.key)
        self.hidden: tuple[Hidden, ...] = (*movers, *self.followers)

    def __iter__(self) -> Iterator[Effect]:
        return iter(self.effects)

    def __bool__(self) -> bool:
        return bool(self._acting)

    def changes(self, stage: str) -> bool:
        """Whether any effect, or part of the simulation, changes a stage."""
        return bool(self._changing[stage])

    def _each(self, stage: str, parameters: Mapping[str, Tensor]) -> Iterator[Acting]:
        """Effects that change a ``stage``, in their order, and how."""
        for effect in self._changing[stage]:
            yield effect, self._acts(effect, stage, parameters)

    def _acts(self, effect: Effect, stage: str, parameters: Mapping[str, Tensor]) -> Callable[[Any], Any]:
        prefix = "body." if effect in self.filed else f"{PREFIX}{effect.key}."
        return partial(getattr(effect, stage), _beginning(prefix, parameters))

    def through(self, stage: str, parameters: Mapping[str, Tensor], x: Any) -> Any:
        """What effects make of ``x`` at a stage that returns x, one after the other: of the body, or of an interval."""
        for _, acts in self._each(stage, parameters):
            x = acts(x)
        return x

    def command(self, parameters: Mapping[str, Tensor], command: Command) -> Command:
        """The command as all actuators make it; in shorter rows, where several do."""
        command = command if self.parts == 1 else command.split(self.parts)
        made: Command = self.through("command", parameters, command)
        return made

    def late(self, parameters: Mapping[str, Tensor], elapsed: Tensor, joints: int) -> Tensor:
        """Largest share, (..., K), of earlier commands that still acts ``elapsed`` (..., 1) s after the first row."""
        elapsed = elapsed.expand(*elapsed.shape[:-1], joints)
        return reduce(torch.maximum, [acts(elapsed) for _, acts in self._each("late", parameters)])

    def force(self, parameters: Mapping[str, Tensor], now: Situation) -> Tensor:
        """Sum of the generalised forces, (..., K) N·m; those of an order above 0 find the others in ``now.motor``.

        Raises ValueError for a force of another size.
        """
        total, order = torch.zeros_like(now.q), 0.0
        for effect, stage in self._forcing:
            if effect.order > order:
                now, order = replace(now, motor=now.motor + total), effect.order
            force = self._acts(effect, stage, parameters)(now)
            if force is not None and force.shape[-1:] != now.q.shape[-1:]:
                raise ValueError(
                    f"{effect.name}: expected a {stage} for each joint, (..., {now.q.shape[-1]}), as now.at(joint, …) "
                    f"gives, got {tuple(force.shape)}"
                )
            total = total if force is None else total + force
        return total

    def driven(self, parameters: Mapping[str, Tensor], now: Situation) -> Situation:
        """The moment with all that motors give: a servo's answer to angle and velocity, too."""
        if not self.has_servo:
            return now
        answers = (acts(now) for _, acts in self._each("answer", parameters))
        return replace(now, motor=sum((each for each in answers if each is not None), start=now.motor))

    def pull(self, parameters: Mapping[str, Tensor], now: Situation) -> Tensor:
        """Of these forces those on points of the links."""
        return sum((acts(now) for _, acts in self._each("pull", parameters)), start=torch.zeros_like(now.q))

    def friction(
        self,
        parameters: Mapping[str, Tensor],
        now: Situation,
        torque: Tensor,
        own: Tensor | None,
        held: bool = False,
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Dry friction on all joints under the other torques (..., K) N·m; several effects at a joint add up.

        At the moment ``now``, or as a constant over the sub-step that starts there; then the error of q, rad, at its
        end; and θ̈ at its start.
        """

        def levels(now: Situation) -> dict[int, Tensor]:
            found: dict[int, Tensor] = {}
            now = self.driven(parameters, now)
            for effect, acts in self._each("friction", parameters):
                joint, level = effect.place[0], acts(now)
                found[joint] = found[joint] + level if joint in found else level
            return found

        def levels_at(q: Tensor, qd: Tensor) -> dict[int, Tensor]:
            return levels(replace(now, q=q, qd=qd))

        settling: dict[int, tuple[Tensor, Tensor]] = {}
        for effect, acts in self._each("settling", parameters):
            times = acts(now)
            if times is not None:
                joint = effect.place[0]
                rest, creep = settling.get(joint) or times
                settling[joint] = torch.maximum(rest, times[0]), torch.maximum(creep, times[1])
        changing = held and self.has_changing_friction
        return dry_friction(levels(now), now, torque, own, levels_at if changing else None, settling, held)

    def inertia(self, parameters: Mapping[str, Tensor], joints: int) -> Tensor | None:
        """Sum of the joints' own inertias, (..., K) kg·m²; None where no effect has any."""
        own = [acts(joints) for _, acts in self._each("inertia", parameters)]
        return sum(own[1:], start=own[0]) if own else None

    def points(self, parameters: Mapping[str, Tensor], view: View) -> View:
        """The view with the points where the camera sees them."""
        for _, acts in self._each("points", parameters):
            view = view.seen_at(acts(view))
        return view

    def angles(self, parameters: Mapping[str, Tensor], view: View) -> Tensor:
        """What the encoders show, (..., K) rad."""
        for _, acts in self._each("angles", parameters):
            view = replace(view, angles=acts(view))
        return view.angles

    def noise(self, parameters: Mapping[str, Tensor], view: View, sd: Tensor) -> Tensor:
        """Standard deviations of the tips' coordinates, (..., S, d) m."""
        for _, acts in self._each("noise", parameters):
            sd = sd * acts(view)
        return sd

    def mistakes(self, parameters: Mapping[str, Tensor], view: View) -> list[Outlier | Swap | Shift]:
        """Errors that the tracker makes now and then."""
        return [acts(view) for stage in ("outlier", "mistiming") for _, acts in self._each(stage, parameters)]

    def shares(self, hidden: Tensor) -> dict[str, Tensor]:
        """Of all hidden states (..., H), which stand in the order of :attr:`hidden`, each effect's, by its key."""
        sizes = [effect.states for effect in self.hidden]
        return dict(zip((effect.key for effect in self.hidden), hidden.split(sizes, -1), strict=True))

    def sites(
        self, parameters: Mapping[str, Tensor], dynamics: Dynamics, q: Tensor, hidden: Tensor, body: Any
    ) -> Tensor:
        """The S sites, or what is seen as them, in hidden states (..., H): (..., S, d) m."""
        if not self.hidden:
            return dynamics.keypoints(q, body)
        own, hinge = self.shares(hidden), self.hinge
        if hinge is None:
            points = dynamics.keypoints(q, body)
        else:
            points = hinge.tips(own_values(hinge, parameters), q, own[hinge.key], body)
        for follower in self.followers:
            points = follower.shown(points, own[follower.key])
        return points


def moves_body(effect: Effect) -> bool:
    """Whether an effect has a part in how the body moves, a hidden state's motion included."""
    return isinstance(effect, Hidden) or any(stage in MOTION for stage in stages_of(effect))


def own_values(effect: Effect, parameters: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """An effect's own parameters by their own names."""
    return _beginning(f"{PREFIX}{effect.key}.", parameters)


def _beginning(prefix: str, parameters: Mapping[str, Tensor]) -> dict[str, Tensor]:
    return {name.removeprefix(prefix): value for name, value in parameters.items() if name.startswith(prefix)}
