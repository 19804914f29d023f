"""What is diagnosed: the simulation as a state-space model on the recording's rows, with a residual torque.

The body obeys the simulation exactly, but for an Ornstein–Uhlenbeck torque at every joint, the residual, whose size is
what a gap in the dynamics is measured by. What it stands for depends on what is known of the torques (:mod:`.regime`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import torch
from torch import Tensor

from invdyn.diagnosis.budget import Budget
from invdyn.diagnosis.catalogue import CATALOGUE, Catalogue
from invdyn.diagnosis.kept_units import content_digest
from invdyn.diagnosis.problem.conventions import check_conventions, refuse
from invdyn.diagnosis.problem.noise_floor import noise_at_rest, shrunk, variance_of_log
from invdyn.diagnosis.problem.outliers import calm, relabelled
from invdyn.diagnosis.problem.regime import Regime, regime_of
from invdyn.diagnosis.problem.stretches import looked_at
from invdyn.diagnosis.problem.uncertain import GEOMETRY, Uncertain, uncertain_numbers
from invdyn.diagnosis.rules import DEFAULT, Rules
from invdyn.inference.execution.checkpoint import Checkpoint
from invdyn.inference.posterior.initialise import Problem, arm_problem, sufficient_substeps
from invdyn.models import ArmModel, ArticulatedBody
from invdyn.models.articulated.as_filed import FiledStep, answered, engine_steps
from invdyn.models.divergence import Diverged
from invdyn.models.effects.scale import typical_torque
from invdyn.models.torques import OrnsteinUhlenbeck
from invdyn.recordings import InputError, Recording, joined
from invdyn.recordings.jitter import jitter


class NotEnoughData(InputError):
    """Too few rows with an observation, or too few tracks, to say anything."""


@dataclass(frozen=True)
class DiagnosisProblem:
    """A recording bound to the simulation of it.

    Attributes:
        problem: model with the residual torque at size one typical torque, and observations.
        regime: what is known of the torques.
        uncertain: :func:`.uncertain_numbers`; where the torque is unknown, those of the geometry alone.
        starts: rows at which another recording starts.
        shape: (K,) the residual's size at each joint for size one, in typical torques; see :meth:`shaped`.
        rules: the numbers that the diagnosis follows.
        budget: what is left of it; all problems of one diagnosis share it.
        catalogue: of the effects that are considered.
        checkpoint: where the units of the diagnosis are kept (:mod:`..kept_units`), or None.
    """

    problem: Problem
    regime: Regime
    uncertain: tuple[Uncertain, ...] = ()
    starts: tuple[int, ...] = ()
    shape: tuple[float, ...] | None = None
    rules: Rules = DEFAULT
    budget: Budget = field(default_factory=Budget, compare=False)
    checkpoint: Checkpoint | None = field(default=None, compare=False)
    catalogue: Catalogue = field(default=CATALOGUE, compare=False)

    @property
    def model(self) -> ArmModel:
        """The simulation."""
        return self.problem.model

    @property
    def observations(self) -> Tensor:
        """(T, O), NaN where missing."""
        return self.problem.observations

    @property
    def min_size(self) -> float:
        """Smallest size of the residual under which a path is found."""
        return self.rules.residual.min_path_size

    @cached_property
    def content(self) -> str:
        """A short hexadecimal name of all that sets this problem apart from others of one diagnosis."""
        model = self.model
        laws = [model.substeps, model.integrator, model.observation.family, self.engine_step, self.regime.name]
        data = [self.observations, model.time, model.command, dict(model.parameters)]
        return content_digest([*laws, self.starts, self.shape, *data])

    @cached_property
    def usual(self) -> Tensor:
        """(T, O) without what jumps, and with exchanged labels put right: where a first path begins."""
        return _usual(self.model, self.observations, self.starts)

    @cached_property
    def typical(self) -> Tensor:
        """Typical torque of each joint, (K,) N·m, in the residual's ``shape``."""
        torque = torch.tensor(self.model.scale.torque, dtype=torch.float64)
        return torque if self.shape is None else torque * torch.tensor(self.shape, dtype=torch.float64)

    def shaped(self, path: Tensor) -> "DiagnosisProblem":
        """The problem with a residual that is distributed over the joints as along ``path`` (T, D).

        One number is the size of all joints' residuals. A joint that lacks little would hide, under the size that
        another one needs, what a cause improves there. Effects are looked for where the joints turn along it.
        """
        joints = self.model.body.num_joints
        missing = path[:, :joints].square().mean(0).sqrt() / self.typical
        shape = (missing / missing.max().clamp_min(1e-12)).clamp_min(self.rules.residual.min_joint_size)
        _, angle, _ = self.model.split(path)
        model = self.model.with_observed_range(angle.amin(0), angle.amax(0))
        return replace(self, problem=replace(self.problem, model=model), shape=tuple(shape.tolist()))

    def in_substeps(self, count: int) -> "DiagnosisProblem":
        """The same problem in so many integrator sub-steps a row."""
        return replace(self, problem=replace(self.problem, model=self.model.in_substeps(count)))

    @property
    def engine_step(self) -> float:
        """First-order step, s, of the simulation, 0 for none; see :meth:`in_engine_steps`."""
        return max((part.parts.step for part in self.model.effects.filed if isinstance(part, FiledStep)), default=0.0)

    def in_engine_steps(self) -> "DiagnosisProblem":
        """The same problem in the steps of the file's own engine; itself where it has none, or without commands."""
        if self.engine_step or not (self.regime.commanded and engine_steps(self.model.body)):
            return self
        return replace(self, problem=replace(self.problem, model=self.model.in_engine_steps()))

    def observing(self, observations: Tensor) -> "DiagnosisProblem":
        """The same problem with other observations (T, O)."""
        return replace(self, problem=replace(self.problem, observations=observations))

    def until(self, row: int) -> "DiagnosisProblem":
        """The same problem seen up to a ``row``, which is not."""
        return replace(self.observing(self.observations[:row]), starts=tuple(s for s in self.starts if s < row))

    def with_residual(self, size: float, model: ArmModel | None = None) -> ArmModel:
        """``model`` with a residual torque of stationary sd ``size`` typical torques, more where it begins."""
        model = model or self.model
        scale = {"torque.scale": size * np.sqrt(2 * self.regime.decay) * self.typical}
        return model.replace(**scale, **self.initial_scale)

    @cached_property
    def initial_scale(self) -> dict[str, Tensor]:
        """Sd (K,) N·m of what is not known of commanded torques where a recording begins, as a parameter."""
        typical = torch.tensor(self.model.scale.torque, dtype=torch.float64)
        return {"torque.initial_scale": self.rules.residual.initial_torque * typical} if self.regime.commanded else {}


def diagnosis_problem(
    recording: Recording | Sequence[Recording],
    body: ArticulatedBody,
    *,
    passive: bool = False,
    force: bool = False,
    rules: Rules = DEFAULT,
) -> DiagnosisProblem:
    """Bind one or several recordings to ``body``; each of several counts from its own first row.

    By ``force``, wrong signs, zeros and units of torques are warned of and not refused.

    Raises InputError where they do not fit; NotEnoughData for too few rows, or tracks that leave a pose open.
    """
    given = [recording] if isinstance(recording, Recording) else recording
    if len(given) > 1:  # their clocks have no time in common
        given = [replace(each, time=each.time - each.time[0]) for each in given]
    recording, begins = joined([part for each in given for part in looked_at(each, rules)])
    regime = regime_of(recording.torques, passive, rules)
    uncertain = uncertain_numbers(body)
    if not regime.knows_torque and (untracked := _untracked(recording, body)):
        # A hand alone fits a pose and its mirror image, and an unknown torque may lead from one to the other.
        raise NotEnoughData(
            f"{recording.name}: torques are unknown and keypoint {', '.join(untracked)} is not "
            "tracked, so several poses show the same points; track it too, or give encoders or the commanded torques"
        )
    if not regime.knows_torque:
        # There only its rough prior would tell of masses: it pulls them down as far as they may go.
        uncertain = tuple(u for u in uncertain if u.quantity in GEOMETRY)
    whole = arm_problem(recording, body, passive=passive, substeps=1)
    rows = (~torch.isnan(whole.observations)).any(-1).numpy()
    seen = int(rows.sum())
    if seen < rules.recording.min_rows:
        raise NotEnoughData(
            f"{recording.name}: {seen} rows with an observation, a diagnosis needs {rules.recording.min_rows} or "
            "more: record longer, or with more frames in which keypoints are seen"
        )
    # Rows without an observation only carry commands, which a row takes as they come.
    torque = OrnsteinUhlenbeck(decay=regime.decay, underway=regime.commanded)
    options: dict[str, Any] = {"passive": passive, "torque": torque, "substeps": 1, "origin": whole.origin}
    problem = arm_problem(recording.at(rows), body, **options)
    # The first row of a recording that was seen; it follows from none before it.
    starts = sorted({int(rows[:start].sum()) for start in begins} - {0, seen})
    usual = _usual(problem.model, problem.observations, starts)
    model = _as_seen(problem, usual, regime)
    if regime.commanded and whole.model.command is not None:
        model = model.driven_by(whole.model.time, whole.model.command)
    paths = model.initial_paths(usual)
    _, angle, velocity = model.split(paths[len(paths) // 2])
    if regime.commanded:
        _check_torques(recording.name, model, angle, velocity, rules, force)
    check_conventions(recording.name, model, problem.observations, rules, force)
    if starts:
        model = model.restarted_at(starts, angle[starts])
    fast = velocity.square().quantile(0.99, dim=0).clamp_min(1e-12).sqrt()
    model = model.with_observed_speed(fast * rules.recording.motion_share)
    model = model.in_substeps(sufficient_substeps(model, usual))
    return DiagnosisProblem(replace(problem, model=model, doubted=False), regime, uncertain, tuple(starts), rules=rules)


def _untracked(recording: Recording, body: ArticulatedBody) -> list[str]:
    """The body's keypoints that were never seen, where there are no encoders either."""
    if recording.angles is not None and np.isfinite(recording.angles).any():
        return []
    seen = np.isfinite(recording.keypoints).any(axis=(0, 2))
    tracked = {name for name, once in zip(recording.keypoint_names, seen, strict=True) if once}
    return [name for name in body.keypoint_names if name not in tracked]


def _check_torques(name: str, model: ArmModel, angle: Tensor, velocity: Tensor, rules: Rules, force: bool) -> None:
    """Refuse torques far beyond what holds the arm level and moves it with velocities (T, K), rad/s.

    Where no gravity tells what an arm takes, friction and rotors may take nearly all of it.
    """
    body, dynamics = model.scale.body, model.dynamics
    if not bool(body.gravity.any()) or model.command is None:
        return
    rms = (velocity.diff(dim=0) / model.dt[1:].unsqueeze(-1)).square().mean(0).sqrt()
    needed = (typical_torque(dynamics, body) + dynamics.typical_inertia(body) * rms).norm().item()
    torque = answered(model.body, model.command, angle, velocity)
    given = torque.square().mean(0).sqrt().norm().item()
    if given > rules.recording.max_torque_ratio * needed:
        refuse(
            f"{name}: expected torques in N·m, some {needed:.2g} for body {model.body.name!r} and this motion, got "
            f"{given:.2g} rms: check their unit, and the body's masses (kg) and lengths (m)",
            force,
        )


def _usual(model: ArmModel, observations: Tensor, starts: Sequence[int]) -> Tensor:
    """Observations (T, O) of the arm's own course: what else there is of them is NaN."""
    return calm(model.time, relabelled(model, observations), starts)


def _as_seen(problem: Problem, usual: Tensor, regime: Regime) -> ArmModel:
    """The model with the noise that the recording's own jitter shows, and less noise of its dynamics.

    ``usual`` are its observations without outliers: those make their neighbours look fast, and noise grow with speed.
    """
    model = problem.model
    observation = model.observation
    reach = model.dynamics.reach(model.body_parameters()).item()
    found = {name: regime.dynamics_noise * model.parameters[name] for name in ("noise.angle", "noise.velocity")}
    if observation.keypoints:
        sd = torch.as_tensor(noise_at_rest(model.time.numpy(), observation.points(usual).numpy()))
        found["emission.keypoint_scale"] = sd.clamp_min(1e-5 * reach)
    if observation.encoders:
        angles = observation.of(observation.encoders, problem.observations).numpy()
        shaken = shrunk(jitter(angles), variance_of_log(np.isfinite(angles).sum(0)))
        found["emission.angle_scale"] = torch.as_tensor(shaken).clamp_min(1e-5)
    return model.replace(**found)


class CannotFollow(InputError, Diverged):
    """Of the user's body on a recording; of a candidate, which is then none."""


def cannot_follow(bound: DiagnosisProblem) -> CannotFollow:
    """The error of a simulation that diverges from its recording with any added torque."""
    return CannotFollow(
        f"{bound.problem.recording.name}: body {bound.model.body.name!r} cannot follow it, even with torque of its "
        "own at each joint: check units of torques (N·m), lengths and masses, signs and zeros of joints, or give a "
        "calmer stretch: --frames 0:500"
    )
