"""Typical sizes of a motion at joints and tendons: forces, speeds, accelerations, ways.

Along a path (T, nq + nv + na) with what was commanded, over its rows: forces are the root mean square of the actuators'
and the applied ones, or of gravity's and the Coriolis forces where those are larger, and at least `engine_least` of the
largest of their unit; speeds, accelerations and ways, half of the range, likewise. A tendon's force is the largest of
its joints', over its lever.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from invdyn.diagnosis.catalogue.model_numbers import Place
from invdyn.diagnosis.rules import FIXED
from invdyn.models.engine.drives import turning_dofs

OF_JOINTS = 2  # MuJoCo's mjEQ_JOINT
KINDS = ("force", "speed", "acceleration", "way")


@dataclass(frozen=True)
class Sizes:
    """Of a motion, at degrees of freedom (nv,) and tendons (K,).

    Attributes:
        model: the compiled one.
        dofs: of :data:`KINDS`, (4, nv).
        tendons: the same, without accelerations, (4, K).
        extent: m, the size of what moves.
    """

    model: Any
    dofs: np.ndarray
    tendons: np.ndarray
    extent: float

    def size(self, kind: str, place: Place) -> float:
        """A "force", "speed", "acceleration" or "way" at a place, in N, m and s, or N·m, rad and s."""
        row, number, joints = KINDS.index(kind), place.number, place.kind != "tendon"
        if place.kind == "equality":
            joints = int(self.model.eq_type[number]) == OF_JOINTS
            number = int(self.model.eq_obj1id[number])
        return float(self.dofs[row, self.model.jnt_dofadr[number]] if joints else self.tendons[row, number])

    @classmethod
    def of(cls, model: Any, physics: np.ndarray, time: np.ndarray, inputs: np.ndarray, spec: int) -> "Sizes":
        """Along a path, with inputs (T, C) of ``spec``, bits of ``mujoco.mjtState``."""
        import mujoco

        data, nq, nv, nt = mujoco.MjData(model), model.nq, model.nv, model.ntendon
        made, loads = np.zeros((len(physics), nv)), np.zeros((len(physics), nv))
        lengths, levers = np.zeros((len(physics), nt)), np.zeros((nt, nv))
        for t, (state, given) in enumerate(zip(physics, inputs, strict=True)):
            data.qpos[:], data.qvel[:], data.act[:] = np.split(state, [nq, nq + nv])
            mujoco.mj_setState(model, data, given, spec)
            mujoco.mj_forward(model, data)
            made[t], loads[t] = data.qfrc_actuator + data.qfrc_applied, data.qfrc_bias
            lengths[t] = data.ten_length
            if t % (len(physics) // FIXED.engine_poses + 1) == 0:
                levers = np.maximum(levers, np.abs(_levers(mujoco, model, data)))
        speed = physics[:, nq : nq + nv]
        acceleration = np.gradient(speed, time, axis=0)
        turns = turning_dofs(model)
        straight = np.array([model.jnt_type[model.dof_jntid[v]] in (2, 3) for v in range(nv)])
        way = np.full(nv, 0.1)
        for v in np.flatnonzero(straight):
            way[v] = 0.5 * np.ptp(physics[:, model.jnt_qposadr[model.dof_jntid[v]]])
        each = [np.maximum(_rms(made), _rms(loads)), _rms(speed), _rms(acceleration), way]
        dofs = np.stack([_floored(values, turns) for values in each])
        force = np.array([np.max(dofs[0][lever > 0] / lever[lever > 0], initial=0.0) for lever in levers])
        pace = np.gradient(lengths, time, axis=0) if nt else lengths
        none = np.ones(nt, bool)
        tendons = np.stack([
            force, _floored(_rms(pace), none), np.zeros(nt), _floored(0.5 * np.ptp(lengths, axis=0), none),
        ]) if nt else np.zeros((4, 0))  # fmt: skip
        return cls(model, dofs, tendons, float(model.stat.extent))


def _levers(mujoco: Any, model: Any, data: Any) -> np.ndarray:
    """Levers (K, nv) of tendons in a state: their speeds when one coordinate moves at speed one."""
    out = np.zeros((model.ntendon, model.nv))
    for v in range(model.nv if model.ntendon else 0):
        data.qvel[:] = np.eye(model.nv)[v]
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        out[:, v] = data.ten_velocity
    return out


def _rms(values: np.ndarray) -> np.ndarray:
    return np.sqrt((values**2).mean(0))


def _floored(values: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """At least `engine_least` of the largest of those of the same unit, and more than zero."""
    out = np.maximum(values, 1e-9)
    for kind in (turns, ~turns):
        if kind.any():
            out[kind] = np.maximum(out[kind], FIXED.engine_least * out[kind].max())
    return out
