"""Bodies and a sensor that the package has never seen, defined here, go through its inference: a registry is all.

Every body is of point masses, one at each site, wherever its joints carry them, by Lagrange's equations:

    D = Σ m JᵀJ        h = Σ m Jᵀ J̇ q̇        c = −Σ m Jᵀ g

A bead on a wire (one dimension), a fork in the plane, of which one link has two sites, and a ball on a rod in space.
The sensor measures how far sites are from a beacon, with a clock's error in common.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import numpy as np
import oracles
import pytest
import torch
from pyro.distributions import MultivariateNormal
from torch import Tensor

from invdyn.inference import Problem, SMCOptions
from invdyn.inference.methods.laplace import laplace
from invdyn.inference.methods.smc import smc
from invdyn.models import (
    ArmModel,
    ArticulatedBody,
    Dynamics,
    Encoders,
    Keypoints,
    Observation,
    Sensor,
    dynamics_for,
)
from invdyn.models.effects import CameraRoll, Outliers, ViscousFriction
from invdyn.recordings import Recording

F64 = torch.float64
STEPS, DT = 30, 0.02
TIME = DT * np.arange(STEPS)


class Masses(NamedTuple):
    """Of S sites (..., S) kg; of L links (..., L) m; (..., d) m/s²."""

    mass: Tensor
    length: Tensor
    gravity: Tensor


@dataclass(frozen=True)
class Points(ArticulatedBody):
    """Point masses on massless links."""

    name: str
    joint_names: tuple[str, ...]
    keypoint_names: tuple[str, ...]
    masses: tuple[float, ...]
    lengths: tuple[float, ...] = ()
    gravity: tuple[float, ...] = (0.0,)
    link_names: tuple[str, ...] = ()

    @property
    def num_joints(self):
        return len(self.joint_names)

    def parameters(self):
        return Masses(*(torch.tensor(value, dtype=F64) for value in (self.masses, self.lengths, self.gravity)))


class Bead(Points):
    dimensions: ClassVar[int] = 1

    @staticmethod
    def places(q, length):
        return q.unsqueeze(-1)


def direction(angle):
    return torch.stack([angle.cos(), angle.sin()], -1)


class Fork(Points):
    """A trunk that ends in two branches; the left one has a site in its middle too."""

    dimensions: ClassVar[int] = 2

    @staticmethod
    def places(q, length):
        trunk, left, right = (length[..., k, None] for k in range(3))
        top = trunk * direction(q[..., 0])
        aside = left * direction(q[..., 0] + q[..., 1])
        return torch.stack([top + aside / 2, top + aside, top + right * direction(q[..., 0] + q[..., 2])], -2)


class Ball(Points):
    """On a rod of one joint with yaw and pitch, whose gravity is along the x axis."""

    dimensions: ClassVar[int] = 3

    @staticmethod
    def places(q, length):
        yaw, pitch = q.unbind(-1)
        unit = torch.stack([yaw.cos() * pitch.cos(), yaw.sin() * pitch.cos(), pitch.sin()], -1)
        return (length * unit).unsqueeze(-2)


class PointDynamics(Dynamics):
    def __init__(self, body):
        self.num_joints, self.places = body.num_joints, body.places

    def keypoints(self, q, p):
        return self.places(q, p.length)

    def inertia_matrix(self, q, p):
        J = self.jacobian(q, p)
        return torch.einsum("...s,...sdj,...sdk->...jk", p.mass, J, J)

    def coriolis(self, q, qd, p):
        turning = self.site_accelerations(q, qd, torch.zeros_like(q), p)
        return torch.einsum("...s,...sdk,...sd->...k", p.mass, self.jacobian(q, p), turning)

    def gravity_load(self, q, p):
        return -torch.einsum("...s,...sdk,...d->...k", p.mass, self.jacobian(q, p), p.gravity)

    def inverse(self, q, qd, qdd, p):
        pulled = self.site_accelerations(q, qd, qdd, p) - p.gravity.unsqueeze(-2)
        return torch.einsum("...s,...sdk,...sd->...k", p.mass, self.jacobian(q, p), pulled)

    def forward(self, q, qd, tau, p, own_inertia=None):
        J = self.jacobian(q, p)
        pulled = self.site_accelerations(q, qd, torch.zeros_like(q), p) - p.gravity.unsqueeze(-2)
        D = torch.einsum("...s,...sdj,...sdk->...jk", p.mass, J, J)
        D = D if own_inertia is None else D + torch.diag_embed(own_inertia)
        return torch.linalg.solve(D, tau - torch.einsum("...s,...sdk,...sd->...k", p.mass, J, pulled))

    def kinetic_energy(self, q, qd, p):
        return 0.5 * (p.mass * self.site_velocities(q, qd, p).square().sum(-1)).sum(-1)

    def potential_energy(self, q, p):
        return -(p.mass * (self.keypoints(q, p) * p.gravity.unsqueeze(-2)).sum(-1)).sum(-1)


@dynamics_for.register
def _(body: Points) -> Dynamics:
    return PointDynamics(body)


@dataclass(frozen=True)
class Ranges:
    """Distances of sites from a beacon, with an error of each, .002 m, and one of the clock in common, .004 m."""

    beacon: Sequence[float]
    sites: tuple[str, ...]
    places: tuple[int, ...] = ()
    name: ClassVar[str] = "range"
    unit: ClassVar[str] = "length"

    def bound(self, body):
        return replace(self, places=tuple(body.keypoint_names.index(site) for site in self.sites))

    def to(self, device):
        return self

    @property
    def shape(self) -> tuple[int, ...]:
        return (len(self.sites),)

    @property
    def coords(self) -> Mapping[str, Sequence[str]]:
        return {"ranged": self.sites}

    def defaults(self, reach):
        return {"emission.range_scale": torch.tensor([0.002], dtype=F64)}

    def started(self, jitter, reach):
        return {}

    def predict(self, view, t, parameters):
        away = view.points[..., list(self.places), :] - torch.tensor(self.beacon).to(view.points)
        own, n = parameters["emission.range_scale"], len(self.sites)
        root = own.unsqueeze(-1) ** 2 * (torch.eye(n).to(own) + 4.0)
        return MultivariateNormal(away.norm(dim=-1), root, validate_args=False)


BEAD = Bead("bead", ("wire",), ("bead",), masses=(1.0,))
FORK = Fork(
    "fork",
    ("root", "left", "right"),
    ("left_middle", "left_tip", "right_tip"),
    masses=(0.3, 0.2, 0.4),
    lengths=(0.4, 0.3, 0.25),
    gravity=(0.0, -9.81),
    link_names=("trunk", "left", "right"),
)
BALL = Ball("ball", ("yaw", "pitch"), ("ball",), masses=(0.5,), lengths=(0.4,), gravity=(9.81, 0.0, 0.0))
STARTS = {"bead": [0.2], "fork": [-1.4, 0.5, -0.6], "ball": [0.3, -0.2]}


def model_of(body, *sensors, **options):
    given = {"initial.angle": STARTS[body.name], "initial.angle_scale": 0.05, "initial.velocity_scale": 0.5}
    given |= {"torque.scale": 0.2, "noise.angle": 1e-4, "noise.velocity": 1e-3, **options.pop("parameters", {})}
    return ArmModel(body, TIME, Observation(*sensors), parameters=given, **{"integrator": "semi_implicit", **options})


def problem_of(model, seed=0):
    torch.manual_seed(seed)
    path, rows = model.simulate()
    return Problem(model, rows, Recording(TIME, np.zeros((STEPS, 1, 2)), ("none",), name="made")), path


def check(idata, path, model):
    """The truth lies where the posterior has it: in units of its sd as a χ² says, joint by joint and in all."""
    _, angle, velocity = model.split(path)
    for name, true in (("angle", angle), ("velocity", velocity)):
        found = idata.posterior[name].stack(sample=("chain", "draw"))
        off = (found.mean("sample").values - true.numpy()) / found.std("sample").values
        # Neighbouring rows go together: some five independent ones in forty.
        assert 0.2 < np.sqrt((off**2).mean()) < 2.0
    assert idata.posterior["angle"].std(("chain", "draw")).max() < 0.1


@pytest.mark.long
def test_lagranges_equations_conserve_energy():
    for body in (BEAD, FORK, BALL):
        model = model_of(body, Encoders(), integrator="rk4", substeps=4)
        model = model.replace(**{"torque.scale": 0 * model.parameters["torque.scale"]})
        state = model.initial().sample()
        p, before = model.body_parameters(), []
        for t in range(1, 11):
            _, q, qd = model.split(state)
            before.append(model.dynamics.kinetic_energy(q, qd, p) + model.dynamics.potential_energy(q, p))
            state = model.transition_mean(state, t)
            state[: body.num_joints] = 0.0
        assert (torch.stack(before) - before[0]).abs().max() < 1e-6 * max(1.0, before[0].abs().item())


@pytest.mark.quick("1-D")
@pytest.mark.parametrize("body", [BEAD, pytest.param(FORK, marks=pytest.mark.slow), BALL], ids=["1-D", "2-D", "3-D"])
def test_keypoints_in_any_number_of_dimensions(body):
    model = model_of(body, Keypoints(body.keypoint_names))
    assert model.observation_dim == len(body.keypoint_names) * body.dimensions
    problem, path = problem_of(model)
    problem.observations[5, 0] = problem.observations[9] = torch.nan
    by_filter = smc(problem, options=SMCOptions(num_filters=8, num_particles=60, refits=0), seed=1)
    by_laplace = laplace(problem, options=SMCOptions(num_filters=8, num_draws=20), seed=1)
    for idata in (by_filter, by_laplace):
        assert idata.posterior["position"].dims == ("chain", "draw", "time", "keypoint", "space")
        assert idata.posterior["space"].values.tolist() == list("xyz"[: body.dimensions])
        assert idata.observed_data["position"].shape == (STEPS, len(body.keypoint_names), body.dimensions)
        check(idata, path, model)
    assert by_filter.attrs["outer_ess"] > 7
    # Near its mode each is Gaussian; the bead is so everywhere.
    apart = abs(by_filter.attrs["log_evidence"] - by_laplace.attrs["log_evidence"])
    assert apart < max(0.3, 4 * by_filter.attrs["log_evidence_sd"])


def test_the_bead_is_a_linear_gaussian_chain():
    """The evidence in one dimension is a Kalman filter's, of matrices read off unit vectors."""
    model = model_of(BEAD, Keypoints(["bead"]))
    problem, _ = problem_of(model)
    first, step = model.initial(), model.transition(torch.zeros(3, dtype=F64), 1)
    F = torch.stack([model.transition_mean(unit, 1) for unit in torch.eye(3, dtype=F64)], -1)
    sd = model.parameters["emission.keypoint_scale"]
    chain = oracles.Chain(
        F.numpy(),
        np.diag(step.variance.numpy()),
        np.array([[0.0, 1.0, 0.0]]),
        np.diag(sd.numpy() ** 2),
        first.mean.numpy(),
        np.diag(first.variance.numpy()),
    )
    exact = oracles.kalman(chain, problem.observations.numpy())[0]
    found = laplace(problem, options=SMCOptions(num_filters=2, num_draws=2), seed=1)
    assert found.attrs["log_evidence"] == pytest.approx(exact, abs=1e-6)


@pytest.mark.slow
def test_a_sensor_of_its_own_on_a_forked_tree():
    """Two sites of one link and one of another are heard by a beacon, and a camera sees one of them."""
    ranges = Ranges((3.0, -0.5), ("left_middle", "left_tip", "right_tip"))
    assert isinstance(ranges, Sensor)
    model = model_of(FORK, Keypoints(["right_tip"]), ranges)
    assert model.observation_dim == 2 + 3
    problem, path = problem_of(model, seed=3)
    problem.observations[4, 3] = problem.observations[7, :3] = problem.observations[11] = torch.nan
    by_filter = smc(problem, options=SMCOptions(num_filters=8, num_particles=80, refits=0), seed=1)
    by_laplace = laplace(problem, options=SMCOptions(num_filters=8, num_draws=20), seed=1)
    for idata in (by_filter, by_laplace):
        assert idata.observed_data["range"].dims == ("time", "ranged")
        assert idata.posterior_predictive["range"].attrs["units"] == "m"
        check(idata, path, model)
    apart = abs(by_filter.attrs["log_evidence"] - by_laplace.attrs["log_evidence"])
    assert apart < max(0.5, 4 * by_filter.attrs["log_evidence_sd"])
    blind = model_of(FORK, Keypoints(["right_tip"])), problem.observations[:, :2]
    alone = laplace(Problem(*blind, problem.recording), options=SMCOptions(num_filters=8, num_draws=20), seed=1)
    sd = [idata.posterior["angle"].sel(joint="left").std(("chain", "draw")).mean() for idata in (by_laplace, alone)]
    assert sd[0] < 0.5 * sd[1]


def test_effects_that_need_no_plane_act_on_any_body():
    model = model_of(BALL, Keypoints(["ball"])).with_effects(ViscousFriction("yaw"), Outliers())
    values = {"effect.viscous_friction.yaw.damping": torch.tensor([0.3], dtype=F64)}
    state = torch.tensor([0.0, 0.0, 0.1, 0.2, 1.0, -1.0], dtype=F64)
    slowed = model.replace(**values).transition_mean(state, 1)
    assert slowed[4] < model.transition_mean(state, 1)[4]
    model.emission(state, 1).sample()
    with pytest.raises(ValueError, match="camera_roll: expected a chain in the plane, got 'ball'"):
        model.with_effects(CameraRoll())
    assert CameraRoll.everywhere(BALL, ["ball"]) == []
