"""Configurations as vectors: a tangent chart about a reference, in which Gaussian noise has a meaning.

MuJoCo's ``mj_integratePos`` and ``mj_differentiatePos`` (mujoco.readthedocs.io, Simulation: state), for many
configurations at once. Hinges and slides add; a rotation R of a ball or a free joint is

    R = R_ref exp([δ]×),     δ = log(R_refᵀ R),     |δ| ≤ π,

so that δ is in the body's own frame, as the angular velocities of ``qvel`` are. A chart is regular within a turn of its
reference. Shapes: qpos (B, nq), reference (nq,) or (B, nq), δ (B, nv); quaternions (…, 4), w first.
"""

from dataclasses import dataclass

import numpy as np


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
            out[..., q : q + 4] = product(out[..., q : q + 4], exponential(tangent[..., v : v + 3]))
        return out

    def tangent(self, reference: np.ndarray, configuration: np.ndarray) -> np.ndarray:
        """δ (B, nv) of configurations (B, nq) from the reference."""
        reference = np.broadcast_to(reference, configuration.shape)
        out = np.empty((*configuration.shape[:-1], self.num_dofs))
        out[..., self.plain_dof] = configuration[..., self.plain_qpos] - reference[..., self.plain_qpos]
        for q, v in zip(self.quaternions, self.rotations, strict=True):
            inverse = reference[..., q : q + 4] * np.array([1.0, -1.0, -1.0, -1.0])
            out[..., v : v + 3] = logarithm(product(inverse, configuration[..., q : q + 4]))
        return out


def product(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Hamilton's product of quaternions (…, 4)."""
    a, b, c, d = np.moveaxis(one, -1, 0)
    e, f, g, h = np.moveaxis(other, -1, 0)
    parts = (
        a * e - b * f - c * g - d * h,
        a * f + b * e + c * h - d * g,
        a * g - b * h + c * e + d * f,
        a * h + b * g - c * f + d * e,
    )
    return np.stack(parts, -1)


def exponential(rotation: np.ndarray) -> np.ndarray:
    """Quaternions (…, 4) of rotation vectors (…, 3), rad."""
    angle = np.linalg.norm(rotation, axis=-1, keepdims=True)
    # np.sinc(x) = sin πx / πx is regular at 0.
    return np.concatenate([np.cos(angle / 2), rotation / 2 * np.sinc(angle / (2 * np.pi))], -1)


def logarithm(quaternion: np.ndarray) -> np.ndarray:
    """Rotation vectors (…, 3), rad, of at most half a turn, of quaternions (…, 4)."""
    quaternion = np.where(quaternion[..., :1] < 0, -quaternion, quaternion)
    sine = np.linalg.norm(quaternion[..., 1:], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(sine, quaternion[..., :1])
    return quaternion[..., 1:] * np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 2.0)
