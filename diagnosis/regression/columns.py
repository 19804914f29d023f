"""Columns that a torque is linear in, joint by joint, without those that are zero there.

A joint's own number enters the torque of that joint alone, and a link's those of the joints that move it. So of P
columns each joint k has a few, X_k (P_k, R), and sums over rows are made joint by joint:

    (X β)_k = X_kᵀ β,     XᵀWX = Σ_k X_k W_k X_kᵀ,     XᵀWy = Σ_k X_k W_k y_k

Shapes: R rows, K joints, P columns, p of them chosen, B blocks of neighbouring rows.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Columns:
    """Of each of K joints its `values` (P_k, R), and which of the `number` P they are, `at` (P_k,)."""

    values: tuple[np.ndarray, ...]
    at: tuple[np.ndarray, ...]
    number: int

    def map(self, change: Callable[[np.ndarray], np.ndarray]) -> "Columns":
        """The columns with every (P_k, R) made another."""
        return Columns(tuple(map(change, self.values)), self.at, self.number)

    def and_sums(self, some: np.ndarray, factors: np.ndarray) -> "Columns":
        """With further columns, each the sum of ``some`` (N, n) of them, a column p times ``factors`` (P,)."""
        values, at = list(self.values), list(self.at)
        whole = np.zeros((len(some), self.number))
        np.put_along_axis(whole, some, factors[some], 1)
        for k, (X, own) in enumerate(zip(self.values, self.at, strict=True)):
            there = np.flatnonzero(whole[:, own].any(1))
            values[k] = np.concatenate([X, whole[np.ix_(there, own)] @ X])
            at[k] = np.append(own, self.number + there)
        return Columns(tuple(values), tuple(at), self.number + len(some))

    @property
    def moving(self) -> np.ndarray:
        """(P,) which are not zero everywhere."""
        found = np.zeros(self.number, dtype=bool)
        for X, at in zip(self.values, self.at, strict=True):
            found[at] |= X.any(1)
        return found

    def of(self, column: int, joint: int) -> np.ndarray:
        """A column (R,) at a joint where it is not zero."""
        return self.values[joint][int(np.flatnonzero(self.at[joint] == column)[0])]

    def torque(self, columns: Sequence[int] | np.ndarray, coefficients: np.ndarray) -> np.ndarray:
        """X β (R, K) of some ``columns`` (p,)."""
        beta = np.zeros(self.number)
        beta[list(columns)] = coefficients
        return np.stack([beta[at] @ X for X, at in zip(self.values, self.at, strict=True)], -1)

    def sums(
        self, y: np.ndarray, weights: np.ndarray, rows: slice = slice(None)
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """XᵀWX (K, P, P), XᵀWy (K, P) and yᵀWy (K,) of each joint over some rows of y and W (R, K)."""
        y, weights = y[rows], weights[rows]
        gram, cross = np.zeros((len(self.at), self.number, self.number)), np.zeros((len(self.at), self.number))
        for k, (X, at) in enumerate(zip(self.values, self.at, strict=True)):
            weighted = X[:, rows] * weights[:, k]
            gram[k][np.ix_(at, at)] = weighted @ X[:, rows].T
            cross[k][at] = weighted @ y[:, k]
        return gram, cross, (weights * y**2).sum(0)

    def block_sums(self, y: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """Xᵀy (B, P) of blocks of rows that begin at ``starts`` (B,), of all joints together."""
        found = np.zeros((len(starts), self.number))
        for k, (X, at) in enumerate(zip(self.values, self.at, strict=True)):
            found[:, at] += np.add.reduceat(X * y[:, k], starts, axis=1).T
        return found

    def triangle(self, columns: Sequence[int] | np.ndarray, scale: np.ndarray | None = None) -> np.ndarray:
        """R (≤ p, p) of a QR of some columns, of all joints one below the other; ``scale`` (R, K) multiplies rows."""
        place = np.full(self.number, -1)
        place[list(columns)] = np.arange(len(columns))
        parts = [np.zeros((0, len(columns)))]
        for k, (X, at) in enumerate(zip(self.values, self.at, strict=True)):
            mine = place[at] >= 0
            rows = X[mine] if scale is None else X[mine] * scale[:, k]
            own = np.linalg.qr(rows.T, mode="r")
            parts.append(np.zeros((len(own), len(columns))))
            parts[-1][:, place[at[mine]]] = own
        return np.asarray(np.linalg.qr(np.concatenate(parts), mode="r"))
