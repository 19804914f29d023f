"""Variational sequential Monte Carlo: the bound E[log p̂(y)] of a whole particle filter, for Pyro's SVI.

Naesseth, Linderman, Ranganath & Blei (2018); Le, Igl, Rainforth, Jin & Wood (2018); Maddison et al. (2017).
p̂ is unbiased, so by Jensen's inequality

    L(θ, φ) = E[log p̂(y)] ≤ log p_θ(y),

for any guide q_φ; it is tight when p̂ has no variance. Particles are drawn as deterministic functions of
(θ, φ) and standard noise, x = μ + σ ε, so that log p̂ of one run is differentiated as it stands, but for the
ancestors, which are integers. What becomes of their part of ∇L is a choice, by ``gradient``:

| name            | what is done                                                    | gradient of L            |
|-----------------|-----------------------------------------------------------------|--------------------------|
| "dropped"       | nothing: ancestors are constants (Naesseth et al. 2018)         | biased, least variance   |
| "score"         | adds (later log p̂ − baseline) ∇ Σ log W^a of the ancestors a    | unbiased; see below      |
| "stop-gradient" | after resampling w = W^a / stop(W^a), Ścibior & Wood (2021)     | biased; E[∇p̂] = ∇p(y)    |
| "transport"     | particles moved, not chosen, Corenflos et al. (2021)            | of a p̂ that is biased    |

"stop-gradient" is the default, for it learns a model's parameters. Measured: with a bootstrap guide an autoregression
starts at −138 nats; after 300 steps it is .25 nats from its maximum, where "dropped" has drifted 6.4 nats away from it.
"dropped" is less noisy, and serves where only a guide is trained, or where the guide leaves little to resample.

"score" needs multinomial ancestors, whose probability is a product, and is unbiased where resampling does
not hang on the parameters: at every row (``ess_threshold=1``). Its baseline is the mean of the other filters.
"transport" (:mod:`.ot_resampling`) leaves no ancestors to be differentiated and costs N² a row.
Its particles are means of particles, so that p̂ is biased and the bound is none: compare models by another estimator.

Shapes: M filters × N particles, weights and evidence in float64 as in :mod:`.particle_filter`.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple, NoReturn

import torch
from pyro import poutine
from pyro.infer import ELBO
from pyro.infer.smcfilter import SMCFailed
from torch import Tensor

from invdyn.inference.contract import check_model
from invdyn.inference.filters.ot_resampling import transport
from invdyn.inference.filters.particles import take
from invdyn.inference.filters.proposal import Particles, Proposal
from invdyn.inference.filters.resampling import RESAMPLERS, check_sizes, ess
from invdyn.inference.filters.weights import ancestors_where, normalised, row_log_prob
from invdyn.inference.variational.gradient_checkpointing import recomputed
from invdyn.inference.variational.pyro_adapter import bound_to, draw, drawn_latents, state_space_model
from invdyn.models.state_space import StateSpaceModel

GRADIENTS = ("dropped", "score", "stop-gradient", "transport")


SVIModel = StateSpaceModel | Callable[..., Any]
"""A model, or its method ``sequence``."""


class _Carried(NamedTuple):
    """What one row hands to the next; evidence and scores are (M,), weights (M, N) as the next row multiplies them."""

    particles: Particles
    log_weights: Tensor
    log_evidence: Tensor
    score: Tensor
    """Σ_t s_t, with s_t the log-probability of row t's ancestors."""
    credited: Tensor
    """Σ_t s_t · (log p̂ up to row t, less the baseline): rows that those ancestors cannot have changed."""


class VSMC_ELBO(ELBO):
    """Loss for ``pyro.infer.SVI``: minus the mean over M filters of log p̂(y).

    ::

        model = model.learn(["body.length"])
        svi = SVI(model.sequence, Corrected(model, observations), Adam({"lr": 0.01}), loss=VSMC_ELBO(100))
        svi.step(observations)  # (T, O), NaN where missing

    SVI's ``model`` is the method :meth:`StateSpaceModel.sequence`, which other losses take too, or the
    :class:`StateSpaceModel` itself: its learned parameters become ``pyro.param``. Its ``guide`` is a
    :class:`Proposal`; one with a method ``sampled(model)`` (:mod:`.affine`) brings ``pyro.param`` of its own.
    Parameters with priors are drawn once an evaluation by ``guide.parameters()``, a Pyro function with sites of
    the same names, whose log p(θ)/q(θ) joins the bound; without it, from their priors, which is a weak bound.

    Args:
        num_particles: N.
        num_filters: M independent filters; more of them make the gradient less noisy, not the bound tighter.
        ess_threshold: resample a filter when its ESS falls below this share of N; in (0, 1].
        resampling: a scheme of :mod:`.resampling`; "score" needs "multinomial".
        gradient: see the table at the top; "dropped" where only a guide is trained.
        regularisation: ε of "transport", relative to the particles' scatter; small is less biased and slower.
        synchronous: whether the host looks at each row's weights, to leave out resampling where no filter needs it;
            by default on a CPU.
        chunk: rows whose graph is in memory: each stretch of them is computed a second time on the way back, and
            of the others only the first row's particles are kept. None holds all. The gradient is the same.

    Raises ValueError for values that are none of these, when made; TypeError for another model or guide, ModelError
    for a model that does not fit the observations, and SMCFailed when all particles of some filter have weight zero,
    when called.
    """

    def __init__(
        self,
        num_particles: int = 100,
        num_filters: int = 16,
        *,
        ess_threshold: float = 0.5,
        resampling: str = "systematic",
        gradient: str = "stop-gradient",
        regularisation: float = 0.5,
        synchronous: bool | None = None,
        chunk: int | None = None,
    ):
        check_sizes(num_filters, num_particles, ess_threshold)
        if chunk is not None and chunk < 1:
            raise ValueError(f"expected at least one row a chunk, got {chunk}")
        if resampling not in RESAMPLERS:
            raise ValueError(f"expected a resampling scheme among {', '.join(RESAMPLERS)}, got {resampling!r}")
        if gradient not in GRADIENTS:
            raise ValueError(f"expected a gradient among {', '.join(GRADIENTS)}, got {gradient!r}")
        if gradient == "score" and resampling != "multinomial":
            raise ValueError(f'gradient "score" needs resampling="multinomial", got {resampling!r}')
        if not regularisation > 0:
            raise ValueError(f"expected a regularisation above zero, got {regularisation}")
        super().__init__(num_particles=num_particles, max_plate_nesting=0)
        self.num_filters = num_filters
        self.ess_threshold = ess_threshold
        self.resampling = resampling
        self.gradient = gradient
        self.regularisation = regularisation
        self.synchronous = synchronous
        self.chunk = chunk

    # -- Pyro's way in -------------------------------------------------------------------------
    @torch.no_grad()
    def loss(self, model: SVIModel, guide: Proposal, observations: Tensor) -> float:
        """Minus the bound's estimate, in nats, without gradients."""
        return self.differentiable_loss(model, guide, observations).item()

    def differentiable_loss(self, model: SVIModel, guide: Proposal, observations: Tensor) -> Tensor:
        """Minus the bound's estimate, a scalar whose gradient is the chosen one."""
        return -self.log_evidence(model, guide, observations).mean()

    def loss_and_grads(self, model: SVIModel, guide: Proposal, observations: Tensor) -> float:
        """Minus the bound's estimate; adds its gradient to every parameter's ``grad``."""
        loss = self.differentiable_loss(model, guide, observations)
        if loss.requires_grad:
            loss.backward()
        return loss.item()

    def _get_trace(self, model: Any, guide: Any, args: Any, kwargs: Any) -> NoReturn:
        # Demanded by Pyro's class for losses that compare two traces; a filter's weights do without.
        raise NotImplementedError("VSMC_ELBO compares no traces; call loss, loss_and_grads or differentiable_loss")

    # -- the bound -----------------------------------------------------------------------------
    def log_evidence(self, model: SVIModel, guide: Proposal, observations: Tensor) -> Tensor:
        """Log p̂(y), (M,) float64, of the filters; the mean is the bound's estimate."""
        model = state_space_model(model)
        observations = check_model(model, observations)
        latents, ratio = drawn_latents(model, guide)
        seen = ~torch.isnan(observations)
        whole, any_seen = seen.all(-1).tolist(), seen.any(-1).tolist()

        def advance(rows: range, before: _Carried, latents: dict[str, Tensor]) -> _Carried:
            drawn = poutine.condition(model.sampled, data=latents)()
            bound = bound_to(guide, drawn)
            for t in rows:
                y = (observations[t], None if whole[t] else seen[t]) if any_seen[t] else None
                before = self._step(drawn, bound, t, y, before, last=t == len(observations) - 1)
            return before

        state = self._start(observations.device)
        every = range(len(observations))
        if self.chunk is None or not torch.is_grad_enabled():
            state = advance(every, state, latents)
        else:
            with poutine.trace(param_only=True) as params:
                bound_to(guide, poutine.condition(model.sampled, data=latents)())
            leaves = [site["value"].unconstrained() for site in params.trace.nodes.values()]
            with poutine.trace(param_only=True) as used:
                for first in every[:: self.chunk]:
                    state = _stretch(advance, every[first : first + self.chunk], state, latents, leaves)
            late = set(used.trace.nodes) - set(params.trace.nodes)
            if late:
                raise TypeError(
                    f"expected a guide that looks up its parameters in sampled(model), got {', '.join(sorted(late))} "
                    "looked up row by row; use chunk=None, or they would get no gradient"
                )
        log_evidence = state.log_evidence
        if not bool(torch.isfinite(log_evidence).all()):
            raise SMCFailed(
                "all particles of a filter have weight zero: the observations are out of the model's reach; use a "
                "larger noise scale, more particles, a smaller learning rate or a guide that starts closer"
            )
        if self.gradient == "score":
            credit = state.score * _centred(log_evidence) - state.credited
            log_evidence = log_evidence + credit - credit.detach()
        return log_evidence + ratio

    def _start(self, device: torch.device) -> _Carried:
        shape = (self.num_filters, self.num_particles)
        weights = torch.full(shape, -math.log(self.num_particles), dtype=torch.float64, device=device)
        zero = weights.new_zeros(self.num_filters)
        return _Carried({}, weights, zero, zero, zero)

    def _step(
        self,
        model: StateSpaceModel,
        guide: Proposal,
        t: int,
        y: tuple[Tensor, Tensor | None] | None,
        before: _Carried,
        last: bool,
    ) -> _Carried:
        """Draw row t, weight it by y (row, which entries were seen) and, unless it is the last, resample."""
        particles, increment = draw(guide, t, before.particles, tuple(before.log_weights.shape))
        if y is not None:
            increment = increment + row_log_prob(model.row_emission(before.particles.get("x"), particles["x"], t), *y)
        if "log_twist" in particles:
            increment = increment + particles["log_twist"] - before.particles.get("log_twist", 0.0)
        log_weights, total, _ = normalised(before.log_weights, increment)
        state = before._replace(particles=particles, log_weights=log_weights, log_evidence=before.log_evidence + total)
        return state if last else self._resampled(guide, t, state)

    def _resampled(self, guide: Proposal, t: int, state: _Carried) -> _Carried:
        fixed = state.log_weights.detach()
        need = ess(fixed) < self.ess_threshold * self.num_particles
        # Elsewhere the question would hold up the device, and the answer "none" changes nothing.
        synchronous = fixed.device.type == "cpu" if self.synchronous is None else self.synchronous
        if synchronous and not bool(need.any()):
            return state
        if self.gradient == "transport":
            return self._transported(guide, t, state, need.unsqueeze(-1))
        index = ancestors_where(need, fixed, self.resampling)
        need = need.unsqueeze(-1)
        weights = torch.full_like(fixed, -math.log(self.num_particles))
        if self.gradient != "dropped":
            chosen = state.log_weights.gather(-1, index)
            if self.gradient == "stop-gradient":
                weights = weights + chosen - chosen.detach()
            else:
                score = torch.where(need, chosen, 0.0).sum(-1)
                state = state._replace(
                    score=state.score + score, credited=state.credited + score * _centred(state.log_evidence)
                )
        return state._replace(
            particles={name: take(value, index) for name, value in state.particles.items()},
            log_weights=torch.where(need, weights, state.log_weights),
        )

    def _transported(self, guide: Proposal, t: int, state: _Carried, need: Tensor) -> _Carried:
        """Row t's particles moved to where they weigh the same, in the filters that ``need`` (M, 1) names."""
        x = transport(state.particles["x"], state.log_weights, self.regularisation)
        moved = guide.at(t, torch.where(need.unsqueeze(-1), x, state.particles["x"]))
        uniform = torch.full_like(state.log_weights, -math.log(self.num_particles))
        return state._replace(particles=moved, log_weights=torch.where(need, uniform, state.log_weights))


def _centred(log_evidence: Tensor) -> Tensor:
    """Each filter's, less the mean of the other filters'; (M,), without gradient."""
    fixed = log_evidence.detach()
    size = len(fixed)
    return fixed if size == 1 else (fixed - fixed.mean()) * (size / (size - 1))


# -- a stretch of rows whose graph is computed again on the way back ----------------------------------
Advance = Callable[[range, _Carried, dict[str, Tensor]], _Carried]


def _stretch(
    advance: Advance, rows: range, before: _Carried, latents: dict[str, Tensor], leaves: list[Tensor]
) -> _Carried:
    """``advance(rows, before, latents)`` without its graph; ``leaves`` as for :func:`.recomputed`."""
    keys: list[str] = []

    def flat(*tensors: Tensor) -> tuple[Tensor, ...]:
        carried, values = tensors[: len(tensors) - len(latents)], tensors[len(tensors) - len(latents) :]
        state = _Carried(dict(zip(before.particles, carried[4:], strict=True)), *carried[:4])
        after = advance(rows, state, dict(zip(latents, values, strict=True)))
        keys[:] = after.particles
        return after[1:] + tuple(after.particles.values())

    after = recomputed(flat, (*before[1:], *before.particles.values(), *latents.values()), leaves)
    return _Carried(dict(zip(keys, after[4:], strict=True)), *after[:4])
