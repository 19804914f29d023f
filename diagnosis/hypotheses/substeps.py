"""Integrator sub-steps whose error costs no evidence.

An error that no row shows adds up over a recording, and whatever takes shorter sub-steps for reasons of its own, as
play does, gains what all others lose by it. The error e_t (D,) of row t is the difference to twice as many sub-steps
along a path. As an input into the state it changes the whitened innovations by a column w (:mod:`.innovations`), and
log evidence by ½ |w|² on average; with next to no residual, which would take the error along.

That is along a path without a cause. Where joints stick, the effect's own sub-steps do (:attr:`.Effect.longest`), but
not always where friction falls with speed: such a motion is unstable, and what is lost at one turn grows until the
next. What leaves something then may leave nothing in shorter ones.
"""

import numpy as np
import torch
from torch import Tensor

from invdyn.diagnosis.hypotheses.pool import Search
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.hypotheses.shortlist import attempt
from invdyn.diagnosis.problem.diagnosis_problem import Setting
from invdyn.diagnosis.sensitivity.sensitivities import Columns
from invdyn.diagnosis.sensitivity.whiten import SPIKE, filter_of, whiten
from invdyn.inference.posterior.initialise import SUBSTEPS

LOST = 0.5
"""Nats that errors of integration may cost."""
MOST = 2
"""Times as many sub-steps as errors in an angle ask for: |w|² falls by a thousand with that, but on wild paths."""
SHORTER = (2, 4)
"""Times as many sub-steps that an effect whose force jumps is refined in, where it leaves something."""


def finely_stepped(setting: Setting, path: Tensor) -> Setting:
    """The setting with as many sub-steps as its own, or the fewest whose error along ``path`` (T, D) costs little.

    Under an unknown torque, which takes errors along, it stays as it is.
    """
    if setting.regime == "unknown_torque":
        return setting
    model, ends = setting.model, {}
    rows = torch.arange(1, len(path))
    about = filter_of(setting, setting.model, path, np.array([SPIKE]))
    nothing = np.zeros((*setting.observations.shape, 1))

    def reached(count: int) -> Tensor:
        """States (T − 1, D) at the ends of all rows, in so many sub-steps."""
        if count not in ends:
            with torch.no_grad():
                ends[count] = model.in_substeps(count).transition_mean(path[:-1], rows)
        return ends[count]

    own = setting.model.substeps
    for count in (n for n in SUBSTEPS if own <= n <= MOST * own):
        error = (reached(count) - reached(2 * count)).unsqueeze(-1).numpy()
        if 0.5 * whiten(setting, about, Columns(error, nothing)).gram[0, 1, 1] <= LOST:
            break
    return setting.in_substeps(count)


def shortened(setting: Setting, found: Search) -> Setting:
    """The setting, in shorter sub-steps where the best effect, whose force jumps, leaves something but nothing in them.

    It is kept as it is there, in its ideal form.
    """
    best = found.ranked[0]
    if best.complete or len(best.effects) != 1 or not best.model.effects.abrupt:
        return setting
    ideal = [effect for effect in found.candidates if effect.key == best.key]
    for times in SHORTER:
        there = setting.in_substeps(times * best.model.substeps_taken)
        cause = attempt(refine, there, ideal, best.values, found.path, setting.loose)
        # What leaves something all the same gains little by them, and all that comes after would take as much longer.
        if cause is not None and cause.complete and cause.log_evidence > best.log_evidence:
            found.add(cause)
            return there
    return setting
