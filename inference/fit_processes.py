"""Fits of one recording under several torque processes, each begun at the last one, and how a checkpoint keeps them."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import version
from typing import Any

import torch
from torch import Tensor

from invdyn.inference.execution.checkpoint import Checkpoint, digest
from invdyn.inference.execution.progress import Report
from invdyn.inference.execution.records import keep, kept
from invdyn.inference.filters.filtering import SMCOptions
from invdyn.inference.fitting.log_parameters import Free
from invdyn.inference.fitting.marginal_likelihood import Fit, fit
from invdyn.inference.free_parameters import at_start
from invdyn.inference.posterior.gap_branches import fit_over_gaps
from invdyn.inference.posterior.initialise import Problem
from invdyn.models import ArmModel
from invdyn.models.divergence import Diverged
from invdyn.recordings import InputError, Recording

PILOT_ROWS, PILOT_FROM = 1000, 4000
"""Rows in the middle of a long recording on which its parameters are fitted first, and from how many rows on."""


def fit_processes(
    problems: Sequence[Problem],
    frees: Sequence[list[Free]],
    begin: Callable[[int, Mapping[str, Tensor]], Mapping[str, Tensor]],
    report: Report | None,
    checkpoint: Checkpoint | None,
) -> tuple[list[Fit[ArmModel]], list[list[str]]]:
    """Fit of each problem, and what is in doubt of each: from the checkpoint, or fitted and kept there."""
    if checkpoint is not None and (found := kept(checkpoint)) is not None:
        known, of_each = found
        models = [each.model.replace(**own["model"]) for each, own in zip(problems, known, strict=True)]
        return [Fit(**{**own, "model": model}) for model, own in zip(models, known, strict=True)], of_each
    fits: list[Fit[ArmModel]] = []
    doubts: list[list[str]] = []
    for number, (problem, free) in enumerate(zip(problems, frees, strict=True)):
        part = _share(report, number, len(problems))
        model, rows = at_start(problem, free), problem.observations
        like = _like(model, problems[0].model, fits[0]) if number else {"begin": {}}
        like["begin"] |= begin(number, like["begin"])
        found, doubt = fit_over_gaps(model, rows, free, part, problem.origin, **like)
        fits.append(found)
        doubts.append(doubt)
    if checkpoint is not None:
        keep(checkpoint, ([{**vars(each), "model": each.model.parameters} for each in fits], doubts))
    return fits, doubts


def fitted_on_the_middle(
    recording: Recording, bound: Callable[[Recording], Problem], free: Sequence[Free], known: Mapping[str, Tensor]
) -> Mapping[str, Tensor]:
    """Parameters fitted on the middle of a long recording, at which to begin with all of it: {} where there are none.

    Their own fit begins at those that are ``known`` of another process.

    They save most of the search, and change what it finds by no more than its tolerance.
    """
    if recording.num_frames < PILOT_FROM or type(recording) is not Recording:
        return {}
    first = (recording.num_frames - PILOT_ROWS) // 2
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the whole recording's fit says what is to be said
            problem = bound(recording.select(first, first + PILOT_ROWS))
            model = fit(at_start(problem, free), problem.observations, free, begin=known).model
    except (InputError, Diverged, KeyError):
        return {}  # the arm is not seen there, say
    return {each.name: model.parameters[each.name] for each in free}


def _like(model: ArmModel, first: ArmModel, fit: Fit[ArmModel]) -> dict[str, Any]:
    """What the fit of a model starts from, given that of the ``first``, which differs in its torque process alone."""
    joints = model.body.num_joints
    z, rest = fit.path[:, : first.torque.size(joints)], fit.path[:, first.torque.size(joints) :]
    begin = {name: value for name, value in fit.model.parameters.items() if name in model.parameters}
    return {"start": torch.cat([model.torque.path(z[:, :joints], model.time), rest], -1), "begin": begin}


def _share(report: Report | None, number: int, count: int) -> Report | None:
    """What reports the progress of one fit of several as that of all."""
    return None if report is None else lambda done, total: report(number * total + done, count * total)


def fingerprint(
    problems: Sequence[Problem], options: SMCOptions, seed: int, frees: Sequence[list[Free]]
) -> dict[str, Any]:
    """All that the numbers of a run depend on, but for the method: each has a folder of its own."""
    model = problems[0].model  # others differ from it in their torque process alone
    observation, torques = model.observation, [each.model.torque for each in problems]
    data = [problems[0].observations, model.time]
    data += [tensor for tensor in (model.command, *observation.data()) if tensor is not None]
    return {
        "version": version("invdyn"),
        "recording": digest(*data),
        "body": repr(model.body),
        "start": digest(*(model.parameters[name] for name in sorted(model.parameters))),
        "free": [repr(f) for free in frees for f in free],
        "torques": ", ".join(f"{type(torque).__name__} {vars(torque)}" for torque in torques),
        "integrator": f"{model.integrator}, {model.substeps} sub-steps",
        "family": observation.family,
        "forces": [repr(effect) for effect in model.effects],
        "seed": seed,
        **{name: str(value) for name, value in asdict(options).items()},
    }
