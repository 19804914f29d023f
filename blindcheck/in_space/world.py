"""Reality in space as MuJoCo simulates it: a tree of hinges, commanded torques or position servos, sites on its links.

Steps, solver, hooks and motors are those of the plane (:mod:`..simulator`), and so are the mechanisms at joints. A
piece's frame is the link's of :class:`invdyn.models.Body`. A position servo's command is the torque that its target
asks for by itself, S θ_d; MuJoCo's actuator adds −S θ − D θ̇. SI units, radians.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from invdyn.blindcheck import simulator
from invdyn.blindcheck.effects.parts import set_part
from invdyn.blindcheck.simulator import MAX_STEP
from invdyn.models import Body
from invdyn.models.bodies.inertia import six, tensor

MAX_REPLAY_STEP = 2e-3
"""s, longest step of a replay for d′ in which nothing jumps: moves no site by more than a hundredth of the noise."""


@dataclass
class Piece:
    """One rigid link behind a hinge: `com` (3,), `inertia` (3, 3) about it, in the link's frame; `joint` its number."""

    hinge: str
    parent: int
    position: np.ndarray
    turn: np.ndarray
    axis: np.ndarray
    mass: float
    com: np.ndarray
    inertia: np.ndarray
    joint: int
    sites: dict[str, np.ndarray]
    servo: tuple[float, float] | None = None
    damping: float = 0.0
    actuated: bool = True


class World(simulator.World):
    """A tree of hinges in MuJoCo, open to mechanisms until its first run.

    Raises ImportError, with what to install, when MuJoCo is missing; ValueError for joints that are no hinges, and for
    links in another order than branch by branch, in which MuJoCo counts joints.
    """

    def __init__(self, body: Body):
        self._start(body.num_joints, np.zeros(3), np.array(body.gravity))
        p, sites = body.parameters(), iter(body.parameters().sites.numpy())
        if any(link.joint.type != "hinge" for link in body.links):
            raise ValueError(f"expected hinges alone, got {', '.join(link.joint.type for link in body.links)}")
        assert body.hand is not None  # every link has a site, and all hang on the first
        self.hand = body.hand
        self.keypoint_names = body.keypoint_names
        self.segments: list[Any] = []
        for place, (link, parts) in enumerate(zip(body.links, body.joint_parts, strict=True)):
            servo = None if parts is None else parts.servo
            self.segments.append(
                Piece(
                    hinge=f"joint{place}",
                    parent=body.parents[place],
                    position=p.position[place].numpy(),
                    turn=np.array(link.rotation),
                    axis=np.array(link.joint.axis),
                    mass=float(p.mass[place]),
                    com=p.com[place].numpy(),
                    inertia=tensor(p.inertia[place].numpy()),
                    joint=place,
                    sites={name: next(sites) for name in link.points},
                    servo=None if servo is None else (servo.stiffness, servo.damping),
                    damping=0.0 if parts is None else parts.damping,
                )
            )

    @property
    def possible(self) -> bool:
        """Whether every piece is a body that can be: with mass, and moments that obey the triangle inequality."""
        moments = [np.linalg.eigvalsh(piece.inertia) for piece in self.segments]
        solid = all(m[0] > 0 and m[2] <= (m[0] + m[1]) * (1 + 1e-9) for m in moments)
        return solid and all(piece.mass > 0 for piece in self.segments)

    def compile(self) -> None:
        """Build the MuJoCo model; later changes by mechanisms do nothing."""
        super().compile()
        if [self.model.joint(j).name for j in range(self.model.njnt)] != [piece.hinge for piece in self.segments]:
            raise ValueError("expected links branch by branch: MuJoCo has their joints in another order")
        self._sites = [self.model.site(name).id for name in self.keypoint_names]

    def _build(self, spec: Any) -> None:
        bodies: list[Any] = []
        for piece in self.segments:
            x, y, z, w = Rotation.from_matrix(piece.turn).as_quat()
            parent = spec.worldbody if piece.parent < 0 else bodies[piece.parent]
            body = parent.add_body(name=piece.hinge, pos=piece.position, quat=[w, x, y, z])
            body.mass, body.ipos, body.fullinertia = piece.mass, piece.com, six(piece.inertia)
            body.explicitinertial = True
            self._hinge(spec, body, piece.hinge, piece.axis, piece.actuated)
            set_part(spec.joint(piece.hinge), {"damping": piece.damping})
            if piece.servo is not None:
                motor = spec.actuator(piece.hinge)
                motor.biastype = self.mujoco.mjtBias.mjBIAS_AFFINE
                motor.biasprm[1:3] = [-piece.servo[0], -piece.servo[1]]
            for name, at in piece.sites.items():
                body.add_site(name=name, pos=at)
            bodies.append(body)

    def _longest_step(self, replayed: bool) -> float:
        """A replay for d′ of a world in which nothing jumps takes longer steps."""
        smooth = not self._step_hooks and not self.model.dof_frictionloss.any()
        return MAX_REPLAY_STEP if replayed and smooth else MAX_STEP

    def _seen(self, time: np.ndarray, qpos: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The world's origin and the sites (N+1, P+1, 3); headings run on from joint to joint."""
        points = np.full((len(time), len(self._sites) + 1, 3), np.nan)
        points[:, 0] = 0.0
        for row in np.flatnonzero(np.isfinite(qpos).all(1)):
            self.data.qpos[:] = qpos[row]
            self.mujoco.mj_kinematics(self.model, self.data)
            points[row, 1:] = self.data.site_xpos[self._sites]
        return points, np.cumsum(qpos, axis=1)
