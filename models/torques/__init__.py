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

SMOOTHNESS = ("ornstein_uhlenbeck", "matern32", "smooth_and_rough")
"""A rough torque, one with a rate, and the sum of a smooth and a small rough one: the prior is their mixture.

Matérn-5/2 by itself is left out: evidence prefers it, as small disturbances hardly change it, but its bands do not
cover them.
"""


def default_torques(given: Iterable[str] = ()) -> list[TorqueProcess]:
    """What a torque may be, where nobody says; the Ornstein–Uhlenbeck process where parameters of it are ``given``."""
    known = any(name.startswith("torque.") for name in given)
    return [TORQUE_PROCESSES[name]() for name in (SMOOTHNESS[:1] if known else SMOOTHNESS)]


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
