"""Effects of which a swinging link shows only its period: each has a size for the same one."""

from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from pendulum import ARM, PENDULUM, recording_of

from invdyn.diagnosis.hypotheses.continuation import data_path
from invdyn.diagnosis.hypotheses.moves import refine_kin
from invdyn.diagnosis.hypotheses.period_equivalents import NAMES, equivalents, factor
from invdyn.diagnosis.hypotheses.pool import HypothesisPool, considered
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.hypotheses.shortlist import TOO_FAR_BEHIND
from invdyn.diagnosis.problem.diagnosis_problem import LOOSE, diagnosis_problem
from invdyn.models.effects import EFFECTS
from invdyn.simulate import random_arm, record

SCALE = diagnosis_problem(recording_of(), PENDULUM).model.scale


def whole(name, values):
    """An effect on the pendulum, and all its parameters: those not said change nothing."""
    effect = next(iter(EFFECTS[name].everywhere(PENDULUM, ["tip"]))).bound(PENDULUM)
    return effect, {p.name: values.get(p.name, 0.0) for p in effect.parameters(SCALE)}


@given(st.floats(0.5, 2.0))
def test_each_equivalent_has_the_same_factor(rho):
    found = equivalents(rho, SCALE.body)
    assert set(found) <= set(NAMES)
    for name, values in found.items():
        assert factor(*whole(name, values), SCALE.body) == pytest.approx(rho, rel=1e-9)


def test_a_swing_cannot_be_slower_than_its_weight_at_the_tip():
    """A load at the tip of a rod makes a pendulum of its length at most, which is half as long again; no more mass
    makes the swing faster."""
    assert set(equivalents(1.4, SCALE.body)) == set(NAMES)
    assert set(equivalents(1.6, SCALE.body)) == set(NAMES) - {"payload"}
    assert set(equivalents(0.9, SCALE.body)) == {"clock_rate", "inertial_error"}
    assert set(equivalents(0.6, SCALE.body)) == {"clock_rate"}  # a link's weight by itself resists as much


@pytest.mark.parametrize(("name", "values"), [("payload", {"mass": 0.4}), ("clock_rate", {"rate": 1.08})])
def test_what_changes_the_period_is_followed_to_all_that_may(name, values):
    """From any of them the search arrives at all others, which are as good but for their priors."""
    truth, known = whole(name, values)
    arm = random_arm(PENDULUM, duration=4.0, fps=50, noise=0.002, torque_scale=0.0, commanded=True, seed=3)
    named = {f"effect.{truth.key}.{p}": torch.tensor([v], dtype=torch.float64) for p, v in known.items()}
    bound = diagnosis_problem(record(arm.with_effects(truth).replace(**named), 3)[0], PENDULUM, passive=True)
    path, stray = data_path(bound)
    none = refine(bound, (), {}, path, LOOSE)
    right = refine(bound, (truth,), {f"{truth.key}.{p}": v for p, v in known.items()}, path, LOOSE)
    found = HypothesisPool(considered(bound), {"": none, right.key: right}, [], path, stray)
    refine_kin(bound, found, 1)
    names = {cause.effects[0].name: cause for cause in found.pool.values() if cause.effects}
    assert set(names) >= set(equivalents(factor(truth, known, SCALE.body), SCALE.body))
    assert all(cause.complete for cause in names.values())
    # An inertial error has two parameters more, whose priors it pays for.
    single = [names[name] for name in ("clock_rate", "armature", "payload")]
    assert min(cause.log_evidence for cause in single) > max(cause.log_evidence for cause in single) - 5
    for cause in single:
        (effect,) = cause.effects
        own = {p.name: cause.values[f"{effect.key}.{p.name}"] for p in effect.parameters(SCALE)}
        assert factor(effect, own, SCALE.body) == pytest.approx(factor(truth, known, SCALE.body), rel=0.01)


def test_a_link_that_does_not_hang_has_no_period():
    """Balanced, or turned over by a load beyond its joint."""
    for com in (0.0, -0.05):
        link = PENDULUM.with_values(com=[com]).parameters()
        effect = EFFECTS["payload"]().bound(PENDULUM)
        assert equivalents(factor(effect, {"mass": 0.4}, link), link) == {}


def test_on_two_links_or_under_torque_or_lying_flat_they_are_no_twins():
    flat = replace(PENDULUM, gravity=(0.0, 0.0))
    for body, passive in ((ARM, True), (PENDULUM, False), (flat, True)):
        bound = diagnosis_problem(recording_of(body=body), body, passive=passive)
        path, stray = data_path(bound)
        none, candidates = refine(bound, (), {}, path, LOOSE, rounds=1), considered(bound)
        clock = next(e for e in candidates if e.name == "clock_rate")
        cause = refine(bound, (clock,), {f"{clock.key}.rate": 1.05}, path, LOOSE, rounds=1)
        found = HypothesisPool(candidates, {"": none, clock.key: cause}, [], path, stray)
        assert cause.log_evidence > found.top - TOO_FAR_BEHIND  # or nothing would be followed
        refine_kin(bound, found, 1)
        assert set(found.pool) == {"", clock.key}
