"""One more effect beside a base: which ones are refined or searched for there, and how good they have to be."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from pendulum import LOOSE, PENDULUM, recorded, recording_of
from variants import nonideal

from invdyn.diagnosis.catalogue import CATALOGUE
from invdyn.diagnosis.hypotheses.add import add, refine_best
from invdyn.diagnosis.hypotheses.continuation import data_path
from invdyn.diagnosis.hypotheses.pool import HypothesisPool, considered
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.hypotheses.swap import regularised
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.problem.unknowns import unknowns
from invdyn.diagnosis.rules import DEFAULT
from invdyn.diagnosis.sensitivity.screen import screen
from invdyn.models.effects import EFFECTS


@pytest.mark.quick("False")
@pytest.mark.parametrize("left", [True, False])
def test_what_no_torque_explains_has_a_cause_that_the_camera_shows(monkeypatch, left):
    """Where errors of prediction show that something is left, what a torque's prior is wrong about is no bar to it."""
    module, asked = sys.modules[add.__module__], []
    bound = diagnosis_problem(replace(recording_of(), torques=None), PENDULUM)
    path, stray = data_path(bound)
    none = refine(bound, (), {}, path, bound.regime.path_size, rounds=1)
    monkeypatch.setattr(module, "show_more", lambda *_: left)
    monkeypatch.setattr(module, "best_imitable_evidence", lambda _: none.log_evidence + 500.0)
    monkeypatch.setattr(module, "refine_searched", lambda *given: asked.append(round(given[3] - none.log_evidence)))
    add(HypothesisPool(bound, considered(bound), {"": none}, [], path, stray), none)
    assert set(asked) == {-DEFAULT.search.large_screen_error if left else 500}


@pytest.mark.quick("0.05-*")
@pytest.mark.parametrize(("damping", "large", "looked"), [(0.0, 10.0, True), (0.05, 10.0, False), (0.05, 60.0, True)])
def test_play_is_looked_for_where_no_other_effect_explains_the_gap(monkeypatch, damping, large, looked):
    """A rigid arm follows small play without a residual torque: that nothing is left does not speak against play.

    Friction that explains a ``large`` gap, in nats, does; here it gains 19.
    """
    tried, module = [], sys.modules[add.__module__]
    bound = diagnosis_problem(recorded(damping), PENDULUM)
    bound = replace(bound, rules=DEFAULT.replace(large_screen_error=large))
    path, stray = data_path(bound)
    friction = EFFECTS["viscous_friction"]("pivot")
    none, found = (refine(bound, effects, {}, path, LOOSE) for effects in ((), (friction,)))
    pool = HypothesisPool(bound, considered(bound), {none.key: none}, [], path, stray, simulation_path=path)

    def refined(pool, base, best, width):
        pool.add(found)
        return []

    monkeypatch.setattr(module, "refine_searched", lambda *given: tried.append(given[2].name))
    monkeypatch.setattr(module, "refine_best", refined)
    monkeypatch.setattr(module, "follow_neighbours", lambda *_: None)
    add(pool, none)
    assert pool.ranked[0].complete
    assert ("backlash" in tried) is looked


@pytest.mark.quick("viscous_friction--1.0-0.0-True", "coulomb*")
@pytest.mark.parametrize(
    ("other", "strays", "ahead", "looked"),
    [
        ("viscous_friction", -1.0, 0.0, True),
        ("viscous_friction", -1.0, 200.0, True),
        ("coulomb_friction", -1.0, 0.0, False),
        ("viscous_friction", 100.0, 0.0, False),
    ],
)
def test_play_is_looked_for_beside_one_other_effect_that_does_not_stick(monkeypatch, other, strays, ahead, looked):
    """Where that one leaves something: a spring, which is not in it; however little a grid along its path shows.

    Beside one that is far behind another cause it must make good a tenth of that there. Not where stray detections
    alone explain more than that one does.
    """
    tried, module = [], sys.modules[add.__module__]
    spring = EFFECTS["joint_stiffness"]("pivot")
    bound = diagnosis_problem(recording_of(spring, stiffness=1.0, torque=0.5), PENDULUM)
    path, stray = data_path(bound)
    none, base = (refine(bound, effects, {}, path, LOOSE, rounds=2) for effects in ((), (EFFECTS[other]("pivot"),)))
    assert not base.complete
    monkeypatch.setattr(module, "refine_searched", lambda *given: tried.append((given[2].name, given[3])))
    monkeypatch.setattr(module, "refine_best", lambda *_: [])
    astray = replace(base, effects=(EFFECTS["outliers"]().bound(PENDULUM),), log_evidence=base.log_evidence + strays)
    better = replace(base, effects=(spring.bound(PENDULUM),), log_evidence=base.log_evidence + ahead)
    found = HypothesisPool(bound, considered(bound), {c.key: c for c in (none, astray, base, better)}, [], path, stray)
    add(found, base)
    enough = [least for name, least in tried if name == "backlash"]  # others that join the base gain less than a nat
    assert enough == pytest.approx([base.log_evidence + ahead / 10] * looked, abs=0.5)


@pytest.mark.parametrize(("gain", "barred"), [(25.0, ["rolling_shutter", "soft_tissue"]), (4.0, ["soft_tissue"])])
def test_what_an_unknown_torque_imitates_sets_the_bar(monkeypatch, gain, barred):
    """Only the torque's prior speaks for friction; what gains less than that on the camera's side says no more.

    Of tissue that swings an ideal law, which follows at once, may explain nothing: it has a variant.
    """
    bound = diagnosis_problem(replace(recording_of(), torques=None), PENDULUM)
    path, stray = data_path(bound)
    gains = {"coulomb_friction": 30.0, "rolling_shutter": gain, "lens_distortion": 40.0}
    gains |= {"base_motion": 35.0, "soft_tissue": 0.0}
    some = [e for e in considered(bound) if e.name in gains]
    common = unknowns(bound, ())
    screened = screen(bound, bound.model, path, some, common, common.mean)
    nothing = next(s.log_evidence for s in screened if s.effect is None)
    screened = [replace(s, log_evidence=nothing + gains[s.effect.name]) if s.effect else s for s in screened]
    screened = sorted((replace(s, dprime=50.0) for s in screened), key=lambda s: -s.log_evidence)
    tried, room, left = [], sys.modules[add.__module__], False
    monkeypatch.setattr(room, "refine", lambda *given, **more: tried.append(given[1][0].name))
    monkeypatch.setattr(room, "screened_with", lambda *_: screened)
    monkeypatch.setattr(room, "show_more", lambda *_: left)
    monkeypatch.setattr(room, "refine_searched", lambda *_: None)
    none = refine(bound, (), {}, path, LOOSE)
    add(HypothesisPool(bound, considered(bound), {"": none}, [], path, stray), none)
    assert tried == ["lens_distortion", "base_motion"]  # a base that shakes takes all points along
    # Where something is left under any torque, what is seen is something else, however little the screen says.
    left = True
    add(HypothesisPool(bound, considered(bound), {"": none}, [], path, stray), none)
    assert tried[2:] == ["lens_distortion", "base_motion", *barred]
    # And what was more promising than those is no less worth it for having had no room before.
    bound = replace(bound, rules=DEFAULT.replace(max_candidates_alone=1, max_candidates_added=1))
    tried.clear()
    add(HypothesisPool(bound, considered(bound), {"": none}, [], path, stray), none)
    assert tried == ["lens_distortion", "base_motion", *barred]


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

    monkeypatch.setattr(sys.modules[add.__module__], "refine", refined_one)
    refine_best(HypothesisPool(bound, considered(bound), {"": none}, [], path, stray), none, screened, 9)
    assert len(tried) == refined


@pytest.mark.parametrize("plausible", [True, False])
def test_what_needs_implausible_values_is_refined_in_its_variant(monkeypatch, plausible):
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
        tried[effect.name].append((bool(effect.variant), values, size))
        mine = {f"{effect.key}.{p.name}": 0.3 for p in effect.parameters(bound.model.scale)}
        return replace(
            none,
            effects=effects,
            names=tuple(mine),
            mean=np.array(list(mine.values())),
            plausible=plausible or bool(effect.variant),
        )

    for room in (add, regularised):
        monkeypatch.setattr(sys.modules[room.__module__], "refine", refined_one)
    found = HypothesisPool(bound, some, {"": none}, [], path, stray)
    refine_best(found, none, screened, 9)
    for effect in some:
        more = names[effect.name] if not plausible else []
        assert [soft for soft, _, _ in tried[effect.name]] == [False] + [True] * bool(more)
        if more:
            _, values, size = tried[effect.name][1]
            ideal = {p.name: 0.3 for p in effect.parameters(bound.model.scale)}
            expected = CATALOGUE.of(effect).start(nonideal(effect), ideal)
            assert values == {f"{effect.key}.{name}": value for name, value in expected.items()}
            assert list(expected) == [*ideal, *more]
            assert size >= DEFAULT.search.min_variant_size
        assert (effect.key in found.pool) == (plausible or bool(more))
