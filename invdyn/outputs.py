"""What a command leaves: the posterior, its figure and film, torques (.sto, .csv), motion (.mot); a comparison."""

import json
from collections.abc import Callable, Iterable
from dataclasses import astuple, dataclass
from pathlib import Path

import arviz as az
import numpy as np

from invdyn.inference import Comparison, save_posterior
from invdyn.recordings import InputError, new_folder, whole_set, write_moments, write_motion, write_table, write_text

from .console import check_ending, check_outputs
from .film import check_film, save_film
from .overlay import Overlay
from .plots import FIGURE_SUFFIXES, plot_comparison, plot_posterior, quantiles, save_figure, shifts

FILES = {*FIGURE_SUFFIXES, ".nc", ".csv", ".json", ".html"}
"""Endings of what lies in the folders that commands leave."""


@dataclass(frozen=True)
class Outputs:
    """Where each output goes; None = not wanted."""

    posterior: Path | None = None
    figure: Path | None = None
    film: Path | None = None
    sto: Path | None = None
    mot: Path | None = None
    csv: Path | None = None

    @property
    def paths(self) -> tuple[Path | None, ...]:
        """All of them."""
        return astuple(self)

    def check(self, *inputs: Path) -> None:
        """Before a long run: raise OSError or InputError unless all of it can be written, over no input."""
        check_outputs(self.paths, inputs)
        check_ending("a posterior", self.posterior, ".nc")
        check_ending("a figure", self.figure, *FIGURE_SUFFIXES)
        check_ending("a table of torques", self.csv, ".csv")
        check_ending("a file of torques for OpenSim", self.sto, ".sto")
        check_ending("a file of angles for OpenSim", self.mot, ".mot")
        if self.film is not None:
            check_film(self.film)

    def write(
        self,
        idata: az.InferenceData,
        progress: Callable[[int, int, str], None] | None = None,
        overlay: Callable[[az.InferenceData], Overlay] | None = None,
    ) -> None:
        """Write what is wanted, as a set (`whole_set`); the posterior first, as it took longest.

        `overlay` makes what the film is laid over.
        """
        if "joint" not in idata["posterior"].dims:
            raise InputError("expected the posterior of an arm, got one of a state-space model: read it by ArviZ")
        if self.sto is not None and "torque" not in idata["posterior"]:
            raise InputError(f"{self.sto}: a kinematic posterior has no torques to write for OpenSim; leave --sto out")
        with whole_set():
            self._write(idata, progress, overlay)

    def _write(
        self,
        idata: az.InferenceData,
        progress: Callable[[int, int, str], None] | None,
        overlay: Callable[[az.InferenceData], Overlay] | None,
    ) -> None:
        time, joints = idata["posterior"]["time"].values, [str(name) for name in idata["posterior"]["joint"].values]
        if self.posterior is not None:
            save_posterior(idata, self.posterior)
        if self.csv is not None:
            write_table(curves(idata), self.csv)
        if self.sto is not None:
            low, _, median, _, high = quantiles(idata, "torque")
            shifting = {name for name, shift in zip(joints, shifts(idata), strict=True) if shift}
            write_moments(self.sto, time, median, low, high, joints, shifting)
        if self.mot is not None:
            write_motion(self.mot, time, quantiles(idata, "angle")[2], joints)
        if self.figure is not None:
            save_figure(plot_posterior(idata), self.figure)
        if self.film is not None:
            save_film(idata, self.film, progress, None if overlay is None else overlay(idata))

    def listing(self) -> str:
        """What lies where: an empty line, then one each."""
        kinds = {
            "posterior": self.posterior,
            "figure": self.figure,
            "film": self.film,
            "OpenSim": self.sto,
            "motion": self.mot,
            "CSV": self.csv,
        }
        return "".join(f"\n{kind:<10} {path}" for kind, path in kinds.items() if path is not None)


@dataclass(frozen=True)
class ComparisonOutputs:
    """The folder of a comparison of `methods`: table (.csv and .json), figure, and each method's posterior."""

    folder: Path
    methods: tuple[str, ...]

    @property
    def paths(self) -> dict[str, Path]:
        """What kind -> where."""
        named = {"table": "comparison.csv", "JSON": "comparison.json", "figure": "figure.png"}
        named |= {method: f"{method}.nc" for method in self.methods}
        return {kind: self.folder / name for kind, name in named.items()}

    def check(self, *inputs: Path) -> None:
        """Before a long run: raise OSError or InputError unless all of it can be written, over no input."""
        check_folder(self.folder, self.paths.values(), inputs)

    def write(self, comparison: Comparison, truth: np.ndarray | None = None) -> None:
        """Write all of it, as a set (`whole_set`), where any method succeeded; posteriors first.

        `truth` (rows, states) is known of a model of one's own. Raises InputError where no method succeeded.
        """
        if not comparison.posteriors:
            reasons = "; ".join(f"{method}: {reason}" for method, reason in comparison.failures.items())
            raise InputError(f"no method succeeded: {reasons}")
        with new_folder(self.folder), whole_set():
            for method, idata in comparison.posteriors.items():
                save_posterior(idata, self.paths[method])
            write_text(self.paths["table"], comparison.table.to_csv(lineterminator="\n"))
            write_text(self.paths["JSON"], json.dumps(comparison.to_dict(), indent=1, ensure_ascii=False) + "\n")
            save_figure(plot_comparison(comparison.posteriors, truth), self.paths["figure"])

    def listing(self, comparison: Comparison) -> str:
        """What lies where: an empty line, then one each."""
        missing = set(self.methods) - set(comparison.posteriors)
        kinds = {kind: path for kind, path in self.paths.items() if kind not in missing}
        width = max(map(len, kinds))
        return "".join(f"\n{kind:<{width}} {path}" for kind, path in kinds.items())


@dataclass(frozen=True)
class DiagnosisOutputs:
    """The folder of a diagnosis."""

    folder: Path

    @property
    def paths(self) -> dict[str, Path]:
        """What kind -> where."""
        named = {"report": "report.html", "JSON": "diagnosis.json", "posterior": "posterior.nc"}
        return {kind: self.folder / name for kind, name in named.items()}

    def check(self, *inputs: Path) -> None:
        """Before a long run: raise OSError or InputError unless all of it can be written, over no input."""
        check_folder(self.folder, self.paths.values(), inputs)

    def listing(self) -> str:
        """What lies where: an empty line, then one each."""
        return "".join(f"\n{kind:<10} {path}" for kind, path in self.paths.items() if path.exists())


def check_folder(folder: Path, outputs: Iterable[Path], inputs: Iterable[Path]) -> None:
    """Raise OSError or InputError unless a folder, there or not, can take those outputs, over no input."""
    if not folder.exists():
        if folder.suffix.lower() in FILES:
            raise InputError(f"{folder}: expected the name of a folder, got that of a file: leave {folder.suffix} out")
        parent = next(parent for parent in folder.absolute().parents if parent.exists())
        check_outputs([parent / folder.name], inputs)
    elif not folder.is_dir():
        raise InputError(f"{folder}: expected a folder, this is a file")
    else:
        check_outputs(outputs, inputs)


def curves(idata: az.InferenceData) -> dict[str, np.ndarray]:
    """Columns of a table: time, then median, 5 and 95 % quantile of each joint's torque, if any, angle, velocity."""
    columns = {"time": idata["posterior"]["time"].values}
    for quantity in [name for name in ("torque", "angle", "velocity") if name in idata["posterior"]]:
        low, _, median, _, high = quantiles(idata, quantity)
        for number, joint in enumerate(idata["posterior"]["joint"].values):
            for suffix, values in (("", median), ("_q05", low), ("_q95", high)):
                columns[f"{joint}_{quantity}{suffix}"] = values[:, number]
    return columns
