"""The answer where no search is made: servos' gains are far from the file's, and a regression has found them.

A search linearises about the file's numbers. Of a servo whose gain is some times another it finds no path of the
recording in minutes, and no cause. The regression's answer is then the first one. What it leaves is looked for in the
file that it corrects.
"""

from dataclasses import replace

import numpy as np

from invdyn.diagnosis.assessment.assemble import nothing_to_say
from invdyn.diagnosis.assessment.closing_measures import measured
from invdyn.diagnosis.assessment.regression_cause import regression_cause
from invdyn.diagnosis.assessment.result import NO_SEARCH, Diagnosis, Gap, Shrinkage
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.regression.regress import Regression


def by_regression_alone(
    regression: Regression, problem: DiagnosisProblem, seed: int, passive: bool
) -> Diagnosis | None:
    """The diagnosis that a regression with far gains gives; None where it closes no torque on rows it has not seen."""
    body, rules = problem.model.body, problem.rules
    torque = regression.torque
    if torque.share <= 0:
        return None
    names, nan = regression.joints, float("nan")
    before, after = (dict(zip(names, each.tolist(), strict=True)) for each in (torque.before, torque.after))
    nats = sum(each.gain_nats for each in regression.stated)
    empty = nothing_to_say(problem.problem.recording, body, seed, passive, "", rules)
    gap = Gap(True, float(1 - np.exp(-min(nats, 700.0))), empty.gap.elpd_per_frame, before, empty.gap.replay_rms_m)
    times = list(regression.far_gains.values())
    words = (
        f"No causes were searched for: the log shows servo gains of {min(times):.2g} to {max(times):.2g} times the "
        "file's, and a search about the file's ends nowhere; diagnose the corrected copy (--write-back) for the rest"
    )
    return replace(
        empty,
        not_enough_data=None,
        gap=gap,
        shrinkage=Shrinkage(torque.share, torque.interval_90, True, after),
        where=replace(empty.where, joints=dict.fromkeys(names, nan)),
        method={NO_SEARCH: words},
        regression=regression,
        closing=measured(regression, body, passive),
        regressed=regression_cause(regression, problem, passive),
    )
