"""What the world does, as Pyro: bodies, dynamics, torque processes, observation, and the HMMs of them."""

from invdyn.models.articulated.arm import ArmModel
from invdyn.models.bodies.body import Body, BodyError, BodyParameters, Learned, Link
from invdyn.models.bodies.protocol import ArticulatedBody, BodyBase
from invdyn.models.dynamics.integrators import INTEGRATORS
from invdyn.models.dynamics.interface import Dynamics
from invdyn.models.dynamics.planar_recursive import RecursiveDynamics
from invdyn.models.dynamics.planar_symbolic import SymbolicDynamics
from invdyn.models.dynamics.registry import dynamics_for, planar_dynamics
from invdyn.models.linear_gaussian import LinearGaussian
from invdyn.models.observation.encoders import Encoders
from invdyn.models.observation.keypoints import Keypoints
from invdyn.models.observation.observation import FAMILIES, Observation
from invdyn.models.observation.sensor import NoisySensor, Sensor
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
    "ArticulatedBody",
    "Body",
    "BodyBase",
    "BodyError",
    "BodyParameters",
    "Dynamics",
    "Encoders",
    "Keypoints",
    "Learned",
    "LinearGaussian",
    "Link",
    "Matern32",
    "Matern52",
    "NoisySensor",
    "Observation",
    "OrnsteinUhlenbeck",
    "RandomWalk",
    "Recurrent",
    "RecursiveDynamics",
    "Sensor",
    "StateSpaceModel",
    "SymbolicDynamics",
    "TorqueProcess",
    "dynamics_for",
    "planar_dynamics",
]
