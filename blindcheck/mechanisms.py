"""What makes reality differ, dynamics: each function installs one effect in a `World`, in MuJoCo's own terms.

Where MuJoCo has the effect, its own part plays it; else a force is applied at every step, or the command is changed
on its way to the motors. Joints, links and tips are counted from 0 at the base; SI units, radians.

    viscous, coulomb, drifting   dof_damping, dof_frictionloss, dof_damping rewritten every step
    stribeck, load friction      dof_frictionloss rewritten every step, so that sticking stays MuJoCo's own; Stribeck's
                                 also through bristles, applied (`softer`)
    stiffness, coupling          springs of joints, of a fixed tendon
    payload, inertial error      an inertial in place of the link's own
    backlash                     a rotor of its own inertia (taken from the link's, so that with no play
                                 nothing changes) and a second hinge with stops ±width/2
    link flexibility             the link cut at half its length, a sprung hinge between the halves
    base motion                  the frame of the base accelerates: gravity g − a_b(t), and all points move
"""

from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from invdyn.blindcheck.nonideal_mechanisms import bristles
from invdyn.blindcheck.simulator import Segment, World

ROTOR_SHARE = 0.5  # of a link's inertia about its centre of mass, when there is play between motor and link


def set_joint(world: World, joint: int, **attributes: Any) -> None:
    """Set attributes of the hinge that a joint's motor drives, as mjSpec calls them."""
    world.on_spec(lambda spec: set_part(spec.joint(world.segments[world.hinge(joint)].hinge), attributes))


def _motor(world: World, joint: int, **attributes: Any) -> None:
    world.on_spec(lambda spec: set_part(spec.actuator(world.segments[world.hinge(joint)].hinge), attributes))


def set_part(element: Any, attributes: dict) -> None:
    """Set attributes of a part of an MjSpec."""
    for name, value in attributes.items():
        if np.ndim(getattr(element, name)) == 1 and np.ndim(value) == 0:  # newer MuJoCos have polynomials here
            value = [value, *np.zeros(len(getattr(element, name)) - 1)]
        setattr(element, name, value)


def viscous_friction(world: World, joint: int, damping: float) -> None:
    """−b θ̇."""
    set_joint(world, joint, damping=damping)


def coulomb_friction(world: World, joint: int, torque: float) -> None:
    """−τc sgn θ̇, and up to ±τc at rest."""
    set_joint(world, joint, frictionloss=torque)


def stribeck_friction(
    world: World,
    joint: int,
    coulomb: float,
    static: float,
    velocity: float,
    bristle_stiffness: float | None = None,
    bristle_damping: float | None = None,
) -> None:
    """−(τc + (τs − τc) exp(−(θ̇/ωs)²)) sgn θ̇; through bristles, where they have a stiffness."""
    if bristle_stiffness is not None and bristle_damping is not None:
        return bristles(world, joint, coulomb, static, velocity, bristle_stiffness, bristle_damping)
    set_joint(world, joint, frictionloss=static)

    def act(t: float, model: Any, data: Any) -> None:
        h = world.hinge(joint)
        model.dof_frictionloss[h] = coulomb + (static - coulomb) * np.exp(-((data.qvel[h] / velocity) ** 2))

    world.on_step(act)


def load_friction(world: World, joint: int, coefficient: float) -> None:
    """−k |τ_motor − τ_external| sgn θ̇, with τ_external what gravity, Coriolis and centrifugal forces exert."""
    set_joint(world, joint, frictionloss=1e-9)

    def act(t: float, model: Any, data: Any) -> None:
        h = world.hinge(joint)
        # qfrc_bias is the load that the motor would have to carry: minus what they exert. One step old: ½ ms
        load = data.qfrc_actuator[h] + data.qfrc_bias[h]
        model.dof_frictionloss[h] = max(coefficient * abs(load), 1e-9)

    world.on_step(act)


def quadratic_drag(world: World, joint: int, drag: float) -> None:
    """−c θ̇ |θ̇|."""
    applied(world, joint, lambda t, q, qd: -drag * qd[joint] * abs(qd[joint]))


def joint_stiffness(world: World, joint: int, stiffness: float, rest_angle: float) -> None:
    """−k (θ − θ₀)."""
    set_joint(world, joint, stiffness=stiffness, springref=rest_angle)


def joint_coupling(world: World, joint: int, stiffness: float, ratio: float) -> None:
    """A spring on θᵢ − r θⱼ, with i the joint and j the one before it: on i, −k (θᵢ − r θⱼ);
    on j, r times the opposite.
    """

    def change(spec: Any) -> None:
        tendon = spec.add_tendon(name=f"coupling{joint}", springlength=[0.0, 0.0])
        set_part(tendon, {"stiffness": stiffness})
        tendon.wrap_joint(world.segments[world.hinge(joint)].hinge, 1.0)
        tendon.wrap_joint(world.segments[world.hinge(joint - 1)].hinge, -ratio)

    world.on_spec(change)


def joint_limit(world: World, joint: int, angle: float, stiffness: float, damping: float, side: float) -> None:
    """A spring-damper past θ_lim (side +1: above it, −1: below) that pushes and never pulls."""

    def torque(t: float, q: np.ndarray, qd: np.ndarray) -> float:
        depth = side * (q[joint] - angle)
        return -side * max(0.0, stiffness * depth + damping * side * qd[joint]) if depth > 0 else 0.0

    applied(world, joint, torque)


def payload(world: World, mass: float) -> None:
    """A point mass at the last tip."""
    last = world.segments[-1]
    total = last.mass + mass
    com = (last.mass * last.com + mass * last.length) / total
    last.inertia += last.mass * (last.com - com) ** 2 + mass * (last.length - com) ** 2
    last.mass, last.com = total, com


def inertial_error(world: World, link: int, mass: float, com: float, inertia: float) -> None:
    """One link's mass, centre of mass along it, and inertia about that, by so much more than its file says."""
    segment = next(s for s in world.segments if s.tip == link)
    segment.mass += mass
    segment.com += com
    segment.inertia += inertia


def gravity_tilt(world: World, angle: float) -> None:
    """Gravity turned counter-clockwise."""
    x, y, z = world.gravity
    world.gravity = np.array([np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y, z])


def armature(world: World, joint: int, inertia: float) -> None:
    """Iₐ θ̈ on the inertia matrix's diagonal."""
    set_joint(world, joint, armature=inertia)


def actuator_gain(world: World, joint: int, gain: float) -> None:
    """(1 + ε) u."""
    _motor(world, joint, gear=[1 + gain, 0, 0, 0, 0, 0])


def actuator_lag(world: World, joint: int, time_constant: float) -> None:
    """T u̇_f + u_f = u."""

    def change(spec: Any) -> None:
        motor = spec.actuator(world.segments[world.hinge(joint)].hinge)
        # not mjDYN_FILTEREXACT, whose decay over a step is exact without Runge–Kutta: with it, it decays twice, as a
        # time constant longer by half a step
        motor.dyntype = world.mujoco.mjtDyn.mjDYN_FILTER
        set_part(motor, {"dynprm": time_constant})

    world.on_spec(change)


def actuator_saturation(world: World, joint: int, limit: float) -> None:
    """Of the command u, clip(u, ±u_max)."""
    _motor(world, joint, forcerange=[-limit, limit], forcelimited=True)


def actuator_delay(world: World, joint: int, delay: float) -> None:
    """u(t − T), as a ring buffer of the steps' commands; before the first, the first."""
    ring: deque[float] = deque()

    def change(i: int, step: float, u: np.ndarray) -> np.ndarray:
        if i == 0:
            ring.clear()
        ring.append(u[joint])
        whole, part = divmod(delay / step, 1.0)
        if len(ring) > whole + 2:
            ring.popleft()
        # the mean over the step of what was held: a delay need not be a multiple of the step
        late = [ring[max(len(ring) - 1 - int(whole) - back, 0)] for back in (0, 1)]
        return np.where(np.arange(len(u)) == joint, (1 - part) * late[0] + part * late[1], u)

    world.on_command(change)


def actuator_deadzone(world: World, joint: int, width: float) -> None:
    """Of the command u, u − clip(u, ±d)."""
    world.on_command(lambda i, step, u: np.where(np.arange(len(u)) == joint, u - np.clip(u, -width, width), u))


def backlash(world: World, joint: int, width: float) -> None:
    """Play of so much in all between the motor, with a rotor's inertia, and the link."""
    place = world.hinge(joint)
    link = world.segments[place]
    rotor = ROTOR_SHARE * link.inertia
    # the rotor has mass 1e-9 of the link's, because MuJoCo lets no moving body have none
    motor = Segment(link.hinge, 0.0, 1e-9 * link.mass, 0.0, rotor, joint, None)
    link.hinge, link.driven, link.inertia = f"play{joint}", False, link.inertia - rotor
    world.segments.insert(place, motor)
    limits = {"limited": True, "range": [-width / 2, width / 2]}
    world.on_spec(lambda spec: set_part(spec.joint(f"play{joint}"), limits))


def torque_ripple(world: World, joint: int, amplitude: float, periods: float, phase: float) -> None:
    """A sin(N θ + φ)."""
    applied(world, joint, lambda t, q, qd: amplitude * np.sin(periods * q[joint] + phase))


def external_push(world: World, keypoint: int, force_x: float, force_y: float, start: float, stop: float) -> None:
    """A constant force at a tip during an interval, as `xfrc_applied` at the centre of mass and a torque about it."""

    def act(t: float, model: Any, data: Any) -> None:
        body = 1 + next(s for s, segment in enumerate(world.segments) if segment.tip == keypoint)
        # the share of this step that lies within the interval
        step = model.opt.timestep
        share = np.clip((min(stop, t + step) - max(start, t)) / step, 0.0, 1.0)
        segment = world.segments[body - 1]
        # kinematics of this very state: those in data are of the last step's beginning
        heading = np.cumsum(data.qpos)[body - 1]
        arm = (segment.length - segment.com) * np.array([np.cos(heading), np.sin(heading)])
        torque = arm[0] * force_y - arm[1] * force_x
        data.xfrc_applied[body] = share * np.array([force_x, force_y, 0.0, 0.0, 0.0, torque])

    world.on_step(act)


def base_motion(world: World, amplitude_x: float, amplitude_y: float, frequency: float, phase: float) -> None:
    """The base moves by (a_x, a_y) sin(2π f t + φ)."""
    amplitude, omega = np.array([amplitude_x, amplitude_y]), 2 * np.pi * frequency
    world.base_shift = lambda t: np.sin(omega * t + phase)[:, None] * amplitude

    def act(t: float, model: Any, data: Any) -> None:
        middle = t + model.opt.timestep / 2
        model.opt.gravity[:2] = world.gravity[:2] + omega**2 * amplitude * np.sin(omega * middle + phase)

    world.on_step(act)


def link_flexibility(world: World, link: int, stiffness: float, damping: float) -> None:
    """The link in two halves that together have its mass, centre and inertia, a sprung hinge at half its length."""
    place = next(s for s, segment in enumerate(world.segments) if segment.tip == link)
    whole = world.segments[place]
    # masses m/2 at com ± a leave I − m a² for the halves themselves; a uniform rod's halves have a = length/4
    apart = min(whole.length / 4, np.sqrt(0.8 * whole.inertia / whole.mass))
    rest = (whole.inertia - whole.mass * apart**2) / 2
    half, mass = whole.length / 2, whole.mass / 2
    inner = Segment(whole.hinge, half, mass, whole.com - apart, rest, whole.joint, None, whole.driven)
    outer = Segment(f"bend{link}", half, mass, whole.com + apart - half, rest, None, link, False)
    world.segments[place : place + 1] = [inner, outer]
    world.on_spec(lambda spec: set_part(spec.joint(f"bend{link}"), {"stiffness": stiffness, "damping": damping}))


def drifting_friction(world: World, joint: int, damping: float, slope: float) -> None:
    """−(b₀ + slope t) θ̇, never below 0."""
    set_joint(world, joint, damping=damping)

    def act(t: float, model: Any, data: Any) -> None:
        _damp(model, world.hinge(joint), max(damping + slope * t, 0.0))

    world.on_step(act)


def _damp(model: Any, hinge: int, damping: float) -> None:
    model.dof_damping[hinge] = damping


def applied(world: World, joint: int, torque: Callable[[float, np.ndarray, np.ndarray], float]) -> None:
    """Apply `torque(t, q, qd)`, N·m, at a joint; q and qd are those of the chain's joints (K,)."""

    def act(t: float, model: Any, data: Any) -> None:
        driven = [world.hinge(k) for k in range(world.num_joints)]
        # the force is held over the step, so it is taken at the middle, from the last acceleration
        half = model.opt.timestep / 2
        q, qd = data.qpos[driven] + half * data.qvel[driven], data.qvel[driven] + half * data.qacc[driven]
        data.qfrc_applied[driven[joint]] += torque(t + half, q, qd)

    world.on_step(act)


MECHANISMS = {
    function.__name__: function
    for function in (
        viscous_friction,
        coulomb_friction,
        stribeck_friction,
        load_friction,
        quadratic_drag,
        joint_stiffness,
        joint_coupling,
        joint_limit,
        payload,
        inertial_error,
        gravity_tilt,
        armature,
        actuator_gain,
        actuator_delay,
        actuator_lag,
        actuator_saturation,
        actuator_deadzone,
        backlash,
        torque_ripple,
        external_push,
        base_motion,
        link_flexibility,
        drifting_friction,
    )
}
"""Every dynamics effect of the catalogue by its name there."""
