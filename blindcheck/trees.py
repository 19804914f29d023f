"""Random trees of hinges in space, what is recorded of them, and how they move.

Three to seven hinges, reaching .3 to 1.6 m, mass ∝ reach² as in the plane. The first turns about the vertical, or about
a level axis. Each link is a slab from one joint to the next, off its axes by some, and carries a marker near its far
end, so that turns about the link's own axis show as well. One body in four has a branch. Of two with seven joints one
is like Franka's Panda: the joints of its data sheet (Denavit and Hartenberg's modified table; Franka Emika, "Robot and
interface specifications", 2017), masses in the proportions that Gaz and others identified (IEEE RA-L 4, 2019).

Two bodies in five that a case allows have position servos, as stiff as hold the arm level with .05 to .2 rad of error,
but for joints that would swing faster than at 10 Hz. One body in three that a case allows has damping of its own, which
its file says. Of one in eight the file's masses are 2 % off, and it says so.
SI units, radians.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from invdyn.blindcheck.effects import OBSERVATIONS
from invdyn.blindcheck.motion import Habits, between
from invdyn.blindcheck.setting import Setting, Style
from invdyn.blindcheck.simulator import World, set_part
from invdyn.blindcheck.stretched import STANDARD_GRAVITY, pendulum_frequency, reach, stretched
from invdyn.models import Body
from invdyn.models.bodies.dh import Inertial, Row, from_dh
from invdyn.models.bodies.inertia import six
from invdyn.models.bodies.joint_parts import JointParts, Motor
from invdyn.models.bodies.joints import WORLD, Joint
from invdyn.models.bodies.link import Link
from invdyn.models.bodies.scalars import nominal, prior

JOINTS, SHARES = (3, 4, 5, 6, 7), (0.4, 0.25, 0.2, 0.05, 0.1)
AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
"""Of a link that runs along x: a roll, a pitch, a yaw."""
MOTORS = {"actuator_gain", "actuator_saturation", "actuator_deadzone", "hot_motor", "encoder_offset"}
"""Effects that mean something else of a servo."""
DAMPED = {"viscous_friction", "drifting_friction"}
"""Effects whose size is another one where the joint is damped already."""
MASS_ERROR = 0.02
"""Standard error of a link's stated mass, as a fraction."""
MAX_SERVO_FREQUENCY = 10.0
"""Hz, of a joint with its servo's spring."""
SETTLING_PERIODS = 12
"""Periods of its pendulum in which a damped body comes to hang."""
RIGHT = np.pi / 2
PANDA = [Row(0, 0, 0.333), Row(0, -RIGHT, 0), Row(0, RIGHT, 0.316), Row(0.0825, RIGHT, 0)]
PANDA += [Row(-0.0825, -RIGHT, 0.384), Row(0, RIGHT, 0), Row(0.088, RIGHT, 0)]
PANDA_MASSES = (5.0, 0.65, 3.2, 3.6, 1.2, 1.7, 0.75)  # kg
PANDA_ENDS = ((0, 0, -0.1), (0, -0.1, 0.03), (0.05, 0.05, -0.1), (-0.08, 0.1, 0), (0, 0.08, -0.1), (0.08, 0, 0))
"""m, about where the links' far ends are in their frames; the last is the flange."""
PANDA_FLANGE = (0.03, 0.03, 0.107)  # m
PANDA_MIDDLE = (0.0, -0.3, 0.0, -1.9, 0.0, 1.6, 0.8)  # rad


def _slab(rng: np.random.Generator, mass: float, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centre of mass (3,) and inertia (3, 3) of a slab from the origin to ``end``: thickest there, askew."""
    length = max(float(np.linalg.norm(end)), 0.05)
    com = end * rng.uniform(0.35, 0.6) + rng.uniform(-0.06, 0.06, 3) * length
    along, _ = Rotation.align_vectors([end if np.linalg.norm(end) else [1, 0, 0]], [[1, 0, 0]])
    turn = (Rotation.from_rotvec(rng.normal(0.0, 0.15, 3)) * along).as_matrix()
    # second moments of what mass there is along, across and through: any of them are a body that can be
    shape = np.array([rng.uniform(0.06, 0.1), rng.uniform(0.005, 0.02), rng.uniform(0.005, 0.02)])
    second = turn @ np.diag(mass * length**2 * shape) @ turn.T
    return com, np.trace(second) * np.eye(3) - second


def random_tree(rng: np.random.Generator, joints: int) -> Body:
    """A serial arm, or one with a branch, of so many hinges."""
    if joints == len(PANDA) and rng.random() < 0.5:
        return _panda_like(rng)
    whole = between(rng, 0.3, 1.6)
    parents = np.arange(joints) - 1
    if joints > 3 and rng.random() < 0.25:
        fork = rng.integers(1, joints - 2)
        parents[rng.integers(fork + 2, joints)] = fork  # what comes behind it hangs on the branch
    lengths = np.cumprod([1.0, *rng.uniform(0.6, 1.1, joints - 1)])
    lengths *= whole / lengths.sum()
    masses = np.cumprod([1.0, *rng.uniform(0.4, 1.0, joints - 1)])
    masses *= 20 * (whole / 1.8) ** 2 * between(rng, 0.5, 2.0) / masses.sum()
    links: list[Link] = []
    letters: list[str] = []
    ends: list[np.ndarray] = []
    for place, parent in enumerate(parents.tolist()):
        inner = "" if parent < 0 else letters[parent]
        # two rolls behind each other would be one
        letters.append(str(rng.choice(list("zzy" if not inner else "yyzz" if inner == "x" else "yyzzx"))))
        axis = np.array(AXES[letters[-1]])
        if inner and rng.random() < 0.3:
            axis = Rotation.from_rotvec(rng.normal(0.0, 0.2, 3)).apply(axis)
        ends.append(np.round(np.array([1.0, *rng.uniform(-0.15, 0.15, 2)]) * lengths[place], 4))
        com, inertia = _slab(rng, float(masses[place]), ends[-1])
        side = rng.uniform(0.15, 0.3, 2) * rng.choice([-1, 1], 2) * lengths[place]
        links.append(
            Link(
                name=f"link{place + 1}",
                joint=Joint(f"joint{place + 1}", "hinge", tuple((axis / np.linalg.norm(axis)).tolist())),
                parent=f"link{parent + 1}" if inner else WORLD,
                origin=ends[parent].tolist() if inner else [0.0, 0.0, 0.0],
                mass=float(f"{masses[place]:.4g}"),
                com=np.round(com, 5).tolist(),
                inertia=[float(f"{value:.5g}") for value in six(inertia)],
                sites={f"p{place + 1}": np.round(ends[-1] + np.array([0.0, *side]), 4).tolist()},
            )
        )
    return Body("robot", links)


def _panda_like(rng: np.random.Generator) -> Body:
    inertials, markers = [], []
    for mass, end in zip(PANDA_MASSES, (*PANDA_ENDS, PANDA_FLANGE), strict=True):
        own = float(f"{mass * between(rng, 0.8, 1.25):.4g}")
        com, inertia = _slab(rng, own, np.array(end))
        inertials.append(Inertial(own, np.round(com, 5).tolist(), [float(f"{value:.5g}") for value in six(inertia)]))
        markers.append(np.round(np.array(end) + rng.uniform(0.03, 0.08, 3) * rng.choice([-1, 1], 3), 4).tolist())
    arm = from_dh("robot", PANDA, inertials)
    return replace(
        arm,
        links=[
            replace(link, sites={f"p{k}": at}) for k, (link, at) in enumerate(zip(arm.links, markers, strict=True), 1)
        ],
    )


def with_servos(rng: np.random.Generator, tree: Body) -> Body:
    """Position servos at all joints: stiff enough for the load, at most `MAX_SERVO_FREQUENCY`."""
    posture = rng.uniform(-1.0, 1.0, tree.num_joints)
    turning = 1 / np.linalg.inv(World(tree).inertia(posture)).diagonal()
    links = []
    for link, load, inertia in zip(tree.links, _loads(tree), turning, strict=True):
        stiffness = min(load / rng.uniform(0.05, 0.2), inertia * (2 * np.pi * MAX_SERVO_FREQUENCY) ** 2)
        damping = 2 * rng.uniform(0.3, 0.7) * np.sqrt(stiffness * inertia)
        gains = float(f"{stiffness:.4g}"), float(f"{damping:.4g}")
        motor = Motor("position", gain=gains[0], stiffness=gains[0], damping=gains[1])
        links.append(replace(link, parts=replace(link.parts or JointParts(), motor=motor)))
    return replace(tree, links=links)


def with_damping(rng: np.random.Generator, tree: Body) -> Body:
    """Damping at all joints: at the pace of the hanging body it takes some per cent of what hangs on them."""
    pace = 2 * np.pi * pendulum_frequency(tree)
    damping = [float(f"{between(rng, 0.01, 0.05) * load / pace:.4g}") for load in _loads(tree)]
    links = [
        replace(link, parts=replace(link.parts or JointParts(), damping=each))
        for link, each in zip(tree.links, damping, strict=True)
    ]
    return replace(tree, links=links)


def _measured(rng: np.random.Generator, tree: Body) -> Body:
    """The tree as its file has it: masses known to 2 %, and said so."""
    off = [float(f"{nominal(link.mass) * np.exp(MASS_ERROR * rng.standard_normal()):.4g}") for link in tree.links]
    links = [replace(link, mass=prior(mass, MASS_ERROR * mass)) for link, mass in zip(tree.links, off, strict=True)]
    return replace(tree, links=links)


def _loads(tree: Body) -> list[float]:
    """By joint, N·m: the weight of all that hangs on it, outstretched horizontally."""
    mass, far, inertia = stretched(tree)
    loads = []
    for place in range(len(tree.links)):
        carried = [k for k in range(len(tree.links)) if place in _inwards(tree, k)]
        arm = np.maximum(far[carried] - far[place], 0.0) + np.sqrt(inertia[place] / mass[place])
        loads.append(STANDARD_GRAVITY * float((mass[carried] * arm).sum()))
    return loads


def _inwards(tree: Body, link: int) -> list[int]:
    way = [link]
    while tree.parents[way[-1]] >= 0:
        way.append(tree.parents[way[-1]])
    return way


def bodies(rng: np.random.Generator, needs: Sequence[str], names: Sequence[str], passive: bool) -> tuple[Body, Body]:
    """A random tree, and what its file says."""
    tree = random_tree(rng, int(rng.choice(JOINTS, p=SHARES)))
    if rng.random() < 0.4 and not passive and not MOTORS & set(names):
        tree = with_servos(rng, tree)
    if rng.random() < 1 / 3 and not DAMPED & set(names):
        tree = with_damping(rng, tree)
    return tree, _measured(rng, tree) if rng.random() < 1 / 8 else tree


def style(rng: np.random.Generator, names: Sequence[str]) -> Style:
    """Encoders alone in two cases of five, keypoints alone in three of ten, both in the others.

    What the camera alone shows has keypoints, what encoders show has encoders.
    """
    seen = bool({*names} & {*OBSERVATIONS} - {"clock_rate", "encoder_offset"})
    shares = [0.0, 0.5, 0.5] if seen else [0.5, 0.0, 0.5] if "encoder_offset" in names else [0.4, 0.3, 0.3]
    kind = str(rng.choice(["encoders", "keypoints", "both"], p=shares))
    encoder, missing = float(f"{between(rng, 1e-4, 1e-3):.2g}"), float(rng.uniform(0.01, 0.05))
    return Style(
        base=False,
        encoder=None if kind == "keypoints" else encoder,
        missing=missing if rng.random() < 0.3 else 0.0,
        filmed=kind != "encoders",
        counted=True,
    )


def posture(rng: np.random.Generator, body: Body, passive: bool, made: Callable[[Body], World]) -> np.ndarray:
    """Anywhere, or about the Panda's usual pose; a passive body is released near where it hangs."""
    anywhere = rng.uniform(-1.2, 1.2, body.num_joints)
    if np.allclose(body.parameters().position[1].numpy(), 0.0):  # as no random tree's second joint is
        anywhere = np.array(PANDA_MIDDLE) + rng.uniform(-0.3, 0.3, body.num_joints)
    if not passive:
        return anywhere
    mass, far, inertia = stretched(body)
    period = 2 * np.pi * np.sqrt(far.max() / STANDARD_GRAVITY)
    damping = float((inertia + mass * far**2).sum()) * 2 * np.pi / period / np.arange(1, body.num_joints + 1) ** 2
    world = made(body)

    def damped(spec: Any) -> None:
        for k, each in enumerate(damping):
            set_part(spec.joint(f"joint{k}"), {"damping": each})

    world.on_spec(damped)
    time, still = np.linspace(0.0, SETTLING_PERIODS * period, 40), np.zeros(body.num_joints)
    hanging = world.run(time, lambda row, t, q, qd: still, anywhere, still).q[-1]
    return hanging + rng.uniform(0.3, 0.8, body.num_joints) * rng.choice([-1, 1], body.num_joints)


def described(body: Body) -> dict:
    """Numbers of the answer; `upright` where the first joint's axis is gravity's."""
    p, gravity = body.parameters(), np.array(body.gravity)
    first = np.array(body.links[0].rotation) @ np.array(body.links[0].joint.axis)
    return {
        "mass": p.mass.tolist(),
        "com": p.com.tolist(),
        "inertia": p.inertia.tolist(),
        "reach": reach(body),
        "gravity": list(body.gravity),
        "base": [0.0, 0.0, 0.0],
        "upright": bool(np.allclose(np.cross(first, gravity), 0.0)),
        "parents": list(body.parents),
        "damping": [parts.damping for parts in body.joint_parts],
        "servos": any(parts.servo is not None for parts in body.joint_parts),
    }


SPACE = Setting(
    bodies,
    style,
    Habits(posture, frame_rates=(50.0, 100.0), seconds=(3.0, 6.0), size=(0.3, 0.9)),
    described,
    thorough=(3, 1),
)
