"""ArviZ without its plots and statistics, until one of them is asked for.

A command keeps its posterior in an `arviz.InferenceData`. `import arviz` also imports plots and statistics, which
compile functions: 1 to 2 s of CPU, of which most commands use nothing. Here the package is registered without being
run, as Python's `importlib.util.LazyLoader` does, but for one thing: `InferenceData` and `from_netcdf` come from
`arviz.data`, and submodules by themselves. Any other name first runs the whole package, once, which then finds those
submodules loaded.
"""

import sys
from importlib import import_module
from importlib.metadata import version
from importlib.util import find_spec, module_from_spec
from logging import getLogger
from threading import RLock
from types import ModuleType
from typing import Any

FROM_DATA = ("InferenceData", "from_netcdf")
OF_SUBMODULES = {"__version__": lambda: version("arviz"), "_log": lambda: getLogger("arviz")}
"""What submodules take from the package; its own logger, made when it runs, also leaves out repeated lines."""
_running = RLock()


class _OnDemand(ModuleType):
    """A package that was not run yet; an ordinary module afterwards."""

    def __getattr__(self, name: str) -> Any:
        # No lock in these: a thread that imports a submodule holds that one's lock, and asks for them.
        if name in OF_SUBMODULES:
            return OF_SUBMODULES[name]()
        if name in FROM_DATA:
            return getattr(import_module("arviz.data"), name)
        if find_spec(f"arviz.{name}") is not None:
            return import_module(f"arviz.{name}")
        with _running:
            if type(self) is _OnDemand:
                self._run(name)
        return getattr(self, name)

    def _run(self, name: str) -> None:
        """Run the package. Raises AttributeError where the package, while it runs, asks for what it has not yet."""
        if vars(self).get("_runs"):
            raise AttributeError(f"module 'arviz' has no attribute {name!r}")
        self._runs = True
        try:
            spec: Any = self.__spec__
            spec.loader.exec_module(self)
        except BaseException:
            sys.modules.pop("arviz", None)  # as after any import that failed
            raise
        finally:
            del self._runs
        self.__class__ = ModuleType  # type: ignore[assignment]


def register() -> None:
    """Make `import arviz` give that package, unless it was imported before."""
    if "arviz" not in sys.modules and (spec := find_spec("arviz")) is not None:
        package = module_from_spec(spec)
        package.__class__ = _OnDemand
        sys.modules["arviz"] = package
