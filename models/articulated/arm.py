"""The arm: a planar chain driven by random torques and watched through keypoints or encoders.

Biderman et al. (2020), eqs. 1–5. State x = (z, θ, θ̇), with τ = z[:K] the joint torques
(:mod:`invdyn.models.torques`):

    θ̈ = D(θ)⁻¹ (τ + u − c(θ) − h(θ, θ̇))
    x_t = integrate(x_{t−1}, δ) + noise,   y_t ~ emission(θ_t)

u is the commanded torque, held between rows; without one, τ is the whole net torque. Effects
(:mod:`invdyn.models.effects`), what a real arm has and an ideal one lacks, change any of it. The
noise of θ and θ̇ is "noise.angle" ε_θ (rad) and "noise.velocity" ε_θ̇ (rad/s), standard
deviations per step, as printed in the paper.

Within a step the mechanical integrator sees the torque move on a straight line from z to its
mean one step later; explicit Euler sees it held, as printed.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from pyro.distributions import Distribution, MultivariateNormal, Normal
from torch import Tensor

from invdyn.models.articulated.start import kinematic_paths
from invdyn.models.articulated.step import ArmRow
from invdyn.models.articulated.variants import ArmVariants
from invdyn.models.bodies.body import Body, BodyParameters, Learned
from invdyn.models.dynamics.integrators import INTEGRATORS
from invdyn.models.dynamics.interface import dynamics_for
from invdyn.models.effects.command import Command
from invdyn.models.effects.composition import PREFIX, Composition
from invdyn.models.effects.effect_context import View
from invdyn.models.effects.parameters import is_signed
from invdyn.models.effects.scale import typical_torque
from invdyn.models.observation.emission import Emission
from invdyn.models.shapes import common, join
from invdyn.models.state_space import StateSpaceModel
from invdyn.models.torques import OrnsteinUhlenbeck, TorqueProcess

DERIVED = ("com", "inertia")


class ArmModel(ArmRow, ArmVariants, StateSpaceModel):
    """Hidden Markov model of a planar arm on a given time grid.

    Args:
        body: links; scalars that are priors or learned are drawn by :meth:`sequence`, and stand
            at their nominal values elsewhere.
        time: (T,) s, increasing; need not be regular.
        emission: what is observed.
        torque: torque process; Ornstein–Uhlenbeck by default.
        command: (T, K) N·m, held from each row to the next, or None.
        integrator: "rk4" (default), "euler" (as printed) or "semi_implicit".
        substeps: integrator steps per row.
        parameters: values that replace the defaults, by dotted name, each broadcastable to its
            own shape: "torque.scale" (K,), "noise.angle", "noise.velocity",
            "initial.angle", "initial.angle_scale", "initial.velocity",
            "initial.velocity_scale" (K,), "emission.…", "body.length" … (K,).

    Raises ValueError for an unknown integrator, times that do not increase, a command or a parameter of
    the wrong shape; KeyError for an unknown parameter.
    """

    def __init__(
        self,
        body: Body,
        time: Sequence[float] | np.ndarray | Tensor,
        emission: Emission | None = None,
        *,
        torque: TorqueProcess | None = None,
        command: np.ndarray | Tensor | None = None,
        integrator: str = "rk4",
        substeps: int = 1,
        parameters: Mapping[str, Tensor | float | Sequence[float]] | None = None,
    ):
        if integrator not in INTEGRATORS:
            raise ValueError(f"expected an integrator among {', '.join(INTEGRATORS)}, got {integrator!r}")
        joints = body.num_joints
        self.body = body
        self.emission_model = emission or Emission(range(joints))
        self.torque = torque or OrnsteinUhlenbeck()
        self.integrator, self.substeps = integrator, substeps
        self._abrupt = 1  # sub-steps that a force that jumps needs
        self.dynamics = dynamics_for(joints)
        # Of which links these follow from length and mass, for want of a number.
        missing = {name: torch.tensor([getattr(link, name) is None for link in body.links]) for name in DERIVED}
        self._derived = {name: which for name, which in missing.items() if bool(which.any())}
        self.effects = Composition()
        self._motors: Command | None = None
        self._finer: Command | None = None
        self._anew: tuple[Tensor, Tensor] | None = None
        self._motion: Tensor | None = None
        self._range: Tensor | None = None
        self.time = torch.as_tensor(np.asarray(time, dtype=np.float64))
        if self.time.ndim != 1 or len(self.time) < 2 or bool((self.time.diff() <= 0).any()):
            raise ValueError("expected at least two strictly increasing times, in seconds")
        self.num_steps = len(self.time)
        intervals = self.time.diff()
        self._elapsed = self._since = self.time - self.time[0]
        # dt[t] leads into row t; row 0 has no step of its own and stands for the stationary law.
        self.dt = torch.cat([intervals.median().reshape(1), intervals])
        self.command = None if command is None else torch.as_tensor(np.asarray(command, dtype=np.float64))
        if self.command is not None and self.command.shape != (self.num_steps, joints):
            raise ValueError(f"expected a command of shape {(self.num_steps, joints)}, got {self.command.shape}")

        self.torque_size = self.torque.size(joints)
        self.state_dim = self.torque_size + 2 * joints
        self.observation_dim = self.emission_model.size
        super().__init__(self._defaults())
        shaped = {}
        for name, value in (parameters or {}).items():
            if name in self.parameters:
                value = torch.as_tensor(value, dtype=torch.float64)
                own = self.parameters[name]
                try:
                    shaped[name] = value.expand_as(own).clone() if value.ndim <= own.ndim else value
                except RuntimeError:
                    expected = "a number" if own.ndim == 0 else f"a number or {tuple(own.shape)} of them"
                    raise ValueError(f"parameter {name}: expected {expected}, got {tuple(value.shape)}") from None
            else:
                shaped[name] = value  # replace() says which names exist
        self.parameters = self.replace(**shaped).parameters

    def _defaults(self) -> dict[str, Tensor]:
        body = self.body.parameters()
        joints = self.body.num_joints
        scale = typical_torque(body)
        reach = body.length.sum().item()

        def constant(value: float) -> Tensor:
            return torch.full((joints,), value, dtype=torch.float64)

        return {
            **{f"body.{name}": value for name, value in body._asdict().items()},
            **self.torque.defaults(scale),
            "noise.angle": constant(1e-3),
            "noise.velocity": constant(1e-2),
            "initial.angle": constant(0.0),
            "initial.angle_scale": constant(1.0),
            "initial.velocity": constant(0.0),
            "initial.velocity_scale": constant(3.0),
            **self.emission_model.defaults(0.02 * reach),
        }

    @property
    def unconstrained(self) -> frozenset[str]:
        """Parameters that may be negative."""
        mine = {"initial.angle", "initial.velocity", "body.gravity", "body.base", "body.com"}
        signed = {name for name, prior in self.priors.items() if name.startswith(PREFIX) and is_signed(prior)}
        return self.torque.unconstrained | mine | signed

    def body_parameters(self) -> BodyParameters:
        """The links' current values, (..., K); defaulted com and inertia follow length and mass, effects come last."""
        p = self.parameters
        length, mass, com, inertia = (p[f"body.{name}"] for name in ("length", "mass", "com", "inertia"))
        if "com" in self._derived:
            com = torch.where(self._derived["com"], length / 2, com)
        if "inertia" in self._derived:
            inertia = torch.where(self._derived["inertia"], mass * length**2 / 12, inertia)
        body = BodyParameters(length, mass, com, inertia, p["body.gravity"], p["body.base"])
        return self.effects.body(p, body)

    def sampled(self) -> "ArmModel":
        """Draw the body's priors and every other Pyro site; see :meth:`StateSpaceModel.sampled`."""
        drawn = self.body.sample(dtype=self.dtype, device=self.device)._asdict()
        values = {}
        for name in ("length", "mass", "com", "inertia"):
            free = [isinstance(getattr(link, name), Distribution | Learned) for link in self.body.links]
            if any(free):
                # Plain numbers stand as the model has them: they may have been replaced.
                free = torch.tensor(free, device=self.device)
                values[f"body.{name}"] = torch.where(free, drawn[name], self.parameters[f"body.{name}"])
        return super(ArmModel, self.replace(**values)).sampled()

    @property
    def motors(self) -> Command:
        """The command as the actuators make it; zero without a command."""
        if self._motors is None:
            torque = self.time.new_zeros(self.num_steps, self.body.num_joints) if self.command is None else self.command
            held = self._finer or Command.held(self.time, torque)
            if self.effects.has_command:
                # In float64, whatever the states' type: times are long and steps short.
                held = self.effects.command({name: value.double() for name, value in self.parameters.items()}, held)
            held = held if held.time is self.time else held.onto(self.time)
            self._motors = Command(held.time, held.mean.to(self.dtype), held.slope.to(self.dtype))
        return self._motors

    # -- the three distributions ---------------------------------------------------------------
    def initial(self) -> Distribution:
        """z_0 stationary, θ_0 and θ̇_0 Gaussian; event shape (D,)."""
        p = self.parameters
        root = self.torque.stationary(self._interval(0), p)
        sds = self._with_hidden("initial.hidden", p["initial.angle_scale"], p["initial.velocity_scale"])
        moving = join(p["initial.angle"], p["initial.velocity"])
        still = moving.new_zeros(*moving.shape[:-1], self.state_dim - moving.shape[-1])
        return self._gaussian(join(still, moving), root, sds)

    def transition(self, state: Tensor, t: int | Tensor) -> Distribution:
        """x_t given x_{t−1} = ``state`` (..., D); event shape (D,)."""
        p = self.parameters
        root = self.torque.noise(self._step(t), p)
        if (late := self.late(t)) is not None:
            root = torch.hypot(root, late)
        sds = self._with_hidden("noise.hidden", p["noise.angle"], p["noise.velocity"])
        moved = self._gaussian(self.transition_mean(state, t), root, sds)
        return moved if self._anew is None else self._unless_anew(moved, t)

    def _unless_anew(self, moved: Distribution, t: int | Tensor) -> Distribution:
        p = self.parameters
        here, middle = (value[t] for value in self._anew)
        sds = self._with_hidden("initial.hidden", torch.full_like(middle, np.pi), p["initial.velocity_scale"])
        still = middle.new_zeros(*middle.shape[:-1], self.state_dim - 2 * self.body.num_joints)
        start = self._gaussian(
            join(still, middle, torch.zeros_like(middle)), self.torque.stationary(self._interval(0), p), sds
        )
        here = here.unsqueeze(-1)
        if self.torque.diagonal:
            loc, scale = (
                torch.where(here, getattr(start.base_dist, name), getattr(moved.base_dist, name))
                for name in ("loc", "scale")
            )
            return Normal(loc, scale, validate_args=False).to_event(1)
        tril = torch.where(here.unsqueeze(-1), start.scale_tril, moved.scale_tril)
        return MultivariateNormal(torch.where(here, start.loc, moved.loc), scale_tril=tril, validate_args=False)

    def emission(self, state: Tensor, t: int | Tensor) -> Distribution:
        """Keypoints and encoder angles of row ``t`` given x_t = ``state``; event shape (O,)."""
        z, q, qd = self.split(state)
        body, p, effects = self.body_parameters(), self.parameters, self.effects
        tips = effects.tips(p, q, z[..., self.torque_size :], body)
        if not (effects.has_points or effects.has_angles or effects.has_noise or effects.has_mistakes):
            return self.emission_model.distribution(tips, q, t, p)
        elapsed = self._elapsed[t].to(state).unsqueeze(-1)

        def turned(seconds: Tensor) -> Tensor:
            return self._ahead(state, t, body, seconds)

        def ahead(seconds: Tensor) -> Tensor:
            return self.dynamics.keypoints(turned(seconds), body) - self.dynamics.keypoints(q, body)

        doubt = self.emission_model.doubted(t, q)
        view = View(q, qd, lambda: self.acceleration(state, t, body), turned, ahead, body, elapsed, tips, doubt)
        angles = effects.angles(p, view) if self.emission_model.num_encoders else q
        view = effects.points(p, view)
        noise = (lambda sd: effects.noise(p, view, sd)) if effects.has_noise else None
        return self.emission_model.distribution(view.points, angles, t, p, noise, effects.mistakes(p, view))

    def split(self, state: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """State (..., D) → torque state z and any hidden ones (..., Z + H), angles (..., K), velocities (..., K)."""
        joints = self.body.num_joints
        return torch.split(state, [self.state_dim - 2 * joints, joints, joints], -1)

    def net_torque(self, path: Tensor) -> Tensor:
        """τ + u along paths (..., T, D), N·m: the torque that moved the arm, (..., T, K)."""
        torque = path[..., : self.body.num_joints]
        return torque if self.command is None else torque + self.command.to(path)

    def _with_hidden(self, name: str, angle: Tensor, velocity: Tensor) -> Tensor:
        return join(*(self.parameters[f"{name}.{each.key}"] for each in self.effects.hidden), angle, velocity)

    def _gaussian(self, mean: Tensor, root: Tensor, sds: Tensor) -> Distribution:
        if self.torque.diagonal:
            scale = join(root, sds)
            return Normal(mean, scale, validate_args=False).to_event(1)
        shape = common(root.shape[:-2], sds.shape[:-1])
        tril = mean.new_zeros(*shape, self.state_dim, self.state_dim)
        tril[..., : self.torque_size, : self.torque_size] = root
        tril.diagonal(dim1=-2, dim2=-1)[..., self.torque_size :] = sds
        return MultivariateNormal(mean, scale_tril=tril, validate_args=False)

    # -- a start for linearisation -------------------------------------------------------------
    def initial_paths(self, observations: Tensor) -> Tensor:
        """Paths (C, T, D) through smoothed inverse kinematics; see :mod:`.start`."""
        paths = kinematic_paths(self, observations)
        return super().initial_paths(observations) if paths is None else paths

    @property
    def driven(self) -> slice | None:
        """A gap's state follows from the joints' motion: it jumps where contact is made, and no slope tells when."""
        hinge = self.effects.hinge
        return slice(self.torque_size, self.torque_size + hinge.states) if hinge and hinge.forgets else None

    def relaxed(self, amount: float) -> "ArmModel":
        """Let angles slip by 0.3 rad × ``amount`` a step, and velocities by what that is in one step."""
        angle, velocity = 0.3 * amount, 0.3 * amount / self.dt.median().item()
        slack = {"noise.angle": angle, "noise.velocity": velocity}
        for each in self.effects.hidden:
            rates = each.states // 2
            slack[f"noise.hidden.{each.key}"] = [0.1 * angle] * (each.states - rates) + [0.1 * velocity] * rates
        return self.replace(
            **{k: torch.hypot(self.parameters[k], self.parameters[k].new_tensor(v)) for k, v in slack.items()}
        )
