"""Numbers of a corrected simulation set in a ``mujoco.MjSpec`` or ``MjModel``, with no file between.

A change is put into a compiled model first (:class:`.mjcf.BodyNumbers`). The rows in which that differs from the
original are then set in the elements of a spec, compiled, and compared with it: what the compiler makes of a number,
such as damping by `dampratio` or inertia from geoms, is said and never silently lost.
"""

import copy
from collections.abc import Callable, Sequence
from typing import Any

import mujoco
import numpy as np

from invdyn.diagnosis.rules import FIXED
from invdyn.diagnosis.write_back.changes import FileChange
from invdyn.diagnosis.write_back.mjcf import BodyNumbers, groups
from invdyn.diagnosis.write_back.mjcf_writer import joint_of_row, rows_differing
from invdyn.models import ArticulatedBody

HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)
OTHERWISE = "MuJoCo's compiler makes this number of others: change those"
NO_ROOM = "a compiled model takes no further body: give a mujoco.MjSpec"
FORGETS = "a compiled model remembers too little of a motor's commands: give a mujoco.MjSpec"


def changed_model(model: Any, body: ArticulatedBody, changes: Sequence[FileChange]) -> tuple[Any, dict[str, str]]:
    """A copy of an ``MjModel``, read as ``body``, with the changes; and what it has no room for: words → why."""
    numbers, unsaid = BodyNumbers(model, body), dict[str, str]()
    now = copy.copy(model)
    for several in groups(changes):
        after = copy.copy(now)
        why = NO_ROOM if several[0].quantity == "payload" else numbers.put(after, several)
        if not why and several[0].quantity == "motor delay":
            remembered = after.actuator_history[:, 0] * after.opt.timestep
            why = FORGETS if (after.actuator_delay > remembered).any() else None  # MuJoCo would leave it out
        now = now if why else after
        unsaid |= {each.words: why for each in several if why}
    mujoco.mj_setConst(now, mujoco.MjData(now))
    return now, unsaid


def changed_spec(spec: Any, body: ArticulatedBody, changes: Sequence[FileChange]) -> tuple[Any, dict[str, str]]:
    """A copy of an ``MjSpec``, read as ``body``, with the changes; and what it could not say: words → why.

    Raises ValueError where MuJoCo cannot compile it.
    """
    own = spec.copy()
    model = own.compile()
    elements = {kind: {each.id: each for each in getattr(own, kind)} for kind in ("joints", "actuators", "bodies")}
    numbers, now = BodyNumbers(model, body), copy.copy(model)
    unsaid, made = dict[str, str](), list[tuple[list[FileChange], list[tuple[str, int]]]]()
    for several in groups(changes):
        if several[0].quantity == "payload":
            number, place = numbers.tip()
            point = elements["bodies"][number].add_body(name="payload", pos=place, explicitinertial=True)
            point.mass, point.ipos, point.inertia = several[0].after, np.zeros(3), np.full(3, FIXED.point_inertia)
            continue
        after = copy.copy(now)
        if why := numbers.put(after, several):
            unsaid |= {each.words: why for each in several}
            continue
        rows = [(array, row) for array in SET for row in rows_differing(now, after, array)]
        for array, row in rows:
            kind, put = SET[array]
            number = joint_of_row(model, array, row) if kind == "joints" else row
            put(elements[kind][number], after, number, row)
        own.option.gravity = after.opt.gravity
        made, now = [*made, (several, rows)], after
    final = own.compile()
    for several, rows in made:
        if not all(np.allclose(getattr(final, a)[r], getattr(now, a)[r], rtol=1e-6, atol=1e-12) for a, r in rows):
            unsaid |= {each.words: OTHERWISE for each in several}
    return own, unsaid


Put = Callable[[Any, Any, int, int], None]
"""Sets in an element what the changed model has in a row: (element, model, number of the element, row)."""


def _as(name: str, array: str) -> Put:
    """The row's numbers, as the first entries of an attribute."""

    def put(element: Any, after: Any, number: int, row: int) -> None:
        value, old = np.atleast_1d(getattr(after, array)[row]), getattr(element, name)
        if np.ndim(old) == 0:
            setattr(element, name, float(value[0]))
        else:
            setattr(element, name, np.concatenate([value, old[len(value) :]]))

    return put


def _angle(name: str, array: str) -> Put:
    """A joint's, in degrees where the spec has these."""

    def put(joint: Any, after: Any, number: int, row: int) -> None:
        value = getattr(after, array)[row]
        setattr(joint, name, np.degrees(value) if joint.compiler.degree and after.jnt_type[number] == HINGE else value)

    return put


def _limit(actuator: Any, after: Any, number: int, row: int) -> None:
    actuator.forcelimited, actuator.forcerange = 1, after.actuator_forcerange[row]


def _delay(actuator: Any, after: Any, number: int, row: int) -> None:
    actuator.delay = float(after.actuator_delay[row])
    actuator.nsample = int(np.ceil(actuator.delay / after.opt.timestep)) + FIXED.extra_samples


def _inertial(body: Any, after: Any, number: int, row: int) -> None:
    body.explicitinertial, body.mass = True, float(after.body_mass[row])
    body.ipos, body.iquat, body.inertia = after.body_ipos[row], after.body_iquat[row], after.body_inertia[row]
    body.fullinertia = np.full(6, np.nan)


SET: dict[str, tuple[str, Put]] = {
    "dof_damping": ("joints", _as("damping", "dof_damping")),
    "dof_frictionloss": ("joints", _as("frictionloss", "dof_frictionloss")),
    "dof_armature": ("joints", _as("armature", "dof_armature")),
    "dof_solimp": ("joints", _as("solimp_friction", "dof_solimp")),
    "jnt_stiffness": ("joints", _as("stiffness", "jnt_stiffness")),
    "jnt_range": ("joints", _angle("range", "jnt_range")),
    "qpos_spring": ("joints", _angle("springref", "qpos_spring")),
    "qpos0": ("joints", _angle("ref", "qpos0")),
    "actuator_gear": ("actuators", _as("gear", "actuator_gear")),
    "actuator_gainprm": ("actuators", _as("gainprm", "actuator_gainprm")),
    "actuator_biasprm": ("actuators", _as("biasprm", "actuator_biasprm")),
    "actuator_forcerange": ("actuators", _limit),
    "actuator_delay": ("actuators", _delay),
    **{f"body_{name}": ("bodies", _inertial) for name in ("mass", "inertia", "ipos", "iquat")},
}
"""Arrays of a compiled model: the kind of element that a row is of, and how it is set."""
