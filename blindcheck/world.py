"""What mechanisms change of a body before an engine compiles it, and how a run of it goes in any engine.

Angles and velocities are the body's, of each hinge in the order of the pieces. Shapes: K joints, S ≥ K pieces, N steps,
C command rows, P sites, d dimensions. SI units, radians.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from invdyn.blindcheck.pieces import Piece, pieces_of, sites_at
from invdyn.models import Body

MAX_JOINT_SPEED = 300.0  # rad/s; beyond it the run has diverged


class Trajectory(NamedTuple):
    """What really happened, at the simulator's own rate.

    `time` (N+1,) s; `q`, `qd` (N+1, K); `points` (N+1, P+1, d) m, the base and the sites, of a chain its K tips;
    `heading` (N+1, P) rad, angles of hinges added up as far as the link that has each site; `command_time` (C,) s and
    `command` (C, K) N·m, as given to the actuators.
    """

    time: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    points: np.ndarray
    heading: np.ndarray
    command_time: np.ndarray
    command: np.ndarray


Policy = Callable[[int, float, np.ndarray, np.ndarray], np.ndarray]
"""(row, t in s, q (K,), qd (K,)) → the command of that row, N·m (K,)."""


def even_steps(command_time: np.ndarray, longest: float) -> tuple[int, float, np.ndarray]:
    """Steps a row, seconds each, ``longest`` at most, and their times (N+1,), for evenly spaced rows (C,)."""
    rows = len(command_time) - 1
    interval = (command_time[-1] - command_time[0]) / rows
    each = int(np.ceil(interval / longest - 1e-9))
    return each, interval / each, command_time[0] + interval / each * np.arange(rows * each + 1)


class ChangeableBody(ABC):
    """A body open to mechanisms until its first run. `links` are the pieces that have the links' sites.

    Raises ValueError for joints that are no hinges.
    """

    def __init__(self, body: Body):
        if any(link.joint.type != "hinge" for link in body.links):
            raise ValueError(f"expected hinges alone, got {', '.join(link.joint.type for link in body.links)}")
        hand = body.hand
        assert hand is not None  # every link has a site, and all hang on the first
        self.dimensions, self.num_joints, self.hand = body.dimensions, body.num_joints, hand
        self.keypoint_names = body.keypoint_names
        self.base, self.gravity = np.array(body.base), np.array(body.in_space().gravity)
        self.pieces = pieces_of(body)
        self.links = tuple(self.pieces)
        self.base_shift: Callable[[np.ndarray], np.ndarray] | None = None  # t (N,) → displacement (N, d)
        self.model: Any = None

    @abstractmethod
    def compile(self) -> None:
        """Build the engine's `model`; later changes by mechanisms do nothing."""

    @abstractmethod
    def _longest_step(self, replayed: bool) -> float:
        """Of a run, s; ``replayed`` says that it is taken back to another one's path again and again."""

    @abstractmethod
    def _advance(
        self, first: int, time: np.ndarray, step: float, row: np.ndarray, lasts: float, q: np.ndarray, qd: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Angles and velocities (n, S) after each of n steps from step `first` on, which begin at `time` (n,).

        The command `row` (K,) is a new one that `lasts` so many seconds, or goes on where these are 0.
        """

    def ready(self) -> None:
        """Compile, unless that was done."""
        if self.model is None:
            self.compile()

    @property
    def possible(self) -> bool:
        """Whether every piece has a mass, and moments that obey the triangle inequality.

        A large error of a link may take all of it.
        """
        moments = [np.linalg.eigvalsh(piece.inertia) for piece in self.pieces]
        solid = all(m[0] >= 0 and m[2] <= (m[0] + m[1]) * (1 + 1e-9) for m in moments)
        return solid and all(piece.mass > 0 for piece in self.pieces)

    def hinge(self, joint: int) -> int:
        """Index, among hinges, of the one that a joint's motor drives."""
        return next(s for s, piece in enumerate(self.pieces) if piece.joint == joint and piece.actuated)

    def add_rotor(self, joint: int, share: float) -> Piece:
        """Put a rotor, of a ``share`` of the link's inertia, between a joint's motor and the link; gives the link.

        The rotor has 1e-9 of the link's mass, as no engine lets a moving body have none.
        """
        place, nowhere = self.hinge(joint), np.zeros(3)
        link = self.pieces[place]
        rotor = share * link.inertia
        motor = Piece(link.hinge, link.parent, link.position, 1e-9 * link.mass, nowhere, rotor, joint, actuated=True)
        link.parent, link.position = motor, nowhere
        link.hinge, link.actuated, link.inertia = f"play{joint}", False, link.inertia - rotor
        self.pieces.insert(place, motor)
        return link

    def cut_link(self, link: int, ends: Sequence[float]) -> list[Piece]:
        """Cut a link of the plane between shares of its length, into pieces behind hinges of their own; inmost first.

        They are uniform as far as its inertia allows, and have its mass, centre and inertia together while straight.
        """
        whole, along = self.links[link], np.array([1.0, 0.0, 0.0])
        length, mass, com, moment = whole.tip[0], whole.mass, whole.com, whole.inertia[2, 2]
        shares, starts = np.diff(ends), np.array(ends[:-1]) * length
        middles = (np.array(ends[1:]) + ends[:-1]) / 2
        from_centre = (middles - (shares * middles).sum()) * length

        # centres as far apart as a uniform rod's, nearer where the link has less inertia
        apart = mass * (shares * from_centre**2).sum()
        nearer = min(1.0, np.sqrt(0.8 * moment / apart))
        rest = (moment - nearer**2 * apart) * shares**3 / (shares**3).sum()

        pieces = [*(replace(whole, sites={}) for _ in shares[1:]), whole]
        for n, piece in enumerate(pieces):
            piece.mass, piece.inertia = shares[n] * mass, rest[n] * np.eye(3)
            piece.com = com + (nearer * from_centre[n] - starts[n]) * along
            if n:
                piece.hinge, piece.parent = f"bend{link}.{n}", pieces[n - 1]
                piece.position = (starts[n] - starts[n - 1]) * along
                piece.joint, piece.actuated, piece.damping = None, False, 0.0

        # what it carries, and its own end, count from its last piece now
        for piece in self.pieces:
            if piece.parent is whole:
                piece.position = piece.position - starts[-1] * along
        whole.sites = {name: at - starts[-1] * along for name, at in whole.sites.items()}
        place = self.pieces.index(whole)
        self.pieces[place:place] = pieces[:-1]
        return pieces

    def add_weight(self, mass: float, length: float, inertia: float) -> None:
        """Hang a weight on a hinge of its own at the last tip."""
        last, far = self.links[-1], np.array([length, 0.0, 0.0])
        self.pieces.append(Piece("hung", last, last.tip, mass, far, inertia * np.eye(3)))

    def run(
        self,
        command_time: np.ndarray,
        policy: Policy,
        q: Sequence[float] | np.ndarray,
        qd: Sequence[float] | np.ndarray,
        restart: tuple[Trajectory, float] | None = None,
    ) -> Trajectory:
        """Simulate from the first to the last of the evenly spaced `command_time` (C,).

        The command of row c acts from its time to the next row's. `restart` = (trajectory, period s): take q and qd
        from that trajectory again after every period, which keeps a replay from running away.
        A run that diverges is NaN from there on.
        """
        self.ready()
        per_row, step, time = even_steps(command_time, self._longest_step(restart is not None))
        total = len(time) - 1
        window = total + 1 if restart is None else max(1, round(restart[1] / step))
        joint_of = np.array([[p.joint == k for p in self.pieces] for k in range(self.num_joints)], dtype=float)
        path, speed = np.full((2, total + 1, len(self.pieces)), np.nan)
        rows = np.full((len(command_time), self.num_joints), np.nan)
        path[0], speed[0] = self._of_hinges(q), self._of_hinges(qd)
        stops = sorted({*range(0, total + 1, per_row), *range(0, total + 1, window)})
        for i, end in zip(stops, [*stops[1:], total], strict=True):
            if restart is not None and i and i % window == 0:
                true = restart[0]
                path[i], speed[i] = (
                    self._of_hinges([np.interp(time[i], true.time, each) for each in of.T]) for of in (true.q, true.qd)
                )
            lasts = 0.0 if i % per_row else per_row * step
            if lasts:
                rows[i // per_row] = policy(i // per_row, time[i], joint_of @ path[i], joint_of @ speed[i])
            after = slice(i + 1, end + 1)
            path[after], speed[after] = self._advance(
                i, time[i:end], step, rows[i // per_row], lasts, path[i], speed[i]
            )
            diverged = np.flatnonzero(~(np.abs(speed[i : end + 1]).max(1) < MAX_JOINT_SPEED))
            if len(diverged):
                first = i + diverged[0]
                path[first:], speed[first:], rows[-(-first // per_row) :] = np.nan, np.nan, np.nan
                break
        points, heading = self.seen(time, path)
        moved = path @ joint_of.T, speed @ joint_of.T
        return Trajectory(time, *moved, points, heading, np.asarray(command_time), rows)

    def _of_hinges(self, values: Sequence[float] | np.ndarray) -> np.ndarray:
        """Values (K,) of joints at their motors' hinges (S,), 0 at the others."""
        whole = np.zeros(len(self.pieces))
        whole[[self.hinge(k) for k in range(self.num_joints)]] = values
        return whole

    def seen(self, time: np.ndarray, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Base and sites (N+1, P+1, d) at angles (N+1, S) of hinges, and the headings (N+1, P) of what has sites."""
        base = np.broadcast_to(self.base, (len(time), 1, self.dimensions))
        seen = np.concatenate([base, sites_at(self.pieces, angle)[..., : self.dimensions]], axis=1)
        if self.base_shift is not None:
            seen = seen + self.base_shift(time)[:, None]
        return seen, np.cumsum(angle, axis=1)[:, [s for s, piece in enumerate(self.pieces) if piece.sites]]
