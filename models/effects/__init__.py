"""What a real arm has and an ideal rigid body lacks, one effect a class; all of them in :mod:`.catalogue`."""

from invdyn.models.effects.base import PREFIX, Effect, effect_name
from invdyn.models.effects.command import Command
from invdyn.models.effects.composition import Composition, own_values
from invdyn.models.effects.effect_context import Situation
from invdyn.models.effects.hidden import Follower, HiddenHinge
from invdyn.models.effects.motors import Actuator
from invdyn.models.effects.scale import Parameter, Scale, Values
from invdyn.models.observation.view import View

# Last: it imports the effects' files, which may itself import from here what stands above.
from invdyn.models.effects.catalogue import EFFECTS  # isort: skip

_CLASSES = {kind.__name__: kind for kind in EFFECTS.values()}

__all__ = [
    *_CLASSES,
    "Actuator",
    "Command",
    "Composition",
    "EFFECTS",
    "Effect",
    "Follower",
    "HiddenHinge",
    "PREFIX",
    "Parameter",
    "Scale",
    "Situation",
    "Values",
    "View",
    "effect_name",
    "own_values",
]
__all__.sort()


def __getattr__(name: str) -> type[Effect]:
    """An effect's class by its name, such as ``ViscousFriction``; the catalogue gathers them from the files."""
    if name in _CLASSES:
        return _CLASSES[name]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
