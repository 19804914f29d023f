"""What a compiled MuJoCo model has and rigid links lack, each with the names of the parts that have it.

A recording of that simulation differs from the body by these, so a diagnosis has to name them. An actuator's
force is gain(…)·act + bias(…), act = control through its own dynamics, clipped, times the gear, through a joint, tendon
or site (mujoco.readthedocs.io, Computation: actuation model); a plain motor has gain 1, bias 0 and no dynamics.
"""

from collections.abc import Callable, Collection, Iterable, Sequence
from typing import Any

import numpy as np

from invdyn.models.bodies.joint_parts_mjcf import acts
from invdyn.models.bodies.parts import listed

AT_JOINTS = {
    "damping": ("dof_damping",),
    "damping that is no straight line": ("dof_dampingpoly",),
    "dry friction": ("dof_frictionloss",),
    "armature": ("dof_armature",),
    "a spring": ("jnt_stiffness",),
    "a spring that is no straight line": ("jnt_stiffnesspoly",),
    "limits": ("jnt_limited",),
    "limits of the actuators' torque": ("jnt_actfrclimited",),
}
"""Words, and the model's arrays, of which older MuJoCos lack some: a row a joint, or a degree of freedom."""
OF_PARTS = ("damping", "dry friction", "armature", "a spring", "limits of the actuators' torque")


def named(mujoco: Any, model: Any, joints: Sequence[str], motors: Collection[int]) -> list[str]:
    """Entries such as "damping (elbow)" for a ``mujoco.MjModel`` and the names of its joints.

    Hinges and slides have their parts (:mod:`.joint_parts_mjcf`), and ``motors`` are the actuators among those.
    """
    found = []
    one_way = np.isin(model.jnt_type, [int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)])
    for words, attributes in AT_JOINTS.items():
        having: set[int] = set()
        for attribute in attributes:
            values = np.asarray(getattr(model, attribute, ()))
            if values.size:
                rows = np.flatnonzero(values.reshape(len(values), -1).any(1))
                having |= set((model.dof_jntid[rows] if attribute.startswith("dof") else rows).tolist())
        if words in OF_PARTS:
            having -= set(np.flatnonzero(one_way).tolist())
        found += listed(words, [name for j, name in enumerate(joints) if j in having])
    found += listed("gravity compensation", _of(model.body, np.flatnonzero(model.body_gravcomp)))
    found += _fluid(model.opt)
    found += _actuators(mujoco, model, motors)
    found += listed("tendons", _of(model.tendon, range(model.ntendon)))
    found += listed("equality constraints", [_equality(mujoco, model, e) for e in range(model.neq)])
    return found + listed("contacts", touching(mujoco, model))


def _of(kind: Callable, numbers: Iterable[int]) -> list[str]:
    return [kind(int(i)).name or f"number {int(i)}" for i in numbers]


def _fluid(option: Any) -> list[str]:
    found = []
    if option.density or option.viscosity:
        found.append(f"a fluid (density {option.density:g} kg/m³, viscosity {option.viscosity:g} Pa·s)")
    if np.any(option.wind):
        found.append(f"wind ({', '.join(f'{w:g}' for w in option.wind)} m/s)")
    return found


def _actuators(mujoco: Any, model: Any, motors: Collection[int]) -> list[str]:
    open_ones = ~np.isin(np.arange(model.nu), list(motors))
    open_ones = open_ones & np.array([acts(mujoco, model, a) for a in range(model.nu)], dtype=bool)
    targets = model.actuator_biasprm[:, 1:3].any(1)
    through = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    plain = int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtGain.mjGAIN_FIXED), int(mujoco.mjtDyn.mjDYN_NONE)
    affine = int(mujoco.mjtBias.mjBIAS_AFFINE)
    bias, gain, filtered = model.actuator_biastype, model.actuator_gaintype, model.actuator_dyntype
    gains = model.actuator_biasprm
    servo = (bias == affine) & (gains[:, 1] != 0)
    speed = (bias == affine) & (gains[:, 1] == 0) & (gains[:, 2] != 0)
    kinds = {
        "position servos": servo,
        "velocity servos": speed,
        "constant forces of actuators": (bias == affine) & (gains[:, 0] != 0),
        "muscles and other actuators with a law of their own": ~np.isin(bias, [plain[0], affine]) | (gain != plain[1]),
        "activation dynamics": filtered != plain[2],
        "gears": model.actuator_gear[:, 0] != 1,
        "gains of motors": (bias == plain[0]) & (gain == plain[1]) & (model.actuator_gainprm[:, 0] != 1),
        "force limits": model.actuator_forcelimited != 0,
        "control limits": model.actuator_ctrllimited != 0,
        "actuators that act elsewhere than on a joint": ~np.isin(model.actuator_trntype, through),
    }
    return (
        [
            entry
            for words, having in kinds.items()
            for entry in listed(words, _of(model.actuator, np.flatnonzero(having[: model.nu] & open_ones)))
        ]
        + listed(
            "constant forces of motors",
            _of(model.actuator, np.flatnonzero((bias == affine) & (gains[:, 0] != 0) & ~(servo | speed | open_ones))),
        )
        + listed(
            "limits of servos' targets",
            _of(model.actuator, np.flatnonzero((model.actuator_ctrllimited != 0) & targets & ~open_ones)),
        )
    )


def _equality(mujoco: Any, model: Any, e: int) -> str:
    """Its name, or what it ties to what: of joints, who follows whom (a URDF's mimic)."""
    if model.eq_type[e] == mujoco.mjtEq.mjEQ_JOINT:
        one, other = int(model.eq_obj1id[e]), int(model.eq_obj2id[e])
        return f"{model.joint(one).name} follows {model.joint(other).name if other >= 0 else 'a constant'}"
    return model.equality(e).name or mujoco.mjtEq(int(model.eq_type[e])).name.removeprefix("mjEQ_").lower()


def touching(mujoco: Any, model: Any, with_world: bool = False) -> list[str]:
    """Bodies of the chain that may touch something: MuJoCo's own filters by bits, welds, parents and exclusions.

    ``with_world``: that may touch what does not move.
    """
    without = mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    if model.opt.disableflags & without:
        return []
    kind, meets = np.zeros((2, model.nbody), int)
    np.bitwise_or.at(kind, model.geom_bodyid, model.geom_contype)
    np.bitwise_or.at(meets, model.geom_bodyid, model.geom_conaffinity)
    may = (kind[:, None] & meets) | (kind & meets[:, None])
    weld = model.body_weldid
    above = weld[model.body_parentid[weld]]  # the weld that each one hangs on
    related = (above[:, None] == weld) & (weld != 0) & (weld[:, None] != 0)
    may[(weld[:, None] == weld) | related | related.T] = 0
    for signature in model.exclude_signature:
        one, other = int(signature) >> 16, int(signature) & 0xFFFF
        may[one, other] = may[other, one] = 0
    for one, other in zip(model.pair_geom1, model.pair_geom2, strict=True):
        pair = model.geom_bodyid[one], model.geom_bodyid[other]
        may[pair] = may[pair[::-1]] = 1
    moving = np.flatnonzero(weld != 0)
    others = weld == 0 if with_world else np.full(model.nbody, True)
    return _of(model.body, [int(b) for b in moving if may[b, others].any()])
