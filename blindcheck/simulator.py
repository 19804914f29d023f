"""Reality as MuJoCo simulates it: a tree of hinges, commanded torques or servos, and the installed mechanisms.

Todorov, Erez & Tassa, "MuJoCo: a physics engine for model-based control", IROS 2012. Recursive dynamics, its
Runge–Kutta integrator of order 4 with steps of at most half a millisecond, and constraints for dry friction and
stops. The tree is a list of pieces, each behind one hinge; a link is one piece, unless a mechanism splits it (a
hidden hinge) or puts a rotor before it (backlash). A planar chain is a tree whose hinges turn about z.

A mechanism changes a `World` before it runs: its `pieces`, its `gravity`, the MuJoCo specification (`on_spec`),
the command on its way to the motors (`on_command`), or a force at every step (`on_step`).

A position servo's command is the torque that its target asks for by itself, S θ_d; MuJoCo's actuator adds
−S θ − D θ̇. Shapes: K joints, S ≥ K pieces, N steps, C command rows, d dimensions. SI units, radians; the joint
angles are those of `invdyn.models.Body`.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from invdyn.blindcheck.pieces import Piece
from invdyn.blindcheck.world import ChangeableBody
from invdyn.models import Body
from invdyn.models.bodies.inertia import six
from invdyn.models.bodies.joint_parts_mjcf import kept_warnings

MAX_STEP = 5e-4  # s; halving it moves no tip of a nominal arm by more than a micrometre
MAX_REPLAY_STEP = 2e-3
"""s, longest step of a replay in space, for d′, in which nothing jumps: no site moves by a hundredth of the noise."""


class World(ChangeableBody):
    """A body in MuJoCo, open to mechanisms until its first run.

    Raises ImportError, with what to install, when MuJoCo is missing; ValueError for joints that are no hinges, and for
    links in another order than branch by branch, in which MuJoCo counts joints.
    """

    def __init__(self, body: Body):
        self.mujoco = _mujoco()
        super().__init__(body)
        self._spec_hooks: list[Callable] = []
        self._command_hooks: list[Callable] = []
        self._step_hooks: list[Callable] = []

    def on_spec(self, change: Callable) -> None:
        """Register `change(spec)`, called with the MjSpec just before it is compiled."""
        self._spec_hooks.append(change)

    def on_command(self, change: Callable) -> None:
        """Register `change(i, step, u)`: the command (K,) that the motors get in step i, which lasts `step` s."""
        self._command_hooks.append(change)

    def on_step(self, act: Callable) -> None:
        """Register `act(t, model, data)`, called before each step; it adds to `data.qfrc_applied`."""
        self._step_hooks.append(act)

    def law(self, joint: int, torque: Callable[[float, np.ndarray, np.ndarray], float]) -> None:
        """Register a joint's torque(t, q, qd), N·m, at the body's angles q and velocities qd (K,)."""

        def act(t: float, model: Any, data: Any) -> None:
            driven = [self.hinge(k) for k in range(self.num_joints)]
            # the force is constant over the step, so it is taken at the middle, from the last acceleration
            half = model.opt.timestep / 2
            q, qd = data.qpos[driven] + half * data.qvel[driven], data.qvel[driven] + half * data.qacc[driven]
            data.qfrc_applied[driven[joint]] += torque(t + half, q, qd)

        self.on_step(act)

    def dry(self, joint: int, level: Callable[[float, float, float], float]) -> None:
        """Register dry friction of a level(q, qd, load), N·m; the load is what the motor would have to carry."""
        self.on_spec(lambda spec: set_part(spec.joint(self.pieces[self.hinge(joint)].hinge), {"frictionloss": 1e-9}))

        def act(t: float, model: Any, data: Any) -> None:
            h = self.hinge(joint)
            load = data.qfrc_actuator[h] + data.qfrc_bias[h]  # one step old: ½ ms
            model.dof_frictionloss[h] = max(level(data.qpos[h], data.qvel[h], load), 1e-9)

        self.on_step(act)

    def resolve(self, rate: Callable[[np.ndarray], float]) -> None:
        """Nothing: steps are short enough for every mechanism."""

    def drive(self, joint: int, of: Callable[[float, float, bool], float]) -> None:
        """Register what a joint's motor makes of a command, of(u, seconds, whether it is the first), in turn."""
        self.on_command(lambda i, s, u: np.where(np.arange(len(u)) == joint, of(float(u[joint]), s, i == 0), u))

    def each_step(self, joint: int, act: Callable[[float, float, float], None]) -> None:
        """Register act(t, seconds, qd), called before each step with a joint's velocity."""
        self.on_step(lambda t, model, data: act(t, model.opt.timestep, data.qvel[self.hinge(joint)]))

    def hang(self, mass: float, length: float, inertia: float, stiffness: float, damping: float) -> None:
        """Hang a weight on a sprung hinge of its own at the last tip."""
        self.add_weight(mass, length, inertia)
        self.on_spec(lambda spec: set_part(spec.joint("hung"), {"stiffness": stiffness, "damping": damping}))

    def compile(self) -> None:
        """Build the MuJoCo model."""
        mj = self.mujoco
        spec = mj.MjSpec()
        spec.compiler.degree = False
        spec.option.integrator = mj.mjtIntegrator.mjINT_RK4
        spec.option.gravity = self.gravity
        spec.option.tolerance = 1e-12
        spec.option.iterations = 100
        spec.option.disableflags |= mj.mjtDisableBit.mjDSBL_AUTORESET
        self._build(spec)
        for change in self._spec_hooks:
            change(spec)
        self.model = spec.compile()
        self.data = mj.MjData(self.model)
        if [self.model.joint(j).name for j in range(self.model.njnt)] != [piece.hinge for piece in self.pieces]:
            raise ValueError("expected links branch by branch: MuJoCo has their joints in another order")
        self._rollout = mj.rollout.Rollout(nthread=0)

    def _build(self, spec: Any) -> None:
        """Put the pieces into a specification: each a body, its hinge, and a motor of the same name, if it has one."""
        mj, bodies = self.mujoco, dict[Piece | None, Any]({None: spec.worldbody})
        for piece in self.pieces:
            x, y, z, w = Rotation.from_matrix(piece.turn).as_quat()
            body = bodies[piece] = bodies[piece.parent].add_body(
                name=piece.hinge, pos=piece.position, quat=[w, x, y, z], mass=piece.mass, ipos=piece.com
            )
            body.fullinertia = six(piece.inertia if piece.inertia.any() else 1e-14 * np.eye(3))
            body.explicitinertial = True
            joint = body.add_joint(name=piece.hinge, type=mj.mjtJoint.mjJNT_HINGE, axis=piece.axis)
            set_part(joint, {"damping": piece.damping})
            # Dry friction and stops as hard as the step allows: the default ones creep by per cents. Friction is a
            # viscous one below a speed of level / inertia · time constant / 2, where no other torque acts.
            joint.solref_friction, joint.solimp_friction = [2 * MAX_STEP, 1.0], [0.9999, 0.9999, 1e-3, 0.5, 2.0]
            joint.solref_limit, joint.solimp_limit = [1e-3, 1.0], [0.99, 0.999, 1e-4, 0.5, 2.0]
            if not piece.actuated:
                continue
            motor = spec.add_actuator(name=piece.hinge, target=piece.hinge)
            motor.trntype = mj.mjtTrn.mjTRN_JOINT
            if piece.servo is not None:
                motor.biastype = mj.mjtBias.mjBIAS_AFFINE
                motor.biasprm[1:3] = [-piece.servo[0], -piece.servo[1]]

    def _longest_step(self, replayed: bool) -> float:
        smooth = not self._step_hooks and not self.model.dof_frictionloss.any()
        return MAX_REPLAY_STEP if replayed and smooth and self.dimensions == 3 else MAX_STEP

    def _advance(
        self, first: int, time: np.ndarray, step: float, row: np.ndarray, lasts: float, q: np.ndarray, qd: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        model, data = self.model, self.data
        if first == 0:
            model.opt.timestep = step
            self.mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = q, qd
        ctrl = np.tile(row, (len(time), 1))
        for s in range(len(time) if self._command_hooks else 0):
            for change in self._command_hooks:
                ctrl[s] = change(first + s, step, ctrl[s])
        if first == 0 and model.na:
            data.act[:] = ctrl[0][model.actuator_dyntype != self.mujoco.mjtDyn.mjDYN_NONE]
        with kept_warnings(self.mujoco):  # of what is thrown off, and NaN from there on
            return self._stepped(time, ctrl)

    def _stepped(self, time: np.ndarray, ctrl: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The same, by controls (n, K)."""
        model, data, count = self.model, self.data, len(time)
        qpos, qvel = np.empty((count, model.nq)), np.empty((count, model.nv))
        if not self._step_hooks:
            # All at once, without Python between the steps; from where the constraints' solver was.
            physics = self.mujoco.mjtState.mjSTATE_FULLPHYSICS
            start: np.ndarray = np.empty((1, self.mujoco.mj_stateSize(model, physics)))
            warm = data.qacc_warmstart[None].copy()
            self.mujoco.mj_getState(model, data, start[0], physics)
            states: np.ndarray = np.empty((1, count, start.shape[1]))
            # Shapes are right, and a command's row has few steps: to have them checked takes a sixth of a case's time.
            self._rollout.rollout(
                [model], [data], start, ctrl[None], nstep=count, initial_warmstart=warm, state=states, skip_checks=True
            )
            end = 1 + model.nq
            return states[0, :, 1:end], states[0, :, end : end + model.nv]
        for s in range(count):
            data.ctrl[:] = ctrl[s]
            data.qfrc_applied[:] = 0.0
            for act in self._step_hooks:
                act(time[s], model, data)
            self.mujoco.mj_step(model, data)
            qpos[s], qvel[s] = data.qpos, data.qvel
        return qpos, qvel

    def inverse(self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        """MuJoCo's own inverse dynamics: torques (N, S), N·m, of motions (N, S); passive forces are subtracted."""
        self.ready()
        torque = np.empty_like(q)
        for i in range(len(q)):
            self.data.qpos[:], self.data.qvel[:], self.data.qacc[:] = q[i], qd[i], qdd[i]
            self.mujoco.mj_inverse(self.model, self.data)
            torque[i] = self.data.qfrc_inverse
        return torque

    def inertia(self, q: np.ndarray) -> np.ndarray:
        """The inertia matrix, kg·m² (S, S), at a posture (S,)."""
        self.ready()
        self.data.qpos[:] = q
        self.mujoco.mj_forward(self.model, self.data)
        full = np.zeros((self.model.nv, self.model.nv))
        self.mujoco.mj_fullM(self.model, self.data, full)
        return full


def set_part(element: Any, attributes: dict) -> None:
    """Set attributes of a part of an MjSpec."""
    for name, value in attributes.items():
        if np.ndim(getattr(element, name)) == 1 and np.ndim(value) == 0:  # newer MuJoCos have polynomials here
            value = [value, *np.zeros(len(getattr(element, name)) - 1)]
        setattr(element, name, value)


def _mujoco() -> Any:
    try:
        import mujoco
        import mujoco.rollout
    except ImportError as error:
        raise ImportError("the blind check needs MuJoCo to simulate reality: pip install 'invdyn[robots]'") from error
    return mujoco
