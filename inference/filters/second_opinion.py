"""Whether an estimate of the evidence may be stated: its own scatter, and an independent second opinion.

That all filters agree does not make them right: if the guide that they share looks away from a mode, each misses it.
Ẑ is unbiased and positive, so by Markov's inequality

    P(Ẑ ≥ e^d Z) ≤ e^{−d}:

an estimate is hardly ever much too high, and often much too low. So a bootstrap pilot that is *higher* contradicts the
look-ahead beyond log (1/LEVEL) nats and three standard errors, however it scatters itself. One that is *lower* says
something only if it has a standing of its own, an outer ESS of at least half of its filters; a collapsed one, as in all
problems with sharp observations, says nothing.

The outer ESS itself is estimated from these filters, and looks well where none of them has reached the tail that the
mean lives on. If log Ẑ is normal with variance s², as it is of many particles, the ESS is M e^{−s²}: so s, which needs
no tail, has to agree. It is the rms above the median, which a few filters far from the observations do not move.

The standard error of log Ẑ from M filters is sd(Ẑ)/(√M mean Ẑ). With an outer ESS under two one filter carries more
than half of the estimate, and no error can be had from it: it is NaN.

Shapes: log-evidences (M,).
"""

import math
from dataclasses import dataclass, replace

from torch import Tensor

from invdyn.inference.filters.nested import OuterWeights, outer_weights

MIN_SHARE, MIN_FILTERS = 0.25, 4.0
"""Outer ESS under which an evidence is not stated, as a share of the filters: where log Ẑ is normal with an sd of 1.2,
up to which its standard error holds. And filters that it takes at least, if there are twice as many."""

MIN_FILTERS_FOR_SD = 16
"""Filters whose standard deviation tells something."""

LEVEL = 0.01
"""Probability, at most, with which a right estimate is contradicted by a higher one without standing."""

ERRORS, SLACK = 3.0, 1.0
"""Standard errors by which estimates may differ; and nats more for a lower one, as unbiased estimates are skewed."""

CLOSE_ERROR = 0.15
"""Nats: an error under which no mode of two goes unseen, that would cost log 2."""


@dataclass(frozen=True)
class Evidence:
    """An estimate of log p(y), and whether it may be used.

    Attributes:
        log_evidence: nats.
        sd: its Monte Carlo standard error; NaN where there is none.
        outer_ess: effective number of filters.
        filters: their number.
        usable: whether it stands.
        reason: why not, in a line; "" if it does.
        contradicted: how another guide contradicts it; "" if none does.
        guide: "controlled", "defended" or "bootstrap".
        filter_sd: sd of log Ẑ over filters, above their median.
    """

    log_evidence: float
    sd: float
    outer_ess: float
    filters: int
    usable: bool
    reason: str
    guide: str
    contradicted: str = ""
    filter_sd: float = 0.0

    @property
    def standing(self) -> bool:
        """Whether at least half of the filters carry the estimate."""
        return self.filters > 1 and self.outer_ess >= self.filters / 2

    def __str__(self) -> str:
        return f"{self.log_evidence:.1f} ± {self.sd:.2f}" if self.sd == self.sd else f"{self.log_evidence:.1f}"


def evidence(log_evidence: Tensor | OuterWeights, guide: str, pilot: Evidence | None = None) -> Evidence:
    """Evidence of filters' log-evidences (M,), doubted by their own scatter and by the ``pilot`` of another guide."""
    outer = outer_weights(log_evidence) if isinstance(log_evidence, Tensor) else log_evidence
    filters = len(outer.log_weights)
    scatter = _sd_above_median(outer.log_weights)
    found = Evidence(outer.log_evidence, outer.log_evidence_sd, outer.ess, filters, True, "", guide, filter_sd=scatter)
    contradicted = "" if pilot is None else contradiction(found, pilot)
    reason = contradicted or scatter_doubt(found)
    return replace(found, usable=not reason, reason=reason, contradicted=contradicted)


def scatter_doubt(found: Evidence, unit: str = "filter") -> str:
    """Why the scatter of the filters, or independent runs, themselves forbids the estimate; "" if it does not."""
    floor = max(MIN_SHARE * found.filters, min(MIN_FILTERS, found.filters / 2), 1.5)
    if not math.isfinite(found.log_evidence):
        return f"all weights of the {unit}s are zero"
    if found.filters == 1:
        return f"one {unit} gives no standard error: use at least two"
    if found.outer_ess < floor:
        return (
            f"outer effective sample size {found.outer_ess:.1f} of {found.filters} {unit}s is under {floor:g}: "
            "use more particles"
        )
    widest = math.sqrt(-math.log(MIN_SHARE))
    if found.filters >= MIN_FILTERS_FOR_SD and found.filter_sd > widest:
        return (
            f"the {unit}s' log-evidences have a standard deviation of {found.filter_sd:.1f}, over {widest:.1f}, up to "
            "which an error can be stated: use more particles"
        )
    return ""


def _sd_above_median(values: Tensor) -> float:
    above = (values - values.median()).clamp_min(0)
    return float((2 * above.square().mean()).sqrt())


def exceeds(other: Evidence, found: Evidence) -> bool:
    """Whether ``other`` is higher than ``found`` beyond errors and, without a standing of its own, beyond luck."""
    luck = 0.0 if other.standing else -math.log(LEVEL)
    return other.log_evidence - found.log_evidence > ERRORS * _joint_sd(found, other) + luck


def confirms(other: Evidence, found: Evidence) -> bool:
    """Whether ``other`` has a standing, and equals ``found`` within errors that are below ``CLOSE_ERROR``."""
    error = _joint_sd(found, other)
    return (
        other.standing and error < CLOSE_ERROR and abs(other.log_evidence - found.log_evidence) <= ERRORS * error + 1e-3
    )


def contradiction(found: Evidence, pilot: Evidence) -> str:
    """How ``pilot``, by another guide, contradicts ``found``; "" if it does not."""
    gap = found.log_evidence - pilot.log_evidence
    lower = pilot.standing and gap > ERRORS * _joint_sd(found, pilot) + SLACK
    if not lower and not exceeds(pilot, found):
        return ""
    return (
        f"the {found.guide} guide estimates {found}, the {pilot.guide} guide {pilot}: they disagree beyond their "
        "errors; use more particles"
    )


def approximation_doubt(log_evidence: float, pilot: Evidence | None) -> str:
    """Why an approximation of the evidence may not be used: the ``pilot`` is elsewhere; "" if it is not.

    A linearised model may be a nat off where it is right, and is far off in a wrong mode.
    """
    if pilot is None:
        return ""
    found = Evidence(log_evidence, 0.0, math.nan, 0, True, "", "linearised")
    error = ERRORS * _joint_sd(found, pilot) + SLACK
    apart = (pilot.standing or pilot.usable) and abs(log_evidence - pilot.log_evidence) > error
    if not apart and not exceeds(pilot, replace(found, log_evidence=log_evidence + SLACK)):
        return ""
    return f"the linearised model has log evidence {log_evidence:.1f}, a {pilot.guide} filter {pilot}: use smc"


def linearisation_doubt(log_evidence: float, bootstrap: Evidence | None, ahead: Evidence | None) -> str:
    """Why the evidence of a linearised model may not be used; "" if it may.

    Two pilots give a second opinion: ``bootstrap`` filters, which see any mode, and filters that the linearised model
    guides, ``ahead``, whose error is small where it is a good one. These have to confirm it.
    """
    if doubt := approximation_doubt(log_evidence, bootstrap):
        return doubt
    if ahead is None or not ahead.usable:
        why = "they collapse" if ahead is None else ahead.reason.partition(":")[0]
        return f"filters that the linearised model guides do not confirm it ({why}): use smc"
    return approximation_doubt(log_evidence, ahead)


def bound_doubt(bound: float, states: int, pilot: Evidence | None) -> str:
    """Why the posterior of a lower bound on log p(y) may not be used, a q over so many numbers; "" if it may.

    The gap is KL(q ‖ p): half a nat a number if q is the Gaussian posterior, off by one standard deviation in each.
    """
    if pilot is None:
        return ""
    found = Evidence(bound + states / 2, 0.0, math.nan, 0, True, "", "variational")
    if not exceeds(pilot, found):
        return ""
    return (
        f"the bound is {bound:.1f}, a bootstrap filter estimates {pilot}: its posterior is further off than by one "
        "standard deviation in each state; use smc"
    )


def _joint_sd(found: Evidence, other: Evidence) -> float:
    """Of a difference; an estimate without an error of its own, which one filter carries, adds none."""
    return math.hypot(*(0.0 if math.isnan(each.sd) else each.sd for each in (found, other)))
