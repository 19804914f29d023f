"""NUTS over the whole path of a state-space model.

Hoffman & Gelman (2014), "The No-U-Turn Sampler". The path is written through standard normals, non-centred,
by the Gaussian smoother's chain (:class:`.gaussian_chain.GaussianChain`), x = path(ε): near ε ~ N(0, I)
where the posterior is nearly Gaussian, however stiff the dynamics, so that steps of order one fit all
coordinates. Its target is exact: log p(x(ε), y), as the map's Jacobian is constant.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import pyro
import torch
from pyro.distributions import Normal
from pyro.infer import MCMC, NUTS
from torch import Tensor

from invdyn.inference.execution.progress import Report
from invdyn.inference.execution.seeds import derived
from invdyn.inference.smoothing.gaussian_chain import GaussianChain
from invdyn.models import StateSpaceModel


class RecordedNUTS(NUTS):
    """NUTS that keeps each transition's energy, log-density and divergence, which ``az.plot_energy`` draws.

    The energy is the Hamiltonian at the start of a trajectory, with the fresh momentum (Betancourt 2016).
    """

    def setup(self, warmup_steps: int, *args: Any, **kwargs: Any) -> None:
        """Begin a chain."""
        self._fresh: Tensor | None = None
        super().setup(warmup_steps, *args, **kwargs)
        self.statistics: dict[str, list[float]] = {"energy": [], "lp": [], "diverging": []}

    def sample(self, params: dict[str, Tensor]) -> dict[str, Tensor]:
        """Take one step; those of the warm-up are not kept."""
        potential = self._fetch_from_cache()[1]
        if potential is None:
            potential = self.potential_fn(params)
        self._fresh = None
        known = len(self._divergences)

        drawn = super().sample(params)

        if self._t > self._warmup_steps and self._fresh is not None:
            self.statistics["energy"].append(float(potential + self._fresh))
            self.statistics["lp"].append(-float(self._fetch_from_cache()[1]))
            self.statistics["diverging"].append(len(self._divergences) > known)
        return drawn

    def _kinetic_energy(self, r_unscaled: dict[str, Tensor]) -> Tensor:
        energy = super()._kinetic_energy(r_unscaled)
        if self._fresh is None:  # the first of a step is that of the fresh momentum
            self._fresh = energy
        return energy


def whitened_model(model: StateSpaceModel, observations: Tensor, chain: GaussianChain) -> Callable[[], None]:
    """The Pyro model whose site "noise" (T, D) makes the path, distributed as p(x, y)."""

    def noise_to_path() -> None:
        noise = pyro.sample("noise", Normal(torch.zeros_like(chain.loc), 1.0).to_event(2))
        # In place of the standard normal's own density.
        pyro.factor("ratio", model.log_joint(chain.path(noise), observations) + 0.5 * noise.square().sum())

    return noise_to_path


def sample_paths(
    model: StateSpaceModel,
    observations: Tensor,
    whitening: GaussianChain,
    *,
    chains: int,
    draws: int,
    warmup: int,
    seed: int = 0,
    progress: Report | None = None,
) -> tuple[Tensor, dict[str, np.ndarray]]:
    """Paths (C, S, T, D) of ``chains`` chains of ``draws`` draws, and energy, lp and diverging (C, S) of each.

    Args:
        model: in float64, its parameters known.
        observations: (T, O), NaN where missing.
        whitening: the chain whose innovations are sampled, near the posterior.
        chains, draws, warmup: chains, started apart from one another, and steps of each that are kept and thrown away.
        seed: of torch's global generator, which the chains set, each its own.
        progress: called with (steps done, steps) of all chains.
    """
    target = whitened_model(model, observations, whitening)
    paths, kept, done = [], [], 0

    def report(*_: object) -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, chains * (warmup + draws))

    for number in range(chains):
        # Each chain begins at a draw from the smoother, twice as wide: R-hat can tell.
        torch.manual_seed(derived(seed, number))
        begin = {"noise": 2 * torch.randn(whitening.loc.shape, dtype=torch.float64)}
        kernel = RecordedNUTS(target, max_tree_depth=8)
        sampler = MCMC(
            kernel,
            num_samples=draws,
            warmup_steps=warmup,
            initial_params=begin,
            hook_fn=report,
            disable_progbar=True,
        )
        sampler.run()
        paths.append(whitening.path(sampler.get_samples()["noise"]))
        kept.append(kernel.statistics)
    return torch.stack(paths), {name: np.array([each[name] for each in kept]) for name in kept[0]}
