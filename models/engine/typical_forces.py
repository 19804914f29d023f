"""Usual sizes of a MuJoCo model's generalised forces, from which defaults of unknown drives are made.

Each is the largest over a few poses of

    |bias − passive|                    what holds the bodies beyond a joint, at rest, against gravity and springs
    5/s² · M_vv                         what accelerates them, M being the inertia of the joints
    |J_v(c)ᵀ m P g|                     what carries the base, where the base can fall

A motor acts on both its bodies: what one does, the joints before it hold, as far as their axes are parallel. With
axes a_v of joints of a kind, those that turn or those that shift, a force f_w asks for

    |a_v · a_w| f_w                     at each joint v between its body and the world.

So a hip is as strong as the knee beyond it. Where a foot sticks to the floor, motion hardly tells how both share.

A base, the first body of a tree, can fall along slides and free joints' shifts that no drive pushes. P projects onto
their directions (rank ≤ 3): a bolted or hinged base, or one on level rails, has P g = 0, and its bearing carries it.
Along P g a joint may have to hold all bodies that are not beyond it, of mass m about c: those of a leg that stands.

Shapes: forces (nv,), N or N·m; J (3, nv).
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from invdyn.models.bodies.body_mjcf import engine
from invdyn.models.engine.drives import turning_dofs
from invdyn.models.engine.scene import Scene

POSES, ACCELERATION = 20, 5.0
"""The reference and random ones about it; m/s² or rad/s²."""
LEAST = 1e-6
"""N or N·m, of a joint that nothing loads."""


def typical_forces(scene: Scene, pushed: Sequence[int] = ()) -> np.ndarray:
    """Usual generalised forces (nv,), given which degrees of freedom are ``pushed`` by a drive."""
    mujoco = engine(scene.name)
    model, rng = scene.model, np.random.default_rng(0)
    data, inertia = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    loads = []
    for k in range(POSES):
        tangent = rng.uniform(-1, 1, scene.num_joints) * (k > 0)
        data.qpos[:] = scene.chart.configuration(scene.reference, tangent)
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, inertia)
        held = np.maximum(np.abs(data.qfrc_bias - data.qfrc_passive), ACCELERATION * np.abs(np.diagonal(inertia)))
        loads.append(_passed_on(model, data, np.maximum(held, _carrying(model, data, pushed))))
    return np.maximum(np.max(loads, 0), LEAST)


def _carrying(model: Any, data: Any, pushed: Sequence[int]) -> np.ndarray:
    """What carries the base (nv,) in a pose, where the base can fall."""
    mujoco = engine("engine model")
    slope, found = np.zeros((3, model.nv)), np.zeros(model.nv)
    shifts = set(np.flatnonzero(~turning_dofs(model))) - set(pushed)
    for body in np.unique(model.dof_bodyid):
        root = model.body_rootid[body]
        if body == root:
            continue
        mujoco.mj_jacBody(model, data, slope, None, root)
        ways = slope[:, [v for v in np.flatnonzero(model.dof_bodyid == root) if v in shifts]]
        falling = ways @ np.linalg.pinv(ways) @ model.opt.gravity
        moments = model.body_subtreemass[[root, body], None] * data.subtree_com[[root, body]]
        mass = model.body_subtreemass[root] - model.body_subtreemass[body]
        mujoco.mj_jac(model, data, slope, None, (moments[0] - moments[1]) / mass, body)
        own = model.dof_bodyid == body
        found[own] = np.abs(mass * falling @ slope[:, own])
    return found


def _passed_on(model: Any, data: Any, load: np.ndarray) -> np.ndarray:
    """Loads (nv,) in a pose with what joints bear of those beyond them, about the same axes."""
    turns, found = turning_dofs(model), load.copy()
    shift, turn = np.zeros((2, 3, model.nv))
    for body in np.unique(model.dof_bodyid):
        engine("engine model").mj_jacBody(model, data, shift, turn, body)
        axes = np.where(turns, turn, 0.0), np.where(turns, 0.0, shift)
        own = model.dof_bodyid == body
        for each in axes:
            found = np.maximum(found, (np.abs(each.T @ each[:, own]) * load[own]).max(1))
    return found
