"""Torque processes: the prior on what the muscles or motors do."""

from invdyn.models.torques.base import TorqueProcess
from invdyn.models.torques.matern import Matern32, Matern52
from invdyn.models.torques.ornstein_uhlenbeck import OrnsteinUhlenbeck, RandomWalk
from invdyn.models.torques.recurrent import Recurrent

TORQUE_PROCESSES: dict[str, type[TorqueProcess]] = {
    "ornstein_uhlenbeck": OrnsteinUhlenbeck,
    "random_walk": RandomWalk,
    "matern32": Matern32,
    "matern52": Matern52,
    "recurrent": Recurrent,
}

SMOOTHNESS = ("ornstein_uhlenbeck", "matern32", "matern52")
"""From rough to smooth: stationary processes with a size and a correlation time each, among which evidence chooses."""

__all__ = [
    "SMOOTHNESS",
    "TORQUE_PROCESSES",
    "Matern32",
    "Matern52",
    "OrnsteinUhlenbeck",
    "RandomWalk",
    "Recurrent",
    "TorqueProcess",
]
