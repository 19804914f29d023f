"""ArviZ without its plots and statistics, until one of them is asked for.

A command keeps its posterior in an `arviz.InferenceData`. `import arviz` also imports plots and statistics, which
compile functions: 1 to 2 s of CPU, of which most commands use nothing. Here the package is registered without being
run, as Python's `importlib.util.LazyLoader` does. `InferenceData` and `from_netcdf` come from `arviz.data` alone; any
other name, or submodule, first runs the whole package.
"""

import sys
from importlib import import_module
from importlib.metadata import version
from importlib.util import find_spec, module_from_spec
from logging import getLogger
from types import ModuleType
from typing import Any

FROM_DATA = ("InferenceData", "from_netcdf")


class _OnDemand(ModuleType):
    """A package that was not run yet. It has no `__path__`, so that an import of a submodule asks for it here."""

    def __getattr__(self, name: str) -> Any:
        spec: Any = self.__spec__
        self.__path__ = spec.submodule_search_locations
        if name in FROM_DATA:
            vars(self).update(__version__=version("arviz"), _log=getLogger("arviz"))  # which its data takes from it
            import_module("arviz.utils")
            found = getattr(import_module("arviz.data"), name)
            setattr(self, name, found)
            del self.__path__
            return found
        self.__class__ = ModuleType  # type: ignore[assignment]  # an ordinary module from now on
        spec.loader.exec_module(self)
        return getattr(self, name)


def register() -> None:
    """Make `import arviz` give that package, unless it was imported before."""
    if "arviz" not in sys.modules and (spec := find_spec("arviz")) is not None:
        package = module_from_spec(spec)
        del package.__path__
        package.__class__ = _OnDemand
        sys.modules["arviz"] = package
