"""Torque processes: the prior on what the muscles or motors do."""

from invdyn.models.torques.base import TorqueProcess
from invdyn.models.torques.matern import Matern32, Matern52
from invdyn.models.torques.ornstein_uhlenbeck import OrnsteinUhlenbeck, RandomWalk
from invdyn.models.torques.recurrent import Recurrent
from invdyn.models.torques.smooth_and_rough import SmoothAndRough

TORQUE_PROCESSES: dict[str, type[TorqueProcess]] = {
    "ornstein_uhlenbeck": OrnsteinUhlenbeck,
    "random_walk": RandomWalk,
    "matern32": Matern32,
    "matern52": Matern52,
    "recurrent": Recurrent,
    "smooth_and_rough": SmoothAndRough,
}

SMOOTHNESS = ("ornstein_uhlenbeck", "smooth_and_rough")
"""A rough torque, or the sum of a smooth and a small rough one: evidence chooses among these.

Purely smooth processes are left out: evidence prefers them, as small disturbances hardly change it, but their bands do
not cover the torque.
"""

__all__ = [
    "SMOOTHNESS",
    "TORQUE_PROCESSES",
    "Matern32",
    "Matern52",
    "OrnsteinUhlenbeck",
    "RandomWalk",
    "Recurrent",
    "SmoothAndRough",
    "TorqueProcess",
]
