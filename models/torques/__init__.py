"""Torque processes: the prior on what the muscles or motors do."""

from collections.abc import Iterable

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

SMOOTHNESS = ("matern32", "smooth_and_rough")
"""A torque with a rate, and the sum of a smooth and a small rough one: the prior is their mixture.

The Ornstein–Uhlenbeck process, which the second one contains, is left out: draws of it jitter by as much as the whole
torque moves. So is Matérn-5/2 by itself: evidence prefers it, as small disturbances hardly change it, but its bands do
not cover them.
"""


def default_torques(given: Iterable[str] = ()) -> TorqueProcess | list[TorqueProcess]:
    """What a torque may be, by default; the Ornstein–Uhlenbeck process where parameters of it are ``given``."""
    if any(name.startswith("torque.") for name in given):
        return OrnsteinUhlenbeck()
    return [TORQUE_PROCESSES[name]() for name in SMOOTHNESS]


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
    "default_torques",
]
