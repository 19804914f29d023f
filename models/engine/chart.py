"""Configurations as vectors: a tangent chart about a reference, in which Gaussian noise has a meaning.

MuJoCo's ``mj_integratePos`` and ``mj_differentiatePos`` (mujoco.readthedocs.io, Simulation: state), for many
configurations at once. Hinges and slides add; a rotation R of a ball or a free joint is

    R = R_ref exp([δ]×),     δ = log(R_refᵀ R),     |δ| ≤ π,

so that δ is in the body's own frame, as the angular velocities of ``qvel`` are. A chart is regular within a turn of its
reference. Shapes: qpos (B, nq), reference (nq,) or (B, nq), δ (B, nv); quaternions (…, 4), w first.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation


@dataclass(frozen=True)
class Chart:
    """Which entries of qpos and of δ are plain numbers, (P,) each, and where quaternions and their rotations begin."""

    plain_qpos: np.ndarray
    plain_dof: np.ndarray
    quaternions: tuple[int, ...]
    rotations: tuple[int, ...]
    num_qpos: int
    num_dofs: int

    @classmethod
    def of(cls, joint_types: np.ndarray, qpos_address: np.ndarray, dof_address: np.ndarray) -> "Chart":
        """The chart of joints of types 0 (free), 1 (ball), 2 (slide) and 3 (hinge), with their addresses."""
        qpos: list[int] = []
        dofs: list[int] = []
        quaternions, rotations = [], []
        num_qpos = num_dofs = 0
        for kind, q, v in zip(joint_types.tolist(), qpos_address.tolist(), dof_address.tolist(), strict=True):
            plain = {0: 3, 1: 0}.get(kind, 1)
            qpos += range(q, q + plain)
            dofs += range(v, v + plain)
            if kind in (0, 1):
                quaternions.append(q + plain)
                rotations.append(v + plain)
            num_qpos, num_dofs = q + {0: 7, 1: 4}.get(kind, 1), v + {0: 6, 1: 3}.get(kind, 1)
        return cls(np.array(qpos, int), np.array(dofs, int), tuple(quaternions), tuple(rotations), num_qpos, num_dofs)

    def configuration(self, reference: np.ndarray, tangent: np.ndarray) -> np.ndarray:
        """Qpos (B, nq) at δ (B, nv) from the reference."""
        out = np.broadcast_to(reference, (*tangent.shape[:-1], self.num_qpos)).copy()
        out[..., self.plain_qpos] += tangent[..., self.plain_dof]
        for q, v in zip(self.quaternions, self.rotations, strict=True):
            turn = tangent[..., v : v + 3]
            turned = rotations(out[..., q : q + 4]) * Rotation.from_rotvec(np.nan_to_num(turn))
            out[..., q : q + 4] = np.roll(turned.as_quat(), 1, -1) + 0 * turn[..., :1]  # NaN stays NaN
        return out

    def tangent(self, reference: np.ndarray, configuration: np.ndarray) -> np.ndarray:
        """δ (B, nv) of configurations (B, nq) from the reference."""
        reference = np.broadcast_to(reference, configuration.shape)
        out = np.empty((*configuration.shape[:-1], self.num_dofs))
        out[..., self.plain_dof] = configuration[..., self.plain_qpos] - reference[..., self.plain_qpos]
        for q, v in zip(self.quaternions, self.rotations, strict=True):
            turn = rotations(reference[..., q : q + 4]).inv() * rotations(configuration[..., q : q + 4])
            out[..., v : v + 3] = turn.as_rotvec() + 0 * configuration[..., q : q + 1]
        return out


def rotations(quaternions: np.ndarray) -> Rotation:
    """Of quaternions (…, 4), w first; the identity where they are no numbers."""
    known = np.isfinite(quaternions).all(-1, keepdims=True)
    return Rotation.from_quat(np.where(known, np.roll(quaternions, -1, -1), [0.0, 0.0, 0.0, 1.0]))
