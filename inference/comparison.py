"""Methods in one table: errors, evidence, mixing and cost, and how a method that fails shows.

Each row is a method:

    <name>_rmse, _crps, _coverage_50, _coverage_90    of a torque or state against the truth, if known (:mod:`.scores`)
    log_evidence, log_evidence_sd, evidence_kind      nats, Monte Carlo standard error; "estimate": unbiased estimate
                                                      of the evidence, "bound": from below, "approximation", or ""
    usable                                            whether the evidence stands (:mod:`.second_opinion`); where it
                                                      does not, a note says why and its error is NaN
    replicates, replicates_sd                         runs with other seeds, and the sd of their log-evidence
    log_score                                         nats per held-out row (:mod:`.held_out`), where it is requested
    elpd_loo, elpd_loo_se, pareto_k                   leave-one-row-out by PSIS, nats; the largest k of a row
    outer_ess                                         effective number of filters, of methods that have filters
    r_hat, ess_bulk, ess_tail, mcse                   the worst of the monitored numbers; mcse is that of the mean,
                                                      in posterior standard deviations
    seconds, ess_per_second, memory                   s of the method itself; ess_bulk per s; MiB

Memory is the growth of the process's resident set, at its peak. In one process what earlier methods have freed is
used again and does not count; with ``isolate`` each method has a process of its own, where what libraries load at
their first use (some 50 MiB) counts too. An executor's workers are other processes: their memory is not counted.
"""

import json
import math
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Protocol

import arviz as az
import cloudpickle
import numpy as np
import pandas as pd
import torch
import xarray as xr

from invdyn.inference.execution import records
from invdyn.inference.execution.distribute import inside
from invdyn.inference.execution.executors import script_not_run_again
from invdyn.inference.execution.progress import Progress
from invdyn.inference.execution.seeds import derived
from invdyn.inference.mcmc.mixing import mixing
from invdyn.inference.posterior.files import packed, unpacked
from invdyn.inference.posterior.posterior import evidence_note
from invdyn.inference.posterior.scores import score_table
from invdyn.inference.renamed_methods import present_name
from invdyn.recordings import InputError
from invdyn.recordings.errors import first_line

REPLICATES = 71
"""Place of the seeds of replicates (:func:`.seeds.derived`)."""

COLUMNS = (
    *("log_evidence", "log_evidence_sd", "evidence_kind", "usable", "replicates", "replicates_sd", "log_score"),
    *("elpd_loo", "elpd_loo_se", "pareto_k", "outer_ess", "r_hat", "ess_bulk", "ess_tail", "mcse"),
    *("seconds", "ess_per_second", "memory"),
)
"""Columns of every table; errors against the truth come before them."""


class Runnable(Protocol):
    """A fitted problem that any method runs on; a dataclass with ``seed``."""

    @property
    def seed(self) -> int:
        """Of every random number."""
        ...

    def run(self, method: str, progress: Progress | None = None, executor: Executor | None = None) -> az.InferenceData:
        """Posterior by ``method``."""
        ...


@dataclass(frozen=True)
class Comparison:
    """What a comparison leaves.

    Attributes:
        table: one row a method, columns as at the top of the file.
        posteriors: of each method that did not fail.
        failures: the reason of each that did, in a line.
        notes: what is missing from a method's row, and why.
        held_out: rows that ``log_score`` is over; 0 when there is none.
        isolated: whether each method ran in a process of its own.
        recording: name of the data.
        seed: of every random number.
    """

    table: pd.DataFrame
    posteriors: dict[str, az.InferenceData]
    failures: dict[str, str]
    notes: dict[str, str]
    held_out: int
    isolated: bool
    recording: str
    seed: int

    def note(self, method: str, note: str) -> None:
        """Add a note on a method to those that it has."""
        self.notes[method] = "; ".join(filter(None, [self.notes.get(method, ""), note]))

    def to_dict(self) -> dict[str, Any]:
        """All but the posteriors, as JSON has it: None where there is no number."""
        rows = json.loads(self.table.to_json(orient="index", double_precision=15))
        return {
            "schema": 1,
            "recording": self.recording,
            "seed": self.seed,
            "methods": rows,
            "failures": self.failures,
            "notes": self.notes,
            "held_out_rows": self.held_out,
            "memory": "MiB, resident-set growth of a process " + ("each" if self.isolated else "shared by all"),
        }


def measured(
    task: Runnable, method: str, progress: Progress | None = None, executor: Executor | None = None
) -> tuple[az.InferenceData, float, float]:
    """``task.run`` with its seconds and MiB."""
    before, start = resident_peak(reset=True), time.perf_counter()
    idata = task.run(method, progress, executor)
    return idata, time.perf_counter() - start, max(resident_peak() - before, 0.0)


Launch = Callable[..., tuple[az.InferenceData, float, float]]
""":func:`measured`, here or in another process."""


def kept(
    launch: Launch, task: Runnable, method: str, progress: Progress | None = None, **options: Any
) -> tuple[az.InferenceData, float, float]:
    """What ``launch`` returns, kept in the task's checkpoint where it has one.

    A method that fails is tried again by the next call: it may have been for want of memory.
    """
    store = inside(getattr(task, "checkpoint", None), f"{method}-result")
    if store is not None and (found := records.kept(store)) is not None:
        file, seconds, memory = found
        return unpacked(file), seconds, memory
    idata, seconds, memory = launch(task, method, progress=progress, **options)
    if store is not None:
        records.keep(store, (packed(idata), seconds, memory))
    return idata, seconds, memory


def checked_methods(
    methods: Sequence[str], known: Sequence[str], replicates: int, isolate: bool, executor: Executor | None
) -> tuple[str, ...]:
    """The methods, each once; raises InputError for none, one that is not ``known``, or options that do not fit."""
    methods = tuple(dict.fromkeys(map(present_name, methods)))
    if unknown := [method for method in methods if method not in known] or ([] if methods else ["none"]):
        raise InputError(f"expected methods among {', '.join(known)}, got {unknown[0]}")
    if replicates < 1:
        raise InputError(f"expected at least one replicate, got {replicates}")
    if isolate and executor is not None:
        raise InputError("expected isolated methods or workers, got both: memory is measured in one process")
    return methods


def run_methods(
    task: Runnable,
    methods: Sequence[str],
    variable: str,
    truth: Callable[[az.InferenceData], np.ndarray | None],
    name: str,
    *,
    replicates: int = 1,
    isolate: bool = False,
    progress: Progress | None = None,
    executor: Executor | None = None,
) -> Comparison:
    """Run each method; one that fails leaves its reason, and the others still run. No row is held out.

    Args:
        task: what each runs on.
        methods: keys of ``METHODS``.
        variable: of the posteriors, (chain, draw, time, …), whose errors and mixing are stated.
        truth: of a posterior's variable, (T, …); None where it is not known.
        name: of the data.
        replicates: runs of each method, with seeds of their own; the first one is the one that is reported.
        isolate, progress, executor: as :func:`.compare.compare` takes them.
    """
    rows: dict[str, dict[str, Any]] = {}
    found = Comparison(pd.DataFrame(), {}, {}, {}, 0, isolate, name, task.seed)
    launch: Launch = partial(kept, in_own_process if isolate else measured)
    places = {} if isolate else {"executor": executor}
    for method in methods:
        rows[method] = {}
        try:
            idata, seconds, memory = launch(task, method, progress=named(progress, method), **places)
        except Exception as error:
            found.failures[method] = f"{type(error).__name__}: {first_line(error)}"
            continue
        found.posteriors[method] = idata
        if doubt := evidence_note(idata):
            found.note(method, f"evidence {doubt}")
        draws = idata["posterior"][variable].transpose("chain", "draw", "time", ...)
        row: dict[str, Any] = {
            **errors(draws, truth(idata)),
            **evidence(idata),
            **mixing_figures(idata, draws.values),
            **loo(idata),
        }
        row |= {"seconds": seconds, "memory": memory, "ess_per_second": row["ess_bulk"] / seconds}
        values = [row["log_evidence"]]
        try:
            for number in range(1, replicates):
                other = _reseeded(task, number)
                again, *_ = launch(other, method, progress=named(progress, f"{method} again"), **places)
                values.append(again.attrs["log_evidence"])
        except Exception as error:
            found.note(method, f"replicate {len(values) + 1} failed: {first_line(error)}")
        scatter = float(np.std(values, ddof=1)) if len(values) > 1 else math.nan
        rows[method] = row | {"replicates": len(values), "replicates_sd": scatter}
    return replace(found, table=_table(rows, found.failures))


def _table(rows: dict[str, dict[str, Any]], failures: dict[str, str]) -> pd.DataFrame:
    """One row a method: the columns at the top of the file, and the reason of a failure."""
    own = [name for row in rows.values() for name in row if name not in COLUMNS]
    table = pd.DataFrame.from_dict(rows, orient="index").reindex(columns=[*dict.fromkeys(own), *COLUMNS])
    table["evidence_kind"] = table["evidence_kind"].astype(object).where(table["evidence_kind"].notna(), "")
    table["usable"] = table["usable"].astype(object)
    table["failure"] = [failures.get(method, "") for method in table.index]
    table.index.name = "method"
    return table


def _reseeded(task: Any, number: int) -> Any:
    """Replicate ``number`` of a task, with a seed and, where there is one, a checkpoint of its own."""
    other = replace(task, seed=derived(task.seed, REPLICATES, number))
    checkpoint = inside(getattr(task, "checkpoint", None), f"replicate-{number}")
    return other if checkpoint is None else replace(other, checkpoint=checkpoint)


def errors(draws: xr.DataArray, truth: np.ndarray | None) -> dict[str, float]:
    """Of each joint's torque or each state, (chain, draw, time, name), against the truth (T, …)."""
    if truth is None:
        return {}
    values = draws.values.reshape(-1, *draws.shape[2:])
    scores = score_table(values, np.full(len(values), 1 / len(values)), truth)
    names = draws[draws.dims[-1]].values
    return {f"{name}_{score}": float(each[k]) for k, name in enumerate(names) for score, each in scores.items()}


def mixing_figures(idata: az.InferenceData, draws: np.ndarray, max_numbers: int = 200) -> dict[str, float]:
    """Return r_hat, ess_bulk, ess_tail and mcse, the worst over draws (chain, draw, …).

    Of more than ``max_numbers`` numbers as many are taken, evenly chosen. A method that knows better, such as a sampler
    that has more draws than it keeps, says so in its attributes. Too few draws give NaN.
    """
    stated = idata["sample_stats"].attrs
    numbers = draws.reshape(*draws.shape[:2], -1)
    chosen = np.unique(np.linspace(0, numbers.shape[-1] - 1, max_numbers).round().astype(int))
    numbers = numbers[..., chosen].astype(float)
    varying = numbers.std((0, 1)) > 0
    if not varying.any() or numbers.shape[1] < 4:
        return dict.fromkeys(("r_hat", "ess_bulk", "ess_tail", "mcse"), math.nan)

    numbers = numbers[..., varying]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # copies of one draw divide zero by zero: R-hat is then infinite
        computed = mixing(numbers)
        mcse = az.mcse(az.convert_to_dataset({"x": numbers}), method="mean")["x"].to_numpy() / numbers.std((0, 1))
    return computed | {name: stated[name] for name in computed if name in stated} | {"mcse": float(np.nanmax(mcse))}


def loo(idata: az.InferenceData) -> dict[str, float]:
    """Return the expected log density of a left-out row, by ArviZ's PSIS (Vehtari, Gelman & Gabry 2017).

    NaN without at least two draws.
    """
    nothing = dict.fromkeys(("elpd_loo", "elpd_loo_se", "pareto_k"), math.nan)
    likelihood = idata["log_likelihood"]["y"]
    if likelihood.sizes["chain"] * likelihood.sizes["draw"] < 2 or not np.isfinite(likelihood).all():
        return nothing
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a large k is a number of the table
        found = az.loo(idata, var_name="y", pointwise=True, reff=1.0)
    worst = float(np.nanmax(found.pareto_k.to_numpy(), initial=-math.inf))
    return {"elpd_loo": float(found.elpd_loo), "elpd_loo_se": float(found.se), "pareto_k": worst}


def evidence(idata: az.InferenceData) -> dict[str, object]:
    """log_evidence, its error, which kind it is, and the outer ESS."""
    statistics, found = idata["sample_stats"], idata.attrs
    if math.isnan(found["log_evidence"]):
        kind = ""
    elif "evidence_kind" in statistics.attrs:
        kind = str(statistics.attrs["evidence_kind"])
    elif "ess" in statistics:
        kind = "estimate"
    else:
        kind = "bound" if statistics.attrs.get("bound", 0) else "approximation"
    usable = not evidence_note(idata)
    return {
        "log_evidence": found["log_evidence"],
        "log_evidence_sd": found["log_evidence_sd"] if usable else math.nan,
        "evidence_kind": kind,
        "usable": usable,
        "outer_ess": found["outer_ess"] if "ess" in statistics else math.nan,
    }


def named(progress: Progress | None, method: str) -> Progress | None:
    """Progress that says of which method it is."""
    return None if progress is None else lambda done, total, what: progress(done, total, f"{method}: {what}")


def in_own_process(
    task: Runnable, method: str, progress: Progress | None = None
) -> tuple[az.InferenceData, float, float]:
    """``measured`` in a fresh process; raises what it raises, or BrokenProcessPool when it dies."""
    with ProcessPoolExecutor(1, get_context("spawn"), torch.set_num_threads, (torch.get_num_threads(),)) as pool:
        with script_not_run_again():
            future = pool.submit(_measured, cloudpickle.dumps((task, method)))
        result = future.result()
    if progress is not None:
        progress(1, 1, "run")
    return result


def _measured(work: bytes) -> tuple[az.InferenceData, float, float]:
    """:func:`measured` of a task and a method, which a script may have defined."""
    return measured(*cloudpickle.loads(work))


def resident_peak(reset: bool = False) -> float:
    """Highest resident set of this process so far, MiB; since now with ``reset``, where the system can (Linux)."""
    try:
        if reset:
            Path("/proc/self/clear_refs").write_text("5")
        status = Path("/proc/self/status").read_text()
        return int(status.split("VmHWM:")[1].split()[0]) / 1024
    except (OSError, IndexError):
        pass
    try:
        import resource
    except ImportError:  # not on Windows
        return math.nan
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 2**20 if sys.platform == "darwin" else peak / 1024
