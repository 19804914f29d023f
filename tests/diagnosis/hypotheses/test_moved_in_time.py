"""When a push came."""

from functools import cache

import pytest
import torch
from pendulum import ARM, LOOSE, path_of

from invdyn.diagnosis.hypotheses.pool import HypothesisPool
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.hypotheses.swap import follow_neighbours
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.rules import DEFAULT
from invdyn.models.effects import EFFECTS
from invdyn.simulate import random_arm, record

TRUE = {"impulse_x": 0.3, "impulse_y": 0.2, "moment": 1.5, "duration": 0.06}


@cache
def pushed():
    """An arm, filmed well, whose wrist is pushed; its setting, "no effect", and the push."""
    effect = EFFECTS["external_push"]("wrist")
    arm = random_arm(ARM, duration=3.0, fps=100, noise=0.0003, torque_scale=0.5, commanded=True, seed=2)
    named = {f"effect.{effect.key}.{name}": torch.tensor([v], dtype=torch.float64) for name, v in TRUE.items()}
    here = diagnosis_problem(record(arm.with_effects(effect).replace(**named), 2)[0], ARM)
    return here, refine(here, (), {}, path_of(here), LOOSE), effect.bound(ARM)


def refined_from(**values):
    here, none, effect = pushed()
    start = {"impulse_x": 0.0, "impulse_y": 0.0} | values
    return refine(
        here, (effect,), {f"{effect.key}.{n}": v for n, v in start.items()}, none.path, DEFAULT.residual.min_path_size
    )


@cache
def right():
    return refined_from(**TRUE)


def moved(cause):
    here, none, effect = pushed()
    found = HypothesisPool(here, [effect], {"": none, cause.key: cause}, [], none.path, False)
    follow_neighbours(found, 1)
    return found.pool[cause.key]


@pytest.mark.quick("start1")
@pytest.mark.parametrize("start", [(1.62, 0.08), (1.40, 0.2)])
def test_a_push_is_moved_to_when_it_was(start):
    """From a tenth of a second away Gauss–Newton ends somewhere between."""
    lost = refined_from(moment=start[0], duration=start[1])
    found, true = moved(lost), right()
    assert lost.log_evidence < true.log_evidence - 20
    assert found.log_evidence == pytest.approx(true.log_evidence, abs=0.5)
    names = [f"external_push.wrist.{name}" for name in TRUE]
    off = [abs(found.values[n] - v) / found.sd[found.names.index(n)] for n, v in zip(names, TRUE.values(), strict=True)]
    assert max(off) < 4


def test_where_it_is_right_it_stays():
    assert moved(right()).log_evidence == pytest.approx(right().log_evidence, abs=DEFAULT.search.equal_gain)
