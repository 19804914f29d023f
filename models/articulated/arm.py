"""An articulated body as a state-space model: driven by random torques, and watched by sensors.

Biderman et al. (2020), eqs. 1–5. State x = (z, θ, θ̇), with τ = z[:K] the joint torques
(:mod:`invdyn.models.torques`):

    θ̈ = D(θ)⁻¹ (τ + u − c(θ) − h(θ, θ̇))
    x_t = integrate(x_{t−1}, δ) + noise,   y_t ~ observation(θ_t)

u is the commanded torque, constant between rows; without one, τ is the whole net torque. Effects
(:mod:`invdyn.models.effects`), what a real arm has and an ideal one lacks, change any of it. The
noise of θ and θ̇ is "noise.angle" ε_θ (rad) and "noise.velocity" ε_θ̇ (rad/s), standard
deviations per step, as printed in the paper.

A base that moves (:mod:`.moving_base`) has states in z, after the torque process's own: the body then feels the gravity
g − b̈, and every site is seen b farther.

Within a step the mechanical integrator sees the torque move on a straight line from z to its
mean one step later; explicit Euler takes it as constant, as printed.

The model is composed: :mod:`.timeline` the rows' clocks, :mod:`.drive` commands and motors, :mod:`.step` the mechanics
of a row, :mod:`.transition` how states go on, made as :mod:`.state` says, :mod:`.observation_model` what is seen of
them. Other circumstances of the same body, such as an effect or another command, are another model that shares the
rest.
"""

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, Self

import numpy as np
import torch
from pyro.distributions import Distribution
from torch import Tensor

from invdyn.models.articulated.as_filed import engine_steps, filed
from invdyn.models.articulated.defaults import Value, WrongValue, default_parameters, shaped
from invdyn.models.articulated.drive import Drive, Motors
from invdyn.models.articulated.moving_base import MovingBase, OnMovingBase
from invdyn.models.articulated.observation_model import ObservationModel
from invdyn.models.articulated.start import kinematic_paths
from invdyn.models.articulated.state import StateLayout
from invdyn.models.articulated.step import Mechanics
from invdyn.models.articulated.timeline import Row, Timeline
from invdyn.models.articulated.transition import Transition
from invdyn.models.bodies.protocol import ArticulatedBody
from invdyn.models.dynamics.integrators import INTEGRATORS
from invdyn.models.dynamics.registry import dynamics_for
from invdyn.models.effects.base import PREFIX, Effect
from invdyn.models.effects.command import Command
from invdyn.models.effects.composition import Composition, NotTogether
from invdyn.models.effects.parameters import check_tracked, hidden_scales, is_signed, parameters_of
from invdyn.models.effects.scale import Experience, Scale
from invdyn.models.observation.keypoints import Keypoints
from invdyn.models.observation.observation import Observation
from invdyn.models.state_space import StateSpaceModel
from invdyn.models.torques import OrnsteinUhlenbeck, TorqueProcess

DERIVED = ("layout", "mechanics", "_motors", "chain", "observation_model")
"""What a model makes of its parts, once it is asked for."""


class ArmModel(StateSpaceModel):
    """Hidden Markov model of an articulated body, an arm or any other, on a given time grid.

    Args:
        body: a chain in the plane, or any :class:`.ArticulatedBody`; scalars that are priors or learned are drawn by
            :meth:`sequence`, and stand at their nominal values elsewhere.
        time: (T,) s, increasing; need not be regular.
        observation: what is observed; by default keypoints at all sites.
        torque: torque process; Ornstein–Uhlenbeck by default.
        base: how the first joint is carried about, in d axes; None where it stands still.
        command: (T, K) N·m, constant from each row to the next, or None.
        dynamics: "traced" (default), or of a planar chain "symbolic", the paper's own derivation by SymPy.
        integrator: "rk4" (default), "euler" (as printed) or "semi_implicit".
        substeps: integrator steps per row.
        parameters: values that replace the defaults, by dotted name, each broadcastable to its
            own shape: "torque.scale" (K,), "noise.angle", "noise.velocity",
            "initial.angle", "initial.angle_scale", "initial.velocity",
            "initial.velocity_scale" (K,), "emission.…", "body.length" … (K,).

    Raises ValueError for unknown dynamics or integrator, times that do not increase, a command or a parameter of
    the wrong shape, and sensors that the body has no place for; KeyError for an unknown parameter.
    """

    emission_about_mean = True

    def __init__(
        self,
        body: ArticulatedBody,
        time: Sequence[float] | np.ndarray | Tensor,
        observation: Observation | None = None,
        *,
        torque: TorqueProcess | None = None,
        base: MovingBase | None = None,
        command: np.ndarray | Tensor | None = None,
        dynamics: str = "traced",
        integrator: str = "rk4",
        substeps: int = 1,
        parameters: Mapping[str, Value] | None = None,
    ):
        if integrator not in INTEGRATORS:
            raise WrongValue(f"expected an integrator among {', '.join(INTEGRATORS)}, got {integrator!r}")
        own = () if dynamics == "traced" else (dynamics,)  # a body of one's own may know of no other
        self.body, self.dynamics = body, dynamics_for(body, *own)
        self.observation = (observation or Observation(Keypoints(range(len(body.keypoint_names))))).bound(body)
        self.torque = torque or OrnsteinUhlenbeck()
        self.base = base
        self.process = self.torque if base is None else OnMovingBase(self.torque, base)
        self.effects = Composition((), filed(body, command is not None))
        self.integrator, self.substeps = integrator, substeps
        self.timeline = Timeline.of(time)
        self.abrupt = self._abrupt(self.effects)
        self.num_steps = len(self.timeline.time)
        self.drive = Drive.held(command, (self.num_steps, body.num_joints))
        self.experience = Experience()
        self.torque_size = self.process.size(body.num_joints)
        self.observation_dim = self.observation.size
        self._numbers = type(body.parameters())
        super().__init__(default_parameters(body, self.dynamics, self.process, self.observation))
        self.state_dim = self.layout.size
        self.parameters = self.replace(**shaped(parameters or {}, self.parameters)).parameters

    # -- parts ---------------------------------------------------------------------------------
    @cached_property
    def layout(self) -> StateLayout:
        """What a state is made of."""
        hidden = sum(each.states for each in self.effects.hidden)
        memory = self.observation.states
        return StateLayout(self.torque_size, hidden, self.body.num_joints, self.process.diagonal, memory)

    @cached_property
    def mechanics(self) -> Mechanics:
        """The body with these effects and parameters."""
        return Mechanics(self.body, self.dynamics, self.effects, self.integrator, self._numbers, self.parameters)

    @cached_property
    def _motors(self) -> Motors:
        return Motors(self.drive, self.timeline, self.effects, self.parameters, self.body.num_joints, self.dtype)

    @cached_property
    def chain(self) -> Transition:
        """How its states go on."""
        parts = self.substeps_taken
        return Transition(
            self.mechanics, self._motors, self.timeline, self.process, self.layout, parts, self.observation
        )

    @cached_property
    def observation_model(self) -> ObservationModel:
        """The body before its sensors."""
        return ObservationModel(
            self.mechanics,
            self._motors,
            self.timeline,
            self.observation,
            self.layout,
            self.substeps_taken,
            self.base,
        )

    @property
    def time(self) -> Tensor:
        """(T,) s."""
        return self.timeline.time

    @property
    def dt(self) -> Tensor:
        """(T,) s; dt[t] is the step that ends at row t."""
        return self.timeline.dt

    @property
    def command(self) -> Tensor | None:
        """(T, K) N·m, or None."""
        return self.drive.command

    @property
    def motors(self) -> Command:
        """The command as the actuators make it; zero without a command."""
        return self._motors.made

    @property
    def substeps_taken(self) -> int:
        """Integrator steps per row: ``substeps``, or more where an effect's force jumps."""
        return max(self.substeps, self.abrupt)

    @property
    def scale(self) -> Scale:
        """What is large and small for this body, which effects' priors follow."""
        command = None if self.command is None else self.command.cpu()
        seen = self.experience
        body, time = self.body, self.time.cpu()
        return Scale(self.dynamics, body.parameters(), time, command, seen.motion, seen.range, body.joint_parts)

    @property
    def unconstrained(self) -> frozenset[str]:
        """Parameters that may be negative."""
        mine = {"initial.angle", "initial.velocity", *(f"body.{name}" for name in self.body.signed)}
        mine |= {name for name in self.parameters if name.startswith("camera.") and name != "camera.turn_scale"}
        signed = {name for name, prior in self.priors.items() if name.startswith(PREFIX) and is_signed(prior)}
        return self.torque.unconstrained | mine | signed

    def body_parameters(self) -> Any:
        """The body's numbers, each (..., own shape); those that follow from others do, effects come last."""
        return self.mechanics.body_parameters()

    def split(self, state: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """State (..., D) → torque state z and hidden ones (..., Z + H + M), angles (..., K), velocities (..., K)."""
        return self.layout.split(state)

    def base_motion(self, path: Tensor) -> tuple[Tensor, Tensor, Tensor] | None:
        """The base's b, ḃ and b̈ along paths (..., T, D): (..., T, d) m, m/s, m/s²; None of one that stands still."""
        if self.base is None:
            return None
        return self.base.parted(path[..., self.torque_size - self.base.size : self.torque_size])

    def sites(self, path: Tensor) -> Tensor:
        """Where the sites are along paths (..., T, D), in the recording's frame, (..., T, S, d) m."""
        points = self.dynamics.keypoints(self.split(path)[1], self.body_parameters())
        moved = self.base_motion(path)
        return points if moved is None else points + moved[0].unsqueeze(-2)

    def net_torque(self, path: Tensor) -> Tensor:
        """τ + u along paths (..., T, D), N·m: the torque that moved the body, (..., T, K)."""
        torque = path[..., : self.body.num_joints]
        return torque if self.command is None else torque + self.command.to(path)

    # -- the three distributions ---------------------------------------------------------------
    def initial(self) -> Distribution:
        """z_0 stationary, θ_0 and θ̇_0 Gaussian; event shape (D,)."""
        return self.chain.initial()

    def transition(self, state: Tensor, t: Row) -> Distribution:
        """x_t given x_{t−1} = ``state`` (..., D); event shape (D,)."""
        return self.chain.following(state, t)

    def emission(self, state: Tensor, t: Row) -> Distribution:
        """What sensors show in row ``t`` given x_t = ``state``; event shape (O,)."""
        return self.observation_model.emission(state, t)

    def transition_mean(self, state: Tensor, t: Row) -> Tensor:
        """E[x_t | x_{t−1} = state], shape (..., D)."""
        return self.chain.mean(state, t)

    def acceleration(self, state: Tensor, t: Row, body: Any) -> Tensor:
        """θ̈ at row ``t`` in ``state``, (..., K), under the mean of the commands before and after it, which may jump."""
        return self.observation_model.acceleration(state, t, body)

    def late(self, t: Row) -> Tensor | None:
        """Sd (..., K), N·m, of what late motors still do in the step into row ``t``; see :meth:`.Transition.late`."""
        return self.chain.late(t)

    def _abrupt(self, effects: Composition) -> int:
        """Sub-steps of a row that forces which jump take; 1 where none does."""
        return math.ceil(self.timeline.dt.median().item() / effects.max_substep) if effects.abrupt else 1

    # -- the same body under other circumstances -------------------------------------------------
    def _with(self, **parts: Any) -> Self:
        """The model with other parts, and what follows from them computed again."""
        other = copy.copy(self)
        for name in DERIVED:
            other.__dict__.pop(name, None)
        other.__dict__.update(parts)
        return other

    def replace(self, **values: Tensor) -> Self:
        """Other parameter values; see :meth:`StateSpaceModel.replace`."""
        parameters = self._replaced(values)
        device = next(iter(parameters.values())).device
        if device == self.time.device:
            return self._with(parameters=parameters)
        # A row must not wait for the host: what it needs besides parameters is where they are.
        return self._with(
            parameters=parameters,
            timeline=self.timeline.to(device),
            observation=self.observation.to(device),
            drive=self.drive.to(device),
        )

    def sampled(self) -> Self:
        """Draw the body's priors and every other Pyro site; see :meth:`StateSpaceModel.sampled`."""
        drawn = {f"body.{name}": value for name, value in self.body.drawn(self.mechanics.given).items()}
        return self.replace(**drawn)._sampled()

    def with_effects(self, *effects: Effect) -> "ArmModel":
        """The model of a body that has these effects too: ``model.with_effects(ViscousFriction("elbow"))``.

        Their parameters are "effect.<effect>.<place>.<parameter>", of shape (1,). They have priors, so :meth:`sequence`
        draws them. Until then each stands at the value where the effect is absent; one that has no such value stands
        in the middle of its grid or prior.

        Hidden states (:mod:`.effects.hidden`) come before the angles, those of a hinge as (z, ψ, ψ̇, θ, θ̇). States that
        move the body come before states that follow it. They add the parameters "initial.hidden.<effect>" and
        "noise.hidden.<effect>": standard deviations (H,) of ψ, rad, and ψ̇, rad/s.

        Raises ValueError for a place that the body lacks or no sensor tracks, for one effect twice at a place, for an
        effect of the plane on a body in space, and for a second effect whose hidden states move the body.
        """
        bound = tuple(effect.bound(self.body) for effect in effects)
        check_tracked(bound, self.observation.tracked_names)
        every = Composition((*self.effects, *bound), self.effects.filed)
        starts, priors = parameters_of(bound, self.scale, self.dtype, self.device)
        starts |= hidden_scales(bound, self.scale, self.dtype, self.device)
        other = self._with(
            effects=every,
            abrupt=self._abrupt(every) if every.abrupt else self.abrupt,
            parameters={**self.parameters, **starts},
            priors={**self.priors, **priors},
        )
        if self.base is not None and every.hinge is not None:
            raise NotTogether(f"{every.hinge.key}: expected a base at rest under a hidden hinge, this one moves")
        other.state_dim = other.layout.size
        return other

    def in_engine_steps(self) -> "ArmModel":
        """The model as the engine that its file names simulates it, in steps of first order (:class:`.FiledStep`)."""
        return self._with(effects=Composition(tuple(self.effects), (*self.effects.filed, *engine_steps(self.body))))

    def in_substeps(self, count: int, abrupt: int | None = None) -> "ArmModel":
        """The model in so many integrator steps a row; ``abrupt`` is what a force that jumps takes at least."""
        return self._with(substeps=count, abrupt=self.abrupt if abrupt is None else abrupt)

    def observed_by(self, observation: Observation) -> "ArmModel":
        """The model with the same sensors under other noise; they keep their parameters, and new ones begin."""
        own = observation.bound(self.body)
        like = self.parameters["noise.angle"]
        begin = {name: value.to(like) for name, value in own.defaults(self.scale.reach).items()}
        new = {name: value for name, value in begin.items() if name not in self.parameters}
        return self._with(observation=own, parameters={**self.parameters, **new})

    def at_times(self, time: Sequence[float] | np.ndarray | Tensor) -> "ArmModel":
        """The model on another grid of times (T,) s, without a command."""
        return self._with(timeline=Timeline.of(time), num_steps=len(time), drive=Drive())

    def commanded(self, torque: np.ndarray | Tensor) -> "ArmModel":
        """The model under a command (T, K) N·m, constant from each row to the next."""
        return self._with(drive=Drive.held(torque, (self.num_steps, self.body.num_joints)), effects=self._with_servos)

    def driven_by(self, time: Tensor, torque: Tensor) -> "ArmModel":
        """The model under a command (C, K) N·m, constant between times (C,) s of its own, finer than the rows.

        ``command`` becomes its mean over each row. It may begin before the first row.
        """
        drive = self.drive.driven_by(time, torque, self.time)
        return self._with(drive=drive, timeline=self.timeline.known_from(time[0]), effects=self._with_servos)

    @property
    def _with_servos(self) -> Composition:
        """The effects of the model under a command."""
        return self.effects if self.command is not None else Composition(tuple(self.effects), filed(self.body))

    def with_observed_speed(self, speed: Tensor) -> "ArmModel":
        """The model of a body whose joints' rms velocities (K,) rad/s are known, which effects' priors follow."""
        return self._with(experience=replace(self.experience, motion=speed.detach().cpu().double()))

    def with_observed_range(self, lowest: Tensor, highest: Tensor) -> "ArmModel":
        """The model of a body whose joints turn between two angles (K,) rad, where effects are looked for."""
        turned = torch.stack([lowest, highest], -1).detach().cpu().double()
        return self._with(experience=replace(self.experience, range=turned))

    def restarted_at(self, rows: Sequence[int], angle: Tensor) -> "ArmModel":
        """The model of several recordings one after another: at ``rows`` (R,) the body starts again.

        There the state does not follow from the row before, but is drawn as the first one is, with angles within
        about half a turn of ``angle`` (R, K) rad.
        """
        return self._with(timeline=self.timeline.restarted_at(rows, angle))

    # -- a start for linearisation -------------------------------------------------------------
    def initial_paths(self, observations: Tensor) -> Tensor:
        """Paths (C, T, D) through smoothed inverse kinematics; see :mod:`.start`."""
        paths = kinematic_paths(self, observations)
        return super().initial_paths(observations) if paths is None else paths

    @property
    def independent_sensor_states(self) -> tuple[list[int], list[int]] | None:
        """The sensors' own states that show in one entry; see :attr:`.StateSpaceModel.independent_sensor_states`."""
        own, shown = self.observation.independent_states
        first = self.layout.torque + self.layout.hidden
        return ([first + state for state in own], shown) if own else None

    @property
    def contact_states(self) -> slice | None:  # type: ignore[override]  # its effects say
        """A gap's state follows from the joints' motion: it jumps where contact is made, and no slope tells when."""
        hinge = self.effects.hinge
        return slice(self.torque_size, self.torque_size + hinge.states) if hinge and hinge.forgets else None

    def relaxed(self, amount: float) -> "ArmModel":
        """Let angles slip by 0.3 rad × ``amount`` a step, and velocities by what that is in one step."""
        angle, velocity = 0.3 * amount, 0.3 * amount / self.dt.median().item()
        slack: dict[str, float | list[float]] = {"noise.angle": angle, "noise.velocity": velocity}
        for each in self.effects.hidden:
            rates = each.states // 2
            slack[f"noise.hidden.{each.key}"] = [0.1 * angle] * (each.states - rates) + [0.1 * velocity] * rates
        return self.replace(
            **{k: torch.hypot(self.parameters[k], self.parameters[k].new_tensor(v)) for k, v in slack.items()}
        )
