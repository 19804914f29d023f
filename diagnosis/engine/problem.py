"""A robot's log bound to MuJoCo's model of it: what was commanded is known, and a residual torque is not.

The model is :class:`.EngineModel` with the commands as given inputs, constant from row to row, and a small unknown
torque at every joint (Ornstein–Uhlenbeck of the sizes that :mod:`..problem.regime` has, in typical torques). Noise of
the dynamics is a thousandth of the usual speeds, so that it can follow nothing that matters; noise of the encoders and
keypoints is what a smooth motion does not explain, and its scale is found with each cause.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from invdyn.diagnosis.catalogue.engine_sizes import Sizes
from invdyn.diagnosis.catalogue.model_numbers import HINGE, Pair
from invdyn.diagnosis.engine.cubature_filter import cubature_filter
from invdyn.diagnosis.problem.regime import Regime, regimes
from invdyn.diagnosis.rules import DEFAULT, FIXED, Rules
from invdyn.inference.posterior.engine_problem import engine_problem
from invdyn.models import EngineModel, Scene
from invdyn.models.engine.contacts import touching_pairs
from invdyn.models.engine.drives import Given, JointTorques
from invdyn.models.torques import OrnsteinUhlenbeck
from invdyn.recordings import InputError, Recording, joined

AT_JOINTS = (0, 1)
"""Actuators at a joint, in MuJoCo's numbers."""


@dataclass(frozen=True)
class EngineLog:
    """One recording or several, and their models.

    Attributes:
        models: of each, with the file's own numbers and a residual of one typical torque.
        rows: of each, (T_r, O).
        recording: all of them, one after the other.
        regime: what is known of torques.
        typical: (K,) torques at the residual's joints.
        sizes: of the motion.
        pairs: geoms that touch along the data's own path.
        rules: that are followed.
    """

    models: tuple[EngineModel, ...]
    rows: tuple[Tensor, ...]
    recording: Recording
    regime: Regime
    typical: np.ndarray
    sizes: Sizes
    pairs: tuple[Pair, ...]
    rules: Rules = DEFAULT

    @property
    def model(self) -> EngineModel:
        """The first recording's."""
        return self.models[0]

    @property
    def observations(self) -> Tensor:
        """All rows (T, O)."""
        return torch.cat(self.rows)

    @property
    def count(self) -> int:
        """Numbers that were seen."""
        return int((~self.observations.isnan()).sum())

    def with_residual(self, size: float, model: EngineModel | None = None) -> EngineModel:
        """The model with a residual of another ``size``, in typical torques."""
        model = model or self.model
        return model.replace(**{"torque.scale": self._scale(size)})

    def _scale(self, size: float) -> Tensor:
        return torch.as_tensor(size * self.typical * math.sqrt(2 * self.rules.residual.residual_decay))


def engine_log(
    recordings: Recording | Sequence[Recording], scene: Scene, *, passive: bool = False, rules: Rules = DEFAULT
) -> EngineLog:
    """Bind one recording, or several, to a scene.

    Args:
        recordings: keypoints, angles, or both; `torques` has, by name, controls of the file's actuators and torques of
            joints that have no actuator of that name. Those that it does not name are zero.
        scene: the simulation.
        passive: nothing was commanded, and all is zero.
        rules: to follow.

    Raises InputError for a recording without commands that is not ``passive``, with names that the scene does not have,
    or that the scene cannot follow, and for recordings that do not agree; Diverged for a scene that runs away.
    """
    every = [recordings] if isinstance(recordings, Recording) else list(recordings)
    whole, _ = joined([sensed(each, scene) for each in every])
    bound = [_bound(each, scene, passive, rules) for each in every]
    sizes = replace(
        bound[0][2],
        dofs=np.max([own.dofs for *_, own in bound], 0),
        tendons=np.max([own.tendons for *_, own in bound], 0),
    )
    speed = torch.as_tensor(FIXED.engine_speed_noise * sizes.dofs[1])
    models = tuple(
        model.replace(**{"noise.velocity": speed, "noise.angle": speed * float(model.time.diff().median())})
        for model, *_ in bound
    )
    regime = replace(regimes(rules)["passive" if passive else "commanded"], levels=FIXED.engine_sizes)
    log = EngineLog(models, tuple(rows for _, rows, _ in bound), whole, regime, sizes.dofs[0], sizes, (), rules)
    pairs = [
        touching_pairs(model, cubature_filter(log.with_residual(1.0, model), own.numpy(), size).mean)
        for size in [np.array([regime.path_size])]
        for model, own in zip(models, log.rows, strict=True)
    ]
    return replace(log, pairs=tuple(sorted({pair for own in pairs for pair in own})))


def _bound(recording: Recording, scene: Scene, passive: bool, rules: Rules) -> tuple[EngineModel, Tensor, Sizes]:
    """Model and rows of one recording, and the sizes of its motion."""
    given = commands(recording, scene, passive)
    names = tuple(dict.fromkeys(scene.model.joint(j).name or f"joint{j}" for j in range(scene.model.njnt)))
    drive, process = JointTorques(names), OrnsteinUhlenbeck(decay=rules.residual.residual_decay)
    bound = engine_problem(sensed(recording, scene), scene, drive=drive, torque=process)
    parameters: Mapping[str, Any] = bound.model.parameters
    model = EngineModel(
        scene, bound.model.time, bound.model.observation, drive=drive, torque=process, given=given,
        parameters={name: value for name, value in parameters.items() if not name.startswith("torque.")},
    )  # fmt: skip
    flat = bound.model.initial_paths(bound.observations)[0].numpy()
    inputs = model.inputs.fields(np.zeros((len(flat), model.inputs.size)), np.arange(len(flat)))
    sizes = Sizes.of(model.compiled(), model.physics(flat), model.time.numpy(), inputs, model.inputs.spec)
    return model, bound.observations, sizes


def looked_at(recording: Recording, rules: Rules, count: int = 1) -> Recording:
    """Its first rows, as many as a diagnosis takes of each of ``count`` recordings."""
    return recording.at(slice(0, rules.recording.max_rows // count))


def commands(recording: Recording, scene: Scene, passive: bool) -> Given:
    """Controls and generalised forces, from each row to the next."""
    rows = recording.num_frames
    controls, forces = np.zeros((rows, scene.model.nu)), np.zeros((rows, scene.num_joints))
    if passive:
        return Given(controls, forces)
    torques = recording.torques
    if torques is None or not np.isfinite(torques).any():
        raise InputError(
            f"{recording.name}: expected what was commanded, in columns <actuator>_torque or <joint>_torque, got none: "
            "a diagnosis by MuJoCo's engine needs it, or --zero-torque"
        )
    for k, name in enumerate(recording.joint_names):
        values = torques[:, k]
        if not np.isfinite(values).any():
            continue
        if not np.isfinite(values).all():
            raise InputError(f"{recording.name}: {name}_torque is missing in some rows: fill in what was commanded")
        if name in scene.actuator_names:
            controls[:, scene.actuator_names.index(name)] = values
        elif name in scene.joint_names:
            forces[:, scene.joint_names.index(name)] = values
        else:
            raise _unknown(recording, name, scene)
    _check_servos(recording, scene)
    return Given(controls, forces)


def _check_servos(recording: Recording, scene: Scene) -> None:
    """Raise InputError where a joint's torque is logged and a servo of it has no target: it would pull to 0."""
    model = scene.model
    assert recording.torques is not None  # :func:`commands` asked
    seen = np.isfinite(recording.torques).any(0)
    logged = {name for name, has in zip(recording.joint_names, seen, strict=True) if has}
    for number, name in enumerate(scene.actuator_names):
        if model.actuator_trntype[number] not in AT_JOINTS or not model.actuator_biasprm[number, 1:3].any():
            continue
        joint = model.joint(int(model.actuator_trnid[number, 0])).name
        if name not in logged and joint in logged:
            raise InputError(
                f"{recording.name}: expected {name}_torque, the target of the servo at {joint!r}, as {joint}_torque is "
                "logged there, got none: log what the servo is given, or take it out of the file"
            )


def sensed(recording: Recording, scene: Scene) -> Recording:
    """What was seen alone, angles of the scene's joints."""
    if recording.angles is None:
        return replace(recording, torques=None, joint_names=())
    seen = [k for k in range(len(recording.joint_names)) if np.isfinite(recording.angles[:, k]).any()]
    names = tuple(recording.joint_names[k] for k in seen)
    if unknown := [name for name in names if name not in scene.joint_names]:
        raise _unknown(recording, unknown[0], scene)
    angles = recording.angles[:, seen] if seen else None
    _check_ranges(recording, scene, seen)
    return replace(recording, angles=angles, torques=None, joint_names=names)


def _check_ranges(recording: Recording, scene: Scene, seen: Sequence[int]) -> None:
    """Raise InputError for a hinge that is seen beyond its stops by more than half a turn: its unit is another."""
    assert recording.angles is not None
    for k in seen:
        joint = scene.model.joint(recording.joint_names[k])
        if not scene.model.jnt_limited[joint.id] or scene.model.jnt_type[joint.id] != HINGE:
            continue
        low, high = joint.range
        shown = recording.angles[:, k]
        if np.nanmin(shown) < low - np.pi or np.nanmax(shown) > high + np.pi:
            raise InputError(
                f"{recording.name}: expected angles of {recording.joint_names[k]!r} from {low:.3g} to {high:.3g} rad, "
                f"its range, got {np.nanmin(shown):.3g} to {np.nanmax(shown):.3g}: --units deg if they are degrees"
            )


def _unknown(recording: Recording, name: str, scene: Scene) -> InputError:
    known = ", ".join(dict.fromkeys((*scene.joint_names, *scene.actuator_names)))
    return InputError(
        f"{recording.name}: {name!r} is no joint and no actuator of {scene.name}, which has {known}: rename the column"
    )
