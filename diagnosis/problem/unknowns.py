"""The unknowns of a cause as one vector: its effects' parameters and the uncertain numbers of the body.

Each has the Gaussian that stands for its prior, cut at bounds: N(mean, sd²) on [lower, upper]. A half-normal is
half of a Gaussian around its edge.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from pyro.distributions import Distribution, LogNormal, Normal

from invdyn.diagnosis.problem.cause import FittedHypothesis
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.problem.noise import is_searched
from invdyn.diagnosis.problem.uncertain import Uncertain
from invdyn.models import ArmModel
from invdyn.models.effects.base import Effect, Parameter

FAR = 4.0
FARTHER = {"HalfNormal": 8.0, "Beta": 8.0, "StudentT": 10.0}
"""Prior standard deviations beyond which no parameter goes, and those of priors with more in their tails or one side
alone. Where nothing fits, evidence would else pay any price: arms without mass under motors without torque explain
whatever there is."""
EDGE = 1e-3
"""Share of an upper edge that parameters keep away from it: at probability one, what else there is is impossible."""


@dataclass(frozen=True)
class Unknowns:
    """Names (p) of unknowns, "<effect key>.<parameter>" or "body.<quantity>.<entry>", priors, Gaussians (p,)."""

    names: tuple[str, ...]
    priors: tuple[Distribution, ...]
    mean: np.ndarray
    sd: np.ndarray
    lower: np.ndarray
    upper: np.ndarray

    def step(self, point: np.ndarray, target: np.ndarray) -> np.ndarray:
        """``target`` (p,) within bounds, and a positive parameter no less than half of what it is at ``point``."""
        positive = np.array([isinstance(prior, LogNormal) for prior in self.priors], dtype=bool)
        target = np.where(positive, np.maximum(target, point / 2), target)
        return np.clip(target, self.lower, self.upper)

    def log_prior(self, values: torch.Tensor) -> torch.Tensor:
        """Log prior density (S,) of values (S, p)."""
        terms = [prior.log_prob(values[:, i]) for i, prior in enumerate(self.priors)]
        return sum(terms, start=values.new_zeros(len(values)))

    def plausible(self, values: np.ndarray) -> bool:
        """Whether values (p,) lie nearer to their priors' centres than ``FAR``."""
        inside = 1e-3 * self.sd
        low = np.where(self.lower < self.mean, self.lower, -np.inf)
        return bool(((values > low + inside) & (values < self.upper - inside)).all())

    def set_in(self, model: ArmModel, values: np.ndarray) -> ArmModel:
        """The model with ``values`` (p,), or with S sets of them (S, p) as parameter sets (S, 1, ...)."""
        given = torch.as_tensor(values)
        many = given.ndim == 2
        changed: dict[str, torch.Tensor] = {}
        nominal = model.body.parameters()._asdict() if any(name.startswith("body.") for name in self.names) else {}
        joints = torch.Size([model.body.num_joints])  # of what the file gives those
        for i, name in enumerate(self.names):
            column = given[..., i, None]
            column = column.unsqueeze(-2) if many else column
            if name.startswith("body."):
                key, entry = name.rsplit(".", 1)
                own = nominal[key.removeprefix("body.")].shape if key.removeprefix("body.") in nominal else joints
                whole = changed.get(key, model.parameters[key])
                whole = whole.expand(*column.shape[:-1], *own).clone(memory_format=torch.contiguous_format)
                whole.flatten(-len(own))[..., int(entry)] = column[..., 0]
                changed[key] = whole
            else:
                changed[f"effect.{name}"] = column
        return model.replace(**changed)


def unknowns(problem: DiagnosisProblem, effects: Sequence[Effect]) -> Unknowns:
    """Unknowns of bound ``effects``, but for those that are searched (:mod:`.noise`), and of the problem's body."""
    found = [(f"{e.key}.{p.name}", p) for e in effects if not is_searched(e) for p in e.parameters(problem.model.scale)]
    rows = [(name, p.prior, centre(p), prior_sd(p), lower_bound(p), upper_bound(p)) for name, p in found]
    rows += [(u.name, _normal(u.mean, u.sd), u.mean, u.sd, _least(u), u.mean + FAR * u.sd) for u in problem.uncertain]
    names, priors = tuple(row[0] for row in rows), tuple(row[1] for row in rows)
    return Unknowns(names, priors, *np.array([row[2:] for row in rows], dtype=float).reshape(-1, 4).T)


def expanded_about(problem: DiagnosisProblem, base: FittedHypothesis) -> tuple[ArmModel, Unknowns, np.ndarray]:
    """Model, unknowns and their values (p,) that a screen beside ``base`` is expanded about.

    Without a cause those of the body as it is stated: what was found of its numbers has stood in for one.
    """
    common = unknowns(problem, base.effects)
    return (base.model, common, base.mean) if base.effects else (problem.model, common, common.mean)


def _least(number: Uncertain) -> float:
    """Smallest value of a number of the body: lengths, masses and inertias stay above a tenth of what they are."""
    edge = -np.inf if number.signed else 0.1 * number.mean
    return max(number.mean - FAR * number.sd, edge)


def _normal(mean: float, sd: float) -> Normal:
    return Normal(*(torch.tensor(value, dtype=torch.float64) for value in (mean, sd)))


def centre(parameter: Parameter) -> float:
    """Mean of the Gaussian that stands for a parameter's prior: its edge, where it is half of one."""
    return 0.0 if type(parameter.prior).__name__ == "HalfNormal" else float(parameter.prior.mean)


def prior_sd(parameter: Parameter) -> float:
    """Standard deviation of that Gaussian."""
    prior = parameter.prior
    return float(prior.scale) if type(prior).__name__ == "HalfNormal" else float(prior.stddev)


def lower_bound(parameter: Parameter) -> float:
    """Smallest value that a parameter may have: its ``least``, its prior's edge, or ``FAR`` from its centre."""
    far = centre(parameter) - _far(parameter) * prior_sd(parameter)
    return max(far, parameter.least, float(getattr(parameter.prior.support, "lower_bound", -np.inf)))


def upper_bound(parameter: Parameter) -> float:
    """Largest value that a parameter may have, likewise."""
    far = centre(parameter) + _far(parameter) * prior_sd(parameter)
    edge = float(getattr(parameter.prior.support, "upper_bound", np.inf))
    return min(far, edge - EDGE * abs(edge)) if np.isfinite(edge) else far


def at_far_end(parameter: Parameter, value: float) -> bool:
    """Whether a value is as large as it may be, and larger ones are not impossible, only beyond what is plausible."""
    edge = float(getattr(parameter.prior.support, "upper_bound", np.inf))
    return value > (1 - EDGE) * upper_bound(parameter) and upper_bound(parameter) < edge - EDGE * abs(edge)


def _far(parameter: Parameter) -> float:
    return FARTHER.get(type(parameter.prior).__name__, FAR)
