"""What a study leaves in its folder.

    files.txt         names of the files below, one a line: what else is there is of an earlier study
    trials.csv        one row a trial, joint and quantity
    left_out.csv      trials that do not count, with reasons
    in_doubt.csv      trials that count and may be wrong, with reasons
    sessions.csv      parameters that each session shares
    summary.csv, differences.csv                of each factor of two levels or more; with several factors
                                                summary_<factor>.csv and so on
    averages_<event>.csv, averages_<event>.png  aligned at each event
    posteriors/<subject>_<session>.nc           draws of torque, angle, velocity [trial, draw, row, joint], float32,
                                                time [trial, row] s; NaN after a trial's last row; event_<name>
                                                [trial], s by its clock
    sto/<trial>.sto                             torques of each trial with their 90 % band, for OpenSim
    nwb/<subject>_<session>.nwb                 the same of a session, and its keypoints, where that is wanted

In names of files, letters, digits, - and . stay; all else becomes _. All files appear together
(:func:`invdyn.recordings.whole_set`).
"""

import re
from collections.abc import Iterable
from contextlib import suppress
from itertools import chain, count
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from invdyn.inference.study.figure import plot_averages
from invdyn.inference.study.work import CURVES
from invdyn.recordings import (
    InputError,
    atomic_path,
    check_nwb,
    new_folder,
    whole_set,
    write_moments,
    write_nwb,
    write_text,
)

FILES = "files.txt"
LONGEST = 100
"""Characters of a name as a part of a file's."""


def save_study(study: Any, folder: Path, nwb: bool = False) -> list[Path]:
    """Write all of a :class:`.study.Study` and return the files.

    Raises InputError where no trial is left or, for NWB, its libraries are missing; OSError as it comes.
    """
    if nwb:
        check_nwb(folder)
    if not study.posteriors:
        first = next(iter(study.reasons["reason"]), "")
        raise InputError(f"no trial of {len(study.trials)} is left; the first one: {first}")
    files: list[Path] = []

    def place(*parts: str) -> Path:
        files.append(folder.joinpath(*parts))
        return files[-1]

    with new_folder(folder), whole_set():
        for name, table in _tables(study).items():
            write_text(place(f"{name}.csv"), table.to_csv(index=False, lineterminator="\n"))
        for event, averages in _averages(study).items():
            name = _events(study)[event]
            write_text(place(f"averages_{name}.csv"), averages.to_csv(index=False, lineterminator="\n"))
            with atomic_path(place(f"averages_{name}.png")) as temporary:
                plot_averages(averages, event, _factors(study)[0]).savefig(temporary, dpi=150)
        for name in ("posteriors", "sto"):
            (folder / name).mkdir(exist_ok=True)
        for name, members in _sessions(study).items():
            data = session_posterior(study, members)
            packed = {each: {"zlib": True, "complevel": 4} for each in data.data_vars}
            with atomic_path(place("posteriors", f"{name}.nc")) as temporary:
                data.to_netcdf(str(temporary), engine="h5netcdf", encoding=packed)
        names = _unlike(study.trials[i].name for i in study.posteriors)
        moments = {}
        for name, (index, part) in zip(names, study.posteriors.items(), strict=True):
            torque = part["torque"].numpy().astype(float)
            low, middle, high = np.quantile(torque, (0.05, 0.5, 0.95), axis=0)
            shifting = {joint for joint, turns in zip(part["joints"], part["turns"], strict=True) if not turns}
            moments[index] = name, (part["time"].numpy(), middle, low, high, part["joints"], shifting)
            write_moments(place("sto", f"{name}.sto"), *moments[index][1])
        for name, members in _sessions(study).items() if nwb else ():
            torques = {moments[i][0]: moments[i][1] for i in members}
            recordings = {moments[i][0]: study.trials[i].recording for i in members}
            (folder / "nwb").mkdir(exist_ok=True)
            unit = study.posteriors[members[0]]["units"]["torque"]
            write_nwb(place("nwb", f"{name}.nwb"), torques, recordings, unit)
        write_text(folder / FILES, "".join(f"{file.relative_to(folder).as_posix()}\n" for file in files))
    return [*files, folder / FILES]


def study_files(folder: Path) -> list[Path]:
    """The files of the last study that was written into a folder. Raises OSError where there is none."""
    return [folder / name for name in (folder / FILES).read_text(encoding="utf-8").splitlines()]


def session_posterior(study: Any, members: list[int]) -> xr.Dataset:
    """Draws of the trials at these places, which have the same joints."""
    parts = [study.posteriors[place] for place in members]
    known = parts[0]
    rows, draws = max(len(part["time"]) for part in parts), len(parts[0]["torque"])
    variables = {}
    for name in CURVES:
        whole = np.full((len(parts), draws, rows, len(known["joints"])), np.nan, np.float32)
        for values, part in zip(whole, parts, strict=True):
            values[:, : len(part["time"])] = part[name].numpy()
        variables[name] = (["trial", "draw", "row", "joint"], whole, {"units": known["units"][name]})
    time = np.full((len(parts), rows), np.nan)
    for values, part in zip(time, parts, strict=True):
        values[: len(part["time"])] = part["time"].numpy()
    trials = [study.trials[place] for place in members]
    labels = {name: ("trial", [trial.factors.get(name, "") for trial in trials]) for name in _factors(study)}
    for event, name in _events(study).items():
        labels[f"event_{name}"] = ("trial", [trial.events.get(event, np.nan) for trial in trials])
    data = xr.Dataset(
        {**variables, "time": (["trial", "row"], time, {"units": "s"})},
        coords={"trial": [trial.name for trial in trials], "joint": known["joints"], **labels},
    )
    return data.assign_attrs(subject=trials[0].subject, session=trials[0].session, method=study.how.method)


def _unlike(names: Iterable[str]) -> list[str]:
    """Names as parts of files' names, each unlike any other."""
    found: dict[str, str] = {}  # some systems do not tell a from A
    for name in names:
        own = re.sub(r"[^\w.-]+", "_", name)[:LONGEST] or "_"
        own = next(each for each in chain([own], (f"{own}-{k}" for k in count(2))) if each.lower() not in found)
        found[own.lower()] = own
    return list(found.values())


def _events(study: Any) -> dict[str, str]:
    """Names of events as parts of files' names, by event."""
    events = sorted({name for trial in study.trials for name in trial.events})
    return dict(zip(events, _unlike(events), strict=True))


def _factors(study: Any) -> list[str]:
    return list(dict.fromkeys(name for trial in study.trials for name in trial.factors))


def _sessions(study: Any) -> dict[str, list[int]]:
    """By name of its file, places of a session's trials; of bodies with other joints in files of their own."""
    found: dict[tuple, list[int]] = {}
    for place, part in study.posteriors.items():
        trial = study.trials[place]
        found.setdefault((trial.subject, trial.session, *part["joints"]), []).append(place)
    return dict(zip(_unlike(f"{subject}_{session}" for subject, session, *_ in found), found.values(), strict=True))


def _tables(study: Any) -> dict[str, pd.DataFrame]:
    tables = {"trials": study.table, "left_out": study.reasons, "in_doubt": study.doubts, "sessions": study.parameters}
    factors = _factors(study)
    for factor, name in zip(factors, _unlike(factors), strict=True):
        ending = "" if len(factors) == 1 else f"_{name}"
        tables[f"summary{ending}"] = study.summary(factor)
        with suppress(InputError):  # of one level, or no joint has two
            tables[f"differences{ending}"] = study.difference(factor)
    return {name: table for name, table in tables.items() if len(table) or name in ("left_out", "in_doubt")}


def _averages(study: Any) -> dict[str, pd.DataFrame]:
    """By event, of the first factor; none of an event that too few trials have."""
    found = {}
    for event in _events(study):
        with suppress(InputError):
            found[event] = study.averages(event, _factors(study)[0])
    return found
