"""Methods side by side, on one recording and one model: which to trust, and at what cost.

Parameters that are not known are fitted once (:mod:`.marginal_likelihood`), so all methods answer the same question;
"vsmc" too, which by itself (:func:`.infer.infer`) would learn their posterior, and here trains its guide alone.
Each row of the table is a method:

    <joint>_rmse, _crps, _coverage_50, _coverage_90   of the torque against the truth, if known (:mod:`.scores`)
    log_evidence, log_evidence_sd, evidence_kind      nats, Monte Carlo standard error; "estimate": unbiased estimate
                                                      of the evidence, "bound": from below, "approximation", or ""
    log_score                                         nats per held-out row (:mod:`.held_out`): parameters are fitted
                                                      and methods run once more, on the first rows alone
    outer_ess                                         effective number of filters, of methods that have filters
    seconds, memory                                   s and MiB of the method itself, without the fit

Memory is the growth of the process's resident set, at its peak. In one process what earlier methods have freed is
used again and does not count; with ``isolate`` each method has a process of its own, where what libraries load at
their first use (some 50 MiB) counts too. An executor's workers are other processes: their memory is not counted.
"""

import json
import math
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import arviz as az
import numpy as np
import pandas as pd
import torch

from invdyn.inference.execution.progress import Progress, Report, stage
from invdyn.inference.filters.filtering import SMCOptions
from invdyn.inference.filters.memory import check_memory
from invdyn.inference.held_out import log_score
from invdyn.inference.methods.registry import METHODS
from invdyn.inference.posterior.initialise import Problem
from invdyn.inference.posterior.scores import score_table
from invdyn.inference.task import Task, prepare
from invdyn.models import ArticulatedBody
from invdyn.models.state_space import UnknownParameter
from invdyn.recordings import InputError, Recording, Truth
from invdyn.recordings.errors import first_line

FEWEST_ROWS = 10
"""Rows that a head must have for its parameters to be fitted."""


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
        recording: its name.
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
    task: Task, method: str, progress: Progress | None = None, executor: Executor | None = None
) -> tuple[az.InferenceData, float, float]:
    """``task.run`` with its seconds and MiB."""
    before, start = resident_peak(reset=True), time.perf_counter()
    idata = task.run(method, progress, executor)
    return idata, time.perf_counter() - start, max(resident_peak() - before, 0.0)


def compare(
    recording: Recording,
    body: ArticulatedBody,
    methods: Sequence[str],
    *,
    truth: Truth | None = None,
    seed: int = 0,
    settings: Mapping[str, object] | None = None,
    num_filters: int = 64,
    num_particles: int = 100,
    num_draws: int = 4,
    held_out: float = 0.2,
    isolate: bool = False,
    progress: Progress | None = None,
    device: str = "cpu",
    filters_per_task: int | None = None,
    executor: Executor | None = None,
    **binding: Any,
) -> Comparison:
    """Run several methods on one recording.

    Args:
        recording, body: as :func:`.infer.infer` takes them.
        methods: keys of ``METHODS``; one that fails leaves a row with its reason and does not stop the others.
        truth: torques to score against.
        seed: same seed, same result (but for seconds and memory).
        settings: parameters by dotted name that are known; the others are fitted.
        num_filters, num_particles, num_draws: M, N, and smoothed trajectories per filter.
        held_out: share of the rows, the last ones, that ``log_score`` is over; 0 for none.
        isolate: run each method in a process of its own.
        progress: called with (done, total, what).
        device, filters_per_task, executor: as :func:`.infer.infer` takes them.
        binding: further options of :func:`.initialise.arm_problem`: torque, integrator, family, learn_lengths …

    Raises:
        InputError: no or an unknown method, a ``held_out`` that is no share, both ``isolate`` and an ``executor``,
            more filters than memory holds, or a recording that does not fit the body.
    """
    methods = tuple(dict.fromkeys(methods))
    if unknown := [method for method in methods if method not in METHODS]:
        raise InputError(f"expected methods among {', '.join(METHODS)}, got {unknown[0]!r}")
    if not methods:
        raise InputError(f"expected at least one method among {', '.join(METHODS)}")
    if not 0 <= held_out < 1:
        raise InputError(f"expected a share of rows to hold out from 0 up to 1, got {held_out}")
    if isolate and executor is not None:
        raise InputError("expected isolated methods or workers, got both: memory is measured in one process")
    options = SMCOptions(num_filters, num_particles, num_draws, device=device, filters_per_task=filters_per_task)
    check_memory(recording.num_frames, body.num_joints, options, methods)
    bind: Callable[..., Task] = partial(prepare, body=body, options=options, seed=seed, settings=settings, **binding)
    whole = bind(recording, truth=truth, report=stage(progress, "fit"))
    bind = partial(bind, torque=whole.problem.model.torque)
    head, future, missing = _split(whole, recording, bind, held_out, stage(progress, "fit without the tail"))
    launch = _in_own_process if isolate else partial(measured, executor=executor)
    rows: dict[str, dict[str, Any]] = {}
    posteriors: dict[str, az.InferenceData] = {}
    failures: dict[str, str] = {}
    notes: dict[str, str] = {}
    for method in methods:
        rows[method] = {}
        try:
            idata, seconds, memory = launch(whole, method, progress=_named(progress, method))
        except Exception as error:  # a method that fails says so in its row, and the others still run
            failures[method] = f"{type(error).__name__}: {first_line(error)}"
            continue
        posteriors[method] = idata
        rows[method] = {**_scores(idata), **_evidence(idata), "seconds": seconds, "memory": memory}
        if head is None or future is None:
            continue
        try:
            scored, *_ = launch(head, method, progress=_named(progress, f"{method} without the tail"))
            rows[method]["log_score"] = log_score(future, scored, whole.path, seed)
        except Exception as error:
            notes[method] = f"no log score: {first_line(error)}"
    if missing:
        notes["all"] = f"no log score: {missing}"
    columns = ["log_evidence", "log_evidence_sd", "evidence_kind", "log_score", "outer_ess", "seconds", "memory"]
    found = [name for row in rows.values() for name in row if name not in columns]
    table = pd.DataFrame.from_dict(rows, orient="index").reindex(columns=[*dict.fromkeys(found), *columns])
    table["evidence_kind"] = table["evidence_kind"].astype(object).where(table["evidence_kind"].notna(), "")
    table["failure"] = [failures.get(method, "") for method in table.index]
    table.index.name = "method"
    seen = 0 if head is None else _seen(whole, head)
    return Comparison(table, posteriors, failures, notes, seen, isolate, recording.name, seed)


def _split(
    whole: Task, recording: Recording, bind: Callable[..., Task], share: float, report: Report | None
) -> tuple[Task | None, Problem | None, str]:
    """Task of the first rows, the whole problem with their parameters, and why there is none."""
    rows = recording.num_frames
    first = rows - round(share * rows)
    if first == rows:
        return None, None, "" if share == 0 else "the tail is empty"
    if first < FEWEST_ROWS:
        return None, None, f"{first} rows are too few to fit parameters to"
    if whole.problem.model.body.has_priors:
        return None, None, "the body is uncertain, and each filter has another"
    if not bool((~torch.isnan(whole.problem.observations[first:])).any()):
        return None, None, "nothing is observed in the tail"
    try:
        head = bind(recording.select(0, first), report=report)
        future = replace(whole.problem, model=whole.problem.model.replace(**head.problem.model.parameters))
    except (InputError, UnknownParameter) as error:
        return None, None, first_line(error)
    return head, future, ""


def _seen(whole: Task, head: Task) -> int:
    """Rows with an observation after the head's."""
    tail = whole.problem.observations[len(head.problem.observations) :]
    return int((~torch.isnan(tail)).any(-1).sum())


def _scores(idata: az.InferenceData) -> dict[str, float]:
    """Of each joint's torque, against the truth where it is known."""
    if "truth_torque" not in idata["constant_data"]:
        return {}
    torque = idata["posterior"]["torque"].transpose("chain", "draw", "time", "joint").values
    truth = idata["constant_data"]["truth_torque"].transpose("time", "joint").values
    draws = torque.reshape(-1, *torque.shape[2:])
    scores = score_table(draws, np.full(len(draws), 1 / len(draws)), truth)
    joints = idata["posterior"]["joint"].values
    return {f"{joint}_{name}": float(score[k]) for k, joint in enumerate(joints) for name, score in scores.items()}


def _evidence(idata: az.InferenceData) -> dict[str, object]:
    """log_evidence, its error, which kind it is, and the outer ESS."""
    statistics, found = idata["sample_stats"], idata.attrs
    if math.isnan(found["log_evidence"]):
        kind = ""
    elif "ess" in statistics:
        kind = "estimate"
    else:
        kind = "bound" if statistics.attrs.get("bound", 0) else "approximation"
    return {
        "log_evidence": found["log_evidence"],
        "log_evidence_sd": found["log_evidence_sd"],
        "evidence_kind": kind,
        "outer_ess": found["outer_ess"] if "ess" in statistics else math.nan,
    }


def _named(progress: Progress | None, method: str) -> Progress | None:
    return None if progress is None else lambda done, total, what: progress(done, total, f"{method}: {what}")


def _in_own_process(task: Task, method: str, progress: Progress | None = None) -> tuple[az.InferenceData, float, float]:
    """``measured`` in a fresh process; raises what it raises, or BrokenProcessPool when it dies."""
    with ProcessPoolExecutor(1, get_context("spawn"), torch.set_num_threads, (torch.get_num_threads(),)) as pool:
        result = pool.submit(measured, task, method).result()
    if progress is not None:
        progress(1, 1, "run")
    return result


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
