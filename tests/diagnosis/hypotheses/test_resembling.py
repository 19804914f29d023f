"""Effects that others are taken for are refined from those: a payload from an error, others from the same period."""

from dataclasses import replace

import pytest
import torch
from pendulum import ARM, LOOSE, PENDULUM, recording_of

from invdyn.diagnosis.catalogue import CATALOGUE
from invdyn.diagnosis.catalogue.neighbours import of_same_period
from invdyn.diagnosis.catalogue.period_equivalents import factor
from invdyn.diagnosis.hypotheses.continuation import data_path
from invdyn.diagnosis.hypotheses.pool import HypothesisPool, considered
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.hypotheses.swap import follow_neighbours
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.rules import DEFAULT
from invdyn.models.effects import EFFECTS
from invdyn.simulate import random_arm, record

PAYLOAD = EFFECTS["payload"]().bound(ARM)


@pytest.mark.parametrize(("place", "load", "followed"), [("forearm", 0.4, True), ("upper_arm", 0.4, False)])
def test_a_payload_is_refined_from_the_error_that_found_it(place, load, followed):
    """No screen along the data's path sees a large one. An error of another link is none."""
    bound = diagnosis_problem(recording_of(PAYLOAD, body=ARM, rows=100, mass=load), ARM)
    path, stray = data_path(bound)
    none = refine(bound, (), {}, path, LOOSE)
    error = EFFECTS["inertial_error"]("forearm")
    wider = refine(bound, (error,), {f"{error.key}.mass": load}, path, 0.01)
    if place != "forearm":
        other = EFFECTS["inertial_error"](place).bound(ARM)
        wider = replace(wider, effects=(other,), names=tuple(n.replace("forearm", place) for n in wider.names))
    found = HypothesisPool(bound, considered(bound), {c.key: c for c in (none, wider)}, [], path, stray)
    follow_neighbours(found, 1)
    assert (PAYLOAD.key in found.pool) is followed
    if followed:
        payload = found.pool[PAYLOAD.key]
        assert payload.complete
        assert abs(payload.mean[0] - load) < 4 * payload.sd[0]
        assert found.ranked[0].key == PAYLOAD.key
        tried = found.followed[PAYLOAD.key]
        follow_neighbours(found, 1)
        assert found.followed == {PAYLOAD.key: tried}


@pytest.mark.quick("payload*")
@pytest.mark.parametrize(("name", "values"), [("payload", {"mass": 0.4}), ("clock_rate", {"rate": 1.08})])
def test_what_changes_the_period_is_followed_to_all_that_may(name, values):
    """From any of them the search arrives at all others, which are as good but for their priors."""
    truth = next(iter(EFFECTS[name].everywhere(PENDULUM, ["tip"]))).bound(PENDULUM)
    arm = random_arm(PENDULUM, duration=4.0, fps=50, noise=0.002, torque_scale=0.0, commanded=True, seed=3)
    named = {f"effect.{truth.key}.{p}": torch.tensor([v], dtype=torch.float64) for p, v in values.items()}
    bound = diagnosis_problem(record(arm.with_effects(truth).replace(**named), 3)[0], PENDULUM, passive=True)
    path, stray = data_path(bound)
    none = refine(bound, (), {}, path, LOOSE)
    right = refine(bound, (truth,), {f"{truth.key}.{p}": v for p, v in values.items()}, path, LOOSE)
    found = HypothesisPool(bound, considered(bound), {"": none, right.key: right}, [], path, stray)
    follow_neighbours(found, 1)
    names = {cause.effects[0].name: cause for cause in found.pool.values() if cause.effects}
    scale = bound.model.scale
    assert set(names) >= set(of_same_period(truth, values, scale, CATALOGUE))
    assert all(cause.complete for cause in names.values())
    # An inertial error has two parameters more, whose priors it pays for.
    single = [names[name] for name in ("clock_rate", "armature", "payload")]
    assert min(cause.log_evidence for cause in single) > max(cause.log_evidence for cause in single) - 5
    for cause in single:
        (effect,) = cause.effects
        own = {p.name: cause.values[f"{effect.key}.{p.name}"] for p in effect.parameters(scale)}
        assert factor(effect, own, scale.body) == pytest.approx(factor(truth, values, scale.body), rel=0.01)


@pytest.mark.long
def test_on_two_links_or_under_torque_or_lying_flat_they_are_no_twins():
    flat = replace(PENDULUM, gravity=(0.0, 0.0))
    for body, passive in ((ARM, True), (PENDULUM, False), (flat, True)):
        bound = diagnosis_problem(recording_of(body=body), body, passive=passive)
        path, stray = data_path(bound)
        none, candidates = refine(bound, (), {}, path, LOOSE, rounds=1), considered(bound)
        clock = next(e for e in candidates if e.name == "clock_rate")
        cause = refine(bound, (clock,), {f"{clock.key}.rate": 1.05}, path, LOOSE, rounds=1)
        found = HypothesisPool(bound, candidates, {"": none, clock.key: cause}, [], path, stray)
        assert cause.log_evidence > found.top - DEFAULT.search.large_screen_error  # or nothing would be followed
        follow_neighbours(found, 1)
        assert set(found.pool) == {"", clock.key}
