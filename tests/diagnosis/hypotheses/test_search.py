"""Forward selection over sets of causes."""

import sys
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from pendulum import ARM, LOOSE, MANY, PENDULUM, recording_of
from variants import nonideal

from invdyn.diagnosis.hypotheses.add import add
from invdyn.diagnosis.hypotheses.continuation import data_path
from invdyn.diagnosis.hypotheses.pool import HypothesisPool, considered
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.hypotheses.regression_start import Start
from invdyn.diagnosis.hypotheses.search import (
    climb_moves,
    exchange,
    extend,
    moves_of,
    refine_tracker_errors,
    search,
    thin,
)
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.rules import DEFAULT
from invdyn.models.effects import EFFECTS
from invdyn.simulate import random_arm, record


@cache
def searched(name=None, *where, left_out=(), **values) -> HypothesisPool:
    bound = diagnosis_problem(recording_of(EFFECTS[name](*where) if name else None, **values), PENDULUM)
    return search(bound, *data_path(bound), left_out)


def test_no_gap_wins_where_there_is_none():
    found = searched()
    assert found.ranked[0].key == ""
    assert found.ranked[0].by_size.argmax() == 0
    assert len(found.pool) < 10  # nothing is missing that every effect would have to be tried for
    assert {s.effect.key for s in found.first if s.effect} <= {e.key for e in found.candidates}


def test_friction_is_named():
    found = searched("viscous_friction", "pivot", left_out=MANY, damping=0.05)
    best = found.ranked[0]
    assert best.key == "viscous_friction.pivot"
    assert abs(best.mean[0] - 0.05) < 4 * best.sd[0]
    assert found.score(best) > found.score(found.pool[""]) + 5
    screened = [s for s in found.first if s.effect is not None]
    assert [s.log_evidence for s in screened] == sorted((s.log_evidence for s in screened), reverse=True)
    # The screen has it in front already, and would have seen it at its usual size.
    place = [s.effect.key for s in screened].index("viscous_friction.pivot")
    assert place < 2
    assert screened[place].dprime > 10


@pytest.mark.long
def test_tissue_that_swings_is_found_whatever_the_torque():
    """As it is seen along the data's path, tissue that follows at once explains nothing of it."""
    tissue = nonideal(EFFECTS["soft_tissue"]("elbow"))
    values = {"kappa": 0.005, "damping_ratio": 0.36}
    arm = random_arm(ARM, duration=2.0, fps=50, noise=0.0004, torque_scale=0.5, commanded=True, seed=1)
    given = {f"effect.{tissue.key}.{name}": torch.tensor([v], dtype=torch.float64) for name, v in values.items()}
    recording = replace(record(arm.with_effects(tissue).replace(**given), 1)[0], torques=None)
    bound = diagnosis_problem(recording, ARM)
    found = search(bound, *data_path(bound), [name for name in EFFECTS if name not in (tissue.name, "keypoint_offset")])
    best = found.ranked[0]
    assert best.key == tissue.key
    assert best.effects[0].variant == 1
    assert best.log_evidence > found.pool["keypoint_offset.elbow"].log_evidence + 1000
    assert np.all(np.abs(best.mean - list(values.values())) < 4 * best.sd)


@pytest.mark.long
def test_no_more_effects_at_once_than_asked_for():
    """Where two are at work, both are found, and one alone where no more are asked for, which leaves something."""
    damped, spring = EFFECTS["viscous_friction"]("pivot"), EFFECTS["joint_stiffness"]("pivot")
    values = {f"{damped.key}.damping": 0.05, f"{spring.key}.stiffness": 1.0, f"{spring.key}.torque": 0.2}
    arm = random_arm(PENDULUM, duration=1.6, fps=50, noise=0.002, torque_scale=0.5, commanded=True, seed=0)
    given = {f"effect.{name}": torch.tensor([value], dtype=torch.float64) for name, value in values.items()}
    bound = diagnosis_problem(record(arm.with_effects(damped, spring).replace(**given), 0)[0], PENDULUM)
    start, few = data_path(bound), {damped.name, spring.name, "payload", "camera_scale"}
    struck = [name for name in EFFECTS if name not in few]
    alone = replace(bound, rules=bound.rules.replace(max_effects=1))
    one = search(alone, *start, struck)
    assert one.rules.search.max_effects == 1  # no prior for another beside it
    assert {len(cause.effects) for cause in one.pool.values()} == {0, 1}
    assert not one.ranked[0].complete
    pair = replace(bound, rules=bound.rules.replace(max_effects=2))
    both = search(pair, *start, struck).ranked[0]
    assert {effect.key for effect in both.effects} == {damped.key, spring.key}
    assert both.complete


@pytest.mark.long
def test_what_imitates_one_of_two_gives_way_while_the_other_stays():
    """Where drag has arrived beside an added rotor, friction takes its place, as it does beside the rotor alone."""
    by_name = {e.name: e for e in considered(diagnosis_problem(recording_of(), PENDULUM))}
    friction, drag, rotor = (by_name[name] for name in ("viscous_friction", "quadratic_drag", "armature"))
    arm = random_arm(PENDULUM, duration=2.4, fps=50, noise=0.002, torque_scale=0.5, commanded=True, seed=0)
    values = {f"effect.{friction.key}.damping": 0.05, f"effect.{rotor.key}.inertia": 0.02}
    given = {name: torch.tensor([value], dtype=torch.float64) for name, value in values.items()}
    bound = diagnosis_problem(record(arm.with_effects(friction, rotor).replace(**given), 0)[0], PENDULUM)
    path, stray = data_path(bound)
    bound = bound.shaped(path)
    none, other = (refine(bound, effects, {}, path, LOOSE) for effects in ((), (drag, rotor)))
    found = HypothesisPool(bound, [friction, drag, rotor], {"": none, other.key: other}, [], path, stray)
    assert found.ranked[0] is other
    climb_moves(found)
    best = found.ranked[0]
    assert {effect.key for effect in best.effects} == {friction.key, rotor.key}
    assert [best.values[name.removeprefix("effect.")] for name in values] == pytest.approx([0.05, 0.02], rel=0.15)


@pytest.mark.long
def test_where_torques_are_unknown_the_motion_has_no_cause(monkeypatch):
    """Not even play, which no screen ranks: an unknown torque could do what it does, and nobody looks for it."""
    tried = []
    module = sys.modules[add.__module__]
    monkeypatch.setattr(module, "refine_searched", lambda *given: tried.append(given[2].name))
    arm = recording_of(EFFECTS["backlash"]("pivot"), width=0.1)
    for torques, looked in ((None, False), (0 * arm.torques, True)):
        tried.clear()
        bound = diagnosis_problem(replace(arm, torques=torques), PENDULUM)
        found = search(bound, *data_path(bound), [name for name in MANY if name != "backlash"])
        assert ("backlash" in tried) is looked
        if torques is None:
            assert all(e.sensor for cause in found.pool.values() for e in cause.effects)


@cache
def parts():
    """A pool of "no effect", two single effects, a pair and three, all of which leave something; and who is who."""
    bound = diagnosis_problem(recording_of(), PENDULUM)
    path, _ = data_path(bound)
    none = refine(bound, (), {}, path, LOOSE, rounds=1)
    effects = {e.name: e for e in considered(bound) if e.name in ("payload", "viscous_friction", "armature")}
    a, b, c = effects.values()
    left = np.where(np.arange(len(none.by_size)) == 0, -100.0, 0.0)
    of = {
        name: replace(none, effects=of, by_size=left, log_evidence=nats)
        for name, of, nats in (
            ("", (), 0.0), ("a", (a,), 100.0), ("b", (b,), 90.0), ("bc", (b, c), 150.0), ("abc", (a, b, c), 300.0),
        )
    }  # fmt: skip
    return bound, list(effects.values()), of, path


@pytest.mark.parametrize(
    ("best", "complete", "swapped", "most", "moves"),
    [
        ("", False, False, 4, ["add "]),
        ("a", True, False, 4, ["add a", "exchange a"]),  # a small one may be hidden
        ("a", True, True, 4, ["exchange a"]),
        ("a", False, True, 4, ["add a", "exchange a"]),
        ("a", False, True, 1, ["exchange a"]),
        ("bc", False, False, 4, ["drop bc", "add a", "add bc", "exchange bc"]),
        ("bc", True, True, 4, ["drop bc", "add a", "exchange bc"]),  # beside the one, another might do better
        ("ab", True, True, 4, ["drop ab", "exchange ab"]),
        ("abc", True, True, 4, ["drop abc", "add a", "exchange abc"]),  # and here one might be enough
        ("abc", False, False, 3, ["drop abc", "add a", "exchange abc"]),
    ],
)
def test_the_best_cause_is_left_smaller_larger_or_exchanged(best, complete, swapped, most, moves):
    """Those that imitate two whatever their sizes must not stand in the way of what is beside one of them."""
    bound, candidates, of, path = parts()
    name = {cause.key: each for each, cause in of.items()}
    pool = {cause.key: cause for each, cause in of.items() if len(each) <= 1}
    given = of.get(best) or replace(of["bc"], effects=(*of["a"].effects, *of["b"].effects))
    name[given.key] = best
    by_size = np.where((np.arange(len(given.by_size)) == 0) == complete, 0.0, -100.0)
    pool[given.key] = replace(given, log_evidence=500.0 if best else 0.0, by_size=by_size)
    bound = replace(bound, rules=bound.rules.replace(max_effects=most))
    found = HypothesisPool(bound, candidates, pool if best else {given.key: given}, [], path, False)
    made = moves_of(found, {(exchange, "")} if swapped else set())
    assert [f"{move.__name__} {name[base.key]}" for move, base in made] == moves


def test_no_move_is_made_twice_and_what_is_better_moves_next(monkeypatch):
    bound, candidates, of, path = parts()
    name = {cause.key: each for each, cause in of.items()}
    found = HypothesisPool(bound, candidates, {"": of[""]}, [], path, False)
    asked, finds = [], {"add ": ["a", "b"], "exchange a": ["abc"], "drop abc": ["bc"]}
    for move in ("drop", "add", "exchange"):

        def made(pool, base, move=move):
            asked.append(f"{move} {name[base.key]}")
            for each in finds.get(asked[-1], ()):
                pool.add(of[each])

        monkeypatch.setattr(sys.modules[search.__module__], move, made)
    climb_moves(found)
    assert asked == ["add ", "add a", "exchange a", "drop abc", "add abc", "exchange abc"]


@pytest.mark.parametrize(
    ("truth", "twin", "parameter", "value"),
    [
        ("gravity_tilt", "camera_roll", "angle", 0.1),
        pytest.param("actuator_delay.pivot", "camera_latency", "delay", 0.015, marks=pytest.mark.slow),
    ],
)
def test_exact_twins_stand_side_by_side(truth, twin, parameter, value):
    name, *where = truth.split(".")
    others = tuple(each for each in MANY if each not in (name, twin))
    where = where if EFFECTS[name].site != "arm" else ()
    found = searched(name, *where, left_out=others, **{parameter: value})
    keys = [cause.key for cause in found.ranked]
    first, second = (next(c for c in found.ranked if c.key.split(".")[0] == k.split(".")[0]) for k in (truth, twin))
    assert abs(first.mean[0] - value) < 4 * first.sd[0]
    # What is left between them is how likely their priors hold such a size.
    priors = [cause.effects[0].parameters(cause.model.scale)[0].prior for cause in (first, second)]
    unlike = [float(prior.log_prob(prior.mean.new_tensor(value))) for prior in priors]
    assert first.log_evidence - second.log_evidence == pytest.approx(unlike[0] - unlike[1], abs=0.5)
    assert {first.key, second.key} <= set(keys[:3])


@pytest.mark.long
def test_stray_detections_are_explained_before_anything_else(monkeypatch):
    """Under them nothing else can be told; what is refined is what may stand beside them."""
    arm = random_arm(ARM, duration=3.0, fps=50, noise=0.001, torque_scale=1.0, commanded=True, seed=4)
    recording = record(arm, 4)[0]
    points = recording.keypoints.copy()
    swapped = np.random.default_rng(1).random(len(points)) < 0.06
    points[swapped] = points[swapped][:, ::-1]
    bound = diagnosis_problem(replace(recording, keypoints=points), ARM)
    path, stray = data_path(bound)
    bases = []
    extending = sys.modules[add.__module__]
    plain = extending.refine_best
    monkeypatch.setattr(
        extending, "refine_best", lambda found, base, *rest: bases.append(base.key) or plain(found, base, *rest)
    )
    found = search(bound, path, stray)
    assert found.ranked[0].key == "label_swap.elbow.wrist"
    assert found.ranked[0].complete
    assert bases[0] == "label_swap.elbow.wrist"


BENDING = EFFECTS["link_flexibility"]("forearm")


@cache
def bending():
    """Setting and path of an arm whose forearm bends so much that the wrist strays from where a rigid one has it."""
    recording = recording_of(BENDING, ARM, effort=1.0, seed=2, stiffness=0.7, damping=0.0014)
    bound = diagnosis_problem(recording, ARM)
    return bound, *data_path(bound)


@pytest.mark.long
def test_what_bends_by_much_is_no_stray_detection():
    """It explains hundreds of nats by itself, which no stray detections do, whatever errors remember."""
    bound, path, stray = bending()
    assert stray
    found = search(bound, path, stray, [name for name in MANY if name not in ("outliers", BENDING.name)])
    assert found.ranked[0].key == BENDING.key
    assert found.ranked[0].complete
    others = [cause.log_evidence for cause in found.pool.values() if BENDING.key not in cause.key]
    assert found.ranked[0].log_evidence > max(others) + 300
    # The screen that the report shows is of single effects, with nothing beside them.
    assert BENDING.key in [screened.effect.key for screened in found.first[:2]]
    assert next(s for s in found.first if s.effect is None).log_evidence < found.ranked[0].log_evidence - 300


@pytest.mark.parametrize(
    ("strays", "cleared", "gain", "complete", "taken"),
    [
        (True, False, 500.0, True, True),
        (True, False, 500.0, False, False),  # what it leaves may be the stray detections
        (True, False, -500.0, True, False),
        (True, True, 500.0, True, None),  # where stray detections leave nothing, nobody looks
        (False, False, 500.0, True, None),  # and where there are none, all are looked at anyway
    ],
)
def test_only_what_leaves_nothing_stands_instead_of_stray_detections(
    monkeypatch, strays, cleared, gain, complete, taken
):
    bound, path, stray = bending()
    module, asked, screened = sys.modules[search.__module__], [], [None]
    none = refine(bound, (), {}, path, LOOSE, rounds=1)
    outliers, limit = (next(e for e in considered(bound) if e.name == name) for name in ("outliers", "joint_limit"))

    def like(complete, *effects, nats):
        by_size = np.where((np.arange(len(none.by_size)) == 0) == complete, 0.0, -100.0)
        return replace(none, effects=effects, log_evidence=none.log_evidence + nats, by_size=by_size)

    mistaken = like(cleared, outliers, nats=200.0 if strays else -200.0)
    found = HypothesisPool(bound, [outliers, limit], {"": like(False, nats=0.0)}, [], path, stray, simulation_path=path)

    def promising(pool, base, given, width):
        asked.append((base.key, given, width))
        pool.add(like(complete, limit, nats=200.0 + gain))

    monkeypatch.setattr(module, "refine_searched", lambda *_: mistaken)
    monkeypatch.setattr(module, "screened_with", lambda *_: screened)
    monkeypatch.setattr(module, "refine_best", promising)
    refine_tracker_errors(found)
    assert asked == ([] if taken is None else [("", screened, DEFAULT.search.max_candidates_for_outliers)])
    assert (limit.key in found.pool) is bool(taken)
    assert found.first == (screened if taken else [])


def test_what_is_usual_is_dropped_at_all_its_places(monkeypatch):
    """And what is odd stays; a set that leaves nothing is only made smaller."""
    tried, added = [], []
    module = sys.modules["invdyn.diagnosis.hypotheses.search"]

    def refined(_, effects, values, *rest, **options):
        tried.append((effects, values))
        return options

    monkeypatch.setattr(module, "refine", refined)
    usual = [EFFECTS[name](joint) for name in ("viscous_friction", "armature") for joint in ("shoulder", "elbow")]
    every = [*usual, EFFECTS["joint_stiffness"]("elbow")]
    values = {f"{effect.key}.number": 1.0 for effect in every}
    best = SimpleNamespace(effects=tuple(every), values=values, path=None, searched={"of": 1}, key="", complete=True)
    regime = SimpleNamespace(knows_torque=True)
    found = SimpleNamespace(
        problem=SimpleNamespace(min_size=0.0, regime=regime),
        everywhere=frozenset({"viscous_friction", "armature", "coulomb_friction"}),
        **{"add": added.append, "best": best, "first": [1]},
    )
    assert [move for move, _ in moves_of(found, ())] == [thin]
    best.complete = False
    assert [move for move, _ in moves_of(found, ())] == [extend, thin]
    thin(found, best)
    kept = [{effect.key for effect in effects} for effects, _ in tried]
    left = "joint_stiffness.elbow"
    assert kept == [{f"{name}.shoulder", f"{name}.elbow", left} for name in ("viscous_friction", "armature")]
    assert all(set(own) == {f"{key}.number" for key in keys} for keys, (_, own) in zip(kept, tried, strict=True))
    assert added == 2 * [best.searched]


def test_a_start_is_refined_with_what_else_is_stated_and_without(monkeypatch):
    """Of effects that are looked for; what gains nothing, or is not plausible, is left alone."""
    module = sys.modules[search.__module__]
    usual, odd, other = (EFFECTS[name]("elbow") for name in ("armature", "joint_stiffness", "viscous_friction"))
    values = {f"{effect.key}.number": 1.0 for effect in (usual, odd, other)}
    monkeypatch.setattr(module, "climb_moves", lambda found: None)
    monkeypatch.setattr(module, "considered", lambda *_: None)

    def begun(start, nats=1.0, plausible=True):
        tried, kept = [], []
        none = SimpleNamespace(log_evidence=0.0)
        bound = SimpleNamespace(
            budget=SimpleNamespace(share=0.0, missed=set()), rules=DEFAULT, regime=SimpleNamespace(path_size=0.0)
        )
        found = SimpleNamespace(
            problem=bound, candidates=[usual, odd], pool={"": none}, path=None, everywhere=frozenset(), add=kept.append
        )

        def refined(_, effects, own, *rest):
            tried.append(([effect.key for effect in effects], set(own)))
            return SimpleNamespace(plausible=plausible, log_evidence=nats)

        monkeypatch.setattr(module, "refine", refined)
        monkeypatch.setattr(module, "_initial_pool", lambda *_: found)
        search(bound, None, False, start=start)
        return tried, len(kept), found.everywhere, bound.budget.share

    rules, names = DEFAULT.search, frozenset({"armature"})
    alone, both = (([e.key for e in of], {f"{e.key}.number" for e in of}) for of in ((usual,), (usual, odd)))
    start = Start((usual, other), values, names, (odd,))
    assert begun(start) == ([alone, both], 2, names, rules.started_share)
    assert begun(replace(start, others=())) == ([alone], 1, names, rules.started_share)
    for doubt in ({"nats": -1.0}, {"plausible": False}):
        assert begun(start, **doubt) == ([alone, both], 0, frozenset(), rules.search_share)
    assert begun(Start()) == ([], 0, frozenset(), rules.search_share)
