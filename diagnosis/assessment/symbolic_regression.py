"""What the catalogue does not explain, as a short formula: sparse regression of the residual torque.

Candidate terms are functions of (θ, θ̇, θ̈, u, t), each as a torque on one joint: a column of the whitened innovations
(:mod:`.innovations`), so that noise and gaps count for what they are worth, unlike in a regression of a differentiated
signal. They are taken half-way from row to row, along the path that the whole recording gives, whose own errors are
small against what varies and enter as a bias. Terms are added one by one while the evidence rises by more than their
number costs (forward selection by Bayes factor; Brunton, Proctor & Kutz 2016 use thresholded least squares for the same
end). A coefficient's standard error is that of leaving out one stretch of rows after the other, terms chosen again each
time (jackknife: Künsch 1989, for what is correlated from row to row), for whitened rows of a wrong model are not
independent. The gain on withheld rows is measured with coefficients from the others, of terms that all rows chose.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from invdyn.diagnosis.assessment.digits import decimals
from invdyn.diagnosis.problem.cause import FittedHypothesis
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.rules import FIXED, Rules
from invdyn.diagnosis.sensitivity.evidence import Regression, regression
from invdyn.diagnosis.sensitivity.sensitivities import Columns
from invdyn.diagnosis.sensitivity.whiten import Whitened, filter_of, linear_of, whiten

Feature = Callable[["Motion", int], np.ndarray]


@dataclass(frozen=True)
class Motion:
    """Angles, velocities, accelerations, commands (T − 1, K) and time (T − 1,) between rows of the data's path."""

    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    u: np.ndarray
    t: np.ndarray


@dataclass(frozen=True)
class Formula:
    """Result of :func:`describe`: sentence, terms name → (coefficient, sd, unit), variables, nats a withheld frame."""

    text: str
    terms: dict[str, tuple[float, float, str]]
    variables: tuple[str, ...]
    gain_per_frame: float


CONSTANT = "constant"
LIBRARY: dict[str, tuple[str, str, Feature]] = {
    CONSTANT: ("", "N·m", lambda m, k: np.ones(len(m.t))),
    "sin {q}": ("position", "N·m", lambda m, k: np.sin(m.q[:, k])),
    "cos {q}": ("position", "N·m", lambda m, k: np.cos(m.q[:, k])),
    "sin 2{q}": ("position", "N·m", lambda m, k: np.sin(2 * m.q[:, k])),
    "cos 2{q}": ("position", "N·m", lambda m, k: np.cos(2 * m.q[:, k])),
    "({q} − mean)": ("position", "N·m/rad", lambda m, k: m.q[:, k] - m.q[:, k].mean()),
    "({q} − mean)³": ("position", "N·m/rad³", lambda m, k: (m.q[:, k] - m.q[:, k].mean()) ** 3),
    "d{q}/dt": ("velocity", "N·m·s/rad", lambda m, k: m.qd[:, k]),
    "sgn d{q}/dt": ("velocity", "N·m", lambda m, k: np.tanh(m.qd[:, k] / (0.02 * np.abs(m.qd[:, k]).max() + 1e-9))),
    "|d{q}/dt| d{q}/dt": ("velocity", "N·m·s²/rad²", lambda m, k: m.qd[:, k] * np.abs(m.qd[:, k])),
    "max(d{q}/dt, 0)": ("velocity", "N·m·s/rad", lambda m, k: np.maximum(m.qd[:, k], 0)),
    "sin({q}) d{q}/dt": ("position", "N·m·s/rad", lambda m, k: np.sin(m.q[:, k]) * m.qd[:, k]),
    "cos({q}) d{q}/dt": ("position", "N·m·s/rad", lambda m, k: np.cos(m.q[:, k]) * m.qd[:, k]),
    "d²{q}/dt²": ("acceleration", "N·m·s²/rad", lambda m, k: m.qdd[:, k]),
    "{u}": ("command", "1", lambda m, k: m.u[:, k]),
    "|{u}|": ("command", "1", lambda m, k: np.abs(m.u[:, k])),
    "t d{q}/dt": ("time", "N·m/rad", lambda m, k: m.t * m.qd[:, k]),
    "t {u}": ("time", "1/s", lambda m, k: m.t * m.u[:, k]),
}
"""Term in an angle {q} or a command {u} → (variable, unit of its coefficient, function of the motion and a joint).

The unit 1 and the constant term are left out in words: "+0.1 × u[elbow] on elbow", "+0.1 N·m on elbow".
"""


def describe(problem: DiagnosisProblem, cause: FittedHypothesis, path: Tensor) -> Formula | None:
    """Formula of what is left under ``cause``; None where no term earns its place."""
    terms, features = library_of_terms(cause, path)
    linear = linear_of(problem, cause.model, path)
    K, D = cause.model.body.num_joints, path.shape[-1]
    decay = torch.full_like(cause.model.parameters["torque.decay"], FIXED.negligible)
    response = linear_of(problem, cause.model.replace(**{"torque.decay": decay}), path).F[:, :, :K].copy()
    response[:, :K] = 0.0  # a torque on joint j, from row to row
    g = np.stack(
        [response[:, :, joint] * feature[:, None] for (_, joint, _, _), feature in zip(terms, features, strict=True)],
        -1,
    )
    d = np.zeros((len(path), problem.observations.shape[-1], len(terms)))
    levels = np.array([problem.min_size, *problem.rules.residual.slab_sizes[:-1]])
    about = filter_of(problem, cause.model, path, levels, linear)
    whitened = whiten(problem, about, Columns(g.reshape(len(path) - 1, D, -1), d))
    typical = problem.typical.numpy()
    sd = np.array(
        [0.5 * typical[j] / (np.sqrt((f**2).mean()) + 1e-12) for (_, j, _, _), f in zip(terms, features, strict=True)]
    )
    cost = np.array([problem.rules.outcome.product_cost * _is_product(name) for name, *_ in terms])
    if not (chosen := _chosen(whitened, sd, cost, problem.rules)):
        return None
    size = int(np.argmax([_at(whitened, g, [chosen], sd).log_evidence[0] for g in range(len(levels))]))
    fit = _at(whitened, size, [chosen], sd)
    errors = np.hypot(
        _scatter(whitened, size, chosen, sd, cost, problem.rules), problem.rules.outcome.path_bias * fit.mean[0]
    )
    errors = np.maximum(np.sqrt(np.diag(fit.covariance[0])), errors)
    named = {
        terms[i][0]: (float(mean), float(s), terms[i][2])
        for i, mean, s in zip(chosen, fit.mean[0], errors, strict=True)
    }
    text = "; ".join(f"{written_coefficient(mean, s)}{_factor(unit, name)}" for name, (mean, s, unit) in named.items())
    variables = tuple(dict.fromkeys(terms[i][3] for i in chosen if terms[i][3]))
    return Formula(text, named, variables, _held_out_gain(whitened, size, chosen, sd, problem.rules))


def _factor(unit: str, name: str) -> str:
    """Unit and term behind a coefficient: " N·m × sin θ[elbow] on elbow"; a constant's is " N·m on elbow"."""
    what = name.removeprefix(CONSTANT) if name.startswith(CONSTANT) else f" × {name}"
    return f"{'' if unit == '1' else f' {unit}'}{what}"


def _is_product(name: str) -> bool:
    """Whether a term's name has two factors: "sin(θ[elbow]) dθ[elbow]/dt on elbow"."""
    return name.startswith("t ") or (" d" in name.partition(" on ")[0] and not name.startswith("sgn "))


def library_of_terms(cause: FittedHypothesis, path: Tensor) -> tuple[list[tuple[str, int, str, str]], list[np.ndarray]]:
    """Terms (name, joint that the torque acts on, unit, variable) and their features (T − 1,)."""
    model = cause.model
    _, q, qd = (x.numpy() for x in model.split(path))
    time = model.time.numpy() - model.time[0].item()
    u = np.zeros_like(q) if model.command is None else model.command.numpy()
    qdd = np.diff(qd, axis=0) / np.diff(time)[:, None]
    angle, velocity, middle = ((x[1:] + x[:-1]) / 2 for x in (q, qd, time))
    motion = Motion(angle, velocity, qdd, u[:-1], middle)
    terms, features = [], []
    joints = model.body.joint_names
    for joint, acts_on in enumerate(joints):
        for k, name in enumerate(joints):
            for pattern, (variable, unit, function) in LIBRARY.items():
                if (pattern == CONSTANT and k != joint) or (
                    variable in ("command", "time") and (k != joint or not u.any())
                ):
                    continue
                feature = function(motion, k)
                if np.ptp(feature) == 0 and pattern != CONSTANT:
                    continue
                what = f"{pattern.format(q=f'θ[{name}]', u=f'u[{name}]')} on {acts_on}"
                terms.append((what, joint, unit, f"{variable}:{name}" if variable else ""))
                features.append(feature)
    return terms, features


def _at(whitened: Whitened, size: int, sets: Sequence[Sequence[int]], sd: np.ndarray) -> Regression:
    """Regression on each set of terms, all of one length."""
    of = np.array(sets, int).reshape(len(sets), -1)
    free = np.full(of.shape, -np.inf)
    gram, log_det = whitened.gram[size], whitened.log_det[size]
    none, centre = np.zeros(len(of), int), np.zeros(of.shape)
    return regression(gram, 1 + of, none, centre, sd[of], free, -free, whitened.count, log_det)


def _evidence(whitened: Whitened, sets: Sequence[Sequence[int]], sd: np.ndarray) -> np.ndarray:
    """Log evidence of each set, all sizes of the residual together."""
    return np.logaddexp.reduce([_at(whitened, g, sets, sd).log_evidence for g in range(len(whitened.sizes))])


def _chosen(whitened: Whitened, sd: np.ndarray, cost: np.ndarray, rules: Rules) -> list[int]:
    """Terms, one by one, while the evidence rises by more than their number and their ``cost`` do."""
    chosen: list[int] = []
    best = _evidence(whitened, [chosen], sd)[0]
    while len(chosen) < rules.outcome.max_terms:
        gains = _evidence(whitened, [[*chosen, i] for i in range(len(sd))], sd) - cost
        gains[chosen] = -np.inf
        if gains.max() < best + np.log(len(sd)) + 3:
            break
        chosen, best = [*chosen, int(gains.argmax())], gains.max()
    return chosen


def _scatter(
    whitened: Whitened, size: int, chosen: list[int], sd: np.ndarray, cost: np.ndarray, rules: Rules
) -> np.ndarray:
    """Standard errors of the coefficients, by the jackknife: one stretch of rows after the other is left out.

    What remains of one row in the next counts, and so do terms that are chosen in another's place: then one has 0.
    """
    seen = np.flatnonzero(whitened.seen)
    found = np.zeros((min(rules.outcome.num_left_out, len(seen)), len(sd)))
    for coefficients, stretch in zip(found, np.array_split(np.arange(len(seen)), len(found)), strict=True):
        rows = whitened.columns[:, stretch[0] * whitened.width : (stretch[-1] + 1) * whitened.width]
        observed, log_det = whitened.seen.copy(), whitened.row_log_det.copy()
        observed[seen[stretch]], log_det[:, seen[stretch]] = 0, 0.0
        gram = whitened.gram - rows.mT @ rows
        rest = replace(whitened, gram=gram, seen=observed, row_log_det=log_det)
        own = _chosen(rest, sd, cost, rules)
        coefficients[own] = _at(rest, size, [own], sd).mean[0]
    return np.sqrt((len(found) - 1) * found[:, chosen].var(axis=0))


def written_coefficient(mean: float, sd: float) -> str:
    """A coefficient to the digits that its standard error, more than 0, supports: "-0.30 ± 0.01"."""
    places = decimals(sd)
    return f"{round(mean, places):+.{max(places, 0)}f} ± {round(sd, places):.{max(places, 0)}f}"


def _held_out_gain(whitened: Whitened, size: int, chosen: list[int], sd: np.ndarray, rules: Rules) -> float:
    """Nats a frame that the last third of the rows gains, with coefficients from the first two."""
    rows = whitened.columns[size]
    cut = int(rules.outcome.fit_share * len(rows))
    A, y = rows[:cut, 1 + np.array(chosen)], rows[:cut, 0]
    kappa2 = (y**2).mean()
    precision = A.T @ A / kappa2 + np.diag(1 / sd[chosen] ** 2)
    coefficients = -np.linalg.solve(precision, A.T @ y / kappa2)
    before, rest = rows[cut:, 0], rows[cut:, 0] + rows[cut:, 1 + np.array(chosen)] @ coefficients
    after2 = ((y + A @ coefficients) ** 2).mean()

    def score(w: np.ndarray, k2: float) -> float:
        return float(-0.5 * (w**2).sum() / k2 - 0.5 * len(w) * np.log(k2))

    frames = max((whitened.seen > 0).sum() - int(rules.outcome.fit_share * (whitened.seen > 0).sum()), 1)
    return (score(rest, after2) - score(before, kappa2)) / frames
