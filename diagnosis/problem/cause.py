"""A cause that was refined: one or several effects together, and what is known of them.

Shapes: p parameters, T rows, states of D coordinates, G sizes of the residual.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.problem.prior import coarsened
from invdyn.models import ArmModel
from invdyn.models.effects.base import PREFIX, Effect


class Scored:
    """What ranks a cause, whichever engine moves it; see :class:`FittedHypothesis`."""

    effects: tuple[Any, ...]
    log_evidence: float
    by_size: np.ndarray
    learned: np.ndarray
    far: float

    @property
    def complete(self) -> bool:
        """Whether the cause does without a residual torque."""
        return int(self.by_size.argmax()) == 0

    @property
    def key(self) -> str:
        """Keys of the effects, sorted and joined; "" for none."""
        return key_of(self.effects)

    def log_evidence_at(self, temper: float) -> float:
        """Log evidence where the likelihood, and not the parameters' prior, is raised to a power; see :mod:`.prior`."""
        return coarsened(self.log_evidence, self.learned, self.far, temper)


@dataclass(frozen=True)
class FittedHypothesis(Scored):
    """A cause, one or several effects together, with its parameters' posterior.

    Attributes:
        effects: bound; empty for "no effect".
        names: p parameters, "viscous_friction.elbow.damping".
        mean, covariance: (p,), (p, p) of their posterior.
        log_evidence: parameters and sizes of the residual integrated out.
        by_size: (G,) log-evidence with the prior weight of each size.
        kappa: factor on the observations' noise at the best size.
        memory, of_memory: of their errors from row to row (:mod:`..sensitivity.memory`), and nats that it is worth.
        path: (T, D) its own.
        model: with the parameters at their means.
        noise, noise_sd: parameters that were searched (effects on the scatter, backlash), which are no part of
            ``names``.
        noise_log: what their integral added to the log evidence, by effect's key.
        plausible: whether all parameters are nearer to their priors' centres than `max_prior_sds`.
        about: (p,) where it was expanded; ``mean`` is at most a short step from there, after one round any.
        learned: (p,) λ: along each principal direction, how many times more the data say of parameters than the prior.
        far: −log prior density of the parameters, in units of the prior's highest one.
    """

    effects: tuple[Effect, ...]
    names: tuple[str, ...]
    mean: np.ndarray
    covariance: np.ndarray
    log_evidence: float
    by_size: np.ndarray
    kappa: float
    path: Tensor
    model: ArmModel
    noise: dict[str, float]
    noise_sd: dict[str, float]
    noise_log: dict[str, float]
    memory: float = 0.0
    of_memory: float = 0.0
    plausible: bool = True
    about: np.ndarray | None = None
    learned: np.ndarray = field(default_factory=lambda: np.zeros(0))
    far: float = 0.0

    @property
    def sd(self) -> np.ndarray:
        """Standard deviations (p,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def values(self) -> dict[str, float]:
        """Parameters by name, those that were searched too."""
        return dict(zip(self.names, self.mean.tolist(), strict=True)) | {k: float(v) for k, v in self.noise.items()}

    @property
    def sds(self) -> dict[str, float]:
        """Standard deviations of :attr:`values`, where they are known."""
        return dict(zip(self.names, self.sd.tolist(), strict=True)) | self.noise_sd

    @property
    def searched(self) -> dict:
        """What :func:`refine` needs to know of parameters that were searched."""
        return {"noise_log": self.noise_log, "noise_sd": self.noise_sd}

    def less(self, problem: DiagnosisProblem, effect: Effect) -> "FittedHypothesis":
        """The same without one of the effects and its parameters, nothing refined.

        Path, evidence and ``learned`` are those of the whole.
        """
        rest = tuple(other for other in self.effects if other.key != effect.key)
        gone = {f"{effect.key}.{p.name}" for p in effect.parameters(problem.model.scale)}
        kept = [i for i, name in enumerate(self.names) if name not in gone]
        model = problem.model.with_effects(*rest)
        return replace(
            self,
            effects=rest,
            names=tuple(self.names[i] for i in kept),
            mean=self.mean[kept],
            covariance=self.covariance[np.ix_(kept, kept)],
            about=None if self.about is None else self.about[kept],
            model=model.replace(**{n: v for n, v in self.model.parameters.items() if n in model.parameters}),
            noise={n: v for n, v in self.noise.items() if n not in gone},
            noise_sd={n: v for n, v in self.noise_sd.items() if n not in gone},
            noise_log={key: v for key, v in self.noise_log.items() if key != effect.key},
        )

    def carried_to(self, other: DiagnosisProblem) -> ArmModel:
        """The model of another recording with this cause's effects and parameters, and with the noise that they know.

        What is said of the noise is said of its scale: another recording's own jitter is no part of it, but at a
        keypoint that this one did not track.
        """
        mine, theirs = self.model, other.model
        values = {name: value for name, value in mine.parameters.items() if name.startswith(PREFIX)}
        recorded = ("body.gravity", "body.base")  # of the recording's frame, and not of the body
        values |= {n: v for n, v in mine.parameters.items() if n.startswith("body.") and n not in recorded}
        keypoint, angle = "emission.keypoint_scale", "emission.angle_scale"
        if keypoint in theirs.parameters:
            known = dict(zip(mine.observation.tracked, mine.parameters.get(keypoint, ()), strict=True))
            own = zip(theirs.observation.tracked, theirs.parameters[keypoint], strict=True)
            values[keypoint] = torch.stack([known.get(tip, scale) for tip, scale in own])
        if angle in theirs.parameters and angle in mine.parameters:
            values[angle] = mine.parameters[angle]
        theirs = theirs.observed_by(theirs.observation.with_family(mine.observation.family))
        values |= {"emission.df": mine.parameters["emission.df"]} if "emission.df" in mine.parameters else {}
        return theirs.with_effects(*self.effects).replace(**values)


def best_size(problem: Any, cause: Scored) -> float:
    """The residual's size that a cause has the highest evidence with, of those in the problem's regime."""
    return float(problem.regime.sizes[int(cause.by_size.argmax())])


def key_of(effects: Sequence[Effect]) -> str:
    """Keys of effects, sorted and joined."""
    return "+".join(sorted(effect.key for effect in effects))


def of_effect(effect: Effect, known: Mapping[str, float]) -> dict[str, float]:
    """Of what is ``known`` by "<effect key>.<name>" that of one effect, by its parameters' own names."""
    parts = ((*name.rpartition(".")[::2], value) for name, value in known.items())
    return {name: value for key, name, value in parts if key == effect.key}
