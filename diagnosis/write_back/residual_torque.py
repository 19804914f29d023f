"""No cause: what no effect explains, as a torque at each joint that depends on its own angle and velocity.

    r(x) ~ GP(0, s² exp(−½ Σ ((x − x')/ℓ)²)),   x = (q, q̇) of the joint,   y = r(x) + e,   e of variance σ²
    y = τ_required − τ_given                                  of the simulation as it is, or as it was corrected

of all rows by M of them, z (Rasmussen & Williams 2006, eq. 8.14 and 8.15, DTC; C is k/s²):

    r(x) = c(x, z) w,   w = (C_zz/ρ + C_zx C_xz)⁻¹ C_zx y,   ρ = s²/σ²
    var r = s² (1 − c(x, z) P c(z, x)),   P = C_zz⁻¹ − (C_zz + ρ C_zx C_xz)⁻¹

The lengths ℓ, of which an infinite one leaves a variable out, and ρ are those that predict parts of the log best from
its other parts. A joint of which nothing predicts unseen rows better than zero has no residual torque. The band is
that of a later row: the variance of r and the mean square of the errors on unseen rows, which need no independence.

Far from the log's angles and velocities r returns to zero, and its band to s. It closes a gap, and names nothing.

Shapes: R rows, K joints. Units: rad, s, N·m, as the robot's own file counts its joints.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from invdyn.diagnosis.regression.linear_effects import required_by_file
from invdyn.diagnosis.regression.measured_motion import measured_motion
from invdyn.diagnosis.rules import DEFAULT, FIXED, Rules
from invdyn.models import ArticulatedBody
from invdyn.models.bodies.joint_parts_mjcf import joint_names
from invdyn.models.dynamics.registry import dynamics_for
from invdyn.recordings import InputError, Recording, write_text


@dataclass(frozen=True)
class JointResidual:
    """The process of one joint.

    Attributes:
        at: (M, 2) z, angles and velocities, and `weights` (M,) w.
        lengths: (2,) ℓ, rad and rad/s.
        precision: (M, M) P.
        size: s, N·m; 0 of a joint without a residual torque.
        error: rms of the errors on rows that were not used, N·m.
        closed: share of the torque missing there that r closes.
    """

    at: np.ndarray
    weights: np.ndarray
    lengths: np.ndarray
    precision: np.ndarray
    size: float
    error: float
    closed: float

    def __call__(self, q: Any, qd: Any) -> tuple[np.ndarray, np.ndarray]:
        """Mean and sd of the torque, N·m, of any shape that angles and velocities have."""
        x = np.stack(np.broadcast_arrays(np.asarray(q, float), np.asarray(qd, float)), -1)
        if self.size == 0:
            return np.zeros(x.shape[:-1]), np.full(x.shape[:-1], self.error)
        near = _kernel(x.reshape(-1, 2), self.at, self.lengths)
        known = 1 - np.einsum("ni,ij,nj->n", near, self.precision, near)
        sd = np.sqrt(self.size**2 * np.maximum(known, 0.0) + self.error**2)
        return (near @ self.weights).reshape(x.shape[:-1]), sd.reshape(x.shape[:-1])


@dataclass(frozen=True)
class ResidualTorque:
    """Residual torques by joint. They are no cause: an engine needs them besides what the diagnosis names."""

    joints: dict[str, JointResidual]
    ranges: dict[str, tuple[float, float, float, float]]

    def to_csv(self, path: str | Path, points: int = 21) -> None:
        """Write a table of joint, q, qd, torque and sd, over the log's least and largest angles and velocities.

        Its first line, a comment that begins with #, says that this is no cause.
        """
        lines = ["# no cause: what no named effect explains", "joint,q,qd,torque,sd"]
        for name, process in self.joints.items():
            low, high, slow, fast = self.ranges[name]
            q, qd = (
                each.ravel() for each in np.meshgrid(*(np.linspace(*e, points) for e in ((low, high), (slow, fast))))
            )
            torque, sd = process(q, qd)
            rows = np.stack([q, qd, torque, sd], -1).tolist()
            lines += [",".join([name, *(f"{value:.7g}" for value in row)]) for row in rows]
        write_text(path, "\n".join(lines) + "\n")

    def control(self, model: Any) -> Callable[[Any, Any], None]:
        """A function (model, data) that sets `qfrc_applied` of a ``mujoco.MjModel``'s joints, whatever is there before.

        For `mujoco.set_mjcb_control`, or a call before each step.
        """
        names = joint_names(model)
        own = [(p, names.index(n)) for n, p in self.joints.items() if p.size > 0]
        places = [(p, int(model.jnt_qposadr[j]), int(model.jnt_dofadr[j])) for p, j in own]

        def callback(_: Any, data: Any) -> None:
            for process, at, dof in places:
                near = _kernel(np.array([[data.qpos[at], data.qvel[dof]]]), process.at, process.lengths)
                data.qfrc_applied[dof] = (near @ process.weights).item()

        return callback


def residual_torque(
    recording: Recording | Sequence[Recording], body: ArticulatedBody, rules: Rules = DEFAULT
) -> ResidualTorque:
    """The torque that the simulation ``body`` still lacks along recordings of it with known torques, as a process.

    Raises InputError where torques are not known, or too few rows show every joint.
    """
    motion = measured_motion(recording, body, rules=rules)
    if motion is None:
        raise InputError("expected recordings with the torques or targets of every joint, got none with enough rows")
    missing = required_by_file(dynamics_for(body), body, motion) - motion.torque
    found, ranges = {}, {}
    for k, (name, own) in enumerate(zip(body.joint_names, body.joint_parts, strict=True)):
        q, qd = own.sign * (motion.q[:, k] - own.zero), own.sign * motion.qd[:, k]
        found[name] = _fitted(np.stack([q, qd], -1), own.sign * missing[:, k])
        ranges[name] = (q.min(), q.max(), qd.min(), qd.max())
    return ResidualTorque(found, ranges)


def _kernel(x: np.ndarray, other: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    return np.exp(-0.5 * (((x[:, None] - other) / lengths) ** 2).sum(-1))


def _fitted(x: np.ndarray, y: np.ndarray) -> JointResidual:
    """The process of rows x (R, 2) and missing torques y (R,)."""
    some = np.unique(np.linspace(0, len(y) - 1, FIXED.residual_points).round().astype(int))
    parts = np.array_split(np.arange(len(y)), FIXED.cross_validation_folds)
    plain = float(np.sqrt((y**2).mean()))
    best: tuple[float, np.ndarray, float] = (plain, np.ones(2), 0.0)
    spread = np.maximum(x.std(0), FIXED.negligible)
    for shares in product(FIXED.residual_lengths, repeat=2):
        points = _among(x, some, lengths := spread * np.array(shares))
        phi = np.linalg.solve(points[0], points[1].T).T
        grams, alongs = [phi[out].T @ phi[out] for out in parts], [phi[out].T @ y[out] for out in parts]
        errors = np.zeros((len(FIXED.residual_ratios), len(y)))
        for out, gram, along in zip(parts, grams, alongs, strict=True):
            own, turn = np.linalg.eigh(sum(grams) - gram)
            seen, rest = phi[out] @ turn, turn.T @ (sum(alongs) - along)
            for n, ratio in enumerate(FIXED.residual_ratios):
                errors[n, out] = y[out] - seen @ (rest / (own + 1 / ratio))
        rms = np.sqrt((errors**2).mean(1))
        if rms.min() < best[0]:
            best = float(rms.min()), lengths, FIXED.residual_ratios[int(rms.argmin())]
    error, lengths, ratio = best
    closed = 1 - error / plain if plain > 0 else 0.0
    if closed < FIXED.min_residual_closed:
        return JointResidual(x[:0], y[:0], lengths, np.zeros((0, 0)), 0.0, plain, 0.0)
    root, across = _among(x, some, lengths)
    own, gram = root @ root.T, across.T @ across
    weights = np.linalg.solve(own / ratio + gram, across.T @ y)
    precision = np.linalg.inv(own) - np.linalg.inv(own + ratio * gram)
    size = float(np.sqrt(ratio) * error)
    return JointResidual(x[some], weights, lengths, precision, size, error, closed)


def _among(x: np.ndarray, some: np.ndarray, lengths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The Cholesky factor of C_zz (M, M), with z ``some`` of the rows x (R, 2), and C_xz (R, M)."""
    across = _kernel(x, x[some], lengths)
    return np.linalg.cholesky(across[some] + FIXED.negligible * np.eye(len(some))), across
