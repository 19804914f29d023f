"""What joints bear along paths: force and moment on each body by what it hangs on, contacts and the drive acting.

MuJoCo's recursive Newton–Euler with all forces (``mj_rnePostConstraint``; R. Featherstone, Rigid Body Dynamics
Algorithms, 2008, chapter 5) has of each body a wrench (m, f) about the centre of mass c of the tree that it belongs to,
in the world's axes. About the anchor p of the body's first joint, which moves with the body,

    moment = m + (c − p) × f.

It is that of the row itself, where contact forces are means up to the next one. Joints bear nothing along what they
leave free, but for drives, springs and damping.

Shapes: paths (N, T, D), B bodies with joints, wrench (N, T, B, 9): force N, then moment N·m, then anchor m.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from invdyn.models.bodies.body_mjcf import engine
from invdyn.models.engine.model import EngineModel


def joint_reactions(model: EngineModel, paths: np.ndarray) -> tuple[tuple[str, ...], np.ndarray]:
    """Names of the B bodies, and their wrenches along ``paths`` (N, T, D) of states; NaN where a state is."""
    mujoco, compiled = engine(model.scene.name), model.compiled()
    bodies = np.flatnonzero(compiled.body_jntnum)
    joints, roots = compiled.body_jntadr[bodies], compiled.body_rootid[bodies]
    flat = paths.reshape(-1, paths.shape[-1])
    out = np.full((len(flat), len(bodies), 9), np.nan)
    for k, data in evaluated(model, compiled, flat):
        mujoco.mj_rnePostConstraint(compiled, data)
        moment, force = data.cfrc_int[bodies, :3], data.cfrc_int[bodies, 3:]
        anchor = data.xpos[bodies] + np.einsum(
            "bij,bj->bi", data.xmat[bodies].reshape(-1, 3, 3), compiled.jnt_pos[joints]
        )
        moment = moment + np.cross(data.subtree_com[roots] - anchor, force)
        out[k] = np.concatenate([force, moment, anchor], -1)
    names = tuple(compiled.body(b).name or f"body{b}" for b in bodies.tolist())
    return names, out.reshape(*paths.shape[:-1], len(bodies), 9)


def evaluated(model: EngineModel, compiled: Any, flat: np.ndarray) -> Iterator[tuple[int, Any]]:
    """Number, and MuJoCo's data of ``compiled`` after ``mj_forward``, of each finite one of states (B, D)."""
    mujoco = engine(model.scene.name)
    data, ends = mujoco.MjData(compiled), [compiled.nq, compiled.nq + compiled.nv]
    fields = model.inputs.fields(flat[:, : model.inputs.size])
    for k, (physics, inputs) in enumerate(zip(model.physics(flat), fields, strict=True)):
        if np.isfinite(physics).all():
            data.qpos[:], data.qvel[:], data.act[:] = np.split(physics, ends)
            data.qacc_warmstart[:] = 0  # so that a state's numbers depend on it alone
            mujoco.mj_setState(compiled, data, inputs, model.inputs.spec)
            mujoco.mj_forward(compiled, data)
            yield k, data
