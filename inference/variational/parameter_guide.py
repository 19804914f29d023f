"""Parameters that are drawn along with the path: the model that draws them, and a guide that follows what was drawn.

φ = centre + root u,   u ~ q(u) = N(m, S), learned;   prior of φ: N(0, diag sd²)
"""

import pyro
import torch
from pyro.distributions import Distribution, MultivariateNormal
from torch import Tensor
from torch.distributions import constraints

from invdyn.inference.fitting.log_parameters import LogParameters
from invdyn.inference.smoothing.gauss_newton import GaussianSmoother
from invdyn.inference.smoothing.linearised import gaussian_smoother
from invdyn.inference.variational.affine import Corrected
from invdyn.inference.variational.path_guides import PathwiseOnly
from invdyn.models import StateSpaceModel
from invdyn.models.divergence import Diverged, diverging

SITE = "log_parameters"


class Uncertain(StateSpaceModel):
    """A model whose free parameters are drawn from their prior, all at one site: u, of φ = centre + root u.

    Args:
        parameters: the free ones.
        centre: (P,) φ at u = 0.
        root: (P, P) square root of the covariance that is one in u.
    """

    def __init__(self, parameters: LogParameters, centre: Tensor, root: Tensor):
        model = parameters.model
        super().__init__(model.parameters)
        self.state_dim, self.observation_dim = model.state_dim, model.observation_dim
        self.num_steps, self.contact_states = model.num_steps, model.contact_states
        self.log_parameters, self.centre, self.root = parameters, centre, root
        inverse = torch.linalg.inv(root)
        scaled = inverse * torch.as_tensor(parameters.sd)
        self.prior = MultivariateNormal(-inverse @ centre, scaled @ scaled.mT)

    def phi(self, u: Tensor) -> Tensor:
        """Log-parameters (…, P) at u (…, P)."""
        return self.centre + u @ self.root.mT

    def sampled(self) -> StateSpaceModel:  # type: ignore[override]  # the model drawn is of its own class
        """Draw the site; return the model that has the parameters."""
        return self.log_parameters.at(self.phi(pyro.sample(SITE, self.prior)))

    def initial(self) -> Distribution:
        """As the model has it at its start."""
        return self.log_parameters.model.initial()

    def transition(self, state: Tensor, t: int | Tensor) -> Distribution:
        """As the model has it at its start."""
        return self.log_parameters.model.transition(state, t)

    def emission(self, state: Tensor, t: int | Tensor) -> Distribution:
        """As the model has it at its start."""
        return self.log_parameters.model.emission(state, t)


class Following(Corrected):
    """The corrected guide of the parameters that are drawn, and the q(u) that they are drawn from.

    Args:
        model, observations, smoother: as for :class:`Corrected`; the smoother stands in where none can be made.
        size: P.
    """

    def __init__(self, model: StateSpaceModel, observations: Tensor, smoother: GaussianSmoother, size: int):
        super().__init__(model, observations, smoother)
        self.observations, self.size = observations, size
        self._known: tuple[bytes, GaussianSmoother] | None = None

    def location_and_root(self) -> tuple[Tensor, Tensor]:
        """Mean (P,) and triangular root (P, P) of q(u), from Pyro's store; standard normal at first."""
        loc = pyro.param(f"{self.name}.loc", torch.zeros(self.size, dtype=torch.float64))
        eye = torch.eye(self.size, dtype=torch.float64)
        return loc, pyro.param(f"{self.name}.root", eye, constraint=constraints.lower_cholesky)

    def parameters(self) -> Tensor:
        """Draw u."""
        loc, root = self.location_and_root()
        live, frozen = (MultivariateNormal(a, scale_tril=b) for a, b in ((loc, root), (loc.detach(), root.detach())))
        return pyro.sample(SITE, PathwiseOnly(live, frozen))

    def sampled(self, model: StateSpaceModel) -> Corrected:
        """The guide of ``model``, linearised along its own path, with the correction from Pyro's store."""
        fixed = model.replace(**{name: value.detach().cpu() for name, value in model.parameters.items()})
        # A bound that is differentiated a stretch of rows at a time asks again and again.
        key = b"".join(value.numpy().tobytes() for value in fixed.parameters.values())
        if self._known is None or self._known[0] != key:
            try:
                with diverging():
                    smoother = gaussian_smoother(fixed, self.observations, self.smoother.path)
            except Diverged:
                smoother = self.smoother
            self._known = key, smoother
        return Corrected(model, self.observations, self._known[1], name=self.name).sampled(model)
