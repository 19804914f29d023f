"""Random bodies, and how they move: a robot that tracks sines, or a limb let go.

Bodies reach from 5 cm, a mouse's limb of some ten grams, to 1.8 m, an industrial arm of some twenty kilograms
(mass ∝ reach², as those two have it). All times follow from the pendulum frequency of the outstretched body under
9.81 m/s², also where no gravity acts in the plane. A commanded body is given, at the command's rate,

    u = τ_nominal(θ_d, θ̇_d, θ̈_d) + K_p (θ_d − θ) + K_d (θ̇_d − θ̇)

with θ_d a sum of three sines for each joint; the recording has the u that was given to the motors. Where these are
position servos, u = S θ_d is the torque that their targets alone would give. Shapes: K joints, C command rows. SI
units, radians.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from invdyn.blindcheck.simulator import World
from invdyn.blindcheck.stretched import STANDARD_GRAVITY, pendulum_frequency
from invdyn.blindcheck.world import Trajectory
from invdyn.models import Body, Link, planar_body

NAMES = (("base", "tip"), ("shoulder", "elbow", "wrist"), ("hip", "knee", "ankle", "toe"))  # keypoints of 1, 2, 3 links
FRAME_RATES = (30.0, 50.0, 60.0, 100.0, 120.0, 200.0)  # Hz
LEAD = 0.4  # s that reality runs before the recording begins: longer than any delay
TRAIL = 0.2  # s after its end: for mistimed frames


def between(rng: np.random.Generator, low: float, high: float) -> float:
    """A log-uniform draw."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def random_body(rng: np.random.Generator, joints: int, horizontal: bool) -> Body:
    """A body of so many links; `horizontal`: it moves in a plane without gravity."""
    reach = between(rng, 0.05, 1.8)
    lengths = np.cumprod([1.0, *rng.uniform(0.6, 1.1, joints - 1)])
    lengths = np.round(lengths * reach / lengths.sum(), 4)
    masses = np.cumprod([1.0, *rng.uniform(0.4, 1.0, joints - 1)])
    masses = masses / masses.sum() * 20 * (reach / 1.8) ** 2 * between(rng, 0.5, 2.0)
    rods = rng.random() < 0.5
    points, links = NAMES[joints - 1], []
    for k in range(joints):
        length, mass = float(lengths[k]), float(f"{masses[k]:.4g}")
        com = None if rods else round(length * rng.uniform(0.35, 0.6), 5)
        inertia = None if rods else float(f"{mass * length**2 * rng.uniform(0.06, 0.12):.4g}")
        links.append(Link(f"link{k + 1}", points[k], points[k + 1], length, mass, com, inertia))
    base = (0.0, 0.0) if rng.random() < 0.7 else tuple(np.round(rng.uniform(-0.3, 0.3, 2) * reach, 4).tolist())
    return planar_body("arm", links, (0.0, 0.0) if horizontal else (0.0, -STANDARD_GRAVITY), base)


@dataclass(frozen=True)
class Plan:
    """The plan of one recording. `amplitude`, `frequency`, `phase` (K, 3) and `centre` (K,) make θ_d; gains (K,).

    A passive plan lets the body go at angles `centre` with velocities `release`, and commands nothing. Of position
    servos `targeted` (K,) has the stiffnesses S, N·m/rad.
    """

    duration: float
    frame_rate: float
    command_rate: float
    centre: np.ndarray
    amplitude: np.ndarray
    frequency: np.ndarray
    phase: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    release: np.ndarray
    passive: bool
    targeted: np.ndarray | None = None

    def desired(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """θ_d, θ̇_d, θ̈_d, each (C, K)."""
        omega = 2 * np.pi * self.frequency
        angle = omega * time[:, None, None] + self.phase
        q = self.centre + (self.amplitude * np.sin(angle)).sum(-1)
        qd = (self.amplitude * omega * np.cos(angle)).sum(-1)
        return q, qd, -(self.amplitude * omega**2 * np.sin(angle)).sum(-1)


@dataclass(frozen=True)
class Habits:
    """How bodies of a kind are moved.

    Attributes:
        posture: (generator, body, whether it is passive, worlds) → the angles (K,) about which it moves, rad.
        frame_rates: Hz, to choose from.
        seconds: shortest and longest recording.
        size: smallest and largest sum of a joint's three amplitudes, rad.
    """

    posture: Callable[..., np.ndarray]
    frame_rates: Sequence[float] = FRAME_RATES
    seconds: tuple[float, float] = (4.0, 10.0)
    size: tuple[float, float] = (0.5, 1.3)


def planar_posture(rng: np.random.Generator, body: Body, passive: bool, made: Callable) -> np.ndarray:
    """Hanging more often than not; a passive one so that it swings and does not whirl."""
    joints = body.num_joints
    hanging = passive or rng.random() < 0.6
    down = -np.pi / 2 if body.gravity[1] else rng.uniform(-np.pi, np.pi)
    first = down + rng.uniform(-1.0, 1.0) if hanging else rng.uniform(-np.pi, np.pi)
    centre = np.array([first, *rng.uniform(-1.2, 1.2, joints - 1)])
    if passive:
        centre = np.array([down + rng.choice([-1.0, 1.0]) * rng.uniform(0.3, 0.9), *rng.uniform(-0.6, 0.6, joints - 1)])
    return centre


IN_THE_PLANE = Habits(planar_posture)


def random_plan(
    rng: np.random.Generator,
    body: Body,
    passive: bool,
    made: Callable[[Any], Any] = World,
    habits: Habits = IN_THE_PLANE,
) -> Plan:
    """A motion for a body, in worlds as `made`. Frames at least 20 for each period of its pendulum."""
    joints, natural = body.num_joints, pendulum_frequency(body)
    rates = [rate for rate in habits.frame_rates if rate >= 20 * natural]
    frame_rate = float(rng.choice(rates or habits.frame_rates[-1:]))
    faster = [n for n in (1, 1, 1, 2, 5) if n * frame_rate <= 500]
    centre = habits.posture(rng, body, passive, made)
    size = rng.dirichlet([2.0, 2.0, 2.0], joints) * rng.uniform(*habits.size, (joints, 1))
    frequency = np.sort(natural * np.exp(rng.uniform(np.log(0.2), np.log(1.1), (joints, 3))), axis=1)
    command_rate = frame_rate * (1 if passive else int(rng.choice(faster)))
    # what a joint's motor feels with all other joints free; a piecewise-constant command limits the speed of the loop
    inertia = 1 / np.linalg.inv(made(body).inertia(centre)).diagonal()
    bandwidth = min(2 * np.pi * natural * rng.uniform(1.0, 2.5), 0.3 * command_rate)
    servos = [] if passive else [parts.servo for parts in body.joint_parts if parts.servo]
    return Plan(
        duration=round(rng.uniform(*habits.seconds), 1),
        frame_rate=frame_rate,
        command_rate=command_rate,
        centre=centre,
        amplitude=size,
        frequency=frequency,
        phase=rng.uniform(0, 2 * np.pi, (joints, 3)),
        stiffness=inertia * bandwidth**2,
        damping=1.4 * inertia * bandwidth,
        release=rng.normal(0.0, 0.5, joints) * natural,
        passive=passive,
        targeted=np.array([servo.stiffness for servo in servos]) if servos else None,
    )


def frame_times(plan: Plan) -> np.ndarray:
    """Stated times of the frames (T,), s."""
    return np.arange(round(plan.duration * plan.frame_rate) + 1) / plan.frame_rate


def simulated(world: World, nominal: World, plan: Plan, pace: float = 1.0) -> Trajectory:
    """Run a plan in a world, from `LEAD` before the recording to `TRAIL` after it.

    `nominal` gives the torques that the controller believes in. `pace`: a clock that runs so many times too fast
    stamps the rows, so that they really are so much closer together.
    """
    interval = 1 / (plan.command_rate * pace)
    before = int(np.ceil(LEAD / interval))
    time = interval * np.arange(-before, int(np.ceil((plan.duration / pace + TRAIL) / interval)) + 1)
    if plan.passive:
        still = np.zeros(len(plan.centre))
        return world.run(time, lambda row, t, q, qd: still, plan.centre, plan.release)
    q_d, qd_d, qdd_d = plan.desired(time)
    if (stiffness := plan.targeted) is not None:
        return world.run(time, lambda row, t, q, qd: stiffness * q_d[row], q_d[0], qd_d[0])
    known = nominal.inverse(q_d, qd_d, qdd_d)

    def policy(row: int, t: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        return known[row] + plan.stiffness * (q_d[row] - q) + plan.damping * (qd_d[row] - qd)

    return world.run(time, policy, q_d[0], qd_d[0])


def replay(world: World, trajectory: Trajectory, period: float) -> Trajectory:
    """The same commands in another world, set back to the trajectory's own state after every `period` s."""
    rows = trajectory.command
    start = trajectory.q[0], trajectory.qd[0]
    return world.run(trajectory.command_time, lambda row, t, q, qd: rows[row], *start, (trajectory, period))
