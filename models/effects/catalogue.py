"""Every effect by its canonical name: dynamics first, then what only sensors see, each in order of the alphabet.

They are gathered from the files of this folder: ``viscous_friction.py`` with the class ``ViscousFriction``
is the effect "viscous_friction". Abstract classes, and files whose classes have other names, are what effects share.
"""

import inspect
import pkgutil
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from types import MappingProxyType

from invdyn.models.effects.base import Effect, effect_name


def gathered(folder: Path, package: str) -> dict[str, type[Effect]]:
    """Effects, by name, of the modules in a folder that are named as their effect is."""
    found = {}
    for module in pkgutil.iter_modules([str(folder)]):
        if module.name == "catalogue":
            continue
        for kind in vars(import_module(f"{package}.{module.name}")).values():
            if not isinstance(kind, type) or not issubclass(kind, Effect) or inspect.isabstract(kind):
                continue
            if effect_name(kind) == module.name:
                found[module.name] = kind
    return dict(sorted(found.items(), key=lambda entry: (entry[1].side, entry[0])))


EFFECTS: Mapping[str, type[Effect]] = MappingProxyType(gathered(Path(__file__).parent, __package__))
