"""Why a file needs MuJoCo's own step: what rigid links with joints cannot do.

Contact with what stands in the world, equality constraints, tendons, muscles and filtered actuators. That an arm may
touch itself is no reason: those contacts are left out with a warning, as a robot's shapes overlap its joints.
"""

import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from invdyn.models.bodies.body_mjcf_left_out import touching
from invdyn.models.bodies.body_xml import MOST_BYTES, is_xml, parse
from invdyn.models.bodies.scalars import BodyError
from invdyn.models.bodies.whole_file import read_whole
from invdyn.models.engine.drives import is_muscle
from invdyn.models.engine.scene import Scene

MOST_NAMED = 4  # names in a message


def reasons_for_engine(path: Path) -> list[str]:
    """What of an MJCF file needs MuJoCo's step, in words; none for other files, or where MuJoCo is not installed."""
    content = read_whole(path, MOST_BYTES)
    if not is_xml(content):
        return []
    root = parse(content, str(path))
    marks = ("equality", "tendon", "actuator", "geom", "include")
    if root.tag != "mujoco" or not any(next(root.iter(mark), None) is not None for mark in marks):
        return []
    try:
        return reasons(Scene.of(path))
    except BodyError as error:  # whoever reads the body says what else is wrong with it
        warnings.warn(f"{error}; so it is taken without MuJoCo's contacts and constraints", UserWarning, stacklevel=2)
        return []


def reasons(scene: Scene) -> list[str]:
    """What of a scene needs MuJoCo's step, in words."""
    import mujoco

    model = scene.model
    found = []
    if (model.geom_bodyid == 0).any() and (feet := touching(mujoco, model, with_world=True)):
        found.append(_listed("contact of {} with the world", feet))
    if model.neq and (active := np.flatnonzero(model.eq_active0)).size:
        found.append(f"{len(active)} equality constraint{'s' * (len(active) > 1)}")
    if model.ntendon:
        found.append(_listed("tendons {}", [model.tendon(k).name or f"tendon{k}" for k in range(model.ntendon)]))
    if (muscles := is_muscle(model)).any():
        names = np.array(scene.actuator_names)[muscles]
        found.append(_listed("muscles {}", names.tolist()))
    elif model.na:
        found.append("actuators with activations")
    return found


def touched(scene: Scene, angles: np.ndarray | None, names: Sequence[str]) -> bool:
    """Whether a scene touches what stands in the world in some row of its joints' ``angles`` (T, K), by name.

    False without any angles: the poses are not known then.
    """
    import mujoco

    model = scene.model
    seen = [k for k, name in enumerate(names) if name in scene.joint_names]
    if angles is None or not np.isfinite(angles[:, seen]).any():
        return False
    data = mujoco.MjData(model)
    for row in angles[:, seen]:
        data.qpos[:] = scene.reference
        for k, value in zip(seen, row, strict=True):
            joint = model.dof_jntid[scene.joint_names.index(names[k])]
            if np.isfinite(value):
                data.qpos[model.jnt_qposadr[joint]] = value
        mujoco.mj_fwdPosition(model, data)
        moving = model.body_weldid[model.geom_bodyid[data.contact.geom[: data.ncon]]] != 0
        if (moving.any(1) & ~moving.all(1)).any():
            return True
    return False


def _listed(words: str, names: list[str]) -> str:
    more = len(names) - MOST_NAMED
    return words.format(", ".join(names[:MOST_NAMED]) + (f" and {more} more" if more > 0 else ""))
