"""A file that MuJoCo loads, as a state-space model: its own step is the transition's mean.

    x = (z, δ, v, a),    (δ, v, a)_t = step(x_{t−1}) + noise,    z_t by a torque process,    y_t ~ observation(x_t)

z is the unknown drive (:mod:`.drives`), δ the configuration in a tangent chart (:mod:`.chart`), v = ``qvel``, a =
``act``, the activations of muscles and filtered actuators. A row is as many equal steps of MuJoCo, by the file's own
integrator, as its time step needs; within it the drive moves on a straight line from z to its mean. Noise is
"noise.angle", "noise.velocity" and "noise.activation", standard deviations per row.

Contacts are MuJoCo's soft ones: the mean is continuous, with kinks where a contact begins or ends
(:attr:`.StateSpaceModel.nonsmooth`). The step has no derivative here: methods that need one refuse the model.

Shapes: states (..., D), D = Z + 2 nv + na; rows (..., O). MuJoCo computes in float64 on the CPU for any type.
"""

import copy
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cached_property
from hashlib import blake2b
from pathlib import Path
from typing import Any, NoReturn, Self

import numpy as np
import torch
from pyro.distributions import Distribution
from torch import Tensor

from invdyn.models.articulated.defaults import Value, WrongValue, of_coordinates, shaped
from invdyn.models.articulated.state import gaussian
from invdyn.models.articulated.timeline import Timeline
from invdyn.models.bodies.body_mjcf import engine
from invdyn.models.bodies.scalars import BodyError
from invdyn.models.engine.drives import Drive, Given, Inputs, JointTorques
from invdyn.models.engine.inverse_kinematics import poses
from invdyn.models.engine.readings import EngineView, Readings
from invdyn.models.engine.scene import Scene
from invdyn.models.engine.simulator import Simulator, unique_steps
from invdyn.models.engine.typical_forces import typical_forces
from invdyn.models.engine.warp import WarpSimulator
from invdyn.models.observation.encoders import Encoders
from invdyn.models.observation.keypoints import Keypoints
from invdyn.models.observation.observation import Observation
from invdyn.models.shapes import common, join
from invdyn.models.state_space import StateSpaceModel
from invdyn.models.torques import OrnsteinUhlenbeck, TorqueProcess

RELAXED_VELOCITY, RELAXED_ANGLE = 200.0, 30.0
"""How many times as large the process noise is under fully relaxed dynamics."""
MEMO_BYTES = 2**28
"""Of results that are kept."""


class EngineModel(StateSpaceModel):
    """Hidden Markov model of a MuJoCo model on a given time grid.

    Args:
        scene: a :class:`.Scene`, or what :meth:`.Scene.of` reads: a file (Path), a text, a ``mujoco.MjSpec``.
        time: (T,) s, increasing; need not be regular.
        observation: what is observed; by default keypoints at all sites. :class:`.Readings` are MuJoCo's own sensors.
        drive: what moves it and is not known; torques at all hinges and slides by default. Several may act at once.
        torque: process of the drive; Ornstein–Uhlenbeck by default.
        parameters: values that replace the defaults, by dotted name, as :class:`.ArmModel` takes them; joints are the
            degrees of freedom. And "noise.activation", "initial.activation", "initial.activation_scale" (na,).
        given: inputs that are known, in addition to the drive: what a robot was commanded.
        threads: of the simulations; all cores by default. Results do not depend on it.
        warp: device of MuJoCo Warp that takes the steps in float32, "cuda" or "cpu"; MuJoCo itself by default.

    Raises BodyError for a model that cannot be used, ValueError for times that do not increase, sensors or parameters
    that do not fit, UnknownParameter for a parameter that it does not have.
    """

    emission_about_mean = True

    def __init__(
        self,
        scene: "Scene | Path | str | Any",
        time: Sequence[float] | np.ndarray | Tensor,
        observation: Observation | None = None,
        *,
        drive: Drive | Sequence[Drive] | None = None,
        torque: TorqueProcess | None = None,
        parameters: Mapping[str, Value] | None = None,
        given: Given | None = None,
        threads: int | None = None,
        warp: str | None = None,
    ):
        self.scene = scene = scene if isinstance(scene, Scene) else Scene.of(scene)
        observation = observation or Observation(Keypoints(range(len(scene.keypoint_names))))
        self.observation = observation.bound(scene)
        if self.observation.states:
            raise ValueError("expected sensors without states of their own, got one that has some: use the arm model")
        self.timeline = Timeline.of(time)
        self.num_steps = len(self.timeline.time)
        drives = (drive or JointTorques(),) if drive is None or not isinstance(drive, Sequence) else tuple(drive)
        self.inputs = Inputs(drives, scene.model, given)
        if self.inputs.given and any(isinstance(each, Readings) for each in self.observation.sensors):
            raise ValueError("expected sites or encoders with given inputs, got MuJoCo's own sensors: leave them out")
        self.torque = torque or OrnsteinUhlenbeck()
        self.torque_size = self.torque.size(self.inputs.size)
        self.nv, self.na = int(scene.model.nv), int(scene.model.na)
        self.state_dim = self.torque_size + 2 * self.nv + self.na
        self.observation_dim = self.observation.size
        self.nonsmooth = scene.nonsmooth
        self.threads, self.warp = threads, warp
        self.relaxation = 0.0
        self._memo = Memo()
        self._which, self._steps = unique_steps(self.timeline.dt.numpy(), float(scene.model.opt.timestep))
        self.steps_per_row = float(np.mean([self._steps[kind][1] for kind in self._which]))
        names = [f"drive_{name}" for name in self.inputs.names]
        names += [f"process_{k}" for k in range(self.torque_size - len(names))]
        names += [f"{kind}_{joint}" for kind in ("angle", "velocity") for joint in scene.joint_names]
        self.state_names = (*names, *(f"activation_{k}" for k in range(self.na)))
        super().__init__(self._defaults())
        self.parameters = self.replace(**shaped(parameters or {}, self.parameters)).parameters

    def _defaults(self) -> dict[str, Tensor]:
        typical = typical_forces(self.scene, self.inputs.pushed(self.scene.model))
        scale = torch.as_tensor(self.inputs.scale(self.scene.model, typical), dtype=torch.float64)
        found = {
            **self.torque.defaults(scale),
            **of_coordinates(self.nv, {"noise.angle": 1e-4, "noise.velocity": 1e-2}),
            **self.observation.defaults(self.scene.reach),
        }
        if self.na:
            usual = {"noise.activation": 1e-3, "initial.activation": 0.2, "initial.activation_scale": 0.3}
            found |= {name: torch.full((self.na,), value, dtype=torch.float64) for name, value in usual.items()}
        return found

    @property
    def unconstrained(self) -> frozenset[str]:
        """Parameters that may be negative."""
        return self.torque.unconstrained | {"initial.angle", "initial.velocity"}

    @property
    def time(self) -> Tensor:
        """(T,) s."""
        return self.timeline.time

    # -- MuJoCo ----------------------------------------------------------------------------------
    @cached_property
    def simulator(self) -> Simulator:
        """Steps the model."""
        if self.warp is not None:
            return WarpSimulator(self.compiled(), self.inputs.spec, self.warp)
        return Simulator(self.compiled(), self.inputs.spec, self.threads)

    @cached_property
    def _watched(self) -> Simulator:
        """Evaluates sensors: one short step, without contacts where no sensor needs them."""
        mujoco, model = engine(self.scene.name), self.compiled()
        model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
        if not any(isinstance(each, Readings) for each in self.observation.sensors):
            model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
        return Simulator(model, self.inputs.spec, self.threads)

    def compiled(self) -> Any:
        """A copy of the ``MjModel``, as it is driven."""
        return self.as_driven(copy.copy(self.scene.model))

    def as_driven(self, compiled: Any) -> Any:
        """A compiled model whose actuators are switched off if no drive sets them."""
        if not self.inputs.controls_actuators:
            compiled.opt.disableflags |= engine(self.scene.name).mjtDisableBit.mjDSBL_ACTUATION
        return compiled

    def on(self, compiled: Any) -> Self:
        """The same of another compiled model of the same sizes, such as one with a changed number."""
        other = copy.copy(self)
        for name in ("simulator", "_watched"):
            vars(other).pop(name, None)
        other.scene, other._memo = replace(self.scene, model=compiled, spec=None), Memo()
        return other

    def row_steps(self, row: int) -> tuple[float, int]:
        """Length in s, and number, of MuJoCo's steps into a ``row``."""
        return self._steps[int(self._which[row])]

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name not in ("simulator", "_watched", "_memo")}

    def __copy__(self) -> Self:
        other = object.__new__(type(self))
        vars(other).update(vars(self))  # with its simulators and results, which no parameter changes
        return other

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state, _memo=Memo())

    def split(self, state: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """State (..., D) → process z (..., Z), chart δ (..., nv), velocities (..., nv), activations (..., na)."""
        z, tangent, velocity, activation = torch.split(state, [self.torque_size, self.nv, self.nv, self.na], -1)
        return z, tangent, velocity, activation

    def physics(self, flat: np.ndarray) -> np.ndarray:
        """States (B, D) as MuJoCo has them, (B, nq + nv + na): qpos, qvel, act within its limits."""
        _, tangent, velocity, activation = np.split(flat, np.cumsum([self.torque_size, self.nv, self.nv]), -1)
        low, high = self._activation_limits
        qpos = self.scene.chart.configuration(self.scene.reference, tangent)
        return np.concatenate([qpos, velocity, np.clip(activation, low, high)], -1)

    @cached_property
    def _activation_limits(self) -> tuple[np.ndarray, np.ndarray]:
        """(na,) each; infinite where there are none. A muscle's are 0 and 1."""
        mujoco, model = engine(self.scene.name), self.scene.model
        low, high = np.full(self.na, -np.inf), np.full(self.na, np.inf)
        for a in range(model.nu):
            first, count = int(model.actuator_actadr[a]), int(model.actuator_actnum[a])
            if first < 0:
                continue
            if model.actuator_dyntype[a] == mujoco.mjtDyn.mjDYN_MUSCLE:
                low[first : first + count], high[first : first + count] = 0.0, 1.0
            elif model.actuator_actlimited[a]:
                low[first : first + count], high[first : first + count] = model.actuator_actrange[a]
        return low, high

    def drive_within(self, flat: np.ndarray, row: int, steps: int) -> np.ndarray:
        """MuJoCo's inputs (B, n, C) in the n steps into a ``row``, from states (B, D)."""
        rows = np.full(len(flat), row)
        return self._within(flat, self._faded(flat, rows), rows, steps)

    def _within(self, flat: np.ndarray, faded: np.ndarray, rows: np.ndarray, steps: int) -> np.ndarray:
        """The same into ``rows`` (B,): z on a line to its mean ``faded`` (B, Z), at the steps' middles."""
        share = (np.arange(steps) + 0.5) / steps
        now, then = (each[:, None, : self.inputs.size] for each in (flat, faded))
        since = np.maximum(rows - 1, 0)[:, None].repeat(steps, 1)
        return self.inputs.fields(now + share[:, None] * (then - now), since)

    def _faded(self, flat: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Means (B, Z) of the drive in ``rows`` (B,), given states (B, D) before them."""
        dt = self.timeline.dt[torch.from_numpy(rows)].cpu().double().unsqueeze(-1)
        return self.torque.mean(torch.as_tensor(flat[:, : self.torque_size]), dt, self._single()).numpy()

    def _single(self) -> dict[str, Tensor]:
        """The torque process's parameters that its mean depends on, of one parameter set, in float64."""
        found = {}
        for name, value in self.parameters.items():
            if name.startswith("torque."):
                flat = value.detach().cpu().double()
                found[name] = flat.reshape(-1, *flat.shape[-1:])[0] if flat.ndim > 1 else flat
        return found

    def moved(self, state: Tensor, t: int | Tensor) -> Tensor:
        """Mean (..., D) of the states into row ``t``, those of the drive excepted, which are zero."""
        flat = self._flat(state)
        rows = np.broadcast_to(np.asarray(t), state.shape[:-1]).reshape(-1).copy()
        faded = self._faded(flat, rows)
        known = np.concatenate([flat, rows[:, None], faded], -1)
        keys = known.view(f"V{known.itemsize * known.shape[-1]}").ravel().tolist()
        out = self._memo.get(keys)
        if out is None:
            out = self._memo.add(keys, self._moved(flat, rows, faded))
        return torch.from_numpy(out.copy()).reshape(state.shape).to(state)

    def _moved(self, flat: np.ndarray, rows: np.ndarray, faded: np.ndarray) -> np.ndarray:
        out = np.zeros_like(flat)
        for kind in np.unique(which := self._which[rows]):
            here = np.flatnonzero(which == kind)
            length, count = self._steps[kind]
            own = flat[here]
            controls = self._within(own, faded[here], rows[here], count)
            ends, _ = self.simulator.run(self.physics(own), controls, length)
            qpos, others = np.split(ends, [self.scene.chart.num_qpos], -1)
            tangent = self.scene.chart.tangent(self.scene.reference, qpos)
            out[here, self.torque_size :] = np.concatenate([tangent, others], -1)
        return out

    def sensed(self, state: Tensor) -> Tensor:
        """MuJoCo's sensor data (..., N) in states (..., D)."""
        flat = self._flat(state)
        controls = self.inputs.fields(flat[:, None, : self.inputs.size])
        _, sensors = self._watched.run(self.physics(flat), controls, 1e-6)
        sensors = np.where(np.isfinite(flat).all(-1, keepdims=True), sensors[:, 0], np.nan)
        return torch.from_numpy(sensors).reshape(*state.shape[:-1], -1).to(state)

    def _flat(self, state: Tensor) -> np.ndarray:
        """States as (B, D) in float64; raises BodyError where their slopes are wanted."""
        if state.requires_grad and torch.is_grad_enabled():
            raise BodyError("MuJoCo's step has no derivative here: use smc, laplace, bootstrap or particle-gibbs")
        return state.detach().cpu().double().reshape(-1, self.state_dim).contiguous().numpy()

    # -- the three distributions -----------------------------------------------------------------
    def initial(self) -> Distribution:
        """Stationary drive; the configuration, velocities and activations about "initial.…"."""
        p = self.parameters
        dt = self.timeline.dt[0].to(self.dtype).reshape(1)
        root = self.torque.stationary(dt, p)
        kinds = ("angle", "velocity", "activation")[: 2 + bool(self.na)]
        mean = join(root.new_zeros(self.torque_size), *(p[f"initial.{kind}"] for kind in kinds))
        sd = join(*(p[f"initial.{kind}_scale"] for kind in kinds))
        lead = common(mean.shape[:-1], sd.shape[:-1], root.shape[: -1 if self.torque.diagonal else -2])
        return gaussian(mean.expand(*lead, -1), root, sd, self.torque.diagonal)

    def transition(self, state: Tensor, t: int | Tensor) -> Distribution:
        """MuJoCo's steps into row ``t``, with noise."""
        p = self.parameters
        dt = self.timeline.dt[t].to(state).unsqueeze(-1)
        z = state[..., : self.torque_size]
        drive = self.torque.mean(z, dt, p)
        mean = self.moved(state, t)
        mean = join(drive, mean[..., self.torque_size :])
        root = self.torque.noise(dt, p)
        more = [p["noise.activation"]] if self.na else []
        sds = join(
            p["noise.angle"] * RELAXED_ANGLE**self.relaxation,
            p["noise.velocity"] * RELAXED_VELOCITY**self.relaxation,
            *more,
        )
        return gaussian(mean, root, sds, self.torque.diagonal)

    def emission(self, state: Tensor, t: int | Tensor) -> Distribution:
        """What the sensors show in ``state``."""
        _, tangent, velocity, _ = self.split(state)
        angles = torch.as_tensor(self.reference_angles).to(state) + tangent
        readings = None
        points = state.new_zeros(*state.shape[:-1], 0, self.scene.dimensions)
        if not all(isinstance(each, Encoders) for each in self.observation.sensors):
            readings = self.sensed(state)
            columns = torch.as_tensor(self.scene.points[:, list(self.scene.plane)])
            points = readings[..., columns]
        unknown: Any = _unknown
        view = EngineView(
            angles,
            velocity,
            points,
            angles,
            self.scene,
            unknown,
            unknown,
            unknown,
            unknown,
            lambda: self.timeline.elapsed[t].to(state).unsqueeze(-1),
            readings=readings,
        )
        return self.observation.predict(view, t, self.parameters)

    @cached_property
    def reference_angles(self) -> np.ndarray:
        """(nv,) the reference's own coordinates; zero of rotations."""
        chart, out = self.scene.chart, np.zeros(self.nv)
        out[chart.plain_dof] = self.scene.reference[chart.plain_qpos]
        return out

    # -- starts ----------------------------------------------------------------------------------
    def initial_paths(self, observations: Tensor) -> Tensor:
        """One path (1, T, D) through the rows' own configurations (:mod:`.inverse_kinematics`), without a drive."""

        def shown(tangent: np.ndarray) -> Any:
            state = torch.zeros(*tangent.shape[:-1], self.state_dim, dtype=torch.float64)
            state[..., self.torque_size : self.torque_size + self.nv] = torch.as_tensor(tangent)
            emission = self.emission(state, 0)
            return getattr(emission, "base_dist", emission)

        rows = observations.detach().cpu().double().numpy()
        noise = shown(np.zeros(self.nv)).scale.expand(rows.shape[-1]).numpy()
        found = poses(lambda tangent: shown(tangent).loc.numpy(), noise, rows, self.time.numpy(), self.nv)
        physics = np.concatenate(found, -1)
        path = torch.zeros(1, len(rows), self.state_dim, dtype=torch.float64)
        path[..., self.torque_size :][..., : 2 * self.nv] = torch.as_tensor(physics)
        if self.na:
            path[..., -self.na :] = self.parameters["initial.activation"].detach().reshape(-1, self.na)[0]
        return path

    def relaxed(self, amount: float) -> Self:
        """The model with more process noise in configuration and velocity, from 1 to 0."""
        other = copy.copy(self)
        other.relaxation = float(amount)
        return other


class Memo:
    """The last results of MuJoCo, by what each state's depends on.

    A smoothed filter asks for each row's means twice, and one that looks ahead for those of the states that go on, too.
    """

    def __init__(self) -> None:
        self._kept: OrderedDict[bytes, np.ndarray] = OrderedDict()
        self._size = 0
        self._last: tuple[dict[bytes, int], np.ndarray] = {}, np.empty((0, 0))

    def get(self, keys: list[bytes]) -> np.ndarray | None:
        """What was kept of these states, or None; of some of those that were added last, in any order, too."""
        places, value = self._last
        with suppress(KeyError):
            return value[[places[key] for key in keys]]
        return self._kept.get(_digest(keys))

    def add(self, keys: list[bytes], value: np.ndarray) -> np.ndarray:
        """Keep values (B, …) of states, in place of the oldest ones where there is no room; return them."""
        self._kept[_digest(keys)] = value
        self._last = dict(zip(keys, range(len(keys)), strict=True)), value
        self._size += value.nbytes
        while self._size > MEMO_BYTES:
            self._size -= self._kept.popitem(last=False)[1].nbytes
        return value


def _digest(keys: list[bytes]) -> bytes:
    return blake2b(b"".join(keys), digest_size=20).digest()


def _unknown(*_: object) -> NoReturn:
    raise WrongValue("this sensor needs accelerations or times between rows, which an engine does not give")
