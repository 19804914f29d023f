"""How much a motion is expected to tell of what a robot's file may lack.

Effects that torque is linear in, β ~ N(0, S²), are seen along a motion in torques with noise of σ_j N·m a row. The
expected information about them, in nats, is the mutual information of a linear Gaussian model (Lindley 1956; Bayesian
D-optimality: Chaloner & Verdinelli 1995),

    I = ½ log |1 + S Xᵀ W X S|,     posterior covariance S (1 + S Xᵀ W X S)⁻¹ S

with W of independent rows: torque's errors are remembered for 1/20 s, so that a second counts for 20 of them. Where
some effects are in question, the others are not known either: I is that of all, less that of the others alone.

    viscous q̇     Coulomb tanh(q̇/v)     rotor q̈     spring q − q̄     constant 1     gain τ_file     link Y(q, q̇, q̈)

S is a tenth of the torque that a joint's load is, at its limit of speed, acceleration and half of its range; of a
link's mass, moment and inertia .3 of what the file has.

Shapes: R rows, K joints, P columns. Units: rad, s, N·m.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from invdyn.diagnosis.catalogue.linear_laws import INERTIAL, JOINT_KINDS, SHOWN_BY
from invdyn.diagnosis.excite.limits import MotionLimits
from invdyn.diagnosis.excite.trajectory import Path
from invdyn.diagnosis.regression.regressors import (
    filed_torques,
    link_names,
    link_torques,
    nominal_link_numbers,
    unit_numbers,
)
from invdyn.diagnosis.rules import DEFAULT, FIXED
from invdyn.models import Body
from invdyn.models.dynamics.registry import dynamics_for
from invdyn.models.effects.scale import typical_torque


@dataclass(frozen=True)
class Column:
    """One number of an effect: `effect`, `place`, `name`, `unit`, and the sd `size` of its prior."""

    effect: str
    place: str
    name: str
    unit: str
    size: float


class Information:
    """What motions of a body tell, in ``noise`` (K,) N·m of its torques; by default a fiftieth of the load.

    ``about`` names effects in question, keys of ``JOINT_KINDS`` or ``INERTIAL``; all if none.
    """

    def __init__(
        self, body: Body, limits: MotionLimits, about: Sequence[str] = (), noise: np.ndarray | float | None = None
    ):
        self.body, self.joint_names = body, body.joint_names
        self.dynamics, self.numbers = dynamics_for(body), body.parameters()
        self.units = unit_numbers(body)
        load = typical_torque(self.dynamics, self.numbers).double()
        self.load = torch.maximum(load, FIXED.excite_least_load * load.max())
        given = FIXED.excite_noise * self.load if noise is None else torch.as_tensor(noise, dtype=torch.float64)
        self.noise = given.expand(len(self.load))
        self.slow = FIXED.excite_slow * torch.as_tensor(limits.speed)
        self.columns = self._columns(body, limits)
        self.about = torch.tensor([not about or each.effect in about for each in self.columns])

    def _columns(self, body: Body, limits: MotionLimits) -> list[Column]:
        one, half, load = np.ones_like(limits.speed), np.maximum(limits.half, 1e-3), self.load.numpy()
        largest = (limits.speed, one, limits.acceleration, half, one, load)
        found = []
        for (kind, ((name, unit), *_)), size in zip(JOINT_KINDS.items(), largest, strict=True):
            sizes = FIXED.excite_share * load / size
            found += [Column(kind, j, name, unit, float(s)) for j, s in zip(body.joint_names, sizes, strict=True)]
        own = nominal_link_numbers(body)
        sizes = []
        for each in own:
            floor = FIXED.min_link_share * max(float(np.abs(each).max()), 1e-12)
            sizes += list(FIXED.excite_link_share * np.maximum(np.abs(each).ravel(), floor))
        labels = [(link, name, unit) for name, unit in link_names(body, own) for link in body.link_names]
        return found + [Column(INERTIAL, *label, float(s)) for label, s in zip(labels, sizes, strict=True)]

    def torque(self, path: Path) -> Tensor:
        """What the file asks for along a motion, its joints' friction, rotors and springs in it, (R, K) N·m."""
        own = filed_torques(self.body, *path, self._sign(path))
        return self.dynamics.inverse(*path, self.numbers) + torch.stack(own, -1)

    def _sign(self, path: Path) -> Tensor:
        return (path.qd / self.slow).tanh()

    def precision(self, path: Path, seconds: float) -> Tensor:
        """S Xᵀ W X S (P, P) of a motion; differentiable."""
        q, qd, qdd = path
        whole = self.torque(path)
        own = [qd, self._sign(path), qdd, q - q.mean(0), torch.ones_like(q), whole]
        X = torch.cat([torch.diag_embed(each).movedim(-1, 0) for each in own])  # (6 K, R, K)
        if self.units is not None:
            X = torch.cat([X, link_torques(self.dynamics, self.units, *path)])
        size = torch.tensor([each.size for each in self.columns], dtype=torch.float64)
        count = DEFAULT.residual.residual_decay * seconds / len(q)  # independent rows that one stands for
        X = (X * size[:, None, None] * count**0.5 / self.noise).flatten(1)
        return X @ X.T

    def nats(self, precision: Tensor) -> Tensor:
        """Expected information about the question."""
        whole = _log_det(precision)
        other = ~self.about
        return 0.5 * (whole - _log_det(precision[other][:, other]) if other.any() else whole)

    def sds(self, precision: Tensor) -> np.ndarray:
        """(P,) posterior sds, of the columns' own units."""
        A = precision.detach() + torch.eye(len(precision), dtype=torch.float64)
        share = torch.linalg.inv(A).diagonal().clamp_min(0).sqrt()
        return np.array([each.size for each in self.columns]) * share.numpy()


def _log_det(precision: Tensor) -> Tensor:
    return torch.linalg.cholesky(precision + torch.eye(len(precision), dtype=torch.float64)).diagonal().log().sum() * 2


KINDS = (*JOINT_KINDS, INERTIAL)
"""Effects that columns are of."""


def kinds_of(names: Sequence[str]) -> list[str]:
    """Which kinds of columns tell of effects of the catalogue, by their ``names``."""
    found = [SHOWN_BY.get(name, name) for name in names]
    return [kind for kind in KINDS if kind in found]
