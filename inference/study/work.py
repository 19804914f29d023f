"""What is done with one trial, and with one session, each a part that any worker can do (:mod:`.distribute`).

First each trial is fitted alone (:func:`fit_trial`). Those of a session that their model explains then share their
parameters (:func:`share_session`). At last each trial has its posterior at what its session shares
(:func:`infer_trial`). A trial is left out, with the reason, where

* it cannot be read, bound to its body, or fitted;
* its model does not explain it (:mod:`.explained`), alone or at the session's parameters;
* the method says that its evidence is not usable.

An error in one trial stays with that trial. Results are values by name, as checkpoints hold them
(:mod:`..execution.records`): "notes" of what is in doubt, or "left_out" alone, the reason. A part is one step of the
work, so that none says how far it is.
"""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from invdyn.inference.fitting.log_parameters import Free, LogParameters
from invdyn.inference.fitting.marginal_likelihood import Fit
from invdyn.inference.fitting.objective import Objective
from invdyn.inference.fitting.parameter_draws import Candidate
from invdyn.inference.fitting.summed_evidence import SharedFit, at_common_start, fit_summed
from invdyn.inference.free_parameters import at_start, free_parameters
from invdyn.inference.plausible_for_body import put_right
from invdyn.inference.posterior.explained import unexplained
from invdyn.inference.posterior.gap_branches import fit_over_gaps
from invdyn.inference.posterior.initialise import Problem, arm_problem
from invdyn.inference.posterior.posterior import evidence_note, uneven
from invdyn.inference.posterior.problem import DRAWS
from invdyn.inference.smoothing.gauss_newton import gauss_newton
from invdyn.inference.study.quantities import quantities, statistics
from invdyn.inference.study.trial import How, Trial
from invdyn.inference.task import Task
from invdyn.models import ArmModel
from invdyn.models.divergence import Diverged
from invdyn.recordings.errors import first_line

CURVES = ("torque", "angle", "velocity")
NOT_SETTLED = "the fit did not settle"
Report = Callable[[int, int], None] | None
Part = dict[str, Any]
"""What is kept of a trial or of a session, by name."""


def fit_trial(trial: Trial, how: How, *, progress: Report = None) -> Part:
    """Fitted parameters by name ("values"), "covariance" (P, P) of their φ, the mode ("path"), and notes."""

    def work() -> Part:
        problem, free = bound(trial, how)
        found, doubts = fit_over_gaps(at_start(problem, free), problem.observations, free, None, problem.origin)
        if reasons := unexplained(replace(problem, model=found.model), found.path):
            return _left_out(reasons[0])
        return {
            "values": {f.name: found.model.parameters[f.name] for f in free},
            "path": found.path,
            "covariance": torch.as_tensor(found.covariance),
            "notes": [*doubts, *([] if found.converged else [NOT_SETTLED])],
        }

    return _guarded(work)


def share_session(trials: Sequence[Trial], fits: Sequence[Part], how: How, *, progress: Report = None) -> Part:
    """Parameters by the summed evidence ("values"), "covariance" (P, P) of their φ, "log_evidence" (N,), and notes.

    One trial alone keeps its own fit, and has no "log_evidence".
    """

    def work() -> Part:
        problems, frees = zip(*(bound(trial, how) for trial in trials), strict=True)
        free = frees[0]
        if not free or len(trials) == 1:
            return {name: fits[0][name] for name in ("values", "covariance")} | {"notes": []}
        models = at_common_start([at_start(each, free) for each in problems], free)
        parameters = LogParameters(models[0].to(dtype=torch.float64), free)
        alone = [parameters.of(fit["values"]) for fit in fits]
        phi = np.median(alone, axis=0)  # one trial that is far off does not move it
        rows, paths = [each.observations.double() for each in problems], [fit["path"] for fit in fits]
        sets = list(zip(models, rows, paths, strict=True))
        try:
            found = _fitted(sets, free, phi)
        except Diverged:
            # Without those that have no evidence here: they are left out when their own turn comes.
            finite = [each for each in sets if _finite(*each, free, phi)]
            if not finite:
                raise
            found = _fitted(finite, free, phi)
        return {
            "values": {f.name: found.models[0].parameters[f.name] for f in free},
            "covariance": torch.as_tensor(found.covariance),
            "log_evidence": torch.as_tensor(found.log_evidence),
            "notes": [] if found.converged else [f"{NOT_SETTLED} that the session shares"],
        }

    return _guarded(work)


def _fitted(sets: Sequence[tuple[ArmModel, Tensor, Tensor]], free: Sequence[Free], phi: np.ndarray) -> SharedFit:
    models, observations, starts = zip(*sets, strict=True)
    return fit_summed(models, observations, free, starts=starts, phi=phi)


def _finite(model: ArmModel, observations: Tensor, path: Tensor, free: Sequence[Free], phi: np.ndarray) -> bool:
    """Whether the evidence at φ can be computed."""
    try:
        return bool(np.isfinite(Objective(model.to(dtype=torch.float64), observations, free, path).value(phi)))
    except Diverged:
        return False


def infer_trial(trial: Trial, how: How, fit: Part, shared: Part, seed: int, *, progress: Report = None) -> Part:
    """Draws that are kept (R, T, K), mean and sd of the torque (T, K), "statistics" (Q, K, 5), and names and units."""

    def work() -> Part:
        problem, free = bound(trial, how)
        values = {f.name: shared["values"][f.name] for f in free}
        start = at_start(problem, free).to(dtype=torch.float64)
        fitted = replace(problem, model=start.replace(**values))
        mode = gauss_newton(fitted.model, problem.observations.double(), start=fit["path"])
        path, evidence = mode.path, mode.log_evidence.item()
        if reasons := unexplained(fitted, path):
            return _left_out(f"at its session's parameters {reasons[0]}")
        record = {"fitted": {name: value.tolist() for name, value in values.items()}}
        phi = LogParameters(start, free).of(values)
        own = Fit(fitted.model, evidence, path, {}, True, phi, shared["covariance"].numpy(), evidence)
        candidate = Candidate(start, free, own, of_more_rows="log_evidence" in shared)
        task = Task(fitted, path, how.sizes, seed, record, None, problem, tuple(free), (candidate,))
        idata = task.run(how.method)
        if note := evidence_note(idata):
            return _left_out(f"the evidence of {how.method} is {note}")
        posterior = idata["posterior"]
        curves = {name: posterior[name].transpose(*DRAWS, "time", "joint").values for name in CURVES}
        drawn = {name: each.reshape(-1, *each.shape[-2:]) for name, each in curves.items()}
        found = quantities(idata, trial.events)
        kept = np.linspace(0, len(drawn["torque"]) - 1, min(how.stored, len(drawn["torque"]))).round().astype(int)
        turns = idata["constant_data"].get("turns")
        return {
            **{name: torch.as_tensor(each[kept].astype(np.float32)) for name, each in drawn.items()},
            "time": torch.as_tensor(posterior["time"].values),
            "statistics": torch.as_tensor(statistics(found)),
            "mean": torch.as_tensor(drawn["torque"].mean(0)),
            "spread": torch.as_tensor(drawn["torque"].std(0)),
            "notes": [few] if (few := uneven(idata)) else [],
            "quantities": {name: unit for name, (_, unit) in found.items()},
            "joints": [str(name) for name in posterior["joint"].values],
            "turns": [True] * posterior.sizes["joint"] if turns is None else [bool(each) for each in turns.values],
            "units": {name: str(posterior[name].attrs["units"]) for name in CURVES},
        }

    return _guarded(work)


def bound(trial: Trial, how: How) -> tuple[Problem, list[Any]]:
    """The trial's problem, and what of it is fitted. Raises as :func:`.arm_problem` does."""
    assert trial.recording is not None
    assert trial.body is not None
    problem = arm_problem(
        put_right(trial.recording, trial.body),
        trial.body.with_uncertainty(),
        parameters=how.settings,
        learn_lengths=how.learn_lengths,
        **{"moving_base": True, **how.binding},
    )
    return problem, free_parameters(problem, tuple(how.settings or ()), how.learn_lengths)


def _left_out(reason: str) -> Part:
    return {"left_out": " ".join(reason.split())}


def _guarded(work: Callable[[], Part]) -> Part:
    """The result, or why there is none; one trial's error is reported and does not stop the others."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what matters of a trial stands in its notes
            return work()
    except Exception as error:
        kind = "" if isinstance(error, ValueError | ArithmeticError) else f"{type(error).__name__}: "
        return _left_out(kind + first_line(error))
