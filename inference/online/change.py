"""Has the body changed? A test on standardised innovations that may alarm at any row, with a bound on false alarms.

Shiryaev–Roberts (Roberts 1966; Pollak 1985, "Optimal detection of a change in distribution"; Tartakovsky, Nikiforov &
Basseville 2014, "Sequential Analysis", chapter 7). While the model holds, innovations are z_t ~ N(0, I). After a
change at row k they are wider, or have a mean of their own; with n entries seen in a row, and S their sum since k,

    wider     B_k(t) = Π_{s=k}^t κ^{−n} exp(½ (1 − κ⁻²) |z_s|²),
    shifted   B_k(t) = Π_i (1 + m_i v)^{−½} exp(½ v S_i² / (1 + m_i v)),    a mean ~ N(0, v) in each entry, m_i rows.

Each is a Bayes factor against no change. Their mean, summed over all k of the last seconds,

    R_t = Σ_{k ≤ t} ½ (B_k^wider(t) + B_k^shifted(t)),

has E[R_t] ≤ t without a change, so that an alarm at R_t ≥ A comes after A rows at the earliest in the mean: A is the
number of rows in the time that is to hold one false alarm. Innovations of a fitted model are not quite standard. They
are divided by ``SLACK``, which is what a fit may be off without an alarm.

Shapes: z (O,), NaN where nothing was seen.
"""

import math

import numpy as np

WIDER, SHIFT = 2.0, 0.25
"""κ, and √v, in standard deviations of an innovation."""
SLACK = 1.1
"""Standard deviations of innovations that count as one."""
SECONDS = 2.0
"""How far back a change may lie that is looked for; an alarm is to come by then."""


class ChangeTest:
    """Alarm when innovations say that the model no longer holds.

    Args:
        rate: rows/s.
        hours: per false alarm, at least, in the mean.

    Raises ValueError for numbers that are not positive.
    """

    def __init__(self, rate: float, hours: float = 2.0):
        if not (rate > 0 and hours > 0):
            raise ValueError(f"expected a positive rate and number of hours, got {rate} and {hours}")
        self.log_threshold = math.log(rate * 3600 * hours)
        self._size = max(2, round(SECONDS * rate))
        self.restart()

    def restart(self) -> None:
        """Forget all rows, as after an alarm, or when the window has started again."""
        self._number = self.since = 0
        self.log_ratio = -math.inf
        self._wider: np.ndarray = np.zeros(0)
        self._sums: np.ndarray = np.zeros((0, 0))
        self._counts: np.ndarray = np.zeros((0, 0))

    def add(self, innovation: np.ndarray) -> bool:
        """Take the innovation (O,) of a row, and return whether there is an alarm.

        ``log_ratio`` is log R_t, and ``since`` the number of rows since the most probable change.
        """
        z = np.asarray(innovation, dtype=float) / SLACK
        seen = np.isfinite(z)
        if not seen.any():
            return False
        if not self._number:
            self._wider = np.full(self._size, -np.inf)
            self._sums, self._counts = (np.zeros((self._size, len(z))) for _ in range(2))
        start = self._number % self._size  # the oldest start makes place for a new one
        self._wider[start], self._sums[start], self._counts[start] = 0.0, 0.0, 0.0
        self._number += 1
        z = np.where(seen, z, 0.0)
        self._wider += 0.5 * (1 - WIDER**-2) * (z**2).sum() - seen.sum() * math.log(WIDER)
        self._sums += z
        self._counts += seen
        scale = 1 + self._counts * SHIFT**2
        shifted = 0.5 * (SHIFT**2 * self._sums**2 / scale - np.log(scale)).sum(-1)
        known = min(self._number, self._size)
        ratios = np.logaddexp(self._wider, shifted)[:known] - math.log(2)
        self.log_ratio = float(np.logaddexp.reduce(ratios))
        self.since = (start - int(ratios.argmax())) % self._size
        return self.log_ratio >= self.log_threshold
