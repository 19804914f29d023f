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


def default_torques(given: Iterable[str] = ()) -> TorqueProcess | list[TorqueProcess]:
    """What a torque may be, by default; the Ornstein–Uhlenbeck process where parameters of it are ``given``.

    In a list, as its parameters are uncertain.
    """
    if any(name.startswith("torque.") for name in given):
        return OrnsteinUhlenbeck()
    return [SmoothAndRough()]


__all__ = [
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
