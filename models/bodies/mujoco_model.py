"""What a compiled MJCF switches off, and MuJoCo's warnings, which it else prints and writes to a log where it runs.

Off are what flags of its `<option>` and groups of actuators say (XML reference: flag).

    frictionloss, limit, constraint    dry friction and limits; a disabled constraint is without both, and equalities
    spring, damper                     passive forces of joints
    clampctrl                          limits of controls
    actuation, actuatorgroupdisable    all actuators, or those of some groups: they act on nothing

Gravity, contacts and the damping of Euler's steps are read where they are used.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np


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
