"""What the world does, as Pyro: bodies, dynamics, torque processes, observation, and the HMMs of them."""

from invdyn.models.articulated.arm import ArmModel
from invdyn.models.bodies.body import Body, BodyError, BodyParameters, Learned, Link
from invdyn.models.dynamics.integrators import INTEGRATORS
from invdyn.models.dynamics.interface import Dynamics, RecursiveDynamics, SymbolicDynamics, dynamics_for
from invdyn.models.linear_gaussian import LinearGaussian
from invdyn.models.observation.emission import FAMILIES, Emission
from invdyn.models.state_space import StateSpaceModel
from invdyn.models.torques import (
    TORQUE_PROCESSES,
    Matern32,
    Matern52,
    OrnsteinUhlenbeck,
    RandomWalk,
    Recurrent,
    TorqueProcess,
)

__all__ = [
    "FAMILIES",
    "INTEGRATORS",
    "TORQUE_PROCESSES",
    "ArmModel",
    "Body",
    "BodyError",
    "BodyParameters",
    "Dynamics",
    "Emission",
    "Learned",
    "LinearGaussian",
    "Link",
    "Matern32",
    "Matern52",
    "OrnsteinUhlenbeck",
    "RandomWalk",
    "Recurrent",
    "RecursiveDynamics",
    "StateSpaceModel",
    "SymbolicDynamics",
    "TorqueProcess",
    "dynamics_for",
]
