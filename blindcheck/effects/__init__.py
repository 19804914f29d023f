"""The effects that the blind check simulates, each with its size and units; `EFFECTS` has them all by name."""

# in this order cases draw them
from invdyn.blindcheck.effects import joints, inertia, motors, disturbances, sensors  # isort: skip
from invdyn.blindcheck.effects.effect import EFFECTS, Injected

MECHANISMS = {name: effect.install for name, effect in EFFECTS.items() if effect.install is not None}
"""What installs each effect of the dynamics."""

OBSERVATIONS = tuple(name for name, effect in EFFECTS.items() if effect.install is None)
"""Effects on what sensors show."""

__all__ = [
    "EFFECTS",
    "MECHANISMS",
    "OBSERVATIONS",
    "Injected",
    "disturbances",
    "inertia",
    "joints",
    "motors",
    "sensors",
]
