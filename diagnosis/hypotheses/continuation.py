"""Paths that refinements start from: that of the data, for any cause; and from one cause's path to another's.

Gauss–Newton finds the path of highest density near where it starts. A first one is had under a large residual, which
lets the arm follow the data under any simulation, with heavy tails where there are outliers.
"""

import torch
from torch import Tensor

from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.rules import DEFAULT, FIXED
from invdyn.diagnosis.sensitivity.latent_response import latent_response
from invdyn.inference.smoothing.gauss_newton import gauss_newton, gauss_newton_path
from invdyn.models import ArmModel
from invdyn.models.fixed_point import settled


def data_path(problem: DiagnosisProblem) -> tuple[Tensor, bool]:
    """The data's path: the simulation under a large residual, robust against outliers.

    And whether there are any.
    """
    free = problem.with_residual(problem.regime.path_size)
    path = gauss_newton(free, problem.observations).path
    rows = torch.arange(len(path))
    with torch.no_grad():
        seen = free.emission(path, rows).base_dist
        far = ((problem.observations - seen.loc) / seen.scale).abs() > problem.rules.recording.path_outlier_sds
    if not bool(far.any()):
        return path, False
    # Outliers have bent the first path: the second one must not start from there.
    start = gauss_newton(free, problem.usual).path
    return gauss_newton(_heavy_tailed(free), problem.observations, start=start).path, True


def _heavy_tailed(model: ArmModel) -> ArmModel:
    """The model with Student-t observations."""
    other = model.observed_by(model.observation.with_family("student_t"))
    return other.replace(**{"emission.df": torch.full((1,), 3.0, dtype=model.dtype)})


def continued(problem: DiagnosisProblem, model: ArmModel, path: Tensor, size: float) -> Tensor:
    """A path (T, D) under ``model`` and a residual of ``size`` from one of another cause, by a homotopy.

    Where joints stick or gears have backlash, Gauss–Newton by itself ends in a path that no parameters make good. With
    much noise in the dynamics it may first break what links one row to the next; then the noise falls to its own.
    """
    names = ["noise.angle", "noise.velocity", *(f"noise.hidden.{each.key}" for each in model.effects.hidden)]
    rules, least = problem.rules.descent, max(size, problem.min_size)
    most = max(problem.regime.path_size, size)
    for slack in rules.lead_slack:
        noisy = model.replace(**{name: slack * model.parameters[name] for name in names})
        quiet = problem.with_residual(min(most, least * slack ** (2 / 3)), noisy)
        path = gauss_newton_path(quiet, problem.observations, path, rules.lead_steps, rules.path_tolerance)
        problem.budget.spend(rules.lead_steps, noisy, len(path))
    return path


def with_smaller_residual(problem: DiagnosisProblem, model: ArmModel, path: Tensor, size: float) -> Tensor:
    """A path (T, D) under ``model`` and a smaller residual, of ``size``, than it was found with.

    Gauss–Newton by itself keeps the times at which joints stick and slip; where they do, it may also need a homotopy,
    and the better of both paths is taken.
    """
    rules, quiet = problem.rules.descent, problem.with_residual(max(size, problem.min_size), model)
    own = gauss_newton_path(quiet, problem.observations, path, rules.quiet_steps, rules.path_tolerance)
    problem.budget.spend(FIXED.quiet_cost, model, len(path))
    if not model.effects.abrupt:
        return own
    other = continued(problem, model, path, size)
    with torch.no_grad():
        better = quiet.log_joint(own, problem.observations) >= quiet.log_joint(other, problem.observations)
    return own if better else other


def lifted(model: ArmModel, path: Tensor) -> Tensor:
    """A path (T, D) in the states of ``model``: hidden ones that it does not know rest, a gap is as it is driven."""
    torque, moving = model.torque_size, 2 * model.body.num_joints
    has, needs = (size - torque - moving for size in (path.shape[-1], model.state_dim))
    if has == needs:
        return settled(model, path)
    path = torch.cat([path[:, :torque], path[:, torque + has :]], -1)
    if model.contact_states is not None:
        path, _ = latent_response(model, path, 1, DEFAULT)  # a gap has no slopes
        return path.squeeze(0)
    return torch.cat([path[:, :torque], path.new_zeros(len(path), needs), path[:, torque:]], -1)
