"""Every effect by its canonical name: dynamics first, then what only sensors see, each in order of the alphabet.

They are gathered from the files of this folder. A file of a family, such as ``friction.py``, has an effect in each of
its classes: ``ViscousFriction`` is "viscous_friction". Of any other file only the class that is named as the file is
one; what else it holds, and abstract classes, are what effects share.
"""

import inspect
import pkgutil
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from types import MappingProxyType

from invdyn.models.effects.base import Effect, effect_name, side_of

FAMILIES = ("camera", "disturbances", "friction", "inertia", "joints", "motors", "sensors")
"""Files with several effects; an effect's entry in ``diagnosis/catalogue`` is in the file of the same name."""


def gathered(folder: Path, package: str) -> dict[str, type[Effect]]:
    """Effects, by name, of the modules in a folder."""
    found = {}
    for module in pkgutil.iter_modules([str(folder)]):
        if module.name == "catalogue":
            continue
        path = f"{package}.{module.name}"
        for kind in vars(import_module(path)).values():
            if not isinstance(kind, type) or not issubclass(kind, Effect) or inspect.isabstract(kind):
                continue
            name = effect_name(kind)
            family = module.name in FAMILIES and kind.__module__ == path
            if family or name == module.name:
                found[name] = kind
    return dict(sorted(found.items(), key=lambda entry: (side_of(entry[1]), entry[0])))


EFFECTS: Mapping[str, type[Effect]] = MappingProxyType(gathered(Path(__file__).parent, __package__))
