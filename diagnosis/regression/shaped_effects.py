"""Effects that torque is linear in once a shape is fixed, as columns along a smoothed motion.

Stribeck's friction is linear in its two levels for a given speed of the change. Of a shape ψ the columns are made for a
few values, and that is taken with which they explain most (variable projection: Golub & Pereyra 1973). A number λ that
is a shape itself, as a delay, has the column τ(λ)/λ. Of an effect that has a shape alone, as a motor's limit, the
column is its whole torque, and the coefficient the share of it that is there. An effect of the catalogue asks, by its
own stages (:mod:`invdyn.models.effects.base`), for the torque

    τ = −f + L E[sgn q̇] + I q̈ − (u' − u) + τ_file(q', q̇, q̈; body') − τ_file(q, q̇, q̈; body)

of forces f, friction's level L, inertias I, commands u, and angles q' of a joint whose encoder shows q. Which value is
taken: :mod:`.shape_profile`.

A motor's law that bends, as a limit's, has another mean where u is noisy. It is that of the command which is expected,

    E[u] = w u + (1 − w) τ_file,     w = min(1, (s² + v)/d²)        (reliability: Carroll et al. 2006, ch. 3)

with d the rms of u − τ_file, s that of its part in frequencies that the motion tells of, and v the variance of τ_file
for what the smoother does not know of q̈. Rows that bend for their noise alone would explain it in what is missing.

Shapes: R rows, K joints, n columns of an effect. Units: rad, s, N·m.
"""

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch
from pyro.distributions import HalfNormal
from torch import Tensor

from invdyn.diagnosis.catalogue import CATALOGUE, CatalogueEntry
from invdyn.diagnosis.catalogue.linear_laws import INERTIAL, JOINT_KINDS
from invdyn.diagnosis.regression.low_pass import cutoff_of, low_passed
from invdyn.diagnosis.regression.measured_motion import MeasuredMotion, limited
from invdyn.diagnosis.regression.regressors import filed_torques
from invdyn.diagnosis.rules import FIXED
from invdyn.models.dynamics.interface import Dynamics
from invdyn.models.dynamics.registry import dynamics_for
from invdyn.models.effects.base import MOTION, Effect, Parameter, Scale, Situation, stages_of
from invdyn.models.effects.command import Command
from invdyn.models.effects.hidden import Hidden

KNOWN = {*MOTION, "angles", "late", "settling"} - {"pull", "interval"}
"""Stages whose torque a motion tells."""
SHARE = Parameter("share", "1", HalfNormal(1.0))
"""Of an effect that has a shape alone: 1 where it is there."""


@dataclass(frozen=True)
class Shaped:
    """An effect, its first joint, its parameters that have columns, and the one that gives their shape."""

    effect: Effect
    joint: int
    sizes: tuple[Parameter, ...]
    shape: Parameter
    entry: CatalogueEntry

    @property
    def key(self) -> tuple[str, str]:
        """Effect and place."""
        return self.effect.name, ".".join(self.effect.where)

    @property
    def is_size(self) -> bool:
        """Whether its shape is the number that has the column, as a delay's."""
        return self.shape in self.sizes

    @property
    def grid(self) -> tuple[float, ...]:
        """Values of the shape that are tried first."""
        return self.shape.grid or (float(self.shape.prior.stddev),)

    def near(self, value: float) -> np.ndarray:
        """A fine grid of the shape about a value, by a factor where it has one sign."""
        grid, step = np.sort(self.grid), np.linspace(-1.0, 1.0, FIXED.shape_grid)
        if grid[0] > 0:
            fine = value * FIXED.near_shape**step
        else:
            fine = value + np.interp(value, grid, np.gradient(grid)) * step
        return np.clip(fine, grid[0], grid[-1])

    @property
    def of_command(self) -> bool:
        """Whether it changes what is commanded."""
        return hasattr(self.effect, "command")


@dataclass(frozen=True)
class Shape:
    """A value of a shape, its standard deviation, its 90 % interval, and how many were tried."""

    value: float
    count: int
    sd: float = 0.0
    interval_90: tuple[float, float] = (0.0, 0.0)


def shaped_effects(
    body: Any, motion: MeasuredMotion, passive: bool, without: Collection[str] = ()
) -> tuple[Shaped, ...]:
    """Effects of the catalogue at joints, pairs of them and stops, whose torque a motion and one shape tell."""
    scale = scale_of(body, motion)
    found = []
    for entry, effect in CATALOGUE.without([*JOINT_KINDS, INERTIAL, *without]).everywhere(body, []):
        if (
            effect.site not in ("joint", "pair", "stop")
            or not effect.place
            or isinstance(effect, Hidden)
            or effect.form
        ):
            continue
        servo, needs = body.joint_parts[effect.place[0]].servo is not None, entry.need_of(effect)
        if {*stages_of(effect)} - KNOWN or (needs and passive) or (needs == "torque" and servo):
            continue
        every = effect.parameters(scale)
        sizes = tuple(each for each in every if each.absent == 0.0)
        shapes = [each for each in every if each.absent != 0.0] or [each for each in sizes if len(sizes) == 1]
        if len(shapes) == 1 and shapes[0].absent in ((None, 0.0) if sizes else (math.inf,)):
            found.append(Shaped(effect, effect.place[0], sizes or (SHARE,), shapes[0], entry))
    return tuple(found)


def scale_of(body: Any, motion: MeasuredMotion) -> Scale:
    """What is large for a body that moves like this."""
    speed = torch.as_tensor(np.sqrt((motion.qd**2).mean(0)))
    seen = torch.as_tensor(np.stack([motion.q.min(0), motion.q.max(0)], -1))
    time, command = torch.as_tensor(motion.time), torch.as_tensor(motion.torque)
    return Scale(dynamics_for(body), body.parameters(), time, command, speed, seen, body.joint_parts)


def lowest(parameter: Parameter) -> float:
    """The smallest value that its prior has."""
    bound = getattr(parameter.prior.support, "lower_bound", -math.inf)
    return max(parameter.least, float(bound))


class Along:
    """A motion as effects know it, with the sign (R, K) that its velocities are expected to have."""

    def __init__(self, body: Any, dynamics: Dynamics, motion: MeasuredMotion, sign: np.ndarray):
        self.body, self.dynamics, self.motion, self.numbers = body, dynamics, motion, body.parameters()
        self.q, self.qd, self.qdd = (torch.as_tensor(each) for each in (motion.q, motion.qd, motion.qdd))
        self.sign = torch.as_tensor(sign)

    @cached_property
    def now(self) -> Situation:
        """All rows as one moment each."""
        time = torch.as_tensor(self.motion.time)[:, None]
        step = torch.full_like(time, float(np.median(np.diff(self.motion.time))))
        # motors as the links need them, as for a gain: what was given has all that is missing, and would imitate it
        return Situation(self.q, self.qd, self.required, time, time - time[0], step, self.numbers, self.dynamics)

    @cached_property
    def command(self) -> Command:
        """What was commanded, constant in a row."""
        time = self.motion.time
        edges = np.concatenate([1.5 * time[:1] - 0.5 * time[1:2], (time[1:] + time[:-1]) / 2])
        return Command.held(torch.as_tensor(edges), torch.as_tensor(self.motion.command))

    @cached_property
    def expected_command(self) -> Command:
        """E[u] of the top of the file; v by a draw of signs, as errors of joints have."""
        u, signs = self.command.mean, np.random.default_rng(0).choice((-1.0, 1.0), self.q.shape)
        filed, other = (self.filed(qdd) for qdd in (self.qdd, self.qdd + torch.as_tensor(signs * self.motion.qdd_sd)))
        slow = torch.as_tensor(low_passed((u - filed).numpy(), self.motion, cutoff_of(self.motion)))
        share = (slow**2 + (other - filed) ** 2).mean(0) / ((u - filed) ** 2).mean(0).clamp_min(1e-300)
        return replace(self.command, mean=filed + share.clamp_max(1.0) * (u - filed))

    def filed(self, qdd: Tensor) -> Tensor:
        """What the file's links and joints ask for, (R, K)."""
        links = self.dynamics.inverse(self.q, self.qd, qdd, self.numbers)
        return links + torch.stack(filed_torques(self.body, self.q, self.qd, qdd, self.sign), -1)

    @cached_property
    def required(self) -> Tensor:
        """What links ask for, (R, K)."""
        return self.dynamics.inverse(self.q, self.qd, self.qdd, self.numbers)

    def columns(self, shaped: Shaped, value: float) -> list[Tensor]:
        """Torque (R, K) that each of an effect's sizes asks for, by its unit, with the shape at a ``value``."""
        fixed = {} if shaped.is_size else {shaped.shape.name: value}
        found = []
        for mine in shaped.sizes:
            size = 1.0 if fixed else value
            numbers = {each.name: 0.0 for each in shaped.sizes} | {mine.name: size} | fixed
            p = {name: torch.tensor([each], dtype=torch.float64) for name, each in numbers.items()}
            asked = self.asked(shaped.effect, p)
            shows = asked.abs().amax(0) > FIXED.negligible * self.required.abs().max()
            found.append(torch.where(shows, asked / size, 0.0))
        return found

    def asked(self, effect: Any, p: Mapping[str, Tensor]) -> Tensor:
        """Τ (R, K) of the top of the file."""
        K, now = self.q.shape[-1], self.now
        total = torch.zeros_like(self.q)
        if hasattr(effect, "command"):
            command = self.command if hasattr(effect, "late") else self.expected_command
            more = (effect.command(p, command).mean - command.mean).numpy()
            wanted, within = self.motion.demanded - self.motion.servo_drag, self.motion.within
            given = limited(self.body, wanted + more, within) - limited(self.body, wanted, within)
            total = total - torch.as_tensor(given)
        if hasattr(effect, "force"):
            total = total - effect.force(p, now)
        if hasattr(effect, "friction"):
            total = total + now.at(effect.place[0], effect.friction(p, now).expand(len(self.q), 1)) * self.sign
        if hasattr(effect, "inertia"):
            total = total + effect.inertia(p, K) * self.qdd
        if hasattr(effect, "body") or hasattr(effect, "angles"):
            q, numbers = self.q, self.numbers
            if hasattr(effect, "angles"):  # a servo follows what the encoder shows, and so do the rows
                q = 2 * q - effect.angles(p, SimpleNamespace(angles=q))
            if hasattr(effect, "body"):
                numbers = effect.body(p, numbers)
            total = total + self.dynamics.inverse(q, self.qd, self.qdd, numbers) - self.required
        return total


def sizes_of(Z: np.ndarray, unit: np.ndarray) -> np.ndarray:
    """Sds (n,) of a prior of columns (n, R, K) that ask for as much as is usual, ``unit`` (K,) N·m, at one joint."""
    most = (np.sqrt((Z**2).mean(1)) / unit).max(-1)
    return np.asarray(1 / np.maximum(most, 1e-12))
