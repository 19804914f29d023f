"""An arm under other circumstances: with effects, other parameter values, a finer command, or several recordings.

Each method gives another :class:`.ArmModel`, and leaves the one that it is called on as it was.
"""

import copy
import math
from collections.abc import Sequence
from typing import Self

import torch
from torch import Tensor

from invdyn.models.effects.base import Effect
from invdyn.models.effects.command import Command
from invdyn.models.effects.composition import Composition
from invdyn.models.effects.hidden import Hidden
from invdyn.models.effects.parameters import check_tracked, parameters_of
from invdyn.models.effects.scale import Scale


class ArmVariants:
    """Variants of :class:`.ArmModel`, which has the body, clocks, command, effects and parameters used here."""

    @property
    def scale(self) -> Scale:
        """What is large and small for this body, which effects' priors follow."""
        command = None if self.command is None else self.command.cpu()
        return Scale(self.body.parameters(), self.time.cpu(), command, self._motion, self._range)

    def with_effects(self, *effects: Effect) -> Self:
        """The model of an arm that has these effects too: ``model.with_effects(ViscousFriction("elbow"))``.

        Their parameters are "effect.<effect>.<place>.<parameter>", of shape (1,), with priors, so that
        :meth:`sequence` draws them; until then they stand where the effect is absent (or, for those that are
        never absent, in the middle of their grid or prior).

        Hidden states (:mod:`.effects.hidden`) stand in the state before the angles, those of a hinge as
        (z, ψ, ψ̇, θ, θ̇), what moves the arm before what follows it, with the parameters "initial.hidden.<effect>" and
        "noise.hidden.<effect>", standard deviations (H,) of ψ, rad, and ψ̇, rad/s.

        Raises ValueError for places that the body does not have or nobody tracks, for an effect twice at one place,
        and for a second one with hidden states that move the arm.
        """
        bound = tuple(effect.bound(self.body) for effect in effects)
        other = self.replace()
        other.effects = Composition((*self.effects, *bound))
        if other.effects.abrupt:
            other._abrupt = math.ceil(self.dt.median().item() / other.effects.longest)
        starts, priors = parameters_of(bound, self.scale, self.dtype, self.device)
        other.parameters |= starts
        other.priors = {**self.priors, **priors}
        for effect in (each for each in bound if isinstance(each, Hidden)):
            spread = torch.tensor(effect.hidden_scale(self.scale), dtype=self.dtype, device=self.device)
            other.parameters[f"initial.hidden.{effect.key}"] = spread
            other.parameters[f"noise.hidden.{effect.key}"] = 1e-4 * spread
            other.state_dim += effect.states
        check_tracked(bound, [self.body.keypoint_names[k] for k in self.emission_model.tips])
        return other

    def replace(self, **values: Tensor) -> Self:
        """Other parameter values; see :meth:`StateSpaceModel.replace`."""
        other = super().replace(**values)
        other._motors = None
        if other.device != other.time.device:
            other._follow(other.device)
        return other

    def _follow(self, device: torch.device) -> None:
        """Move what rows need besides parameters to where these are: a row must not wait for the host."""
        clocks = (self.time, self._elapsed, self._since, self.dt)
        self.time, self._elapsed, self._since, self.dt = (clock.to(device) for clock in clocks)
        self._derived = {quantity: which.to(device) for quantity, which in self._derived.items()}
        self.emission_model = self.emission_model.to(device)
        if self.command is not None:
            self.command = self.command.to(device)
        if self._finer is not None:
            self._finer = self._finer.to(device)
        if self._anew is not None:
            self._anew = tuple(value.to(device) for value in self._anew)

    def driven_by(self, time: Tensor, torque: Tensor) -> Self:
        """The model under a command (C, K) N·m held between times (C,) s of its own, finer than the rows.

        ``command`` becomes its mean over each row. It may begin before the first row.
        """
        other = copy.copy(self)
        other._finer, other._motors = Command.held(time, torque).to(self.device), None
        other.command = other._finer.onto(self.time).mean
        other._since = self.time - time[0].to(self.time)
        return other

    def moving(self, speed: Tensor) -> Self:
        """The model of an arm whose joints' rms velocities (K,) rad/s are known, which effects' priors follow."""
        other = copy.copy(self)
        other._motion = speed.detach().cpu().double()
        return other

    def turning(self, lowest: Tensor, highest: Tensor) -> Self:
        """The model of an arm whose joints turn between two angles (K,) rad, where effects are looked for."""
        other = copy.copy(self)
        other._range = torch.stack([lowest, highest], -1).detach().cpu().double()
        return other

    def starting_anew(self, rows: Sequence[int], angle: Tensor) -> Self:
        """The model of several recordings one after another: at ``rows`` (R,) the arm starts anew.

        There the state does not follow from the row before, but is drawn as the first one is, with angles within
        about half a turn of ``angle`` (R, K) rad.
        """
        other = copy.copy(self)
        first = torch.zeros(self.num_steps, dtype=torch.bool)
        middle = torch.zeros(self.num_steps, self.body.num_joints, dtype=torch.float64)
        first[list(rows)], middle[list(rows)] = True, angle.double()
        other._anew = first.to(self.device), middle.to(self.device)
        began = torch.where(first.to(self.device), self.time, -torch.inf).cummax(0).values
        other._since = torch.minimum(self._since, self.time - began)
        return other
