"""Joints' parts out of a compiled MuJoCo model: passive forces of joints, and actuators that act on one joint alone.

A position servo of MuJoCo has gain kp and bias (0, −kp, −kv) on its length gear · q; at the joint it is one of
K = S = kp gear² and D = kv gear². Limits are those of the actuator's force, of its control (of a torque motor), and of
the joint's actuators together, whichever is narrower. :mod:`.body_mjcf_left_out` warns of what is left out.

Its integrators are of first order but for RK4 (Computation: numerical integration). Euler takes joints' damping at a
step's end and servos' at its beginning, "implicit" and "implicitfast" both at its end.

What a compiled MJCF switches off, and MuJoCo's warnings, which it else prints and writes to a log where it runs.

Off are what flags of its `<option>` and groups of actuators say (XML reference: flag).

    frictionloss, limit, constraint    dry friction and limits; a disabled constraint is without both, and equalities
    spring, damper                     passive forces of joints
    clampctrl                          limits of controls
    actuation, actuatorgroupdisable    all actuators, or those of some groups: they act on nothing

Gravity, contacts and the damping of Euler's steps are read where they are used.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np

from invdyn.models.bodies.joint_parts import NOTHING, JointParts, Motor


def read(mujoco: Any, model: Any, names: Sequence[str]) -> tuple[dict[str, JointParts], set[int]]:
    """Parts of hinges and slides, by the names of all joints, in the file's own angles; and their actuators."""
    found: dict[str, JointParts] = {}
    used: set[int] = set()
    for j, name in enumerate(names):
        if int(model.jnt_type[j]) not in (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)):
            continue  # an enum of MuJoCo's equals a number from one side alone
        dof = int(model.jnt_dofadr[j])
        own = actuators_of(mujoco, model, j)
        motor = None
        if len(own) == 1 and (motor := _motor(mujoco, model, own[0], j)) is not None:
            used.add(own[0])
        damping = _first(model.dof_damping[dof])
        step, late = _step(mujoco, model, damping, 0.0 if motor is None else motor.damping)
        parts = JointParts(
            damping=damping,
            friction=float(model.dof_frictionloss[dof]),
            armature=float(model.dof_armature[dof]),
            stiffness=_first(model.jnt_stiffness[j]),
            rest=float(model.qpos_spring[model.jnt_qposadr[j]]),
            motor=motor,
            step=step,
            late=late,
        )
        if parts.stiffness == 0:
            parts = replace(parts, rest=0.0)
        if parts != NOTHING:
            found[name] = parts
    return found, used


def joint_names(model: Any) -> list[str]:
    """Of all joints, in the file's order; one without a name is called by its number, from 1."""
    return [model.joint(j).name or f"joint{j + 1}" for j in range(model.njnt)]


def actuators_of(mujoco: Any, model: Any, joint: int) -> list[int]:
    """Numbers of the actuators that act on a joint, and on no tendon, site or body; none that is disabled."""
    through = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    kinds, targets = model.actuator_trntype, model.actuator_trnid[:, 0]
    return [
        a for a in range(model.nu) if int(kinds[a]) in through and int(targets[a]) == joint and acts(mujoco, model, a)
    ]


def _motor(mujoco: Any, model: Any, a: int, joint: int) -> Motor | None:
    """The motor that an actuator is at its joint; None for one with a law or dynamics of its own."""
    plain = model.actuator_gaintype[a] == mujoco.mjtGain.mjGAIN_FIXED
    bias_kind = int(model.actuator_biastype[a])
    known = bias_kind in (int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE))
    if not (plain and known and model.actuator_dyntype[a] == mujoco.mjtDyn.mjDYN_NONE):
        return None
    gear, gain = float(model.actuator_gear[a, 0]), float(model.actuator_gainprm[a, 0])
    affine = bias_kind == int(mujoco.mjtBias.mjBIAS_AFFINE)
    constant, stiff, slow = (float(x) for x in model.actuator_biasprm[a, :3]) if affine else (0.0, 0.0, 0.0)
    kind = "position" if stiff else "velocity" if slow else "torque"
    limits = []
    if model.actuator_forcelimited[a]:
        limits.append(sorted(gear * model.actuator_forcerange[a]))
    if model.jnt_actfrclimited[joint]:
        limits.append(list(model.jnt_actfrcrange[joint]))
    if kind == "torque" and model.actuator_ctrllimited[a]:
        limits.append(sorted(gear * gain * model.actuator_ctrlrange[a] + gear * constant))
    low, high = (np.max([x[0] for x in limits]), np.min([x[1] for x in limits])) if limits else (-np.inf, np.inf)
    return Motor(
        kind,
        1.0 if kind == "torque" else gain * gear**2,
        -stiff * gear**2 + 0.0,  # no −0
        -slow * gear**2 + 0.0,
        0.0 if kind == "torque" else constant * gear,
        float(low),
        float(high),
        gear,
    )


def _step(mujoco: Any, model: Any, damping: float, servo: float) -> tuple[float, float]:
    """The engine's first-order step, s, 0 of RK4; and a joint's dampers at its end less those at its beginning."""
    kind, option = int(model.opt.integrator), mujoco.mjtIntegrator
    if kind == int(option.mjINT_RK4):
        return 0.0, 0.0
    euler = kind == int(option.mjINT_EULER)
    explicit = euler and bool(model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_EULERDAMP)
    return float(model.opt.timestep), (-damping if explicit else damping) + (-servo if euler else servo)


def _first(value: Any) -> float:
    """A coefficient, or the first of several: newer MuJoCos have polynomials."""
    return float(np.ravel(value)[0])


def without_disabled(mujoco: Any, model: Any) -> list[str]:
    """Set to zero, in a compiled ``model``, what its flags switch off; gives words for what the file has of that."""
    bit, flags, off = mujoco.mjtDisableBit, int(model.opt.disableflags), list[str]()

    def disabled(*names: str) -> bool:
        return any(flags & int(getattr(bit, f"mjDSBL_{name}", 0)) for name in names)

    cleared = {
        "dry friction": (("FRICTIONLOSS", "CONSTRAINT"), ("dof_frictionloss", "tendon_frictionloss")),
        "limits of joints": (("LIMIT", "CONSTRAINT"), ("jnt_limited", "tendon_limited")),
        "springs": (("SPRING",), ("jnt_stiffness", "jnt_stiffnesspoly", "tendon_stiffness")),
        "damping": (("DAMPER",), ("dof_damping", "dof_dampingpoly", "tendon_damping")),
        "limits of controls": (("CLAMPCTRL",), ("actuator_ctrllimited",)),
    }
    for words, (names, attributes) in cleared.items():
        arrays = [np.asarray(getattr(model, each)) for each in attributes if hasattr(model, each)]
        if disabled(*names) and any(array.any() for array in arrays):
            off.append(words)
            for array in arrays:
                array[...] = 0
    dead = [a for a in range(model.nu) if not acts(mujoco, model, a)]
    if dead:
        off.append(f"actuators ({', '.join(model.actuator(a).name or f'number {a}' for a in dead)})")
    return off


def acts(mujoco: Any, model: Any, actuator: int) -> bool:
    """Whether an actuator does anything: neither all of them nor its group are switched off."""
    if int(model.opt.disableflags) & int(mujoco.mjtDisableBit.mjDSBL_ACTUATION):
        return False
    group = int(model.actuator_group[actuator])
    return not 0 <= group < 31 or not int(model.opt.disableactuator) >> group & 1


@contextmanager
def kept_warnings(mujoco: Any) -> Iterator[list[str]]:
    """A list that fills with what MuJoCo warns of, in the module ``mujoco``; what was there before takes over again."""
    before, said = mujoco.get_mju_user_warning(), list[str]()
    mujoco.set_mju_user_warning(said.append)
    try:
        yield said
    finally:
        mujoco.set_mju_user_warning(before)
