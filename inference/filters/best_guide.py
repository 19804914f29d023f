"""Which guide to filter with, chosen by the evidence of pilot runs.

Ẑ is unbiased for any guide, and a guide that misses a part of the posterior leaves it low: of guides, the one
with the higher log Ẑ sees more (:mod:`.second_opinion`). The look-ahead is taken where its own filters agree and a
bootstrap pilot does not contradict it, as in problems with sharp observations, where the bootstrap collapses; for a
model without a start of its own, only if a pilot of the defended look-ahead (:mod:`.defended`), which gives up no mode,
confirms it closely. Else the defended look-ahead and the bootstrap filter stand for it, and

    of those that no other exceeds beyond errors, the one that needs the fewest particles is taken,

or the bootstrap, if the look-ahead and the defended one disagree and the bootstrap is within reach: guides of one ψ may
miss the same mode. If it is not, and its pilot has no standing, no run is usable. A guide has as many particles as
bring the variance of log Ẑ to ``VARIANCE``, up to ``MAX_FACTOR`` times those of the options: one that sees less of what
is to come needs more of them. The look-ahead that stands uncontradicted has those of the options.

A model without a Gaussian approximation (a discrete or bounded state, no variance), or one that cannot be linearised,
has the bootstrap guide alone.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from pyro.infer.smcfilter import SMCFailed
from torch import Tensor

from invdyn.inference.execution.seeds import derived, seeded
from invdyn.inference.filters.filtering import PILOT_PARTICLE_STEPS, SMCOptions, adapted, run_filters
from invdyn.inference.filters.moment_matching import exact_closed_form, moment_matched
from invdyn.inference.filters.particle_filter import ParticleFilter
from invdyn.inference.filters.particles import FilterResult
from invdyn.inference.filters.second_opinion import Evidence, confirms, evidence, exceeds
from invdyn.inference.smoothing.gauss_newton import GaussianSmoother
from invdyn.inference.smoothing.linearisation import Linearisation, SeenRows
from invdyn.inference.smoothing.square_root import BackwardFactors
from invdyn.models.divergence import Diverged, Singular, diverging
from invdyn.models.state_space import StateSpaceModel
from invdyn.recordings.errors import first_line

PILOT_FILTERS = 16
"""Filters of a bootstrap pilot. That of a model without a start of its own has as many particles in all as the run."""

MAX_PILOT_SD = 30.0
"""Standard deviation of log Ẑ over filters, in nats, after which a pilot can come to no agreement."""

VARIANCE = 0.5
"""Of log Ẑ over filters, at which its mean over 64 has next to no skew."""

UNCONFIRMED = "guides that look ahead disagree, and no bootstrap pilot is steady enough to decide: use more particles"

BOOTSTRAP_FACTOR = 4
"""Times the particles that it may have which a bootstrap may need, to stand for guides that disagree."""

MAX_FACTOR, RUN_PARTICLE_STEPS = 16, 2e7
"""Times the particles of the options that a guide may take, and steps of all particles of its filters at most."""


class Pilot(ParticleFilter):
    """Filters that give up where their log-evidences differ by ``MAX_PILOT_SD``: a collapsed pilot says nothing."""

    def _alive(self, totals: Tensor, first: int, states: Tensor | None = None) -> None:
        super()._alive(totals, first, states)
        if bool(self.log_evidence.std() > MAX_PILOT_SD):
            raise SMCFailed(f"the pilot's filters have collapsed by row {first}")


@dataclass(frozen=True)
class Guide:
    """What filters are guided by.

    Attributes:
        name: "controlled", "defended" or "bootstrap", as :func:`.filtering.run_filters` takes it.
        smoother: whose factors guide; None for "bootstrap".
        num_particles: N that a filter needs.
        opinion: log-evidences (M,) of a bootstrap pilot; None where it failed, or is no other guide.
        reason: why the look-ahead is not used, in a line; "" if it is.
        doubt: why no run by this guide may be believed; "" if one may.
        expected: evidence of its pilot, with the scatter to expect where no run may have more particles; or None.
    """

    name: str
    smoother: GaussianSmoother | None
    num_particles: int
    opinion: Tensor | None = None
    reason: str = ""
    doubt: str = ""
    expected: Evidence | None = None

    def judged(self, log_evidence: Tensor) -> Evidence:
        """Evidence of filters (M,) that this guide steered, doubted by the pilot's."""
        pilot = None if self.opinion is None else evidence(self.opinion, "bootstrap")
        found = evidence(log_evidence, self.name, pilot)
        if self.doubt and found.usable:
            return replace(found, usable=False, reason=self.doubt, contradicted=self.doubt)
        return found


RECORDS = (Guide, Evidence, GaussianSmoother, BackwardFactors, Linearisation, SeenRows)
"""Dataclasses that a guide consists of, for a checkpoint."""


@dataclass(frozen=True)
class _Pilot:
    name: str
    log_evidence: Tensor
    num_particles: int

    @property
    def found(self) -> Evidence:
        return evidence(self.log_evidence, self.name)

    @property
    def needed(self) -> float:
        """Particles for a variance of log Ẑ of ``VARIANCE``, which falls with their number."""
        return self.num_particles * self.found.filter_sd**2 / VARIANCE

    def expected(self, particles: int) -> Evidence:
        """Evidence of as many filters of so many ``particles`` each."""
        sd = self.found.filter_sd * math.sqrt(self.num_particles / particles)
        return replace(self.found, filter_sd=sd, outer_ess=self.found.filters * math.exp(-(sd**2)))


def best_guide(
    model: StateSpaceModel,
    observations: Tensor,
    options: SMCOptions | None = None,
    seed: int | None = None,
    start: Tensor | None = None,
) -> Guide:
    """Return the guide for ``model`` on ``observations`` (T, O), NaN where missing.

    Args:
        model: any.
        observations: of it.
        options: sizes of the run that the guide is for.
        seed: of the pilots; torch's own generator continues where it was. None takes its state, and moves it.
        start: path (T, D) to linearise at first.
    """
    options = options or SMCOptions()
    if seed is not None:
        with seeded(seed, options.device):
            return best_guide(model, observations, options, start=start)
    # Without a start of the model's own, the pilot's particles tell where its modes may be.
    searched = start is None and not has_own_start(model)
    opinion, blind = _blind(model, observations, options) if searched else (None, None)
    pilot_size, steps = min(options.num_particles, 100), model.steps_per_row * len(observations)
    try:
        with diverging():
            like = moment_matched(model)
            smoother, log_evidence = adapted(model, observations, options, start, blind)
            name = "controlled" if exact_closed_form(like, smoother.path) and like is model else "defended"
            if log_evidence is None:
                pilot_size = options.num_particles
                log_evidence = run_filters(model, observations, _few(options), smoother=smoother, keep=0).log_evidence
    # A model of one's own may raise anything at the states of a linearisation: outside of a support, of a domain.
    except (TypeError, ValueError, NotImplementedError, AttributeError, Diverged, SMCFailed) as error:
        few = _affordable(opinion, options, steps)
        return Guide("bootstrap", None, few, reason=first_line(error))
    if not searched:
        opinion, _ = _blind(model, observations, options, keep=0)
    ahead = _Pilot(name, log_evidence, pilot_size)
    size, doubt = options.num_particles, ""
    doubted = not ahead.found.standing or (opinion is not None and exceeds(opinion.found, ahead.found))
    if searched or doubted:
        defended = [] if name == "defended" else _defended(model, observations, options, smoother)
        confirmed = not doubted and all(confirms(each.found, ahead.found) for each in defended)
        if not confirmed:
            rivals = [*defended, *([] if opinion is None else [opinion])]
            # Where a model has no start of its own, any mode may have been missed.
            own = [] if rivals and searched and name == "controlled" else [ahead]
            ahead = _chosen(rivals + own)
            # Guides of one ψ that disagree tell of modes that ψ may miss: filters then agree on what they all miss.
            if own == [] and opinion is not None:
                if opinion.needed < BOOTSTRAP_FACTOR * _most(options, steps):
                    ahead = opinion
                elif ahead is not opinion and not opinion.found.standing:
                    doubt = UNCONFIRMED
            size = _affordable(ahead, options, steps)
    if ahead.name == "bootstrap":
        reason = f"the {name} guide misses a part of the posterior, or is less steady"
        return Guide("bootstrap", None, size, reason=reason)
    seen = None if opinion is None else opinion.log_evidence
    expected = ahead.expected(size) if size >= _most(options, steps) else None
    return Guide(ahead.name, smoother, size, seen, doubt=doubt, expected=expected)


def guides_agree(model: StateSpaceModel, observations: Tensor, options: SMCOptions, seed: int, ahead: Evidence) -> bool:
    """Whether filters that look ahead, of evidence ``ahead``, agree, and no bootstrap pilot of ``seed`` is higher."""
    if not ahead.standing:
        return False
    blind = _blind_opinion(model, observations, options, seed)
    return blind is None or not exceeds(blind, ahead)


def has_own_start(model: StateSpaceModel) -> bool:
    """Whether a model says where its paths may lie, so that a linearisation starts near the posterior."""
    return type(model).initial_paths is not StateSpaceModel.initial_paths


BLIND, LOOK_AHEAD = 1, 2
"""Places of the random numbers of second opinions in those of a run (:func:`.seeds.derived`)."""


def second_opinion(
    model: StateSpaceModel, observations: Tensor, options: SMCOptions, seed: int, start: Tensor | None = None
) -> Evidence | None:
    """Evidence of a bootstrap pilot of the run of ``seed``, where a linearisation may end in a wrong mode.

    None where the pilot collapses, and where a ``start`` or one of the model's own is near the posterior.
    """
    return None if start is not None or has_own_start(model) else _blind_opinion(model, observations, options, seed)


def _blind_opinion(model: StateSpaceModel, observations: Tensor, options: SMCOptions, seed: int) -> Evidence | None:
    with seeded(derived(seed, BLIND), options.device):
        pilot, _ = _blind(model, observations, options, keep=0)
    return None if pilot is None else pilot.found


def look_ahead_opinion(
    model: StateSpaceModel, observations: Tensor, options: SMCOptions, seed: int, smoother: GaussianSmoother
) -> Evidence | None:
    """Evidence of a few defended filters that a smoother guides, of the run of ``seed``.

    They are weighed by the model's own densities, so that they are unbiased where the smoother's model is not exact.
    None where they collapse.
    """
    with seeded(derived(seed, LOOK_AHEAD), options.device):
        pilots = _defended(model, observations, options, smoother)
    return pilots[0].found if pilots else None


def _chosen(pilots: Sequence[_Pilot]) -> _Pilot:
    highest = max(pilots, key=lambda pilot: pilot.found.log_evidence)
    level = [pilot for pilot in pilots if pilot is highest or not exceeds(highest.found, pilot.found)]
    return min(level, key=lambda pilot: pilot.needed)


def _affordable(pilot: _Pilot | None, options: SMCOptions, steps: float) -> int:
    """Particles that the guide of ``pilot`` needs, within bounds."""
    most = _most(options, steps)
    if pilot is None or not pilot.needed < most:
        return most
    return max(options.num_particles, math.ceil(pilot.needed))


def _most(options: SMCOptions, steps: float) -> int:
    """Particles of a filter at most, each of which takes so many steps along a recording."""
    room = int(RUN_PARTICLE_STEPS / (options.num_filters * steps))
    return max(options.num_particles, min(MAX_FACTOR * options.num_particles, room))


def _blind(
    model: StateSpaceModel, observations: Tensor, options: SMCOptions, keep: int | None = None
) -> tuple[_Pilot | None, FilterResult | None]:
    """A bootstrap run of a few filters; where it is kept, with as many particles in all, or as memory has room for."""
    filters = max(2, min(options.num_filters, PILOT_FILTERS))
    size = options.num_particles
    if keep is None:
        room = min(options.num_filters * size, int(PILOT_PARTICLE_STEPS / len(observations)))
        size = max(room // filters, 2)
    few = replace(options, num_filters=filters, num_particles=size)
    kind = ParticleFilter if keep is None else Pilot
    try:
        result = run_filters(model, observations, few, guide="bootstrap", keep=keep, kind=kind).cpu()
    except SMCFailed:
        return None, None
    return _Pilot("bootstrap", result.log_evidence, size), result


def _defended(
    model: StateSpaceModel, observations: Tensor, options: SMCOptions, smoother: GaussianSmoother
) -> list[_Pilot]:
    try:
        with diverging():
            result = run_filters(model, observations, _few(options), guide="defended", smoother=smoother, keep=0)
    except (SMCFailed, Singular):
        return []
    return [_Pilot("defended", result.log_evidence.cpu(), options.num_particles)]


def _few(options: SMCOptions) -> SMCOptions:
    return replace(options, num_filters=max(2, min(options.num_filters, PILOT_FILTERS)))
