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
from invdyn.diagnosis.rules import DEFAULT, Rules
from invdyn.models import ArmModel
from invdyn.models.effects.base import Effect
from invdyn.models.effects.scale import Parameter


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
        return self.within(target)

    def within(self, values: np.ndarray) -> np.ndarray:
        """``values`` (p,) within bounds."""
        return np.clip(values, self.lower, self.upper)

    def log_prior(self, values: torch.Tensor) -> torch.Tensor:
        """Log prior density (S,) of values (S, p)."""
        terms = [prior.log_prob(values[:, i]) for i, prior in enumerate(self.priors)]
        return sum(terms, start=values.new_zeros(len(values)))

    def plausible(self, values: np.ndarray) -> bool:
        """Whether values (p,) lie within `max_prior_sds` of their priors' centres."""
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
    rules, scale = problem.rules, problem.model.scale
    found = [(f"{e.key}.{p.name}", p) for e in effects if not is_searched(e) for p in e.parameters(scale)]
    rows = [(name, p.prior, centre(p), prior_sd(p), *bounds(p, rules)) for name, p in found]
    for u in problem.uncertain:
        far = rules.residual.max_prior_sds * u.sd
        edge = -np.inf if u.signed else 0.1 * u.mean  # lengths, masses and inertias stay positive
        rows.append((u.name, _normal(u.mean, u.sd), u.mean, u.sd, max(u.mean - far, edge), u.mean + far))
    names, priors = tuple(row[0] for row in rows), tuple(row[1] for row in rows)
    return Unknowns(names, priors, *np.array([row[2:] for row in rows], dtype=float).reshape(-1, 4).T)


def expanded_about(problem: DiagnosisProblem, base: FittedHypothesis) -> tuple[ArmModel, Unknowns, np.ndarray]:
    """Model, unknowns and their values (p,) that a screen with ``base`` is expanded about.

    Without a cause those of the body as it is stated: what was found of its numbers has stood in for one.
    """
    common = unknowns(problem, base.effects)
    return (base.model, common, base.mean) if base.effects else (problem.model, common, common.mean)


def _normal(mean: float, sd: float) -> Normal:
    return Normal(*(torch.tensor(value, dtype=torch.float64) for value in (mean, sd)))


def centre(parameter: Parameter) -> float:
    """Mean of the Gaussian that stands for a parameter's prior: its edge, where it is half of one."""
    return 0.0 if type(parameter.prior).__name__ == "HalfNormal" else float(parameter.prior.mean)


def prior_sd(parameter: Parameter) -> float:
    """Standard deviation of that Gaussian."""
    prior = parameter.prior
    return float(prior.scale) if type(prior).__name__ == "HalfNormal" else float(prior.stddev)


def bounds(parameter: Parameter, rules: Rules = DEFAULT) -> tuple[float, float]:
    """Smallest and largest value that a parameter may have: its prior's edge, or so many sds from its centre.

    Without limits evidence pays any price where nothing fits: arms without mass under motors without torque explain
    any recording. At probability one, all else is impossible: an upper edge is not reached.
    """
    middle, far = centre(parameter), _max_sds(parameter, rules) * prior_sd(parameter)
    support = parameter.prior.support
    low, edge = (float(getattr(support, name, np.nan)) for name in ("lower_bound", "upper_bound"))
    below = np.nanmax([middle - far, parameter.least, low])
    above = np.nanmin([middle + far, edge - rules.residual.edge_margin * abs(edge)])
    return float(below), float(above)


def at_far_end(parameter: Parameter, value: float, rules: Rules = DEFAULT) -> bool:
    """Whether a value is as large as it may be, and larger ones are not impossible, only implausible."""
    _, above = bounds(parameter, rules)
    margin = rules.residual.edge_margin
    edge = float(getattr(parameter.prior.support, "upper_bound", np.inf))
    return value > (1 - margin) * above and above < edge - margin * abs(edge)


def _max_sds(parameter: Parameter, rules: Rules) -> float:
    """Standard deviations that a parameter may be from its centre: more where a prior has one side or long tails."""
    residual, kind = rules.residual, type(parameter.prior).__name__
    if kind == "StudentT":
        return residual.max_prior_sds_heavy
    return residual.max_prior_sds_one_sided if kind in ("HalfNormal", "Beta") else residual.max_prior_sds
