"""Whether the rows say enough to call a simulation right: what it may lack without anybody seeing it.

With p(y | s) the evidence under a residual of size s (:mod:`.whiten`), log p(y | s) − log p(y | 0) says how much more
likely a missing torque of that size is than none. "No gap" is an answer where a large one is out of the question, "a
gap" where none is; in a few frames, or between detections as far apart as the arm is long, both are as likely.
"""

from invdyn.diagnosis.hypotheses.pool import HypothesisPool
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem


def too_little(problem: DiagnosisProblem, found: HypothesisPool) -> str | None:
    """Why the rows do not tell whether there is a gap; None where they do, or an effect was found in them.

    An unknown torque may be of any size, and the question there is whether the camera shows something.
    """
    if not problem.regime.knows_torque or found.best.effects:
        return None
    levels, rules = problem.regime.sizes, problem.rules.evidence
    by_size = found.pool[""].by_size - problem.regime.log_prior
    hidden = levels[(levels >= rules.detectable_torque) & (by_size > by_size[0] - rules.ruled_out_gap)]
    if not len(hidden) or by_size.max() > by_size[0] + rules.ruled_out_gap:
        return None
    time, torque = problem.model.time, float(hidden.max() * problem.typical.max())
    rows, seconds = len(time), float(time[-1] - time[0])
    return (
        f"{problem.problem.recording.name}: in {rows} rows of {seconds:.2g} s a torque of "
        f"{torque:.2g} N·m could be missing and not show; give a longer recording, or a less noisy one"
    )
