"""Any effect in the place of one of a set's."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from pendulum import LOOSE, PENDULUM, driven

from invdyn.diagnosis.hypotheses.continuation import data_path
from invdyn.diagnosis.hypotheses.pool import HypothesisPool, considered
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.hypotheses.search import exchange
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.problem.noise import is_searched
from invdyn.diagnosis.problem.unknowns import unknowns
from invdyn.diagnosis.rules import DEFAULT
from invdyn.diagnosis.sensitivity.screen import screen
from invdyn.models.effects import EFFECTS


@pytest.mark.long
def test_the_path_of_one_leads_to_another_that_is_like_it():
    """Where only Stribeck's friction has arrived, dry friction is tried again."""
    bound = diagnosis_problem(driven("coulomb_friction", rows=120, coulomb_friction_torque=0.15), PENDULUM)
    path, stray = data_path(bound)
    bound = bound.shaped(path)
    stribeck = EFFECTS["stribeck_friction"]("pivot")
    values = {f"{stribeck.bound(PENDULUM).key}.{k}": v for k, v in (("coulomb", 0.15), ("static", 0.15))}
    none, other = (
        refine(bound, (), {}, path, LOOSE),
        refine(bound, (stribeck,), values, path, DEFAULT.residual.min_path_size),
    )
    found = HypothesisPool(bound, considered(bound), {"": none, other.key: other}, [], path, stray)
    exchange(found, found.ranked[0])
    assert found.ranked[0].key == "coulomb_friction.pivot"
    assert found.ranked[0].mean[0] == pytest.approx(0.15, rel=0.05)
    assert len(found.pool) < 6  # and no more than a few


@pytest.mark.long
def test_where_one_leaves_nothing_only_what_was_like_it_is_tried(monkeypatch):
    bound = diagnosis_problem(driven("coulomb_friction", rows=120, coulomb_friction_torque=0.15), PENDULUM)
    path, stray = data_path(bound)
    bound = bound.shaped(path)
    friction = EFFECTS["coulomb_friction"]("pivot")
    none, cause = (
        refine(bound, (), {}, path, LOOSE),
        refine(bound, (friction,), {"torque": 0.15}, path, DEFAULT.residual.min_path_size),
    )
    assert cause.complete
    common = unknowns(bound, ())
    free = [e for e in considered(bound) if not is_searched(e)]
    first = screen(bound, bound.model, path, free, common, common.mean)
    found = HypothesisPool(bound, considered(bound), {"": none, cause.key: cause}, first, path, stray)
    tried = []

    def screened(workers, problem, model, path, effects, *given):
        tried.extend(e.name for e in effects)
        return screen(problem, model, path, effects, *given)

    monkeypatch.setattr(sys.modules[exchange.__module__], "screen_in_halves", screened)
    monkeypatch.setattr(sys.modules[exchange.__module__], "follow_neighbours", lambda *_: None)
    exchange(found, found.ranked[0])
    assert {"stribeck_friction", "viscous_friction"} <= set(tried)
    assert len(tried) < len(free) / 2
    arrived = replace(cause, effects=(EFFECTS["stribeck_friction"]("pivot"),), log_evidence=cause.log_evidence - 5)
    tried.clear()
    pool = {"": none, cause.key: cause, arrived.key: arrived}
    exchange(HypothesisPool(bound, considered(bound), pool, first, path, stray), cause)
    assert "viscous_friction" in tried
    assert "stribeck_friction" not in tried  # it leaves nothing either


@pytest.mark.long
def test_in_a_set_too_one_gives_way_while_the_other_stays():
    """Where drag has arrived beside an added rotor, friction takes its place, and the rotor stays."""
    true = {"viscous_friction_damping": 0.05, "armature_inertia": 0.02}
    bound = diagnosis_problem(driven("viscous_friction", "armature", rows=120, **true), PENDULUM)
    path, stray = data_path(bound)
    bound = bound.shaped(path)
    none = refine(bound, (), {}, path, LOOSE)
    pair = tuple(EFFECTS[name]("pivot").bound(PENDULUM) for name in ("quadratic_drag", "armature"))
    other = refine(bound, pair, {}, path, LOOSE)
    found = HypothesisPool(bound, considered(bound), {"": none, other.key: other}, [], path, stray)
    exchange(found, found.ranked[0])
    best = found.ranked[0]
    assert best.key == "armature.pivot+viscous_friction.pivot"
    values = dict(zip((name.rpartition(".")[2] for name in best.names), best.mean, strict=True))
    assert values["damping"] == pytest.approx(0.05, rel=0.15)
    assert values["inertia"] == pytest.approx(0.02, rel=0.15)


def test_what_is_large_is_exchanged_from_half_of_its_gain(monkeypatch):
    """A payload as heavy as its link moves what is seen on no straight line: the screen has half of it at most."""
    bound = diagnosis_problem(driven(), PENDULUM)
    path, stray = data_path(bound)
    none = refine(bound, (), {}, path, LOOSE, rounds=1)
    old, *others = (EFFECTS[name]().bound(PENDULUM) for name in ("payload", "gravity_tilt", "camera_roll"))
    best = replace(none, effects=(old,), log_evidence=none.log_evidence + 1000)
    found = HypothesisPool(bound, considered(bound), {"": none, best.key: best}, [], path, stray)
    module, gains = sys.modules[exchange.__module__], {"gravity_tilt": 510.0, "camera_roll": 490.0}

    def screened(*_, **__):
        first = screen(bound, bound.model, path, others, unknowns(bound, ()), np.zeros(0))
        alone = next(s for s in first if s.effect is None)
        nothing = replace(alone, log_evidence=none.log_evidence)
        return [replace(s, log_evidence=none.log_evidence + gains[s.effect.name]) for s in first if s.effect] + [
            nothing
        ]

    tried = []
    monkeypatch.setattr(module, "screen_in_halves", screened)
    monkeypatch.setattr(module, "refine_best", lambda *a: tried.extend(s.effect.name for s in a[2] if s.effect))
    monkeypatch.setattr(module, "follow_neighbours", lambda *_: None)
    exchange(found, found.ranked[0])
    assert tried == ["gravity_tilt"]


def test_what_takes_the_place_of_a_bending_link_joins_the_set_without_it(monkeypatch):
    """In model and path too: the hinge in the link has states of its own."""
    bound = diagnosis_problem(driven("viscous_friction", viscous_friction_damping=0.1), PENDULUM)
    path, stray = data_path(bound)
    friction, bending = EFFECTS["viscous_friction"]("pivot"), EFFECTS["link_flexibility"]("rod")
    push = next(e for e in considered(bound) if e.name == "external_push")
    none, both = (
        refine(bound, (), {}, path, LOOSE),
        refine(bound, (friction, bending), {}, path, LOOSE, rounds=2),
    )
    both = replace(both, log_evidence=none.log_evidence + 100)
    room, bases = sys.modules[exchange.__module__], []
    monkeypatch.setattr(room, "refine_best", lambda found, base, *_: bases.append(base))
    exchange(HypothesisPool(bound, [friction.bound(PENDULUM), push], {"": none, both.key: both}, [], path, stray), both)
    base = next(base for base in bases if base.effects == both.effects[:1])
    assert [effect.name for effect in base.model.effects] == ["viscous_friction"]
    assert base.path.shape[-1] == base.model.state_dim < both.model.state_dim
