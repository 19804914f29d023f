"""What a command leaves: posterior, figure, film, torques (.sto, .nwb, .csv), motion (.mot); a comparison."""

import json
from collections.abc import Callable, Container, Hashable, Iterable
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import arviz as az
import numpy as np

from invdyn.inference import Comparison, functional_table, save_posterior
from invdyn.recordings import (
    InputError,
    Recording,
    check_nwb,
    new_folder,
    whole_set,
    write_moments,
    write_motion,
    write_nwb,
    write_table,
    write_text,
)
from invdyn.recordings.reading import TrackedFilm

from .console import check_ending, check_outputs
from .film import FILM_SUFFIXES, check_film, save_film
from .overlay import Overlay
from .plots import FIGURE_SUFFIXES, plot_comparison, plot_posterior, quantiles, save_figure, shifts

FILES = {*FIGURE_SUFFIXES, ".nc", ".csv", ".json", ".html"}
"""Endings of what lies in the folders that commands leave."""


KINDS = {
    "posterior": (".nc",),
    "figure": FIGURE_SUFFIXES,
    "film": FILM_SUFFIXES,
    "OpenSim": (".sto",),
    "NWB": (".nwb",),
    "motion": (".mot",),
    "functionals": ("functionals.csv",),
    "CSV": (".csv",),
}
"""What an output of an inference is, by the first ending that fits."""


def kind_of(path: Path) -> str | None:
    """What an output is, a key of :data:`KINDS`; None where no ending fits."""
    name = path.name.lower()
    return next((kind for kind, endings in KINDS.items() if name.endswith(endings)), None)


@dataclass(frozen=True)
class OutputFiles:
    """The files that an inference leaves; what each is, its ending says."""

    paths: tuple[Path, ...]

    def of(self, kind: str) -> list[Path]:
        """Those of a kind, a key of :data:`KINDS`."""
        return [path for path in self.paths if kind_of(path) == kind]

    @property
    def usual_tracks(self) -> Path:
        """Where the tracks of a film go, unless it is said: next to the posterior."""
        return next(iter(self.of("posterior")), Path("posterior.nc")).with_suffix(".tracks.csv")

    def check(self, *inputs: Path, inferred: bool = False, tracks: Path | None = None, torques: bool = True) -> None:
        """Before a long run: raise OSError or InputError unless all of it can be written, over no input.

        A posterior that is ``inferred`` must be among the files. ``tracks`` is the file of a film's tracks;
        ``torques`` is whether they are inferred.
        """
        check_outputs([*self.paths, tracks], inputs)
        for path in self.paths:
            check_ending("an output", path, *(end for kind in KINDS.values() for end in kind if end.startswith(".")))
        check_ending("a file of tracks", tracks, ".csv")
        if inferred and len(found := self.of("posterior")) != 1:
            raise InputError(f"--out: expected one file for the posterior, such as posterior.nc, got {len(found)}")
        if not torques:
            self._check_torques(())
        for path in self.of("film"):
            check_film(path)
        for path in self.of("NWB"):
            check_nwb(path)

    def write(
        self,
        idata: az.InferenceData,
        progress: Callable[[int, int, str], None] | None = None,
        tracked: TrackedFilm | None = None,
    ) -> None:
        """Write all of it as a set (`whole_set`), the posterior first, as it took longest.

        A film of the arm is laid over the film that was ``tracked``, if any.
        """
        if "joint" not in idata["posterior"].dims:
            raise InputError("expected the posterior of an arm, got one of a state-space model: read it by ArviZ")
        self._check_torques(idata["posterior"])
        time, joints = idata["posterior"]["time"].values, [str(name) for name in idata["posterior"]["joint"].values]
        with whole_set():
            for path in self.of("posterior"):
                save_posterior(idata, path)
            for path in self.of("CSV"):
                write_table(curves(idata), path)
            for path in self.of("functionals"):
                write_text(path, functional_table(idata).to_csv(index=False, lineterminator="\n"))
            if "torque" in idata["posterior"]:
                low, _, median, _, high = quantiles(idata, "torque")
                shifting = {name for name, shift in zip(joints, shifts(idata), strict=True) if shift}
                moments = time, median, low, high, joints, shifting
                for path in self.of("OpenSim"):
                    write_moments(path, *moments, engine_curves(idata))
                for path in self.of("NWB"):
                    unit = str(idata["posterior"]["torque"].attrs["units"])
                    write_nwb(path, {"behavior": moments}, {"behavior": seen(idata)}, unit)
            for path in self.of("motion"):
                write_motion(path, time, quantiles(idata, "angle")[2], joints)
            for path in self.of("figure"):
                save_figure(plot_posterior(idata), path)
            for path in self.of("film"):
                save_film(idata, path, progress, None if tracked is None else Overlay.of(tracked, idata))

    def _check_torques(self, known: Container[Hashable]) -> None:
        if "torque" not in known and (paths := self.of("OpenSim") + self.of("NWB") + self.of("functionals")):
            raise InputError(f"{paths[0]}: a kinematic posterior has no torques to write; leave it out")

    def listing(self) -> str:
        """What lies where: an empty line, then one each."""
        return "".join(f"\n{kind:<10} {path}" for kind in KINDS for path in self.of(kind))


@dataclass(frozen=True)
class OutputFolder:
    """A folder that a command leaves, with a file of each kind."""

    folder: Path
    names: dict[str, str]

    @classmethod
    def of_comparison(cls, folder: Path, methods: Iterable[str]) -> "OutputFolder":
        """Table (.csv and .json), figure, and each method's posterior."""
        named = {"table": "comparison.csv", "JSON": "comparison.json", "figure": "figure.png"}
        return cls(folder, named | {method: f"{method}.nc" for method in methods})

    @classmethod
    def of_diagnosis(cls, folder: Path) -> "OutputFolder":
        """Report, JSON and posterior."""
        return cls(folder, {"report": "report.html", "JSON": "diagnosis.json", "posterior": "posterior.nc"})

    @property
    def paths(self) -> dict[str, Path]:
        """What kind -> where."""
        return {kind: self.folder / name for kind, name in self.names.items()}

    def check(self, *inputs: Path) -> None:
        """Before a long run: raise OSError or InputError unless all of it can be written, over no input."""
        check_folder(self.folder, self.paths.values(), inputs)

    def listing(self, failed: Container[str] = ()) -> str:
        """What lies where: an empty line, then one each; none of methods that ``failed``."""
        there = {kind: path for kind, path in self.paths.items() if path.exists() and kind not in failed}
        width = max(10, *map(len, there))
        return "".join(f"\n{kind:<{width}} {path}" for kind, path in there.items())


def write_comparison(outputs: OutputFolder, comparison: Comparison, truth: np.ndarray | None = None) -> None:
    """Write a comparison as a set (`whole_set`), posteriors first; ``truth`` (rows, states) is that of one's own model.

    Raises InputError where no method succeeded.
    """
    if not comparison.posteriors:
        reasons = "; ".join(f"{method}: {reason}" for method, reason in comparison.failures.items())
        raise InputError(f"no method succeeded: {reasons}")
    paths = outputs.paths
    with new_folder(outputs.folder), whole_set():
        for method, idata in comparison.posteriors.items():
            save_posterior(idata, paths[method])
        write_text(paths["table"], comparison.table.to_csv(lineterminator="\n"))
        write_text(paths["JSON"], json.dumps(comparison.to_dict(), indent=1, ensure_ascii=False) + "\n")
        save_figure(plot_comparison(comparison.posteriors, truth), paths["figure"])


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


def seen(idata: az.InferenceData) -> Recording:
    """The keypoints that an inference was given; of a posterior without any, its mean ones."""
    given = "position" in idata["observed_data"]
    points = idata["observed_data"]["position"] if given else idata["posterior"]["position"].mean(("chain", "draw"))
    return Recording(
        idata["posterior"]["time"].values,
        points.transpose("time", "keypoint", "space").values,
        tuple(str(name) for name in points["keypoint"].values),
        length_unit=str(idata["posterior"]["position"].attrs["units"]),
    )


def curves(idata: az.InferenceData) -> dict[str, np.ndarray]:
    """Columns of a table: time, then median, 5 and 95 % quantile of each joint's torque, if any, angle, velocity."""
    columns = {"time": idata["posterior"]["time"].values}
    for quantity in [name for name in ("torque", "angle", "velocity") if name in idata["posterior"]]:
        low, _, median, _, high = quantiles(idata, quantity)
        for number, joint in enumerate(idata["posterior"]["joint"].values):
            for suffix, values in (("", median), ("_q05", low), ("_q95", high)):
                columns[f"{joint}_{quantity}{suffix}"] = values[:, number]
    return columns | engine_curves(idata)


OF_ENGINE = {
    "activation": "activation",
    "actuator_force": "actuator_force",
    "contact_force": "force",
    "reaction_force": "reaction_force",
    "reaction_moment": "reaction_moment",
}
"""Variables of MuJoCo's engine, and what their columns end in: a joint and its actuator may share a name."""


def engine_curves(idata: az.InferenceData) -> dict[str, np.ndarray]:
    """Columns, as above, of activations, forces of actuators, of contacts and of joints by axis; {} without them."""
    columns = {}
    for name, ending in OF_ENGINE.items():
        if name not in idata["posterior"]:
            continue
        own = idata["posterior"][name].stack(sample=("chain", "draw"), create_index=False).transpose("sample", ...)
        low, median, high = np.quantile(own.values, [0.05, 0.5, 0.95], axis=0)
        of = [str(each) for each in own.coords[own.dims[2]].values]
        axes = [f"_{axis}" for axis in own.coords["axis"].values] if "axis" in own.dims else [""]
        for k, (each, axis) in enumerate(product(of, axes)):
            for suffix, values in (("", median), ("_q05", low), ("_q95", high)):
                columns[f"{each}_{ending}{axis}{suffix}"] = values.reshape(len(values), -1)[:, k]
    return columns
