"""Which effects a log could show: how far each, of a typical size, would move what was recorded, in its noise (d′).

It is the diagnosis' own screen (:mod:`..sensitivity.screen`) along the data's path, without the search that follows.
"""

from dataclasses import dataclass

from invdyn.diagnosis.assessment.findings import key
from invdyn.diagnosis.hypotheses.continuation import data_path
from invdyn.diagnosis.hypotheses.pool import considered
from invdyn.diagnosis.problem.diagnosis_problem import cannot_follow, diagnosis_problem
from invdyn.diagnosis.problem.unknowns import unknowns
from invdyn.diagnosis.rules import DEFAULT, Rules
from invdyn.diagnosis.sensitivity.screen import added, screen
from invdyn.models import ArticulatedBody
from invdyn.models.divergence import Diverged, diverging
from invdyn.recordings import Recording


@dataclass(frozen=True)
class Visible:
    """d′ of each effect at its place, by key; and what to record to see those that would not show."""

    dprime: dict[str, float]
    record: dict[str, tuple[str, ...]]

    @property
    def hidden(self) -> tuple[str, ...]:
        """Keys of those that would not show."""
        unseen = {name for names in self.record.values() for name in names}
        return tuple(name for name in self.dprime if name in unseen)


def visible(recording: Recording, body: ArticulatedBody, passive: bool = False, rules: Rules = DEFAULT) -> Visible:
    """Look at the first `max_look_rows` rows of a recording; raises InputError where it does not fit the body."""
    rows = min(rules.check.max_look_rows, recording.num_frames)
    bound = diagnosis_problem(recording.select(0, rows), body, passive=passive, rules=rules)
    try:
        with diverging():
            path, _ = data_path(bound)
            bound = bound.shaped(path)
            common = unknowns(bound, ())
            screened = screen(bound, bound.model, path, considered(bound), common, common.mean)
    except Diverged as error:
        raise cannot_follow(bound) from error
    dprime = {key(s.effect): float(s.dprime) for s in added(screened)}
    dprime = dict(sorted(dprime.items(), key=lambda item: -item[1]))
    record: dict[str, list[str]] = {}
    for s in added(screened):
        if s.dprime < rules.evidence.min_dprime:
            record.setdefault(bound.catalogue[s.effect.name].shown_by, []).append(key(s.effect))
    return Visible(dprime, {what: tuple(sorted(names)) for what, names in record.items()})
