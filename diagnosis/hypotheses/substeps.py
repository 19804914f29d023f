"""Integrator sub-steps whose error costs no evidence.

An error that no row shows adds up over a recording, and what takes shorter sub-steps for other reasons, as
backlash does, gains what all others lose by it. The error e_t (D,) of row t is the difference to twice as many
sub-steps along a path. As an input into the state it changes the whitened innovations by a column w
(:mod:`.innovations`), and log evidence by ½ |w|² on average; with next to no residual, which would take the error
along.

That is along a path without a cause. Where joints stick, the effect's own sub-steps do (:attr:`.Effect.longest`).
"""

import numpy as np
import torch
from torch import Tensor

from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.sensitivity.sensitivities import Columns
from invdyn.diagnosis.sensitivity.whiten import filter_of, whiten
from invdyn.inference.posterior.initialise import SUBSTEPS


def finely_stepped(problem: DiagnosisProblem, path: Tensor) -> DiagnosisProblem:
    """The problem with as many sub-steps as its own, or the fewest whose error along ``path`` (T, D) costs little.

    Under an unknown torque, which takes errors along, it stays as it is.
    """
    if not problem.regime.knows_torque:
        return problem
    model, ends = problem.model, {}
    rows = torch.arange(1, len(path))
    about = filter_of(problem, problem.model, path, np.array([problem.rules.residual.spike_size]))
    nothing = np.zeros((*problem.observations.shape, 1))

    def reached(count: int) -> Tensor:
        """States (T − 1, D) at the ends of all rows, in so many sub-steps."""
        if count not in ends:
            with torch.no_grad():
                ends[count] = model.in_substeps(count).transition_mean(path[:-1], rows)
        return ends[count]

    own = problem.model.substeps
    for count in (n for n in SUBSTEPS if own <= n <= problem.rules.search.max_step_factor * own):
        error = (reached(count) - reached(2 * count)).unsqueeze(-1).numpy()
        if 0.5 * whiten(problem, about, Columns(error, nothing)).gram[0, 1, 1] <= problem.rules.search.max_step_loss:
            break
    return problem.in_substeps(count)
