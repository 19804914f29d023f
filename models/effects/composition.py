"""Several effects on one arm: their hooks, one after the other."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import reduce
from typing import Any

import torch
from torch import Tensor

from invdyn.models.dynamics.interface import Dynamics
from invdyn.models.effects.base import Effect, Values
from invdyn.models.effects.bristles import BristleFriction
from invdyn.models.effects.command import Command
from invdyn.models.effects.dry_friction import dry_friction
from invdyn.models.effects.effect_context import Situation
from invdyn.models.effects.hidden import Follower, Hidden, HiddenHinge
from invdyn.models.observation.tracker_errors import Outlier, Shift, Swap
from invdyn.models.observation.view import View

PARTS = 8
"""Of a row, each with a line of its own, where a lagging command is changed further."""


class NotTogether(ValueError):
    """Effects that no model has at once."""


class Composition:
    """Bound effects and the parameters that a model has for them.

    Args:
        effects: in any order; hooks run by :attr:`Effect.order`.
        filed: parts of the simulation itself, which act as effects do and are none: they come first, and iterating
            over a composition leaves them out.

    Raises NotTogether for an effect twice at a place, and for two whose hidden states move the arm.
    """

    def __init__(self, effects: tuple[Effect, ...] = (), filed: tuple[Effect, ...] = ()):
        keys = [effect.key for effect in effects]
        if twice := {key for key in keys if keys.count(key) > 1}:
            raise NotTogether(f"expected each effect once at a place, got {', '.join(sorted(twice))} twice")
        self.effects, self.filed = tuple(sorted(effects, key=lambda effect: effect.order)), filed
        effects = self._acting = tuple(sorted((*filed, *effects), key=lambda effect: effect.order))
        self.has_force = any(type(effect).force is not Effect.force for effect in effects)
        self.has_servo = any(effect.drives for effect in effects)
        self.yields = any(effect.yields for effect in effects)
        self.pulls = any(effect.pulls for effect in effects)
        self.longest = min((effect.longest for effect in effects), default=math.inf)
        self.abrupt = self.longest < math.inf
        self.has_friction = any(type(effect).friction is not Effect.friction for effect in effects)
        self.has_changing_friction = self.has_friction and any(
            type(effect).friction is not Effect.friction and not effect.steady for effect in effects
        )
        commanding = [effect for effect in effects if type(effect).command is not Effect.command]
        self.has_command = bool(commanding)
        self.has_late = any(type(effect).late is not Effect.late for effect in effects)
        # What one makes of a row is a curve, which another may cut within the row.
        self.parts = PARTS if self.has_late and len(commanding) > 1 else 1
        has_points = any(type(effect).points is not Effect.points for effect in effects)
        has_angles = any(type(effect).angles is not Effect.angles for effect in effects)
        self.has_noise = any(type(effect).noise is not Effect.noise for effect in effects)
        has_mistakes = any(type(effect).mistake is not Effect.mistake for effect in effects)
        self.seen = has_points or has_angles or self.has_noise or has_mistakes
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

    def _each(self, parameters: Mapping[str, Tensor]) -> Iterator[tuple[Effect, Values]]:
        for effect in self._acting:
            yield effect, own_values(effect, parameters)

    def body(self, parameters: Mapping[str, Tensor], body: Any) -> Any:
        """The body's numbers as all effects leave them."""
        for effect, p in self._each(parameters):
            body = effect.body(p, body)
        return body

    def command(self, parameters: Mapping[str, Tensor], command: Command) -> Command:
        """The command as all actuators make it; in shorter rows, where several do."""
        command = command if self.parts == 1 else command.split(self.parts)
        for effect, p in self._each(parameters):
            command = effect.command(p, command)
        return command

    def late(self, parameters: Mapping[str, Tensor], elapsed: Tensor, joints: int) -> Tensor:
        """Largest share of what motors were told before a recording that still acts after ``elapsed`` (..., 1) s."""
        shares = (effect.late(p, elapsed, joints) for effect, p in self._each(parameters))
        return reduce(torch.maximum, [share for share in shares if share is not None])

    def force(self, parameters: Mapping[str, Tensor], now: Situation) -> Tensor:
        """Sum of the generalised forces, (..., K) N·m; softer stops take what all other forces press into them."""
        total = torch.zeros_like(now.q)
        for last in (False, True) if self.yields else (False,):
            pressed = replace(now, motor=now.motor + total) if last else now
            forces = [effect.force(p, pressed) for effect, p in self._each(parameters) if effect.yields == last]
            total = sum((force for force in forces if force is not None), start=total)
        return total

    def driven(self, parameters: Mapping[str, Tensor], now: Situation) -> Situation:
        """The moment with all that motors give: a servo's answer to angle and velocity, too."""
        if not self.has_servo:
            return now
        answers = (effect.force(p, now) for effect, p in self._each(parameters) if effect.drives)
        return replace(now, motor=sum((each for each in answers if each is not None), start=now.motor))

    def pull(self, parameters: Mapping[str, Tensor], now: Situation) -> Tensor:
        """Of these forces those on points of the links."""
        forces = (effect.force(p, now) for effect, p in self._each(parameters) if effect.pulls)
        return sum((force for force in forces if force is not None), start=torch.zeros_like(now.q))

    def friction(
        self,
        parameters: Mapping[str, Tensor],
        now: Situation,
        torque: Tensor,
        own: Tensor | None,
        held: bool = False,
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Dry friction on all joints under the other torques (..., K) N·m; several effects at a joint add up.

        At the moment ``now``, or as it is to be ``held`` over the sub-step that begins there; what q, rad, is off by at
        its end then; and θ̈ at its beginning.
        """

        def levels(now: Situation) -> dict[int, Tensor]:
            found: dict[int, Tensor] = {}
            now = self.driven(parameters, now)
            for effect, p in self._each(parameters):
                level = effect.friction(p, now)
                if level is not None:
                    joint = effect.place[0]
                    found[joint] = found[joint] + level if joint in found else level
            return found

        def levels_at(q: Tensor, qd: Tensor) -> dict[int, Tensor]:
            return levels(replace(now, q=q, qd=qd))

        settling: dict[int, tuple[Tensor, Tensor]] = {}
        for effect, p in self._each(parameters):
            times = effect.settling(p)
            if times is not None:
                joint = effect.place[0]
                rest, creep = settling.get(joint, times)
                settling[joint] = torch.maximum(rest, times[0]), torch.maximum(creep, times[1])
        changing = held and self.has_changing_friction
        return dry_friction(levels(now), now, torque, own, levels_at if changing else None, settling, held)

    def inertia(self, parameters: Mapping[str, Tensor], joints: int) -> Tensor | None:
        """Sum of the joints' own inertias, (..., K) kg·m²; None where no effect has any."""
        each = (effect.inertia(p, joints) for effect, p in self._each(parameters))
        own = [inertia for inertia in each if inertia is not None]
        return sum(own[1:], start=own[0]) if own else None

    def interval(self, parameters: Mapping[str, Tensor], dt: Tensor) -> Tensor:
        """The time that a step really takes, s."""
        for effect, p in self._each(parameters):
            dt = effect.interval(p, dt)
        return dt

    def points(self, parameters: Mapping[str, Tensor], view: View) -> View:
        """The view with the points where the camera sees them."""
        for effect, p in self._each(parameters):
            view = view.seen_at(effect.points(p, view))
        return view

    def angles(self, parameters: Mapping[str, Tensor], view: View) -> Tensor:
        """What the encoders show, (..., K) rad."""
        for effect, p in self._each(parameters):
            if type(effect).angles is not Effect.angles:
                view = replace(view, angles=effect.angles(p, view))
        return view.angles

    def noise(self, parameters: Mapping[str, Tensor], view: View, sd: Tensor) -> Tensor:
        """Standard deviations of the tips' coordinates, (..., S, d) m."""
        for effect, p in self._each(parameters):
            sd = effect.noise(p, view, sd)
        return sd

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

    def mistakes(self, parameters: Mapping[str, Tensor], view: View) -> list[Outlier | Swap | Shift]:
        """What the tracker gets wrong now and then."""
        found = [effect.mistake(p, view) for effect, p in self._each(parameters)]
        return [mistake for mistake in found if mistake is not None]


def own_values(effect: Effect, parameters: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """An effect's own parameters by their own names."""
    start = effect.prefix
    return {name.removeprefix(start): value for name, value in parameters.items() if name.startswith(start)}
