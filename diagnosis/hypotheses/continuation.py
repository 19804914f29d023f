"""Paths that refinements start from: what the data ask for, whatever the cause; and from one cause's path to another's.

Gauss–Newton finds the path of highest density near where it starts. A first one is had under a large residual, which
lets the arm follow the data under any simulation, with heavy tails where there are stray detections.
"""

import torch
from torch import Tensor

from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.problem.regime import FIRM
from invdyn.diagnosis.sensitivity.latent_response import latent_response
from invdyn.inference.smoothing.gauss_newton import gauss_newton, gauss_newton_path
from invdyn.models import ArmModel
from invdyn.models.fixed_point import settled

STRAY = 5.0
"""Standard deviations beyond which a detection counts as stray when the first path is judged."""
SLACK = (1000.0, 100.0, 10.0, 1.0)
"""Factors on the dynamics' own noise, one after the other, by which a path is led to a stiff chain's."""
ITERATIONS, PATIENT, CLOSE = 6, 20, 0.3
"""Gauss–Newton steps at each of them, at most, or all at once; and the gain in nats under which they end."""
STEPS = 3
"""They take in the middle, from a path that is near."""


def data_path(problem: DiagnosisProblem) -> tuple[Tensor, bool]:
    """The path that the data ask for: the simulation under a large residual, robust against stray detections.

    And whether there are any.
    """
    loose = problem.with_residual(problem.regime.loose)
    path = gauss_newton(loose, problem.observations).path
    rows = torch.arange(len(path))
    with torch.no_grad():
        seen = loose.emission(path, rows).base_dist
        far = ((problem.observations - seen.loc) / seen.scale).abs() > STRAY
    if not bool(far.any()):
        return path, False
    # What jumps has led the first path to where it is: it must not be what the second one starts from.
    start = gauss_newton(loose, problem.usual).path
    return gauss_newton(_heavy_tailed(loose), problem.observations, start=start).path, True


def _heavy_tailed(model: ArmModel) -> ArmModel:
    """The model with Student-t observations."""
    other = model.observed_by(model.observation.with_family("student_t"))
    return other.replace(**{"emission.df": torch.full((1,), 3.0, dtype=model.dtype)})


def led(problem: DiagnosisProblem, model: ArmModel, path: Tensor, size: float) -> Tensor:
    """A path (T, D) under ``model`` and a residual of ``size`` from one of another cause, by a homotopy.

    Where joints stick or gears have play, Gauss–Newton by itself ends in a path that no parameters make good. With
    much noise in the dynamics it may first break what links one row to the next; then the noise falls to its own.
    """
    names = ["noise.angle", "noise.velocity", *(f"noise.hidden.{each.key}" for each in model.effects.hidden)]
    for slack in SLACK:
        loose = model.replace(**{name: slack * model.parameters[name] for name in names})
        quiet = problem.with_residual(min(max(problem.regime.loose, size), max(size, FIRM) * slack ** (2 / 3)), loose)
        path = gauss_newton_path(quiet, problem.observations, path, ITERATIONS, CLOSE)
        problem.budget.spend(ITERATIONS, loose, len(path))
    return path


def firmed(problem: DiagnosisProblem, model: ArmModel, path: Tensor, size: float) -> Tensor:
    """A path (T, D) under ``model`` and a smaller residual, of ``size``, than it was found with.

    Gauss–Newton by itself keeps the times at which joints stick and slip; where they do, it may also need to be led,
    and the better of both paths is taken.
    """
    quiet = problem.with_residual(max(size, FIRM), model)
    own = gauss_newton_path(quiet, problem.observations, path, PATIENT, CLOSE)
    problem.budget.spend(STEPS, model, len(path))
    if not model.effects.abrupt:
        return own
    other = led(problem, model, path, size)
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
    if model.jumping is not None:
        return latent_response(model, path, 1)[0].squeeze(0)
    return torch.cat([path[:, :torque], path.new_zeros(len(path), needs), path[:, torque:]], -1)
