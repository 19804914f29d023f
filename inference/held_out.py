"""The score of a prediction: one-step log density of a held-out tail (leave-future-out).

Bürkner, Gabry & Vehtari (2020), "Approximate leave-future-out cross-validation". A method sees rows 0 … s−1, and
its draws of the last state become a Gaussian b(x_{s−1}), its belief, of their mean and covariance. From there the
sum of the one-step predictive log densities,

    Σ_{t ≥ s} log p(y_t | y_{s:t}, b)  =  log ∫ b(x_{s−1}) p(y_{s:T} | x_{s−1}) dx_{s−1},

is the evidence of the tail alone. One controlled particle filter (:mod:`.controlled`), the same for every method and
good to hundredths of a nat, estimates it: so methods without a filter have a score too, and what differs between
methods is what they believe. (Bootstrap filters on the tail would differ by more than the methods do.)
"""

from typing import Self

import arviz as az
import numpy as np
import torch
from pyro.distributions import Distribution
from torch import Tensor

from invdyn.inference.execution.seeds import seeded
from invdyn.inference.filters.filtering import SMCOptions, run_filters
from invdyn.inference.filters.nested import outer_weights
from invdyn.inference.posterior.initialise import Problem
from invdyn.inference.smoothing.linearised import gaussian_smoother
from invdyn.models import StateSpaceModel
from invdyn.models.gaussian import by_root
from invdyn.models.torques.given_torques import given_torques
from invdyn.recordings import InputError

OPTIONS = SMCOptions(num_filters=8, num_particles=500, dtype=torch.float64)


class Continued(StateSpaceModel):
    """A model from row ``first`` on, x_first ~ N(mean, root rootᵀ); its row t is the whole model's first + t."""

    def __init__(self, model: StateSpaceModel, first: int, mean: Tensor, root: Tensor):
        super().__init__({**model.parameters, "start.mean": mean, "start.root": root})
        self.model, self.first = model, first
        self.state_dim, self.observation_dim = model.state_dim, model.observation_dim
        self.num_steps, self.contact_states = model.num_steps - first, model.contact_states
        self.emission_about_mean = model.emission_about_mean

    def replace(self, **values: Tensor) -> Self:
        """Other values, of the whole model's parameters too."""
        other = super().replace(**values)
        other.model = self.model.replace(**{name: v for name, v in values.items() if name in self.model.parameters})
        return other

    def initial(self) -> Distribution:
        """N(mean, root rootᵀ)."""
        root = self.parameters["start.root"]
        return by_root(self.parameters["start.mean"], root)

    def transition(self, state: Tensor, t: int | Tensor) -> Distribution:
        """The whole model's."""
        return self.model.transition(state, t + self.first)

    def emission(self, state: Tensor, t: int | Tensor) -> Distribution:
        """The whole model's."""
        return self.model.emission(state, t + self.first)

    def emission_given(self, previous: Tensor, state: Tensor, t: int | Tensor) -> Distribution:
        """The whole model's."""
        return self.model.emission_given(previous, state, t + self.first)

    @property
    def emission_sees_previous(self) -> bool:
        """As the whole model's; its first row here is taken for one that sees no state before."""
        return self.model.emission_sees_previous


def belief(idata: az.InferenceData, model: StateSpaceModel) -> tuple[Tensor, Tensor]:
    """Mean (D,) and Cholesky factor (D, D) of the last row's state in a posterior.

    Derivatives of a torque and the like are not in a posterior: they follow from its torques (:mod:`.given_torques`).

    Raises InputError where the posterior does not tell the whole state, or has too few draws of it.
    """
    posterior = idata["posterior"]
    kept = ("residual_torque", "stated_torque", "torque")  # the model's own, of the body as its file has it
    torque = next(name for name in kept if name in posterior)
    pieces = [posterior[name].stack(path=("chain", "draw")) for name in (torque, "angle", "velocity")]
    torques, *others = (np.array(each.transpose("path", "time", "joint").values, float) for each in pieces)
    state, rest = torques[:, -1], np.zeros((0, 0))
    process = getattr(model, "torque", None)
    if process is not None and process.torques_suffice:
        numbers = {name: value.double() for name, value in model.parameters.items() if name.startswith("torque.")}
        time = torch.tensor(posterior["time"].values, dtype=torch.float64)
        state, rest = (each.numpy() for each in given_torques(process, torch.as_tensor(torques), time, numbers))
    draws = np.concatenate([state, *(each[:, -1] for each in others)], -1)
    if draws.shape[-1] != model.state_dim:
        raise InputError("the model has a state that its posterior does not tell, such as a base's")
    effective = idata.attrs["outer_ess"] * posterior.sizes["draw"]
    if effective < 2 * model.state_dim:
        raise InputError(f"{effective:.1f} effective draws are too few for a state of {model.state_dim} numbers")
    mean = draws.mean(0)
    deviation = draws - mean
    covariance = deviation.T @ deviation / len(draws) / (1 - 1 / effective)
    covariance[: len(rest), : len(rest)] += rest
    # Numbers of very different size: Cholesky of the correlation. A method may be certain of a state.
    sd = np.sqrt(covariance.diagonal()).clip(1e-12)
    correlation = covariance / np.outer(sd, sd) + 1e-9 * np.eye(len(sd))
    root = sd[:, None] * np.linalg.cholesky(correlation)
    return torch.as_tensor(mean), torch.as_tensor(root)


def log_score(problem: Problem, head: az.InferenceData, path: Tensor, seed: int = 0) -> float:
    """One-step predictive log density of the rows after ``head``, nats per row that holds an observation.

    Args:
        problem: of the whole recording; its parameters must not have seen the tail.
        head: a posterior of the first rows.
        path: (T, D) to linearise at first.
        seed: of the filter.

    Raises InputError as :func:`belief` does.
    """
    first = head["posterior"].sizes["time"] - 1
    tail = problem.observations[first:].clone()
    tail[0] = torch.nan  # the head has seen it
    model = Continued(problem.model, first, *belief(head, problem.model))
    seen = int((~torch.isnan(tail)).any(-1).sum())
    with seeded(seed):
        smoother = gaussian_smoother(model, tail, path[first:])
        result = run_filters(model, tail, OPTIONS, smoother=smoother, keep=1)
    return outer_weights(result.log_evidence).log_evidence / seen
