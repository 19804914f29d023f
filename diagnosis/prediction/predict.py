"""What a cause makes of a recording: one-step predictions, the residual torque that is left, and open-loop replay.

* One-step predictive log density of every row given all before it, from the whitened innovations:
  log p(y_t | y_{<t}) = −½ |w_t|²/κ² − n_t log κ − ½ log |S_t| + const, less what they remember (:mod:`.memory`).
  On rows that the parameters have not seen, integrated over their posterior N(μ, LLᵀ): with w_t + A_t L z, z ~ N(0, I),
  G_t = I + Σ_{s≤t} LᵀA_sᵀA_s L/κ² and r_t = Σ_{s≤t} LᵀA_sᵀw_s/κ², it is more by
  ½ (r_tᵀ G_t⁻¹ r_t − log |G_t|) less the same of t−1 (Bishop 2006, §3.3 and §3.5).
* Residual torque: its smoothed posterior.
* Replay: the simulation alone, set to the smoothed state every `replay_window` seconds and left to run.

Shapes: T rows, K joints.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from invdyn.diagnosis.problem.cause import FittedHypothesis, best_size
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.problem.unknowns import unknowns
from invdyn.diagnosis.rules import FIXED
from invdyn.diagnosis.sensitivity.memory import forgotten
from invdyn.diagnosis.sensitivity.sensitivities import Columns, slopes
from invdyn.diagnosis.sensitivity.whiten import Whitened, filter_of, whiten
from invdyn.inference.smoothing.gauss_newton import GaussianSmoother, gauss_newton
from invdyn.models import ArmModel


@dataclass(frozen=True)
class Scores:
    """Per row, nats; NaN where nothing was seen.

    Attributes:
        score: (T,) of the prediction.
        floor: (T,) what a simulation without any gap would score on average under the same noise.
    """

    score: np.ndarray
    floor: np.ndarray


def whitened(
    problem: DiagnosisProblem,
    cause: FittedHypothesis,
    levels: Sequence[float] | np.ndarray,
    columns: Columns | None = None,
) -> Whitened:
    """Innovations of ``problem``'s rows under a cause along its path, for each size of the residual.

    And ``columns``, if there are any. What they remember of the row before is in them.
    """
    path = cause.path
    none = Columns(
        np.zeros((len(path) - 1, path.shape[-1], 0)), np.zeros((len(path), problem.observations.shape[-1], 0))
    )
    return whiten(problem, filter_of(problem, cause.model, path, np.array(levels)), columns or none)


def scores(problem: DiagnosisProblem, cause: FittedHypothesis, unseen: np.ndarray | None = None) -> Scores:
    """One-step predictive scores of ``problem``'s rows under a cause found there or on another recording.

    ``unseen`` (T,) are rows that the cause's parameters have not seen: there they are what is known of them and of the
    rows before.
    """
    quietest = problem.rules.residual.spike_size if problem.regime.knows_torque else best_size(problem, cause)
    columns = None if unseen is None else posterior_columns(problem, cause)
    rows = forgotten(whitened(problem, cause, [best_size(problem, cause), quietest], columns), cause.memory)
    seen, kappa = rows.seen, cause.kappa
    known = seen > 0
    constant = -seen * (np.log(kappa) + 0.5 * np.log(2 * np.pi))
    w = rows.columns[0].reshape(known.sum(), -1, rows.columns.shape[-1]) / kappa
    score = np.full(len(seen), np.nan)
    score[known] = (constant - rows.row_log_det[0])[known] - 0.5 * (w[..., 0] ** 2).sum(-1)
    if unseen is not None:
        here = known & unseen
        score[here] += _learning(w[unseen[known]])
    floor = constant - rows.row_log_det[1] - 0.5 * seen
    return Scores(score, np.where(known, floor, np.nan))


def posterior_columns(problem: DiagnosisProblem, cause: FittedHypothesis) -> Columns:
    """Slopes in p numbers z ~ N(0, I) along a cause's path: its parameters are μ + L z a posteriori."""
    among = unknowns(problem, cause.model.effects.effects)
    step = np.maximum(problem.rules.screening.slope_step * cause.sd, 1e-7 * among.sd)
    plain = slopes(cause.model, among, cause.mean, step, cause.path)
    values, vectors = np.linalg.eigh(cause.covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    return Columns(plain.g @ root, plain.d @ root)


def _learning(w: np.ndarray) -> np.ndarray:
    """What z ~ N(0, I), the more of its rows are known, adds to the log density of each row of w (T, O, 1 + p)."""
    data, slope = w[..., 0], w[..., 1:]
    G = np.eye(slope.shape[-1]) + np.einsum("toi,toj->tij", slope, slope).cumsum(0)
    r = np.einsum("toi,to->ti", slope, data).cumsum(0)
    fitted = np.einsum("ti,ti->t", r, np.linalg.solve(G, r[..., None])[..., 0])
    return np.diff(0.5 * (fitted - np.linalg.slogdet(G)[1]), prepend=0.0)


def smoothed(problem: DiagnosisProblem, cause: FittedHypothesis) -> GaussianSmoother:
    """Posterior of the states under a cause, with its own residual size."""
    quiet = problem.with_residual(max(best_size(problem, cause), problem.min_size), cause.model)
    return gauss_newton(quiet, problem.observations, start=cause.path, max_iterations=3)


def residual(problem: DiagnosisProblem, cause: FittedHypothesis) -> tuple[np.ndarray, np.ndarray, Tensor]:
    """Mean and sd (T, K) of the residual torque, N·m; and the smoothed path (T, D).

    Of a row it is what acts until the next one, in the mean: the state's torque has decayed by a third until then at 50
    rows a second, and is that much larger than what it stands for where that does not decay.
    """
    smoother = smoothed(problem, cause)
    K, torque = cause.model.body.num_joints, cause.model.torque
    variance = smoother.covariance().diagonal(dim1=-2, dim2=-1)[:, :K]
    one = torch.ones_like(smoother.path[:, :K])
    steps = torch.cat([cause.model.dt[1:], cause.model.dt[-1:]])[:, None]
    acts = ((one + torque.mean(one, steps, cause.model.parameters)) / 2).numpy()
    mean, sd = smoother.path[:, :K].numpy(), variance.clamp_min(0).sqrt().numpy()
    return acts * mean, acts * sd, smoother.path


@torch.no_grad()
def replay(model: ArmModel, path: Tensor, restarts: Sequence[int] = ()) -> np.ndarray:
    """Sites (T, S, d) m of open-loop replays, each of `replay_window` seconds, from the states of ``path`` (T, D).

    Rows ``restarts`` are set to their states too.
    """
    path = path.clone()
    path[:, : model.body.num_joints] = 0.0  # no residual
    time = model.time.numpy()
    starts = np.searchsorted(time, np.arange(time[0], time[-1], FIXED.replay_window))
    starts = np.unique([*starts, *restarts])
    lengths = np.diff(np.append(starts, len(time)))
    states, state = path.clone(), path[starts]
    for step in range(1, int(lengths.max())):
        alive = lengths > step
        rows = torch.as_tensor(starts + step).clamp(max=len(time) - 1)
        state = model.transition_mean(state, rows)
        state[:, : model.body.num_joints] = 0.0
        states[starts[alive] + step] = state[torch.as_tensor(alive)]
    _, q, _ = model.split(states)
    tips = model.dynamics.keypoints(q, model.body_parameters()).nan_to_num(posinf=np.nan, neginf=np.nan)
    # In the order that another process would send it in: sums over it depend on that in their last digit.
    return np.ascontiguousarray(tips.numpy())


def seen_tips(model: ArmModel, path: Tensor) -> np.ndarray:
    """Where the camera would see the sites along ``path``, (T, P, d) m, P tracked."""
    rows = torch.arange(len(path))
    with torch.no_grad():
        emission = model.emission(path, rows)
        loc = getattr(emission, "base_dist", emission).loc
    return model.observation.points(loc).numpy()


def replay_rms(replayed: np.ndarray, smooth: np.ndarray) -> float:
    """Root mean square, m, over rows and sites between a replay and the smoothed ones, (T, S, d) each; NaN of none."""
    distance = ((replayed - smooth) ** 2).sum(-1)
    return float(np.sqrt(np.nanmean(distance))) if np.isfinite(distance).any() else float("nan")
