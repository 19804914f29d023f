"""Reality as Pinocchio's equations and our own integrator simulate it: the second generator.

Featherstone's articulated-body algorithm (Rigid Body Dynamics Algorithms, Springer 2008, ch. 7) as Pinocchio has it
(Carpentier et al., IEEE SII 2019), and the classical Runge–Kutta method of order 4 in steps of at most 2 ms, or of a
twentieth of the fastest swing's inverse angular frequency, or of what a mechanism asks for by `resolve`.

Dry friction that is hard (`dry`) brings the joint to rest at the end of each step h, as far as its level L allows
(Moreau's time stepping, 1988): f = clip(−(q̇/h + a)/A, ±L). Here a is the acceleration without it, and A the joint's
mobility. Several joints take turns (Gauss–Seidel).

Shapes: K joints, S ≥ K hinges, N steps, C command rows. SI units, radians.
"""

from collections.abc import Callable

import numpy as np

from invdyn.blindcheck.pinocchio.dynamics import Dynamics
from invdyn.models import Body

MAX_STEP = 2e-3  # s
MAX_DRY_STEP = 5e-4  # s, where there is dry friction
MAX_CHANGE_PER_STEP = 0.2  # radians or e-folds that a mechanism may change in a step
MAX_FRICTION_SWEEPS = 100  # over dry joints
FRICTION_TOLERANCE = 1e-9  # share of the largest that frictions change by in the last sweep
MAX_SWING_FRACTION = 0.05  # a step's share of the inverse angular frequency of the fastest swing

Force = Callable[[float, np.ndarray, np.ndarray, np.ndarray, list[int]], None]
"""(t, q (S,), q̇ (S,), torque (S,), hinges (K,) of the joints): adds to the torque, N·m, in place."""
Level = Callable[[float, float, float], float]
"""(q, q̇, load N·m) → N·m: the load is what the motor gives, less what gravity and rotation exert on the joint."""


class World(Dynamics):
    """A body under Pinocchio, open to mechanisms until its first run. Raises as `Dynamics`."""

    def __init__(self, body: Body):
        super().__init__(body)
        self.lags: dict[int, float] = {}  # joint → s
        self._lagged: dict[int, float] = {}
        self._rates: list[Callable[[np.ndarray], float]] = []
        self._forces: list[Force] = []
        self._drives: list[tuple[int, Callable[[float, float, bool], float]]] = []
        self._begins: list[Callable] = []
        self._dry: list[tuple[int, Level, float]] = []

    def resolve(self, rate: Callable[[np.ndarray], float]) -> None:
        """Choose steps that follow what changes at a rate, 1/s, given the joints' mobilities (K,), 1/(kg·m²)."""
        self._rates.append(rate)

    def force(self, act: Force) -> None:
        """Register torques that depend on time, angles and velocities, smoothly or nearly so."""
        self._forces.append(act)

    def law(self, joint: int, torque: Callable[[float, np.ndarray, np.ndarray], float]) -> None:
        """Register a joint's torque(t, q, qd), N·m, at the body's angles q and velocities qd (K,)."""

        def act(t: float, x: np.ndarray, v: np.ndarray, tau: np.ndarray, at: list[int]) -> None:
            tau[at[joint]] += torque(t, x[at], v[at])

        self.force(act)

    def drive(self, joint: int, of: Callable[[float, float, bool], float]) -> None:
        """Register what a joint's motor makes of a row's command, of(u, seconds, whether it is the first), in turn."""
        self._drives.append((joint, of))

    def each_step(self, joint: int, act: Callable[[float, float, float], None]) -> None:
        """Register act(t, seconds, qd), called before each step with a joint's velocity."""
        self.begin(lambda t, h, x, v, at: act(t, h, v[at[joint]]))

    def hang(self, mass: float, length: float, inertia: float, stiffness: float, damping: float) -> None:
        """Hang a weight on a sprung hinge of its own at the last tip."""
        self.add_weight(mass, length, inertia)

        def act(t: float, x: np.ndarray, v: np.ndarray, tau: np.ndarray, at: list[int]) -> None:
            tau[-1] -= stiffness * x[-1] + damping * v[-1]

        self.force(act)

    def begin(self, act: Callable[[float, float, np.ndarray, np.ndarray, list[int]], None]) -> None:
        """Register `act(t, h, q, q̇, hinges)`, called before each step of h seconds."""
        self._begins.append(act)

    def dry(self, joint: int, level: Level, creep: float = 0.0) -> None:
        """Register dry friction of a `level`; hard, or L tanh(|q̇|/creep), which never sticks."""
        self._dry.append((joint, level, creep))

    def compile(self) -> None:
        """Build the model, and choose the step."""
        super().compile()
        longest = [MAX_STEP, MAX_SWING_FRACTION / self.fastest_swing(), *([MAX_DRY_STEP] if self._dry else [])]
        mobility = self.mobility()
        self._longest = min([*longest, *(MAX_CHANGE_PER_STEP / max(rate(mobility), 1e-9) for rate in self._rates)])

    def _longest_step(self, replayed: bool) -> float:
        return self._longest

    def _advance(
        self, first: int, time: np.ndarray, step: float, row: np.ndarray, lasts: float, q: np.ndarray, qd: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        path, speed = np.empty((2, len(time), len(q)))
        if first == 0:
            self._lagged, self._motor = {}, np.zeros(len(q))
        if lasts:
            self._motor[self.at] = self._wanted = self._driven(row, lasts, first == 0)
        with np.errstate(all="ignore"):  # a run that diverges overflows before it is stopped
            for n, t in enumerate(time):
                path[n], speed[n] = q, qd = self._step(t, step, q, qd, self._motor)
        return path, speed

    def _driven(self, row: np.ndarray, interval: float, first: bool) -> np.ndarray:
        """What the motors give in a row, (K,); where a drive lags, what it tends to."""
        u = row.copy()
        for joint, of in self._drives:
            u[joint] = of(u[joint], interval, first)
        for joint in self.lags:
            self._lagged.setdefault(joint, u[joint])  # settled at first
        return u

    def _step(self, t: float, h: float, x: np.ndarray, v: np.ndarray, motor: np.ndarray) -> tuple[np.ndarray, ...]:
        for joint, lag in self.lags.items():  # the mean over the step of an exponential approach
            gap, share = self._lagged[joint] - self._wanted[joint], -np.expm1(-h / lag)
            motor[self.at[joint]] = self._wanted[joint] + gap * share * lag / h
            self._lagged[joint] -= gap * share
        for act in self._begins:
            act(t, h, x, v, self.at)
        torque = motor if not self._dry else motor + self._friction(t, h, x, v, motor)
        a1 = self._acceleration(t, x, v, torque)
        v2 = v + h / 2 * a1
        a2 = self._acceleration(t + h / 2, x + h / 2 * v, v2, torque)
        v3 = v + h / 2 * a2
        a3 = self._acceleration(t + h / 2, x + h / 2 * v2, v3, torque)
        v4 = v + h * a3
        a4 = self._acceleration(t + h, x + h * v3, v4, torque)
        return x + h / 6 * (v + 2 * (v2 + v3) + v4), v + h / 6 * (a1 + 2 * (a2 + a3) + a4)

    def _acceleration(self, t: float, x: np.ndarray, v: np.ndarray, motor: np.ndarray) -> np.ndarray:
        torque = motor.copy()
        for act in self._forces:
            act(t, x, v, torque, self.at)
        return self.pin.aba(self.model, self.data, x, v, torque)

    def _friction(self, t: float, h: float, x: np.ndarray, v: np.ndarray, motor: np.ndarray) -> np.ndarray:
        """Dry frictions (S,), N·m, constant over a step."""
        a, friction = self._acceleration(t, x, v, motor), np.zeros(len(x))
        load = motor + self.pin.nonLinearEffects(self.model, self.data, x, v)
        columns = []
        for joint, *_ in self._dry:
            more = motor.copy()
            more[self.at[joint]] += 1.0
            columns.append(self._acceleration(t, x, v, more) - a)
        for _ in range(MAX_FRICTION_SWEEPS):
            before = friction.copy()
            for (joint, level, creep), column in zip(self._dry, columns, strict=True):
                s = self.at[joint]
                faster = v[s] + h / 2 * a[s]
                most = level(x[s] + h / 2 * v[s], faster, load[s]) * (np.tanh(abs(faster) / creep) if creep else 1.0)
                new = min(max(friction[s] - (v[s] / h + a[s]) / column[s], -most), most)
                a = a + (new - friction[s]) * column
                friction[s] = new
            if np.abs(friction - before).max() <= FRICTION_TOLERANCE * np.abs(friction).max():
                break
        return friction
