"""What a file does not say of its body, how well it is known, as a part of the torques' uncertainty.

Where the motion is observed and the torque is not, the torque follows from the motion and the body's numbers φ,

    τ(φ) = D(q; φ) q̈ + h(q, q̇; φ) + c(q; φ),

with masses, centres of mass, moments and the direction of gravity in φ. The motion tells none of them: twice the mass
moves equally under twice the torque. What the torque's prior prefers is no knowledge of the body, so the posterior of φ
is cut off from it and stays its prior (M. Plummer, "Cuts in Bayesian graphical models", Statistics and Computing 25,
2015). Each draw of a path has a draw of φ of its own, and the torque

    τ + τ(φ) − τ(φ̄) + o + f tanh(θ̇/v) + b θ̇ + a θ̈,

whose last terms are what joints have besides the body: friction, cables, the zero of a sensor, and what the file's own
damping, dry friction and rotor are off by. They may have either sign, so that the mean stays the net torque. τ(φ) is
linear in m, m c and the moments about the joint (C. Atkeson, C. An and J. Hollerbach, "Estimation of inertial
parameters of manipulator loads and links", IJRR 5, 1986). The error lasts as long as the recording. Bodies whose file
states an uncertainty are integrated out as any parameters are instead (:mod:`.parameter_draws`), as is right where φ
has a part in the motion: commands that are known, or lengths before keypoints.

    m ~ LogNormal of relative sd `MASS`              c ~ N(c̄, (`CENTRE` s)²) along each axis, s a link's size
    moments all times LogNormal of sd `MOMENT`       g rotated by N(0, `LEVEL`²) about each level axis
    o, f ~ N(0, (`JOINT` S)²)
    file's damping, dry friction and rotor all times LogNormal of relative sd `FILED`, the difference in b, f and a

with S the weight of the joint's own link times its size: a link and its bearing, or motor, are as large. A joint of a
frame without mass has the largest S of those on it.

The sds are those that torque sensors bear out. In a regression of three robots' sensors on these changes all have most
evidence at a `JOINT` of .03 or a little more, and of the body's sds the best of the robots at these, the others at
larger ones (`benchmarks/what_is_off.py --scales`). Wider ones hold more rows, but by less than they are wider
(interval score of `benchmarks/against_sensors.py`).

Shapes: M chains, R draws, T rows, K joints, L links. Units: kg, m, kg·m², rad.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from invdyn.inference.posterior.problem import DRAWS, Contents
from invdyn.models import ArmModel, Body
from invdyn.models.bodies.scalars import prior
from invdyn.models.effects.disturbances import GravityTilt
from invdyn.models.effects.inertias import inertia_of, size_of, with_inertia

MASS, MOMENT = 0.05, 0.1
"""Relative sds. Policies for real robots are trained under more: J. Tan and others (RSS 2018) vary masses by 20 % and
inertias by 50 %, uniformly, which are sds of 12 and 29 %.
"""
CENTRE = 0.05
"""Of a link's size: one to two centimetres of an arm's link."""
LEVEL = 0.0175
"""rad, one degree: how far from level a bench, or the frame of a laboratory, is."""
JOINT = 0.03
"""Of a link's weight times its size."""
FILED = 1.0
"""Relative sd of a joint's damping, dry friction and rotor, which few have measured and simulations need for their own
sake. X. B. Peng and others (ICRA 2018) vary damping from .2 to 20 times.
"""
SLOW, GRAVITY = 0.05, 9.81
"""v, rad/s (m/s of a slide), below which dry friction is not full; m/s²."""
CHANGED = ("mass", "com", "inertia", "gravity")
OF_JOINTS = {
    "torque_offset": "N·m",
    "dry_friction": "N·m",
    "viscous_friction": "N·m·s/rad",
    "rotor_inertia": "kg·m²",
}
"""Variables o, f, b and a of a posterior, with their units where lengths are metres."""
NOTE = (
    "torques are net, what moves the links of the body's file: a geared motor's current, or a sensor before a tool, "
    "shows that motor's friction, or the tool's weight, besides: `load` in the body's file adds a tool, whose mass "
    "may be uncertain (docs/how-to/masses.md). The file does not say how well its numbers are known: the bands count "
    f"masses and moments as known to {MASS:.0%}, centres of mass to {CENTRE:.0%} of a link's size, level to 1°, and "
    f"what joints take besides, as by friction, to {JOINT:.0%} of a link's weight times its size; damping, dry "
    f"friction and rotors that it has, to {FILED:.0%} (--set exact_body=yes: all are exact)"
)


def is_doubted(model: ArmModel) -> bool:
    """Whether a body of unknown torque has numbers without a stated certainty."""
    body = model.body
    if not isinstance(body, Body) or model.command is not None:
        return False
    return not (body.exact or body.uncertainty or body.has_priors)


def drawn(model: ArmModel, shape: tuple[int, ...]) -> Any:
    """Draws of the body's numbers, each (*shape, own), by torch's global generator."""
    numbers = model.body_parameters()

    def factor(sd: float, like: Tensor) -> Tensor:
        return prior(1.0, sd).sample((*shape, *like.shape)).to(like)

    sizes = torch.tensor([size_of(numbers, link) for link in range(len(model.body.link_names))]).to(numbers.com)
    if numbers.com.ndim > 1:
        sizes = sizes.unsqueeze(-1)
    moments = factor(MOMENT, numbers.mass)
    if numbers.inertia.ndim > 1:
        moments = moments.unsqueeze(-1)
    changed = numbers._replace(
        mass=numbers.mass * factor(MASS, numbers.mass),
        com=numbers.com + CENTRE * sizes * torch.randn(*shape, *numbers.com.shape).to(numbers.com),
        inertia=numbers.inertia * moments,
        gravity=numbers.gravity.expand(*shape, -1),
    )
    for place, link in enumerate(model.body.links if isinstance(model.body, Body) else ()):
        if link.load is not None:
            mass, at = link.load
            own = inertia_of(changed, place)
            where = torch.zeros_like(own.com)
            where[..., : len(at)] = own.com.new_tensor(at)
            more = (mass.sample((*shape, 1)) - mass.mean).to(own.com)
            changed = with_inertia(changed, place, own.loaded(more, where))
    if not bool(numbers.gravity.any()):
        return changed
    tilt = GravityTilt().bound(model.body)
    angles = {each.name: LEVEL * torch.randn(*shape, 1).to(numbers.mass) for each in tilt.parameters(model.scale)}
    return tilt.body(angles, changed)


def joint_weights(model: ArmModel) -> Tensor:
    """S of each joint, (K,) N·m, or N of a slide; see the top."""
    body, numbers = model.body, model.body_parameters()
    assert isinstance(body, Body)  # the only one with links to doubt
    weight = GRAVITY * numbers.mass
    lever = torch.stack([weight[link] * size_of(numbers, link) for link in range(len(body.links))])
    own = torch.stack([lever, weight], -1)
    for link, parent in reversed(list(enumerate(body.parents))):
        if parent >= 0 and not numbers.mass[parent]:
            own[parent] = torch.maximum(own[parent], own[link])
    places = [(body.links.index(link), int(not motion.turns)) for link, motion in body.motions()]
    return torch.stack([own[place] for place in places])


def drawn_joints(model: ArmModel, shape: tuple[int, ...]) -> dict[str, Tensor]:
    """Draws of what joints have besides the body, o, f, b and a by name, each (*shape, K); see :data:`OF_JOINTS`."""
    size = joint_weights(model)
    offset, friction = (JOINT * size * torch.randn(*shape, len(size)).to(size) for _ in range(2))

    def off(part: str) -> Tensor:
        if f"body.{part}" not in model.parameters:
            return torch.zeros_like(offset)
        return model.parameters[f"body.{part}"] * (prior(1.0, FILED).sample(offset.shape) - 1).to(size)

    return dict(zip(OF_JOINTS, (offset, friction + off("friction"), off("damping"), off("armature")), strict=True))


def joint_losses(joints: Mapping[str, Tensor], velocity: Tensor) -> Tensor:
    """Return o + f tanh(θ̇/v) + b θ̇ (..., K) of numbers (..., K) at velocities (..., K)."""
    offset, friction, damping, _ = (joints[name] for name in OF_JOINTS)
    return offset + friction * torch.tanh(velocity / SLOW) + damping * velocity


def with_doubted_body(contents: Contents, model: ArmModel, paths: Tensor) -> Contents:
    """The contents of a posterior with torques of bodies that may differ from the file.

    Args:
        contents: of the body as its file has it, whose ``posterior`` is changed: "torque" is that of a drawn body,
            "stated_torque" that of the file's. The numbers that differ between draws become variables, joints' own
            as those of :data:`OF_JOINTS`.
        model: of the arm, in float64.
        paths: (M, R, T, D) draws of the states.
    """
    nominal, other = model.body_parameters(), drawn(model, tuple(paths.shape[:2]))
    _, q, qd = model.split(paths)
    qdd = model.acceleration(paths, torch.arange(paths.shape[-2]), nominal)
    joints = drawn_joints(model, tuple(paths.shape[:2]))
    # One body for all rows of a draw; what does not differ between draws broadcasts as it is.
    wide = other._replace(**{name: getattr(other, name).unsqueeze(2) for name in CHANGED})
    q, qd, qdd = (each.contiguous() for each in torch.broadcast_tensors(q, qd, qdd))
    change = model.dynamics.inverse(q, qd, qdd, wide) - model.dynamics.inverse(q, qd, qdd, nominal)
    if (moved := model.base_motion(paths)) is not None:  # gravity is then g − b̈
        felt = moved[2].contiguous()
        change = change - model.dynamics.uniform_load(q, felt, wide) + model.dynamics.uniform_load(q, felt, nominal)
    taken = {name: value.unsqueeze(2) for name, value in joints.items()}
    change = change + joint_losses(taken, qd) + taken["rotor_inertia"] * qdd
    dims, torque = contents.posterior["torque"]
    posterior = contents.posterior | {"torque": (dims, torque + change), "stated_torque": (dims, torque)}
    for name, (own, _) in model.body.described(nominal).items():
        if name in CHANGED:
            posterior[name] = [*DRAWS, *own], getattr(other, name)
    posterior |= {name: ([*DRAWS, "joint"], value) for name, value in joints.items()}
    torque_unit = contents.units["torque"]
    units = contents.units | OF_JOINTS | dict.fromkeys(("stated_torque", "torque_offset", "dry_friction"), torque_unit)
    attributes = contents.attributes | {"body_doubt": NOTE}
    return replace(contents, posterior=posterior, units=units, attributes=attributes)
