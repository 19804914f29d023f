"""The motion to record next: the most informative one within a robot's limits.

Of all motions of :mod:`.trajectory`, which keep to ranges, speeds and accelerations, the one of most expected
information (:mod:`.information`) is looked for by Adam (Kingma & Ba 2015) from several random starts. A penalty keeps
torques and the points' space within theirs. In the end the motion is checked at a fine step. Where it exceeds a limit
all its swings are made smaller, together, until it does not.

Shapes: R rows, K joints, P columns. Units: s, rad, N·m, nats.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path as File
from typing import Any

import numpy as np
import torch

from invdyn.diagnosis.excite.information import KINDS, Column, Information, kinds_of
from invdyn.diagnosis.excite.limits import MotionLimits, motion_limits, with_joints
from invdyn.diagnosis.excite.trajectory import Coefficients, Family, Path
from invdyn.diagnosis.rules import FIXED
from invdyn.models import Body
from invdyn.recordings import InputError

Report = Callable[[int, int], None]


@dataclass(frozen=True)
class Excitation:
    """A motion to record, and what it will tell.

    Attributes:
        joints: names of the K coordinates.
        time, angle, velocity, acceleration: (R,) s; (R, K) rad, rad/s, rad/s², in the robot file's own angles.
        torque: (R, K) N·m that the file's robot needs.
        columns, sds: (P,) numbers, and their expected posterior sds.
        nats: expected information about the question; `usual` the same of a random motion within the limits.
        assumed: limits that were not given.
    """

    joints: tuple[str, ...]
    time: np.ndarray
    angle: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    torque: np.ndarray
    columns: tuple[Column, ...]
    sds: np.ndarray
    nats: float
    usual: float
    assumed: tuple[str, ...] = ()

    @cached_property
    def hidden(self) -> tuple[Column, ...]:
        """Numbers of which the motion tells little: they stay as uncertain as they are."""
        pairs = zip(self.columns, self.sds, strict=True)
        return tuple(column for column, sd in pairs if sd > FIXED.excite_min_sd * column.size)

    def to_json(self) -> dict[str, Any]:
        """What it will tell, as a JSON file has it."""
        pairs = zip(self.columns, self.sds, strict=True)
        tells = [
            {
                "effect": c.effect,
                "place": c.place,
                "parameter": c.name,
                "unit": c.unit,
                "sd": float(sd),
                "prior_sd": c.size,
            }
            for c, sd in pairs
        ]
        return {"nats": self.nats, "random_motion_nats": self.usual, "numbers": tells, "assumed": list(self.assumed)}


def design_motion(
    body: Body,
    robot: str | File | None = None,
    *,
    limits: str | File | MotionLimits | None = None,
    joints: Sequence[str] = (),
    about: Sequence[str] = (),
    seconds: float = 20.0,
    noise: float | None = None,
    starts: int = 2,
    seed: int = 0,
    report: Report | None = None,
) -> Excitation:
    """Design a motion that tells most of what the file of a robot may lack.

    Args:
        body: the robot as its file has it.
        robot: that file, for the joints' ranges.
        limits: a table of limits (:mod:`.limits`), or the limits.
        joints: those that move, all by default; the others stand in the middle of their ranges.
        about: effects in question, such as "coulomb_friction"; all that torque is linear in by default.
        seconds: how long.
        noise: of a torque, N·m; by default a fiftieth of each joint's load.
        starts: searches from different random motions.
        seed: same seed, same motion.
        report: called with (steps done, all).

    Raises InputError for an unknown joint or effect, a duration under 2 s, a noise of 0, and limits that even the robot
    at rest exceeds.
    """
    if not 2.0 <= seconds <= 3600.0:
        raise InputError(f"expected a motion of 2 to 3,600 s, got {seconds:g}")
    if strange := [name for name in joints if name not in body.joint_names]:
        raise InputError(f"unknown joint {strange[0]!r}: expected some of {', '.join(body.joint_names)}")
    if strange := [name for name in about if not kinds_of([name])]:
        raise InputError(f"expected effects among {', '.join(KINDS)}, got {strange[0]!r}")
    if noise is not None and not noise > 0:
        raise InputError(f"expected a noise of torques above 0 N·m, got {noise:g}")
    within = limits if isinstance(limits, MotionLimits) else motion_limits(body, robot, limits, joints)
    moving = np.array([not joints or name in joints for name in body.joint_names])
    family = Family(with_joints(within, moving), seconds, FIXED.excite_search_rate)
    information = Information(body, within, kinds_of(about), noise)
    generator = torch.Generator().manual_seed(seed)
    found = []
    for start in range(max(1, starts)):

        def step(done: int, start: int = start) -> None:
            if report is not None:
                report(start * FIXED.excite_steps + done, max(1, starts) * FIXED.excite_steps)

        began = family.start(generator)
        found.append((_improved(information, family, began, step), began))
    kept = [_kept(information, family, best) for best, _ in found]
    values = [_nats(information, family, each) for each in kept]
    best = kept[int(np.argmax(values))]
    usual = _nats(information, family, _kept(information, family, found[0][1]))
    return _design(body, information, family, best, max(values), usual, within.assumed)


def _improved(
    information: Information, family: Family, start: Coefficients, step: Callable[[int], None]
) -> Coefficients:
    """The best of the coefficients that a search from ``start`` meets."""
    free = [each.clone().requires_grad_() for each in start]
    optimiser = torch.optim.Adam(free, lr=FIXED.excite_rate)
    best, most = start, -np.inf
    for done in range(FIXED.excite_steps):
        path = family.path(Coefficients(*free))
        value = information.nats(information.precision(path, family.seconds))
        value = value - FIXED.excite_penalty * _excess(information, family, path).square().mean()
        if value.item() > most:
            best, most = Coefficients(*(each.detach().clone() for each in free)), value.item()
        optimiser.zero_grad()
        (-value).backward()
        optimiser.step()
        step(done + 1)
    return best


def _excess(information: Information, family: Family, path: Path) -> torch.Tensor:
    """How far torques and points are beyond their limits, (R, ·) in limits and in tenths of a metre; 0 within."""
    limits = family.limits
    torque = torch.as_tensor(limits.torque)
    over = (information.torque(path).abs() / torque - 1).clamp_min(0)
    if not np.isfinite(limits.space).any():
        return over
    low, high = torch.as_tensor(limits.space).T
    points = information.dynamics.keypoints(path.q, information.numbers)
    outside = ((low - points).clamp_min(0) + (points - high).clamp_min(0)) / 0.1
    return torch.cat([over, outside.flatten(-2)], -1)


def _kept(information: Information, family: Family, of: Coefficients) -> Coefficients:
    """The motion with swings that keep to torques and space at a fine step."""
    fine = family.at(FIXED.excite_check_rate)
    with torch.no_grad():
        for _ in range(200):
            excess = _excess(information, fine, fine.path(of))
            if not bool((excess > 0).any()):
                return of
            of = family.scaled(of, FIXED.excite_shrink)
    number = int(excess.amax(0).argmax())
    names = information.joint_names
    what = f"the torque of joint '{names[number]}'" if number < len(names) else "the space of the body's points"
    raise InputError(f"{what} is beyond its limit even where the robot stands: widen the limit, or move the range")


@torch.no_grad()
def _nats(information: Information, family: Family, of: Coefficients) -> float:
    return information.nats(information.precision(family.path(of), family.seconds)).item()


@torch.no_grad()
def _design(
    body: Body,
    information: Information,
    family: Family,
    of: Coefficients,
    nats: float,
    usual: float,
    assumed: tuple[str, ...],
) -> Excitation:
    """The motion at a fine step, in the file's own angles."""
    fine = family.at(FIXED.excite_check_rate)
    path = fine.path(of)
    sds = information.sds(information.precision(path, fine.seconds))
    sign, zero = body.file_counting
    angle, velocity, acceleration = (each.numpy() for each in path)
    return Excitation(
        tuple(body.joint_names),
        fine.time.numpy(),
        sign * (angle - zero),
        sign * velocity,
        sign * acceleration,
        sign * information.torque(path).numpy(),
        tuple(information.columns),
        sds,
        nats,
        usual,
        assumed,
    )
