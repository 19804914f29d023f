"""What shapes push each other with, along paths: the mean force up to the next row, and where it acts.

MuJoCo's contact sensor sums the forces of a pair's contacts, in the world's frame, and has the force-weighted middle of
their points. Over the n steps of a row, of length δ/n, with the drive as the transition has it,

    f_t = (1/n) Σ_k f(k),     r_t = Σ_k |f(k)| r(k) / Σ_k |f(k)|     the centre of pressure.

Which pairs touch is looked up in the paths' own states. A row's last step has no next row: it is as long as the one
before. Shapes: paths (N, T, D), P pairs, forces and centres (N, T, P, 3) in N and m; a centre is NaN without a force.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from invdyn.models.bodies.body_mjcf import engine
from invdyn.models.bodies.scalars import BodyError
from invdyn.models.engine.model import EngineModel
from invdyn.models.engine.scene import geom_name
from invdyn.models.engine.simulator import Simulator

MAX_PAIRS = 40
"""Pairs that are reported, those that touch in most rows first."""
MIN_FORCE = 1e-6
"""N, under which there is no centre of pressure."""
SEARCHED = 4000
"""States in which contacts are looked up, at most."""


@dataclass(frozen=True)
class ContactForces:
    """Forces on the second shape of each pair by the first, which is fixed in the world if one of them is.

    Attributes:
        pairs: numbers of two geoms each.
        names: "floor-foot".
        force, centre: (N, T, P, 3).
        ground: (P,) whether the first shape is fixed in the world.
    """

    pairs: tuple[tuple[int, int], ...]
    names: tuple[str, ...]
    force: np.ndarray
    centre: np.ndarray
    ground: np.ndarray


def contact_forces(model: EngineModel, paths: np.ndarray) -> ContactForces:
    """Forces of all pairs that touch along ``paths`` (N, T, D) of states."""
    pairs = touching_pairs(model, paths)
    names = tuple(f"{geom_name(model.scene.model, one)}-{geom_name(model.scene.model, other)}" for one, other in pairs)
    fixed = np.array([is_fixed(model.scene.model, one) for one, _ in pairs], bool)
    count, rows = paths.shape[:2]
    force = np.zeros((count, rows, len(pairs), 3))
    centre = np.full_like(force, np.nan)
    if not pairs:
        return ContactForces(pairs, names, force, centre, fixed)
    simulator, columns = _with_sensors(model, pairs)
    for t in range(rows):
        after = min(t + 1, rows - 1)
        length, steps = model.row_steps(after)
        own = paths[:, t]
        _, sensors = simulator.run(model.physics(own), model.drive_within(own, after, steps), length)
        each = sensors[..., columns]  # (N, n, P, 6)
        force[:, t] = each[..., :3].mean(1)
        weight = np.linalg.norm(each[..., :3], axis=-1, keepdims=True)
        total = weight.sum(1)
        with np.errstate(invalid="ignore", divide="ignore"):
            centre[:, t] = np.where(total > MIN_FORCE, (weight * each[..., 3:]).sum(1) / total, np.nan)
    return ContactForces(pairs, names, force, centre, fixed)


def touching_pairs(model: EngineModel, paths: np.ndarray) -> tuple[tuple[int, int], ...]:
    """Pairs of geoms that touch in states along ``paths``, those in most states first."""
    mujoco, compiled = engine(model.scene.name), model.scene.model
    data, found = mujoco.MjData(compiled), dict[tuple[int, int], int]()
    rows = np.arange(len(paths))[:, None] + np.arange(paths.shape[1])  # other rows of each path
    flat = paths[rows % -(-rows.size // SEARCHED) == 0]
    for qpos in model.physics(flat)[:, : compiled.nq]:
        data.qpos[:] = qpos
        mujoco.mj_fwdPosition(compiled, data)
        for pair in {tuple(pair) for pair in data.contact.geom[: data.ncon].tolist()}:
            one, other = sorted(pair, key=lambda geom: (not is_fixed(compiled, geom), geom))
            found[one, other] = found.get((one, other), 0) + 1
    order = sorted(found, key=lambda pair: (-found[pair], pair))[:MAX_PAIRS]
    return tuple(sorted(order))


def is_fixed(model: Any, geom: int) -> bool:
    """Whether a geom does not move."""
    return bool(model.body_weldid[model.geom_bodyid[geom]] == 0)


def _with_sensors(model: EngineModel, pairs: tuple[tuple[int, int], ...]) -> tuple[Simulator, np.ndarray]:
    """A simulator with a sensor a pair, and where its force and point are, (P, 6)."""
    mujoco = engine(model.scene.name)
    if model.scene.spec is None:
        raise BodyError("expected a model that was read here, got one from another process: make it again")
    spec = model.scene.spec.copy()
    names = [geom.name for geom in spec.geoms]
    kinds = 2 ** int(mujoco.mjtConDataField.mjCONDATA_FORCE) | 2 ** int(mujoco.mjtConDataField.mjCONDATA_POS)
    for number, (one, other) in enumerate(pairs):
        spec.add_sensor(
            name=f"invdyn contact {number}",
            type=mujoco.mjtSensor.mjSENS_CONTACT,
            objtype=mujoco.mjtObj.mjOBJ_GEOM,
            objname=names[one],
            reftype=mujoco.mjtObj.mjOBJ_GEOM,
            refname=names[other],
            intprm=[kinds, 3, 1],  # its data, reduced to the net force, one of it
        )
    compiled = spec.compile()
    model.as_driven(compiled)
    first = [int(compiled.sensor(f"invdyn contact {number}").adr[0]) for number in range(len(pairs))]
    return Simulator(compiled, model.inputs.spec, model.threads), np.array(first)[:, None] + np.arange(6)
