"""What a motion tells of the numbers that inverse dynamics are linear in: base parameters (Gautier & Khalil 1990).

Columns of the regressor, each a link's m, m c or J or a joint's friction or rotor, are taken one by one, those that
add most first (QR with pivoting: Gautier 1991). What adds nothing is known with others alone, in the combination that
its column is. A base parameter's sd follows from what the torques leave, as correlated as its window makes it.

Shapes: R rows, K joints, P columns.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg

from invdyn.diagnosis.check.torque_regression import Motion, joint_regressors
from invdyn.diagnosis.regression.regressors import base_columns, link_names, link_regressors, nominal_link_numbers
from invdyn.models.dynamics.interface import Dynamics


@dataclass(frozen=True)
class BaseParameter:
    """What is known together: `parts`, name → factor, the first of which is 1; its nominal value, sd and unit."""

    parts: dict[str, float]
    value: float
    sd: float
    unit: str

    @property
    def words(self) -> str:
        """Such as "m·c of upper + 0.3 m of fore"."""
        (first, _), *rest = self.parts.items()
        return first + "".join(f" {'+' if f > 0 else '−'} {abs(f):.3g} × {name}" for name, f in rest)


def excited(dynamics: Dynamics, body: Any, motion: Motion, by_joint: np.ndarray) -> list[BaseParameter]:
    """Base parameters along a motion, best known first; ``by_joint`` (K,) is the share of torque that is left."""
    names, units, values = _named(body)
    size = np.sqrt((motion.torque**2).mean(0))
    if not size.any():  # nothing was measured that noise could be a share of
        return []
    noise = np.maximum(by_joint, motion.rules.check.min_noise_share) * np.maximum(size, 0.01 * size.max())
    X = np.concatenate([link_regressors(dynamics, body, motion), joint_regressors(motion)]) / noise
    rows = X.reshape(len(X), -1).T
    base, rest, combined = base_columns(rows)
    own = np.linalg.qr(rows[:, base], mode="r")
    inverse = scipy.linalg.solve_triangular(own, np.eye(len(base)))
    # rows of a window say the same: one in some ten is news
    sd = np.sqrt((inverse**2).sum(1) * 10)
    found = []
    for i, column in enumerate(base):
        parts, value = {names[column]: 1.0}, values[column]
        for j, other in enumerate(rest):
            if abs(combined[i, j]) > 1e-9:
                value += combined[i, j] * values[other]
                if abs(combined[i, j] * values[other]) > motion.rules.check.min_part * abs(values[column]):
                    parts[names[other]] = float(combined[i, j])
        found.append(BaseParameter(parts, float(value), float(sd[i]), units[column]))
    return sorted(found, key=lambda each: each.sd / max(abs(each.value), 1e-12))


def _named(body: Any) -> tuple[list[str], list[str], np.ndarray]:
    """Names, units and nominal values (P,) of the columns."""
    own = nominal_link_numbers(body)
    links = [(f"{kind} of {link}", unit) for kind, unit in link_names(body, own) for link in body.link_names]
    besides = (("damping", "N·m·s/rad"), ("dry friction", "N·m"), ("rotor inertia", "kg·m²"))
    joints = [(f"{kind} at {joint}", unit) for kind, unit in besides for joint in body.joint_names]
    names, units = zip(*links, *joints, strict=True)
    return list(names), list(units), np.concatenate([*(each.ravel() for each in own), np.zeros(len(joints))])
