"""The arm: a planar chain driven by random torques and watched through keypoints or encoders.

Biderman et al. (2020), eqs. 1–5. State x = (z, θ, θ̇), with τ = z[:K] the joint torques
(:mod:`invdyn.models.torques`):

    θ̈ = D(θ)⁻¹ (τ + u − c(θ) − h(θ, θ̇))
    x_t = integrate(x_{t−1}, δ) + noise,   y_t ~ emission(θ_t)

u is the commanded torque, held between rows; without one, τ is the whole net torque. The
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

from invdyn.models.body import Body, BodyParameters, Learned
from invdyn.models.dynamics import dynamics_for
from invdyn.models.emission import Emission
from invdyn.models.integrators import INTEGRATORS
from invdyn.models.kinematics import joint_angle_candidates
from invdyn.models.shapes import join
from invdyn.models.state_space import StateSpaceModel
from invdyn.models.torques import OrnsteinUhlenbeck, TorqueProcess


class ArmModel(StateSpaceModel):
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
        self.dynamics = dynamics_for(joints)
        self.time = torch.as_tensor(np.asarray(time, dtype=np.float64))
        if self.time.ndim != 1 or len(self.time) < 2 or bool((self.time.diff() <= 0).any()):
            raise ValueError("expected at least two strictly increasing times, in seconds")
        self.num_steps = len(self.time)
        intervals = self.time.diff()
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
        return self.torque.unconstrained | mine

    def body_parameters(self) -> BodyParameters:
        """The links' current values, (..., K); defaulted com and inertia follow length and mass."""
        p = self.parameters
        length, mass, com, inertia = (p[f"body.{name}"] for name in ("length", "mass", "com", "inertia"))
        if any(link.com is None for link in self.body.links):
            com = torch.where(self._follows("com"), length / 2, com)
        if any(link.inertia is None for link in self.body.links):
            inertia = torch.where(self._follows("inertia"), mass * length**2 / 12, inertia)
        return BodyParameters(length, mass, com, inertia, p["body.gravity"], p["body.base"])

    def _follows(self, quantity: str) -> Tensor:
        free = [getattr(link, quantity) is None for link in self.body.links]
        return torch.tensor(free, device=self.device)

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

    # -- the three distributions ---------------------------------------------------------------
    def initial(self) -> Distribution:
        """z_0 stationary, θ_0 and θ̇_0 Gaussian; event shape (D,)."""
        p = self.parameters
        root = self.torque.stationary(self._interval(0), p)
        sds = join(p["initial.angle_scale"], p["initial.velocity_scale"])
        moving = join(p["initial.angle"], p["initial.velocity"])
        still = moving.new_zeros(*moving.shape[:-1], self.torque_size)
        return self._gaussian(join(still, moving), root, sds)

    def transition(self, state: Tensor, t: int | Tensor) -> Distribution:
        """x_t given x_{t−1} = ``state`` (..., D); event shape (D,)."""
        p = self.parameters
        dt = self._interval(t)
        root = self.torque.noise(dt, p)
        sds = join(p["noise.angle"], p["noise.velocity"])
        return self._gaussian(self.transition_mean(state, t), root, sds)

    def emission(self, state: Tensor, t: int | Tensor) -> Distribution:
        """Keypoints and encoder angles of row ``t`` given x_t = ``state``; event shape (O,)."""
        _, q, _ = self.split(state)
        tips = self.dynamics.keypoints(q, self.body_parameters())
        return self.emission_model.distribution(tips, q, t, self.parameters)

    def transition_mean(self, state: Tensor, t: int | Tensor) -> Tensor:
        """E[x_t | x_{t−1} = state], shape (..., D)."""
        z, q, qd = self.split(state)
        dt = self._interval(t)
        body = self.body_parameters()
        z_next = self.torque.mean(z, dt, self.parameters)
        joints = self.body.num_joints
        start, change = z[..., :joints], (z_next - z)[..., :joints]
        if self.command is not None:
            start = start + self.command[t - 1].to(state)

        def acceleration(q: Tensor, qd: Tensor, s: float) -> Tensor:
            torque = start + s * change if s else start
            return self.dynamics.forward(q, qd, torque, body)

        q, qd = INTEGRATORS[self.integrator](acceleration, q, qd, dt, self.substeps)
        return join(z_next, q, qd)

    def split(self, state: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """State (..., D) → torque state z (..., Z), angles (..., K), velocities (..., K)."""
        joints = self.body.num_joints
        return torch.split(state, [self.torque_size, joints, joints], -1)

    def net_torque(self, path: Tensor) -> Tensor:
        """τ + u along paths (..., T, D), N·m: the torque that moved the arm, (..., T, K)."""
        torque = path[..., : self.body.num_joints]
        return torque if self.command is None else torque + self.command.to(path)

    def _interval(self, t: int | Tensor) -> Tensor:
        return self.dt[t].to(dtype=self.dtype, device=self.device).unsqueeze(-1)

    def _gaussian(self, mean: Tensor, root: Tensor, sds: Tensor) -> Distribution:
        if self.torque.diagonal:
            scale = join(root, sds)
            return Normal(mean, scale, validate_args=False).to_event(1)
        shape = torch.broadcast_shapes(root.shape[:-2], sds.shape[:-1])
        tril = mean.new_zeros(*shape, self.state_dim, self.state_dim)
        tril[..., : self.torque_size, : self.torque_size] = root
        rest = torch.arange(self.torque_size, self.state_dim)
        tril[..., rest, rest] = sds
        return MultivariateNormal(mean, scale_tril=tril, validate_args=False)

    # -- a start for linearisation -------------------------------------------------------------
    def initial_paths(self, observations: Tensor) -> Tensor:
        """Paths (C, T, D) through smoothed inverse kinematics; see :mod:`.kinematics`."""
        body = BodyParameters(*(value.detach().cpu().double() for value in self.body_parameters()))
        candidates = joint_angle_candidates(
            self.time.numpy(), observations, self.emission_model, body, self._link_angle_sd(body)
        )
        if candidates is None:
            return super().initial_paths(observations)
        return torch.stack([self._path_through(torch.as_tensor(angles), body) for angles in candidates])

    def _link_angle_sd(self, body: BodyParameters) -> np.ndarray:
        if self.emission_model.num_encoders:
            sd = self.parameters["emission.angle_scale"]
        else:
            sd = 1.5 * self.parameters["emission.keypoint_scale"].max() / body.length
        return sd.detach().cpu().double().clamp(max=1.0).numpy()

    def _path_through(self, q: Tensor, body: BodyParameters) -> Tensor:
        step = self.dt[1:, None]
        # Forward differences: under explicit Euler they satisfy the transition exactly.
        qd = q.diff(dim=0) / step
        qd = torch.cat([qd, qd[-1:]])
        qdd = torch.cat([qd.diff(dim=0) / step, torch.zeros_like(q[:1])])
        torque = self.dynamics.inverse(q, qd, qdd, body)
        if self.command is not None:
            torque = torque - self.command
        path = torch.cat([self.torque.path(torque, self.time), q, qd], -1)
        return path.to(dtype=self.dtype, device=self.device)

    def relaxed(self, amount: float) -> "ArmModel":
        """Let angles slip by 0.3 rad × ``amount`` a step, and velocities by what that is in one step."""
        slack = {"noise.angle": 0.3 * amount, "noise.velocity": 0.3 * amount / self.dt.median().item()}
        return self.replace(
            **{k: torch.hypot(self.parameters[k], torch.tensor(v).to(self.dtype)) for k, v in slack.items()}
        )


def typical_torque(body: BodyParameters) -> Tensor:
    """Size (K,) of the torques that a body needs, N·m: its gravity load held level, or, without
    gravity, what turns it by a radian in a fifth of a second.
    """
    length, mass, com, inertia = body.length, body.mass, body.com, body.inertia
    load, turning = [], []
    for k in range(len(length)):
        # Reach of each further link's centre of mass when the chain is stretched out from joint k.
        reach = torch.stack([length[k:j].sum() + com[j] for j in range(k, len(length))])
        load.append((mass[k:] * reach).sum() * body.gravity.norm())
        turning.append((inertia[k:] + mass[k:] * reach**2).sum() * 25.0)
    return torch.maximum(torch.stack(load), 0.2 * torch.stack(turning))
