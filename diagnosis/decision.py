"""The decision rule: the numbers that turn evidence into what a diagnosis says, in one place.

The model's own stand with the model: priors of effects and their bounds (:mod:`.problem.unknowns`), what values a name
means (:meth:`Effect.credible`), sizes of the residual (:mod:`.sensitivity.whiten`). So do those of the check of signs
and zeros before it (:mod:`.problem.conventions`). Numbers that say how hard to look (how many candidates are refined,
when a descent ends, grids, budgets) stand beside their algorithms: with time enough they should change nothing. Each
field of :data:`RULE` has unit, meaning and source; `python benchmarks/decision_sensitivity.py` asks what half and twice
the value change.

A source is one of five. *odds*: an argument about probabilities, which stands beside it. *chance*: the level of a
one-sided test under a right simulation. *measured*: on opened runs of the blind check, as said. *stated*: what is meant
by a word, so that a user may want it otherwise. *chosen*: by hand, and then held to by the blind check.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from typing import Any

TOLD = ("unit", "meaning", "source")


def stated(value: Any, unit: str, meaning: str, source: str) -> Any:
    """A field with its value, and what a reader must know of it."""
    return field(default=value, metadata={"unit": unit, "meaning": meaning, "source": source})


@dataclass(frozen=True)
class Decision:
    """The rule; :func:`table` prints it."""

    # -- priors and evidence ---------------------------------------------------------------------
    number: tuple[float, ...] = stated(
        (0.4, 0.5, 0.08, 0.016, 0.004), "1", "P(n effects at work), n = 0, 1, …; a quarter for each beyond", "odds"
    )
    alpha: float = stated(1000.0, "nats", "between causes no more evidence counts, however large a gap", "chosen")
    alpha_within: float = stated(
        8000.0, "nats", "the same for the intervals of parameters", "measured: 740 intervals, .90 hold the truth"
    )
    # -- what is left beside a cause ---------------------------------------------------------------
    little: float = stated(0.1, "1", "of the torque that is missing without a cause: as much may be left", "stated")
    few: float = stated(5.0, "nats", "that a residual may gain by chance, besides little² of the gap's", "odds: e⁵")
    loud: float = stated(1.5, "noise", "errors of prediction from which on something is left", "stated")
    alike: float = stated(0.3, "1", "memory of a tracker's errors from which on something is left", "stated")
    company: float = stated(0.25, "1", "share of stray detections that stray together", "chosen")
    along: float = stated(0.05, "1", "share of errors beyond a half that lie along the motion", "chosen")
    chance: float = stated(2.0, "sd", "that each of these three may be off in a right simulation", "chance: .023")
    ample: float = stated(3.0, "1", "times its likeliest size, what an unknown torque may be beside errors", "stated")
    several: int = stated(3, "effects", "from which on held-out rows must bear out each of a set", "odds: P(3) = .016")
    # -- what SMC says of the best ----------------------------------------------------------------
    near: float = stated(3.0, "nats", "behind the best within which causes are confirmed by SMC", "odds: e³")
    confirmed: int = stated(2, "causes", "that are confirmed at most", "cost: seconds each")
    sure: float = stated(
        0.7, "nats", "standard error up to which SMC's evidence takes the linearised one's place", "odds: 2"
    )
    # -- what is said ----------------------------------------------------------------------------
    credible: float = stated(0.95, "1", "probability that an ambiguity set holds", "stated")
    faint: float = stated(
        3.0, "d′", "of an effect of typical size, under which the recording could not show it", "chance: .0013"
    )
    tolerance: float = stated(0.005, "typical torque", "under which a torque does not matter", "stated")
    step: float = stated(0.002, "s", "first-order step whose own error does not matter either", "MuJoCo's default")
    worst: float = stated(1.0, "s", "over which a torque is averaged before it is held against the tolerance", "stated")
    large: float = stated(0.2, "typical torque", 'that no answer "no gap" may overlook', "stated")
    out_of_question: float = stated(
        3.0, "nats", "by which a torque is less likely than another to be ruled out", "odds: 20 to 1"
    )
    # -- held-out rows -------------------------------------------------------------------------------
    block: float = stated(0.4, "s", "length of the bootstrap's blocks: errors are alike for less", "stated")
    share: float = stated(2 / 3, "rows", "fitted on where the last ones are held out", "stated")
    later: float = stated(
        4.0, "1", "growth of a parameter's sd by which the held-out rows alone show it", "measured: 1.2 elsewhere"
    )


RULE = Decision()


@contextmanager
def ruled(**values: Any) -> Iterator[Decision]:
    """Another rule for a while, for tests and sensitivity. Raises TypeError for a name that it does not have."""
    known = {each.name for each in fields(Decision)}
    if unknown := values.keys() - known:
        raise TypeError(f"the decision rule has no {', '.join(sorted(unknown))}")
    before = {name: getattr(RULE, name) for name in values}
    try:
        for name, value in values.items():
            object.__setattr__(RULE, name, value)
        yield RULE
    finally:
        for name, value in before.items():
            object.__setattr__(RULE, name, value)


def table() -> str:
    """The rule as a Markdown table."""
    rows = [("name", "value", *TOLD), ("---",) * 5]
    rows += [
        (f"`{each.name}`", _number(getattr(RULE, each.name)), *(each.metadata[what] for what in TOLD))
        for each in fields(Decision)
    ]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def _number(value: Any) -> str:
    return ", ".join(map(_number, value)) if isinstance(value, tuple) else f"{value:.3g}"
