"""How much work a diagnosis may take, what it is trying, and which candidates it had no time for.

A real recording always has something left, so a search that ends when nothing is left does not end. Work is counted,
not timed: the same recording gets the same answer on every machine, with any number of workers. Its unit is one pass, a
linearisation of the plain arm along every row; a model with hidden states or sub-steps takes more of them,

    work = passes · T (D/D₀)² (3 + s)/4,        in space · max(1, (K/3)³),

of T rows, D states, D₀ those of the plain arm, s sub-steps a row and K joints, and a budget allows so many passes a
row. Where seconds are given, the clock ends it instead, and the result depends on the machine. The best so far is
always an answer (anytime algorithms: Dean & Boddy 1988). A search that cannot come to its first screen is not begun:
what it would need is known before.
"""

import math
import os
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

from invdyn.diagnosis.rules import FIXED
from invdyn.models import ArmModel
from invdyn.models.divergence import Diverged, diverging
from invdyn.models.effects.composition import NotTogether

T = TypeVar("T")


class Spent(Exception):
    """The budget is spent: a candidate is not looked at."""


@dataclass
class Budget:
    """Work and seconds that are left; without limits unless some are given.

    Attributes:
        work: allowed, in passes times rows.
        seconds: allowed, by ``clock``.
        on_progress: called with what is being tried, by the process that made the budget.
        done: work so far.
        missed: names of candidates that were not looked at.
        share: of work and seconds that may be used for now; no limit while it is infinite.
    """

    work: float = math.inf
    seconds: float = math.inf
    clock: Callable[[], float] = time.monotonic
    on_progress: Callable[[str], None] | None = None
    done: float = 0.0
    missed: frozenset[str] = frozenset()
    share: float = math.inf
    started: float = field(init=False)
    process: int = field(init=False)

    def __post_init__(self) -> None:
        """Start now, in this process."""
        self.started, self.process = self.clock(), os.getpid()

    def __getstate__(self) -> dict:
        """Without clock and listener: a copy in another process has the usual clock, and reports nothing."""
        return self.__dict__ | {"on_progress": None, "clock": time.monotonic}

    @property
    def over(self) -> bool:
        """Whether the share for now is spent."""
        return self.done >= self.share * self.work or self.clock() - self.started >= self.share * self.seconds

    @property
    def allowed(self) -> str:
        """In words."""
        return "counted work, the same on every machine" if math.isinf(self.seconds) else f"{self.seconds:g} s"

    def start(self, *names: str) -> None:
        """Say that ``names`` are looked at now; raises :class:`Spent` where nothing is left for them."""
        if self.over:
            self.missed |= set(names)
            raise Spent("the budget is spent")
        if self.on_progress is not None and os.getpid() == self.process:
            self.on_progress(names[0] if len(names) == 1 else f"{len(names)} effects")

    def spend(self, passes: float, model: ArmModel, rows: int) -> None:
        """Count ``passes`` of a model along so many rows."""
        self.done += work_of(passes, model, rows)

    def apart(self, part: Callable[[], T]) -> "Outcome[T]":
        """Run a part as if it were the only one."""
        before, results = (self.done, self.missed), []
        try:
            with suppress(Spent):
                results.append(part())
            return Outcome(results, self.done - before[0], self.missed)
        finally:
            self.done, self.missed = before

    def together(self, outcomes: "Sequence[Outcome[T]]") -> list[T]:
        """Results of parts that ran :meth:`apart`, whose work counts from now on; raises as one of them did."""
        self.done += sum(each.work for each in outcomes)
        self.missed = self.missed.union(*(each.missed for each in outcomes))
        if not all(each.results for each in outcomes):
            raise Spent("the budget is spent")
        return [each.results[0] for each in outcomes]


def work_of(passes: float, model: ArmModel, rows: int) -> float:
    """Work of ``passes`` of a model along so many rows."""
    joints = model.body.num_joints
    plain = model.torque_size + 2 * joints
    passes *= FIXED.rowwise_cost if model.contact_states is not None else 1.0
    if not model.body.is_chain:
        passes *= max(1.0, (joints / FIXED.usual_joints) ** 3)
    return passes * rows * (model.state_dim / plain) ** 2 * (3 + model.substeps_taken) / 4


def work_per_second(model: ArmModel) -> float:
    """What a usual machine does of a model in the plane, or in space."""
    plane, space = FIXED.work_per_second
    return plane if model.body.is_chain else space


@dataclass(frozen=True)
class Outcome(Generic[T]):
    """What came of a part: its result, none where the budget ended it, its work, and what was missed by then."""

    results: list[T]
    work: float
    missed: frozenset[str]


def attempt(work: Callable[..., T], *arguments: Any, **options: Any) -> T | None:
    """The result of ``work``, such as a refinement, or None.

    None where it ends at parameters with which the simulation does not run, at effects that no simulation has together,
    or where the budget is spent.
    """
    try:
        with diverging():
            return work(*arguments, **options)
    except (Diverged, NotTogether, Spent):
        return None
