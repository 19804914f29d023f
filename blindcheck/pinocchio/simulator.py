"""Reality as Pinocchio's equations and our own integrator play it: the second generator, with conventions of its own.

Featherstone's articulated-body algorithm (Rigid Body Dynamics Algorithms, Springer 2008, ch. 7) as Pinocchio has it
(Carpentier et al., IEEE SII 2019), and the classical Runge–Kutta method of order 4 in steps of at most 2 ms, or of a
twentieth of the fastest swing's inverse angular frequency, or of what a mechanism asks for by `resolve`.

The arm moves in a robot's x–z plane. Angles φ are its own: that of the first joint counts from hanging, those of the
others between the two links, π where they are stretched out. With θ those of `invdyn.models.Body`,

    θ₀ = φ₀ − π/2,     θₖ = π − φₖ     (σ = 1, zero −π/2; σ = −1, zero π; hidden hinges σ = 1, zero 0)

Dry friction that is hard (`dry`) is, over each step h, the force that brings the joint to rest at the step's end, as
far as its level L allows (Moreau's time stepping, 1988):  f = clip(−(φ̇/h + a)/A, ±L), a the acceleration without it,
A the joint's mobility; several joints in turn (Gauss–Seidel).

Shapes: K joints, S ≥ K hinges, N steps, C command rows. SI units, radians.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from invdyn.blindcheck.motion import EARTH
from invdyn.blindcheck.simulator import FASTEST, Trajectory
from invdyn.models import Body

LONGEST_STEP = 2e-3  # s
DRY_STEP = 5e-4  # s, where there is dry friction
FOLLOWED = 0.2  # radians or e-folds that a mechanism may change in a step
SWEEPS, SETTLED = 100, 1e-9  # over dry joints at most; until they change by less than such a share
SWING_SHARE = 0.05  # a step's share of the inverse angular frequency of the fastest swing

Force = Callable[[float, np.ndarray, np.ndarray, np.ndarray, list[int]], None]
"""(t, φ (S,), φ̇ (S,), torque (S,), hinges (K,) of the joints): adds to the torque, N·m, in place."""
Level = Callable[[float, float, float], float]
"""(φ, φ̇, load N·m) → N·m: the load is what the motor gives, less what gravity and rotation exert on the joint."""
Policy = Callable[[int, float, np.ndarray, np.ndarray], np.ndarray]


@dataclass
class Piece:
    """One rigid piece behind a hinge, in metres and kilograms; `joint` that drives it, `tip` at its end, or None."""

    length: float
    mass: float
    com: float
    inertia: float
    joint: int | None = None
    tip: int | None = None
    sign: float = 1.0
    zero: float = 0.0


class World:
    """A body under Pinocchio, open to mechanisms until its first run.

    Raises ImportError, with what to install, when Pinocchio is missing.
    """

    def __init__(self, body: Body):
        self.pin = _pinocchio()
        self.num_joints = body.num_joints
        self.base, self.gravity = np.array(body.base), np.array(body.gravity)
        self.pieces = [
            Piece(
                *(link.nominal(key) for key in ("length", "mass", "com", "inertia")),
                joint=k,
                tip=k,
                sign=-1.0 if k else 1.0,
                zero=np.pi if k else -np.pi / 2,
            )
            for k, link in enumerate(body.links)
        ]
        self.base_shift: Callable[[np.ndarray], np.ndarray] | None = None  # t (N,) → displacement (N, 2)
        self.rotors: dict[int, float] = {}  # joint → kg·m² beside the links'
        self.lags: dict[int, float] = {}  # joint → s
        self.rows: list[np.ndarray] = []  # commands of this run so far, (K,) each
        self._rates: list[Callable[[np.ndarray], float]] = []
        self._forces: list[Force] = []
        self._shapes: list[tuple[int, Callable[[float, float], float]]] = []
        self._begins: list[Callable] = []
        self._dry: list[tuple[int, Level, float]] = []
        self.model: Any = None

    def resolve(self, rate: Callable[[np.ndarray], float]) -> None:
        """Ask for steps that follow what changes at a rate, 1/s, given the joints' mobilities (K,), 1/(kg·m²)."""
        self._rates.append(rate)

    def force(self, act: Force) -> None:
        """Register torques that depend on time, angles and velocities, smoothly or nearly so."""
        self._forces.append(act)

    def torque(self, joint: int, of: Callable[[float, float, float], float]) -> None:
        """Register a joint's own torque (t, φ, φ̇) → N·m, that turns φ."""

        def act(t: float, q: np.ndarray, v: np.ndarray, tau: np.ndarray, at: list[int]) -> None:
            tau[at[joint]] += of(t, q[at[joint]], v[at[joint]])

        self.force(act)

    def shape(self, joint: int, of: Callable[[float, float], float]) -> None:
        """Register what a joint's drive makes of a row's command: (u, interval s) → u, called once a row, in turn."""
        self._shapes.append((joint, of))

    def begin(self, act: Callable[[float, float, np.ndarray, np.ndarray, list[int]], None]) -> None:
        """Register `act(t, h, φ, φ̇, hinges)`, called before each step of h seconds."""
        self._begins.append(act)

    def dry(self, joint: int, level: Level, creep: float = 0.0) -> None:
        """Register dry friction of a `level`; hard, or L tanh(|φ̇|/creep), which never sticks."""
        self._dry.append((joint, level, creep))

    @property
    def possible(self) -> bool:
        """Whether every piece has a mass, and none a negative inertia."""
        return all(piece.mass > 0 and piece.inertia >= 0 for piece in self.pieces)

    def own(self, joint: int, angle: float) -> float:
        """φ at a body's angle θ of a joint."""
        piece = self.pieces[self.hinge(joint)]
        return piece.sign * (angle - piece.zero)

    def sign(self, joint: int) -> float:
        """dφ/dθ of a joint: 1 or −1."""
        return self.pieces[self.hinge(joint)].sign

    def hinge(self, joint: int) -> int:
        """Index of the hinge that a joint's motor drives."""
        return next(s for s, piece in enumerate(self.pieces) if piece.joint == joint)

    def compile(self) -> None:
        """Build Pinocchio's model; later changes by mechanisms do nothing."""
        pin = self.pin
        model, parent, offset = pin.Model(), 0, np.zeros(3)
        for s, piece in enumerate(self.pieces):
            turned = np.array(
                [[np.cos(piece.zero), 0, -np.sin(piece.zero)], [0, 1, 0], [np.sin(piece.zero), 0, np.cos(piece.zero)]]
            )
            hinge = pin.JointModelRevoluteUnaligned(np.array([0.0, -piece.sign, 0.0]))
            parent = model.addJoint(parent, hinge, pin.SE3(turned, offset), f"hinge{s}")
            about = np.eye(3) * max(piece.inertia, 1e-14)  # about x and z nothing turns
            model.appendBodyToJoint(
                parent, pin.Inertia(piece.mass, np.array([piece.com, 0.0, 0.0]), about), pin.SE3.Identity()
            )
            offset = np.array([piece.length, 0.0, 0.0])
        model.gravity.linear = np.array([self.gravity[0], 0.0, self.gravity[1]])
        own = np.zeros(model.nv)
        for joint, inertia in self.rotors.items():
            own[self.hinge(joint)] += inertia
        model.armature = own
        self.model, self.data = model, model.createData()
        self._at = [self.hinge(k) for k in range(self.num_joints)]
        self._signs = np.array([piece.sign for piece in self.pieces])
        self._zeros = np.array([piece.zero for piece in self.pieces])
        longest = [LONGEST_STEP, SWING_SHARE / self._fastest_swing(), *([DRY_STEP] if self._dry else [])]
        mobility = self._mobility() if self._rates else None
        self._longest = min([*longest, *(FOLLOWED / max(rate(mobility), 1e-9) for rate in self._rates)])

    def run(
        self,
        command_time: np.ndarray,
        policy: Policy,
        q: Sequence[float] | np.ndarray,
        qd: Sequence[float] | np.ndarray,
        restart: tuple[Trajectory, float] | None = None,
    ) -> Trajectory:
        """Simulate from the first to the last of the evenly spaced `command_time` (C,), as `simulator.World.run`."""
        if self.model is None:
            self.compile()
        interval = (command_time[-1] - command_time[0]) / (len(command_time) - 1)
        per_row = int(np.ceil(interval / self._longest - 1e-9))
        h = interval / per_row
        total = (len(command_time) - 1) * per_row
        time = command_time[0] + h * np.arange(total + 1)
        window = total + 1 if restart is None else max(1, round(restart[1] / h))
        at, signs = self._at, self._signs
        path, speed = np.full((total + 1, len(signs)), np.nan), np.full((total + 1, len(signs)), np.nan)
        given = np.full((len(command_time), self.num_joints), np.nan)
        self.rows, self._lagged, motor = [], {}, np.zeros(len(signs))
        x, v = self._state(q, qd)
        with np.errstate(all="ignore"):  # a run that diverges overflows before it is stopped
            for i in range(total + 1):
                if restart is not None and i and i % window == 0:
                    true = restart[0]
                    states = (
                        [np.interp(time[i], true.time, each) for each in given_.T] for given_ in (true.q, true.qd)
                    )
                    x, v = self._state(*states)
                if not np.abs(v).max() < FASTEST:
                    break
                path[i], speed[i] = x, v
                if i % per_row == 0:
                    joints = signs[at] * x[at] + self._zeros[at], signs[at] * v[at]
                    given[i // per_row] = policy(i // per_row, time[i], *joints)
                    self._command(given[i // per_row], interval, motor)
                if i < total:
                    x, v = self._advance(time[i], h, x, v, motor)
        return self._trajectory(time, path, speed, command_time, given)

    def inverse(self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        """Torques (N, S), N·m, of motions (N, S) in the body's angles; mechanisms' forces are left out."""
        if self.model is None:
            self.compile()
        x, v, a = self._signs * (q - self._zeros), self._signs * qd, self._signs * qdd
        return self._signs * np.array([self.pin.rnea(self.model, self.data, *row) for row in zip(x, v, a, strict=True)])

    def inertia(self, q: np.ndarray) -> np.ndarray:
        """The inertia matrix, kg·m² (S, S), at a posture (S,) in the body's angles."""
        if self.model is None:
            self.compile()
        upper = np.triu(self.pin.crba(self.model, self.data, self._signs * (q - self._zeros)))
        return np.outer(self._signs, self._signs) * (upper + np.triu(upper, 1).T)

    def energy(self, q: np.ndarray, qd: np.ndarray) -> float:
        """Kinetic and potential energy, J, at a posture and velocity (S,) in the body's angles."""
        if self.model is None:
            self.compile()
        x, v = self._signs * (q - self._zeros), self._signs * qd
        kinetic = self.pin.computeKineticEnergy(self.model, self.data, x, v)
        return float(kinetic + self.pin.computePotentialEnergy(self.model, self.data, x))

    def _state(self, q: Sequence[float] | np.ndarray, qd: Sequence[float] | np.ndarray) -> tuple[np.ndarray, ...]:
        x, v = np.zeros(len(self.pieces)), np.zeros(len(self.pieces))
        x[self._at] = self._signs[self._at] * (np.asarray(q) - self._zeros[self._at])
        v[self._at] = self._signs[self._at] * np.asarray(qd)
        return x, v

    def _command(self, row: np.ndarray, interval: float, motor: np.ndarray) -> None:
        """What the motors give in a row, into `motor` (S,); where a drive lags, what it tends to."""
        self.rows.append(row)
        u = row.copy()
        for joint, of in self._shapes:
            u[joint] = of(u[joint], interval)
        for joint in self.lags:
            self._lagged.setdefault(joint, u[joint])  # settled at first
        self._wanted = u
        motor[self._at] = self._signs[self._at] * u

    def _advance(self, t: float, h: float, x: np.ndarray, v: np.ndarray, motor: np.ndarray) -> tuple[np.ndarray, ...]:
        for joint, lag in self.lags.items():  # the mean over the step of an exponential approach
            gap, share = self._lagged[joint] - self._wanted[joint], -np.expm1(-h / lag)
            motor[self._at[joint]] = self._signs[self._at[joint]] * (self._wanted[joint] + gap * share * lag / h)
            self._lagged[joint] -= gap * share
        for act in self._begins:
            act(t, h, x, v, self._at)
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
            act(t, x, v, torque, self._at)
        return self.pin.aba(self.model, self.data, x, v, torque)

    def _friction(self, t: float, h: float, x: np.ndarray, v: np.ndarray, motor: np.ndarray) -> np.ndarray:
        """Dry frictions (S,), N·m, held over a step."""
        a, friction = self._acceleration(t, x, v, motor), np.zeros(len(x))
        load = motor + self.pin.nonLinearEffects(self.model, self.data, x, v)
        columns = []
        for joint, *_ in self._dry:
            more = motor.copy()
            more[self._at[joint]] += 1.0
            columns.append(self._acceleration(t, x, v, more) - a)
        for _ in range(SWEEPS):
            before = friction.copy()
            for (joint, level, creep), column in zip(self._dry, columns, strict=True):
                s = self._at[joint]
                faster = v[s] + h / 2 * a[s]
                most = level(x[s] + h / 2 * v[s], faster, load[s]) * (np.tanh(abs(faster) / creep) if creep else 1.0)
                new = min(max(friction[s] - (v[s] / h + a[s]) / column[s], -most), most)
                a = a + (new - friction[s]) * column
                friction[s] = new
            if np.abs(friction - before).max() <= SETTLED * np.abs(friction).max():
                break
        return friction

    def _mobility(self) -> np.ndarray:
        """The largest mobilities (K,), 1/(kg·m²), of the joints, stretched out and folded at right angles."""
        bent = np.array([0.0 if piece.joint is None else np.pi / 2 for piece in self.pieces])
        inverses = [np.linalg.inv(self.inertia(q) + np.diag(self.model.armature)) for q in (0 * bent, bent)]
        return np.max([np.diagonal(each)[self._at] for each in inverses], axis=0)

    def _fastest_swing(self) -> float:
        """The highest angular frequency, rad/s, at which the arm swings about hanging straight, under 9.81 m/s²."""
        lengths, masses, coms = (np.array([getattr(p, key) for p in self.pieces]) for key in ("length", "mass", "com"))
        beyond = masses * coms + lengths * (masses.sum() - np.cumsum(masses))
        straight = np.where(np.arange(len(lengths)) == 0, -np.pi / 2, 0.0)
        absolute = np.tril(np.ones((len(lengths), len(lengths))))  # headings of hinge angles
        stiffness = EARTH * absolute.T @ np.diag(beyond) @ absolute
        driven = [s for s in range(len(lengths)) if self.pieces[s].joint is not None]
        pick = np.ix_(driven, driven)
        square = np.linalg.eigvals(np.linalg.solve(self.inertia(straight)[pick], stiffness[pick])).real.max()
        return float(np.sqrt(max(square, 1e-6)))

    def _trajectory(
        self, time: np.ndarray, path: np.ndarray, speed: np.ndarray, command_time: np.ndarray, given: np.ndarray
    ) -> Trajectory:
        angle = self._signs * path + self._zeros
        heading = np.cumsum(angle, axis=1)
        lengths = np.array([piece.length for piece in self.pieces])
        steps = lengths[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
        tips = [s for s, piece in enumerate(self.pieces) if piece.tip is not None]
        base = np.broadcast_to(self.base, (len(time), 1, 2))
        points = np.concatenate([base, base + np.cumsum(steps, axis=1)[:, tips]], axis=1)
        if self.base_shift is not None:
            points = points + self.base_shift(time)[:, None]
        turned = angle[:, self._at], (self._signs * speed)[:, self._at]
        return Trajectory(time, *turned, points, heading[:, tips], np.asarray(command_time), given)


def _pinocchio() -> Any:
    try:
        import pinocchio
    except ImportError as error:
        raise ImportError("this reality needs Pinocchio: pip install 'invdyn[robots]'") from error
    return pinocchio
