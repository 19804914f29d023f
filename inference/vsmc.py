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

"score" needs multinomial ancestors, whose probability is a product, and is unbiased where resampling does
not hang on the parameters: at every row (``ess_threshold=1``). Its baseline is the mean of the other filters.
Optimal-transport and soft resampling are left out: the first costs N² and biases p̂ itself.

Shapes: M filters × N particles, weights and evidence in float64 as in :mod:`.particle_filter`.
"""

import copy
import math
from collections.abc import Callable
from typing import NamedTuple

import torch
from pyro import poutine
from pyro.infer import ELBO
from pyro.infer.smcfilter import SMCFailed
from torch import Tensor

from invdyn.inference.particles import take
from invdyn.inference.proposal import Particles, Proposal
from invdyn.inference.resampling import RESAMPLERS, ess, resample
from invdyn.models.missing import observed_log_prob
from invdyn.models.state_space import StateSpaceModel

GRADIENTS = ("dropped", "score", "stop-gradient")


class _Carried(NamedTuple):
    """What one row hands to the next; evidence and scores are (M,), weights (M, N) normalised."""

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
    the same names, whose log p(θ)/q(θ) joins the bound; without it, from their priors, which is a loose bound.

    Args:
        num_particles: N.
        num_filters: M independent filters; more of them make the gradient less noisy, not the bound tighter.
        ess_threshold: resample a filter when its ESS falls below this share of N; in (0, 1].
        resampling: a scheme of :mod:`.resampling`; "score" needs "multinomial".
        gradient: see the table at the top.
        chunk: rows whose graph is held at once: each stretch of them is computed a second time on the way back, and
            of the others only the first row's particles are kept. None holds all. The gradient is the same.

    Raises ValueError for values that are none of these, when made; TypeError for another model or guide, and
    SMCFailed when all particles of some filter have weight zero, when called.
    """

    def __init__(
        self,
        num_particles: int = 100,
        num_filters: int = 16,
        *,
        ess_threshold: float = 0.5,
        resampling: str = "systematic",
        gradient: str = "dropped",
        chunk: int | None = None,
    ):
        if num_particles < 1 or num_filters < 1 or (chunk is not None and chunk < 1):
            raise ValueError("expected at least one particle, one filter and, if given, one row a chunk")
        if not 0 < ess_threshold <= 1:
            raise ValueError(f"expected an ess_threshold in (0, 1], got {ess_threshold}")
        if resampling not in RESAMPLERS:
            raise ValueError(f"expected a resampling scheme among {', '.join(RESAMPLERS)}, got {resampling!r}")
        if gradient not in GRADIENTS:
            raise ValueError(f"expected a gradient among {', '.join(GRADIENTS)}, got {gradient!r}")
        if gradient == "score" and resampling != "multinomial":
            raise ValueError(f'gradient "score" needs resampling="multinomial", got {resampling!r}')
        super().__init__(num_particles=num_particles, max_plate_nesting=0)
        self.num_filters = num_filters
        self.ess_threshold = ess_threshold
        self.resampling = resampling
        self.gradient = gradient
        self.chunk = chunk

    # -- Pyro's way in -------------------------------------------------------------------------
    @torch.no_grad()
    def loss(self, model, guide: Proposal, observations: Tensor) -> float:
        """Minus the bound's estimate, in nats, without gradients."""
        return self.differentiable_loss(model, guide, observations).item()

    def differentiable_loss(self, model, guide: Proposal, observations: Tensor) -> Tensor:
        """Minus the bound's estimate, a scalar whose gradient is the chosen one."""
        return -self.log_evidence(model, guide, observations).mean()

    def loss_and_grads(self, model, guide: Proposal, observations: Tensor) -> float:
        """Minus the bound's estimate; adds its gradient to every parameter's ``grad``."""
        loss = self.differentiable_loss(model, guide, observations)
        if loss.requires_grad:
            loss.backward()
        return loss.item()

    def _get_trace(self, model, guide, args, kwargs):
        # Demanded by Pyro's class for losses that compare two traces; a filter's weights do without.
        raise NotImplementedError("VSMC_ELBO compares no traces; call loss, loss_and_grads or differentiable_loss")

    # -- the bound -----------------------------------------------------------------------------
    def log_evidence(self, model, guide: Proposal, observations: Tensor) -> Tensor:
        """Log p̂(y), (M,) float64, of the filters; the mean is the bound's estimate."""
        model = _state_space_model(model)
        latents, ratio = _latents(model, guide)
        seen = (~torch.isnan(observations)).any(-1).tolist()

        def advance(rows: range, before: _Carried, latents: dict[str, Tensor]) -> _Carried:
            drawn = poutine.condition(model.sampled, data=latents)()
            bound = _bound_to(guide, drawn)
            for t in rows:
                y = observations[t] if seen[t] else None
                before = self._step(drawn, bound, t, y, before, last=t == len(observations) - 1)
            return before

        state = self._start(observations.device)
        every = range(len(observations))
        if self.chunk is None or not torch.is_grad_enabled():
            state = advance(every, state, latents)
        else:
            with poutine.trace(param_only=True) as params:
                _bound_to(guide, poutine.condition(model.sampled, data=latents)())
            leaves = [site["value"].unconstrained() for site in params.trace.nodes.values()]
            with poutine.trace(param_only=True) as used:
                for first in every[:: self.chunk]:
                    state = _recomputed(advance, every[first : first + self.chunk], state, latents, leaves)
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
        self, model: StateSpaceModel, guide: Proposal, t: int, y: Tensor | None, before: _Carried, last: bool
    ) -> _Carried:
        """Draw row t, weight it and, unless it is the last, resample."""
        particles, increment = _draw(guide, t, before.particles, tuple(before.log_weights.shape))
        if y is not None:
            increment = increment + observed_log_prob(model.emission(particles["x"], t), y)
        if "log_twist" in particles:
            increment = increment + particles["log_twist"] - before.particles.get("log_twist", 0.0)
        log_weights = before.log_weights + increment.double()
        log_weights = torch.where(torch.isnan(log_weights), -torch.inf, log_weights)
        total = log_weights.logsumexp(-1)
        state = before._replace(
            particles=particles,
            log_weights=log_weights - total.unsqueeze(-1),
            log_evidence=before.log_evidence + total,
        )
        return state if last else self._resampled(state)

    def _resampled(self, state: _Carried) -> _Carried:
        fixed = state.log_weights.detach()
        need = ess(fixed) < self.ess_threshold * self.num_particles
        # Elsewhere the question would hold up the device, and the answer "none" changes nothing.
        if fixed.device.type == "cpu" and not bool(need.any()):
            return state
        need = need.unsqueeze(-1)
        identity = torch.arange(self.num_particles, device=fixed.device).expand_as(fixed)
        index = torch.where(need, resample(fixed, self.resampling), identity)
        uniform = torch.full_like(fixed, -math.log(self.num_particles))
        if self.gradient != "dropped":
            chosen = state.log_weights.gather(-1, index)
            if self.gradient == "stop-gradient":
                uniform = uniform + chosen - chosen.detach()
            else:
                score = torch.where(need, chosen, 0.0).sum(-1)
                state = state._replace(
                    score=state.score + score, credited=state.credited + score * _centred(state.log_evidence)
                )
        return state._replace(
            particles={name: take(value, index) for name, value in state.particles.items()},
            log_weights=torch.where(need, uniform, state.log_weights),
        )


def _draw(guide: Proposal, t: int, particles: Particles, shape: tuple[int, ...]) -> tuple[Particles, Tensor]:
    """Row t's particles, differentiable in all parameters, and log p(x_t | x_{t−1})/q(x_t)."""
    if getattr(guide, "reparameterised", False):
        return guide.propose_initial(shape) if t == 0 else guide.propose(t, particles)
    if t == 0:
        before, proposal = guide.model.initial(), guide.conditional_initial().expand(torch.Size(shape))
    else:
        before, proposal = guide.model.transition(particles["x"], t), guide.conditional(t, particles["x"])
    if not proposal.has_rsample:
        raise TypeError(f"expected a guide with reparameterised draws (rsample), got {proposal} at row {t}")
    x = proposal.rsample()
    drawn = {"x": x}
    if hasattr(guide, "log_twist"):
        drawn["log_twist"] = guide.log_twist(drawn, t)
    return drawn, before.log_prob(x) - proposal.log_prob(x)


def _state_space_model(model) -> StateSpaceModel:
    owner = getattr(model, "__self__", model)
    if not isinstance(owner, StateSpaceModel) or (owner is not model and model.__name__ != "sequence"):
        raise TypeError(f"expected a StateSpaceModel or its method sequence as SVI's model, got {model!r}")
    return owner


def _latents(model: StateSpaceModel, guide: Proposal) -> tuple[dict[str, Tensor], Tensor | float]:
    """Values of the sites of parameters with priors, and log p(θ)/q(θ) of those that the guide draws."""
    draw = getattr(guide, "parameters", None)
    drawn = poutine.trace(draw).get_trace() if draw else poutine.Trace()
    trace = poutine.trace(poutine.replay(model.sampled, trace=drawn)).get_trace()
    latents = {name: trace.nodes[name]["value"] for name in trace.stochastic_nodes}
    if not draw:
        return latents, 0.0
    trace.compute_log_prob(lambda name, site: name in drawn.stochastic_nodes)
    ratio = sum(trace.nodes[name]["log_prob_sum"] for name in drawn.stochastic_nodes) - drawn.log_prob_sum()
    return latents, ratio


def _bound_to(guide: Proposal, model: StateSpaceModel) -> Proposal:
    """The guide of this model, its own parameters looked up in Pyro's store."""
    if not isinstance(guide, Proposal):
        raise TypeError(f"expected a Proposal as SVI's guide, got {type(guide).__name__}")
    if hasattr(guide, "sampled"):
        return guide.sampled(model)
    guide = copy.copy(guide)
    guide.model = model
    return guide


def _centred(log_evidence: Tensor) -> Tensor:
    """Each filter's, less the mean of the other filters'; (M,), without gradient."""
    fixed = log_evidence.detach()
    size = len(fixed)
    return fixed if size == 1 else (fixed - fixed.mean()) * (size / (size - 1))


# -- a stretch of rows whose graph is made anew on the way back ----------------------------------
Advance = Callable[[range, _Carried, dict[str, Tensor]], _Carried]


def _recomputed(
    advance: Advance, rows: range, before: _Carried, latents: dict[str, Tensor], leaves: list[Tensor]
) -> _Carried:
    """``advance(rows, before, latents)``, keeping no graph of it.

    ``leaves`` are the tensors that require gradients and that ``advance`` finds by itself, in Pyro's store.
    :func:`torch.utils.checkpoint.checkpoint` keeps the nodes of the graph, if not their tensors: with small
    particles that is most of the memory, and its hooks double the time.
    """
    keys: list[str] = []

    def flat(*tensors: Tensor) -> tuple[Tensor, ...]:
        carried, values = tensors[: len(tensors) - len(latents)], tensors[len(tensors) - len(latents) :]
        state = _Carried(dict(zip(before.particles, carried[4:], strict=True)), *carried[:4])
        after = advance(rows, state, dict(zip(latents, values, strict=True)))
        keys[:] = after.particles
        return after[1:] + tuple(after.particles.values())

    inputs = (*before[1:], *before.particles.values(), *latents.values())
    after = _Stretch.apply(flat, len(leaves), *leaves, *inputs)
    return _Carried(dict(zip(keys, after[4:], strict=True)), *after[:4])


class _Stretch(torch.autograd.Function):
    """Outputs of a function without its graph; backward calls it again, with the same random numbers."""

    @staticmethod
    def forward(ctx, function, num_leaves: int, *tensors: Tensor):
        ctx.function, ctx.leaves = function, tensors[:num_leaves]
        ctx.save_for_backward(*tensors[num_leaves:])
        ctx.random = torch.get_rng_state()
        ctx.device = next((tensor.device for tensor in tensors if tensor.is_cuda), None)
        ctx.device_random = None if ctx.device is None else torch.cuda.get_rng_state(ctx.device)
        # Views, since what went in unchanged must not come out as the same tensor.
        return tuple(value.view_as(value) for value in function(*tensors[num_leaves:]))

    @staticmethod
    def backward(ctx, *gradients: Tensor):
        inputs = [tensor.detach().requires_grad_() for tensor in ctx.saved_tensors]
        with torch.random.fork_rng(devices=[] if ctx.device is None else [ctx.device]), torch.enable_grad():
            torch.set_rng_state(ctx.random)
            if ctx.device is not None:
                torch.cuda.set_rng_state(ctx.device_random, ctx.device)
            outputs = ctx.function(*inputs)
        pairs = [pair for pair in zip(outputs, gradients, strict=True) if pair[0].requires_grad]
        values, gradients = zip(*pairs, strict=True)
        found = torch.autograd.grad(values, [*ctx.leaves, *inputs], gradients, allow_unused=True)
        return None, None, *found
