"""Which of the screened effects are refined."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from pendulum import LOOSE, PENDULUM, recording_of

from invdyn.diagnosis.hypotheses.continuation import data_path
from invdyn.diagnosis.hypotheses.pool import HypothesisPool, considered
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.hypotheses.shortlist import (
    SOFTENED,
    refine_barred,
    refine_promising,
)
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.problem.unknowns import unknowns
from invdyn.diagnosis.sensitivity.screen import screen


def test_what_an_unknown_torque_imitates_sets_the_bar(monkeypatch):
    """Only the torque's prior speaks for friction; what gains less than that on the camera's side says no more."""
    bound = diagnosis_problem(replace(recording_of(), torques=None), PENDULUM)
    path, stray = data_path(bound)
    gains = {"coulomb_friction": 30.0, "camera_roll": 25.0, "lens_distortion": 40.0, "base_motion": 35.0}
    some = [e for e in considered(bound) if e.name in gains]
    common = unknowns(bound, ())
    screened = screen(bound, bound.model, path, some, common, common.mean)
    nothing = next(s.log_evidence for s in screened if s.effect is None)
    screened = [replace(s, log_evidence=nothing + gains[s.effect.name]) if s.effect else s for s in screened]
    screened = sorted((replace(s, dprime=50.0) for s in screened), key=lambda s: -s.log_evidence)
    tried = []
    monkeypatch.setattr(
        sys.modules[refine_promising.__module__], "refine", lambda *given, **more: tried.append(given[1][0].name)
    )
    none = refine(bound, (), {}, path, LOOSE)
    refine_promising(bound, HypothesisPool(considered(bound), {"": none}, [], path, stray), none, screened, 9)
    assert tried == ["lens_distortion", "base_motion"]  # a base that shakes takes all points along
    # Where something is left under any torque, what is seen is something else, however little the screen says.
    tried.clear()
    refine_barred(bound, HypothesisPool(considered(bound), {"": none}, [], path, stray), none, screened)
    assert tried == ["lens_distortion", "camera_roll"]  # the first for its softer form, had it been refined


def test_where_something_is_left_softer_forms_are_tried_whatever_the_screen_says(monkeypatch):
    """From the ideal one that is known, where it is; none of a softer one again."""
    bound = diagnosis_problem(replace(recording_of(), torques=None), PENDULUM)
    path, stray = data_path(bound)
    none = refine(bound, (), {}, path, LOOSE)
    tissue, roll = (next(e for e in considered(bound) if e.name == name) for name in ("soft_tissue", "camera_roll"))
    common = unknowns(bound, ())
    screened = screen(bound, bound.model, path, [tissue, roll], common, common.mean)
    nothing = next(s.log_evidence for s in screened if s.effect is None)
    screened = [replace(s, log_evidence=nothing, dprime=50.0) for s in screened]
    room, asked = sys.modules[refine_promising.__module__], []
    monkeypatch.setattr(room, "refine", lambda _, effects, *more, **given: replace(none, effects=effects))
    monkeypatch.setattr(room, "softer", lambda _, cause, mine: asked.append((cause.effects[0].softness, mine.key)))
    known = [replace(none, effects=(tissue,)), replace(none, effects=(roll.softened(),))]
    for pool, expected in (([], [tissue.key, roll.key]), (known, [tissue.key])):
        asked.clear()
        refine_barred(bound, HypothesisPool([], {c.key: c for c in (none, *pool)}, [], path, stray), none, screened)
        assert sorted(asked) == sorted((0, key) for key in expected)


@pytest.mark.parametrize(("second", "refined"), [(400.0, 1), (600.0, 2)])
def test_one_that_stands_out_is_refined_alone_first(monkeypatch, second, refined):
    """Where it leaves nothing, one that gained less than half as much is spared."""
    bound = diagnosis_problem(recording_of(), PENDULUM)
    path, stray = data_path(bound)
    none = refine(bound, (), {}, path, LOOSE)
    none = replace(none, by_size=np.where(np.arange(len(none.by_size)) == 0, -1e4, 0.0))  # it leaves something
    some = [e for e in considered(bound) if e.name in ("coulomb_friction", "camera_roll")]
    common = unknowns(bound, ())
    screened = screen(bound, bound.model, path, some, common, common.mean)
    nothing = next(s.log_evidence for s in screened if s.effect is None)
    gains = dict(zip((e.key for e in some), (1000.0, second), strict=True))
    screened = [replace(s, log_evidence=nothing + (gains[s.effect.key] if s.effect else 0.0)) for s in screened]
    screened = sorted(screened, key=lambda s: -s.log_evidence)
    tried = []

    def refined_one(problem, effects, values, path, size, **given):
        tried.append(effects[0].key)
        settled = np.where(np.arange(len(none.by_size)) == 0, 0.0, -1e4)
        return replace(none, effects=effects, log_evidence=none.log_evidence + 1000, by_size=settled)

    monkeypatch.setattr(sys.modules[refine_promising.__module__], "refine", refined_one)
    refine_promising(bound, HypothesisPool(considered(bound), {"": none}, [], path, stray), none, screened, 9)
    assert len(tried) == refined


@pytest.mark.parametrize("plausible", [True, False])
def test_what_needs_implausible_values_is_refined_in_its_softer_form(monkeypatch, plausible):
    """A stop from values as deep, a friction from a short settling time; the others have no such form."""
    bound = diagnosis_problem(recording_of(), PENDULUM)
    path, stray = data_path(bound)
    none = refine(bound, (), {}, path, LOOSE)
    names = {"joint_limit": ["softness"], "coulomb_friction": ["settling", "creep"], "viscous_friction": []}
    some = [e for e in considered(bound) if e.name in names and "lower" not in e.where]
    common = unknowns(bound, ())
    screened = screen(bound, bound.model, path, some, common, common.mean)
    screened = [replace(s, log_evidence=1e3 if s.effect else 0.0) for s in screened]
    tried = {e.name: [] for e in some}

    def refined_one(problem, effects, values, path, size, **given):
        (effect,) = effects
        tried[effect.name].append((effect.soft, values, size))
        mine = {f"{effect.key}.{p.name}": 0.3 for p in effect.parameters(bound.model.scale)}
        return replace(
            none,
            effects=effects,
            names=tuple(mine),
            mean=np.array(list(mine.values())),
            plausible=plausible or effect.soft,
        )

    monkeypatch.setattr(sys.modules[refine_promising.__module__], "refine", refined_one)
    found = HypothesisPool(some, {"": none}, [], path, stray)
    refine_promising(bound, found, none, screened, 9)
    for effect in some:
        softer = names[effect.name] if not plausible else []
        assert [soft for soft, _, _ in tried[effect.name]] == [False] + [True] * bool(softer)
        if softer:
            _, values, size = tried[effect.name][1]
            ideal = {p.name: 0.3 for p in effect.parameters(bound.model.scale)}
            expected = effect.softened().as_soft(ideal)
            assert values == {f"{effect.key}.{name}": value for name, value in expected.items()}
            assert list(expected) == [*ideal, *softer]
            assert size >= SOFTENED
        assert (effect.key in found.pool) == (plausible or bool(softer))
