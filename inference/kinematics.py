"""The motion of a body, and the lengths of its sticks, without forces: the posterior of a kinematic model.

Biderman et al. (2020) fit the mouse so. Walks, noise and lengths are fitted by marginal likelihood; then paths are
drawn by forward filtering and backward sampling: with particles ("smc", exact but for Monte Carlo), or of the
linearised model ("laplace", in one pass).
"""

import json
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, cast

import arviz as az
import numpy as np

from invdyn.inference.execution.progress import Progress, stage
from invdyn.inference.filters.filtering import SMCOptions
from invdyn.inference.fitting.log_parameters import Free
from invdyn.inference.fitting.marginal_likelihood import fit
from invdyn.inference.methods.registry import METHODS
from invdyn.inference.posterior.base_motion import hold_base
from invdyn.inference.posterior.initialise import arm_problem
from invdyn.inference.renamed_methods import present_name
from invdyn.models import ArmModel, ArticulatedBody, Body, KinematicModel
from invdyn.models.articulated.defaults import Value
from invdyn.recordings import InputError, Recording, Truth
from invdyn.recordings.cameras import Filmed

SAMPLERS = ("smc", "laplace")
"""Methods that need no torque of a model."""


def infer_kinematics(
    recording: Recording,
    body: ArticulatedBody,
    *,
    order: int = 2,
    method: str = "smc",
    num_filters: int = 64,
    num_particles: int = 100,
    num_draws: int = 4,
    seed: int = 0,
    settings: Mapping[str, Value] | None = None,
    family: str = "gaussian",
    learn_lengths: bool = False,
    truth: Truth | None = None,
    progress: Progress | None = None,
) -> az.InferenceData:
    """Infer how a recorded body moved.

    Args:
        recording: keypoints, encoders, or both.
        body: its masses are not used.
        order: of the walk, 1 or 2; see :mod:`invdyn.models.kinematic`.
        method: "smc" or "laplace".
        num_filters, num_particles, num_draws: as of :func:`.infer`.
        seed: same seed, same result.
        settings: parameters by dotted name that are known; walks and noise that are not given are fitted.
        family: of the observation noise, one of :data:`invdyn.models.FAMILIES`.
        learn_lengths: learn the lengths of sticks, from the median distances on.
        truth: to compare with.
        progress: called with (done, total, what).

    Returns:
        InferenceData as :mod:`.posterior` lays it out, without torques. Attributes: model "kinematic", and under
        settings what was fitted, and "length", for each link that was learned (length, sd).

    Raises InputError: the recording does not fit the body or is a film, an unknown parameter, or another method.
    """
    method = present_name(method)
    if method not in SAMPLERS:
        raise InputError(f"--torque none: expected a method among {', '.join(SAMPLERS)}, got {method!r}")
    if isinstance(recording, Filmed):
        raise InputError(
            f"{recording.name} is a film, and a kinematic model knows no cameras: "
            "give it the triangulated points, as a Recording of time, keypoints and keypoint_names"
        )
    options = SMCOptions(num_filters, num_particles, num_draws)
    options.check()
    # What no dynamics has to explain may be taken away.
    recording = hold_base(recording, body).at_rest
    problem = arm_problem(
        recording, body, family=family, substeps=1, learn_lengths=learn_lengths, hide_torque=True, truth=truth
    )
    try:
        model = KinematicModel.of(problem.model, order).with_values(settings or {})
    except (KeyError, ValueError) as error:
        raise InputError(f"settings: {error.args[0]}") from None
    learned: dict[str, tuple[int, ...]] = dict(model.body.learned)
    if learn_lengths and model.body.is_chain:
        learned = {"length": tuple(range(model.body.num_joints))}
    free = [
        Free("walk.scale"),
        *(Free(name, sd=1.0, tied=name != "emission.df") for name in model.parameters if name.startswith("emission.")),
        *(Free(f"body.{name}", sd=0.3, entries=entries) for name, entries in learned.items()),
    ]
    free = [each for each in free if each.name not in (settings or {})]
    fitted = fit(model, problem.observations, free, progress=stage(progress, "fit"))
    record: dict[str, Any] = {
        "fitted": {each.name: fitted.model.parameters[each.name].tolist() for each in free},
        "fit_converged": fitted.converged,
        "order": order,
        "family": family,
    }
    if lengths := _lengths(fitted.model, fitted.log_sd, learned):
        record["length"] = lengths
    return METHODS[method](
        replace(problem, model=cast(ArmModel, fitted.model)),  # these methods need no more than both have
        options=options,
        start=fitted.path,
        seed=seed,
        settings=record,
        progress=progress,
    )


def learned_lengths(idata: az.InferenceData) -> dict[str, tuple[float, float]]:
    """Length and its posterior sd (Laplace) of each link whose length was learned, in the recording's unit."""
    return {link: (length, sd) for link, length, sd in json.loads(idata.attrs["settings"]).get("length", [])}


def _lengths(
    model: KinematicModel, log_sd: Mapping[str, np.ndarray], learned: Mapping[str, tuple[int, ...]]
) -> list[tuple[str, float, float]]:
    """Links with length and sd: a chain's, and a tree's sticks, of which it is the x of the tip."""
    body, name = model.body, "length" if model.body.is_chain else "sites"
    ends = list(body.link_names)
    if isinstance(body, Body) and not body.is_chain:
        sticks = {link.tip: link.name for link in body.links if link.tip is not None}
        ends = [sticks.get(site, "") if axis == "x" else "" for site in body.keypoint_names for axis in "xyz"]
    values = model.parameters.get(f"body.{name}")
    found = zip(learned.get(name, ()), log_sd.get(f"body.{name}", ()), strict=False)
    return [
        (ends[entry], length := float(values.reshape(-1)[entry]), length * float(relative))
        for entry, relative in found
        if values is not None and ends[entry]
    ]
