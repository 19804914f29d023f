"""Neighbours of what was found: twins, special cases, variants, and what it may be taken for."""

import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
from pendulum import ARM, LOOSE, PENDULUM, recording_of
from variants import nonideal

from invdyn.diagnosis.catalogue import CATALOGUE
from invdyn.diagnosis.catalogue.neighbours import Neighbour
from invdyn.diagnosis.hypotheses.continuation import data_path
from invdyn.diagnosis.hypotheses.pool import HypothesisPool, considered
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.hypotheses.swap import follow_neighbours, instead
from invdyn.diagnosis.problem.cause import of_effect
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.rules import DEFAULT
from invdyn.models.effects import EFFECTS
from invdyn.simulate import random_arm

SWAP = sys.modules[follow_neighbours.__module__]


@pytest.mark.quick("*-two joints")
@pytest.mark.parametrize("body", [PENDULUM, ARM], ids=["one joint", "two joints"])
@pytest.mark.parametrize(("name", "parameter"), [("actuator_delay", "delay"), ("camera_latency", "latency")])
def test_the_twin_of_a_delay_starts_from_the_path_of_the_other(monkeypatch, name, parameter, body):
    """On one joint the motors' delay is that of its motor."""
    bound = diagnosis_problem(recording_of(body=body), body)
    path, stray = data_path(bound)
    none, candidates = refine(bound, (), {}, path, LOOSE, rounds=1), considered(bound)
    one = next(e for e in candidates if e.name == name)
    cause = replace(
        none, effects=(one,), names=(f"{one.key}.{parameter}",), mean=np.array([0.03]), covariance=np.array([[1e-6]])
    )
    started = []
    monkeypatch.setattr(
        SWAP,
        "refine",
        lambda s, effects, values, path, *_, **__: started.append(path),
    )
    follow_neighbours(HypothesisPool(bound, candidates, {"": none, one.key: cause}, [], path, stray), 1)
    assert torch.equal(started[0], cause.path)
    assert torch.equal(started[1], path)
    # Followed once: not again before it has gained something.
    tried = len(started)
    pool = HypothesisPool(bound, candidates, {"": none, one.key: cause}, [], path, stray)
    follow_neighbours(pool, 1)
    assert len(started) == 2 * tried
    follow_neighbours(pool, 1)
    assert len(started) == 2 * tried
    pool.pool[one.key] = replace(cause, log_evidence=cause.log_evidence + 2 * DEFAULT.search.equal_gain)
    follow_neighbours(pool, 1)
    assert len(started) == 3 * tried


@pytest.mark.long
def test_a_special_case_that_is_behind_is_refined_from_the_wider_effect():
    truth, wide = (EFFECTS[name]("pivot") for name in ("coulomb_friction", "stribeck_friction"))
    bound = diagnosis_problem(recording_of(truth, torque=0.06, rows=140), PENDULUM)
    path, stray = data_path(bound)
    start = {f"{wide.key}.coulomb": 0.06, f"{wide.key}.static": 0.06}
    none, narrow, wider = (
        refine(bound, effects, values, path, LOOSE) for effects, values in (((), {}), ((truth,), {}), ((wide,), start))
    )
    lost = replace(narrow, log_evidence=wider.log_evidence - 10)
    found = HypothesisPool(bound, considered(bound), {c.key: c for c in (none, lost, wider)}, [], path, stray)
    follow_neighbours(found, 1)
    assert found.pool[truth.key].log_evidence > wider.log_evidence
    assert abs(found.pool[truth.key].mean[0] - 0.06) < 4 * narrow.sd[0]
    assert found.followed == {truth.key: wider.log_evidence}
    arrived = HypothesisPool(bound, considered(bound), {c.key: c for c in (none, narrow, wider)}, [], path, stray)
    follow_neighbours(arrived, 1)
    assert not arrived.followed


@pytest.mark.long
def test_a_wider_law_is_followed_from_where_it_is_the_narrower_one(monkeypatch):
    """From elsewhere Gauss–Newton has lost its way; where it leaves nothing already, it is not followed."""
    monkeypatch.setattr(SWAP, "regularised", lambda *_, **__: None)
    truth = EFFECTS["stribeck_friction"]("pivot")
    bound = diagnosis_problem(recording_of(truth, coulomb=0.04, static=0.12, velocity=1.0, rows=140), PENDULUM)
    path, stray = data_path(bound)
    none = refine(bound, (), {}, path, LOOSE)
    narrow = refine(bound, (EFFECTS["coulomb_friction"]("pivot"),), {}, path, LOOSE)
    names = tuple(f"{truth.key}.{name}" for name in ("coulomb", "static", "velocity"))
    lost = replace(narrow, effects=(truth.bound(PENDULUM),), log_evidence=narrow.log_evidence - 1)
    lost = replace(lost, names=names, mean=np.array([0.04, 0.3, 1.0]), covariance=1e-6 * np.eye(3))
    assert not narrow.complete
    pool = {cause.key: cause for cause in (none, narrow, lost)}
    found = HypothesisPool(bound, considered(bound), pool, [], path, stray)
    follow_neighbours(found, 1)
    cause = found.pool[truth.key]
    assert cause.complete
    assert np.all(np.abs(cause.mean - [0.04, 0.12, 1.0]) < 4 * cause.sd)
    assert found.followed[truth.key] == narrow.log_evidence
    there = HypothesisPool(bound, considered(bound), {**pool, truth.key: cause}, [], path, stray)
    follow_neighbours(there, 1)
    assert truth.key not in there.followed


@pytest.mark.quick("slides")
@pytest.mark.parametrize("form", [(), ("sliding",)], ids=["lags", "slides"])
def test_a_link_that_bends_is_refined_from_the_soft_tissue_that_it_looks_like(monkeypatch, form):
    """In place of tissue at its own tip, in the best cause alone, and once."""
    monkeypatch.setattr(SWAP, "regularised", lambda *_, **__: None)
    truth = EFFECTS["link_flexibility"]("forearm").bound(ARM)
    stiffness, damping = truth.parameters(random_arm(ARM, duration=0.1, fps=50).scale)
    values = {"stiffness": stiffness.grid[2], "damping": damping.grid[0]}
    bound = diagnosis_problem(recording_of(truth, body=ARM, rows=100, **values), ARM)
    path, stray = data_path(bound)
    none = refine(bound, (), {}, path, LOOSE)
    tissue = refine(bound, (EFFECTS["soft_tissue"]("wrist", *form),), {}, path, LOOSE)
    elsewhere = refine(bound, (EFFECTS["soft_tissue"]("elbow", *form),), {}, path, LOOSE)
    best = replace(tissue, log_evidence=max(tissue.log_evidence, none.log_evidence + 20))
    found = HypothesisPool(bound, considered(bound), {c.key: c for c in (none, best)}, [], path, stray)
    follow_neighbours(found, 1)
    cause = found.pool[truth.key]
    assert found.ranked[0] is cause
    assert cause.log_evidence > tissue.log_evidence + 10
    assert cause.values[f"{truth.key}.stiffness"] == pytest.approx(values["stiffness"], rel=0.1)
    once = dict(found.followed)
    assert once[truth.key] == best.log_evidence
    follow_neighbours(found, 1)
    assert found.followed == once
    other = replace(elsewhere, log_evidence=best.log_evidence)
    for pool in ((none, other), (replace(none, log_evidence=best.log_evidence + 100), best)):
        found = HypothesisPool(bound, considered(bound), {c.key: c for c in pool}, [], path, stray)
        follow_neighbours(found, 1)
        assert truth.key not in found.pool


@pytest.mark.slow
def test_load_friction_is_found_from_the_friction_that_stands_in_for_it():
    """From that one's level: where joints stick, the slope near none of it says little."""
    stand_in, friction = (EFFECTS[name]("pivot").bound(PENDULUM) for name in ("coulomb_friction", "load_friction"))
    bound = diagnosis_problem(recording_of(friction, rows=120, coefficient=0.2), PENDULUM)
    path, stray = data_path(bound)
    none, other = (refine(bound, effects, {}, path, LOOSE) for effects in ((), (stand_in,)))
    found = HypothesisPool(bound, [stand_in, friction], {c.key: c for c in (none, other)}, [], path, stray)
    follow_neighbours(found, 1)
    cause = found.ranked[0]
    assert cause.key == friction.key
    assert cause.complete
    assert abs(cause.mean[0] - 0.2) < 4 * cause.sd[0]
    starts = CATALOGUE.of(stand_in).starts["load_friction"]
    assert not starts(stand_in, EFFECTS["load_friction"]("other"), {}, bound.model.scale)
    assert not CATALOGUE.of(friction).starts


def test_another_form_of_an_effect_keeps_its_values_where_one_is_swapped(monkeypatch):
    """The key of the one is what the key of the other begins with."""
    places = ("soft_tissue", "wrist"), ("soft_tissue", "wrist", "sliding"), ("link_flexibility", "forearm")
    swings, slides, bends = (EFFECTS[name](*where).bound(ARM) for name, *where in places)
    bound = diagnosis_problem(recording_of(body=ARM), ARM)
    path, _ = data_path(bound)
    none, started = refine(bound, (), {}, path, LOOSE, rounds=1), []
    names = tuple(f"{each.key}.{p.name}" for each in (swings, slides) for p in each.parameters(bound.model.scale))
    values = np.arange(1.0, len(names) + 1)
    both = replace(none, effects=(swings, slides), names=names, mean=values, covariance=np.eye(len(names)))
    monkeypatch.setattr(SWAP, "refine", lambda _, effects, values, *__, **___: started.append((effects, values)))
    instead(bound, both, swings, bends, {"stiffness": 7.0}, path, LOOSE)
    ((effects, begun),) = started
    assert effects == (slides, bends)
    assert begun[f"{bends.key}.stiffness"] == 7.0
    for form in (swings, slides):
        assert of_effect(form, both.values).keys() == {p.name for p in form.parameters(bound.model.scale)}
    assert of_effect(slides, begun) == of_effect(slides, both.values)


def test_neighbours_of_what_a_neighbour_found_are_followed(monkeypatch):
    """In a chain of three, each of which knows the next alone."""
    chain = [
        EFFECTS[name]("pivot").bound(PENDULUM) for name in ("viscous_friction", "quadratic_drag", "joint_stiffness")
    ]
    next_of = dict(zip((e.key for e in chain), chain[1:], strict=False))

    def neighbours(mine, *_):
        return [Neighbour(next_of[mine.key], "twin", [{}])] if mine.key in next_of else []

    monkeypatch.setattr(SWAP, "neighbours", neighbours)
    bound = diagnosis_problem(recording_of(chain[0], damping=0.05), PENDULUM)
    bound = replace(bound, rules=DEFAULT.replace(large_screen_error=1e6))
    path, stray = data_path(bound)
    none, first = (refine(bound, effects, {}, path, LOOSE) for effects in ((), chain[:1]))
    found = HypothesisPool(bound, chain, {c.key: c for c in (none, first)}, [], path, stray)
    follow_neighbours(found, 1)
    assert {effect.key for effect in chain} <= found.pool.keys()


@pytest.mark.long
def test_what_ideal_friction_leaves_is_followed_by_its_variant(monkeypatch):
    """Under the same key, the better one stays; where the ideal one leaves nothing, it is not looked for."""
    ideal = EFFECTS["coulomb_friction"]("pivot")
    soft, given = nonideal(ideal), {"torque": 0.1, "settling": 0.033, "creep": 0.003}
    bound = diagnosis_problem(recording_of(soft, effort=0.3, rows=200, **given), PENDULUM)
    path, stray = data_path(bound)
    none, hard = (refine(bound, effects, {}, path, LOOSE) for effects in ((), (ideal,)))
    assert not hard.complete
    own = [effect for effect in considered(bound) if effect.key == ideal.key]
    found = HypothesisPool(bound, own, {"": none, hard.key: hard}, [], path, stray)
    follow_neighbours(found, 1)
    cause = found.pool[ideal.key]
    assert cause.complete
    assert cause.effects[0].variant
    assert cause.names == tuple(f"{soft.key}.{name}" for name in given)
    assert np.all(np.abs(cause.mean - list(given.values())) < 4 * cause.sd)
    assert cause.log_evidence > hard.log_evidence + 10
    assert found.followed[f"{ideal.key} {ideal.key}"] == hard.log_evidence
    # Followed once, and never from what leaves nothing.
    started = []
    monkeypatch.setattr(SWAP, "regularised", lambda _, cause, mine, **__: started.append(cause))
    follow_neighbours(
        HypothesisPool(bound, [], {"": none, hard.key: hard}, [], path, stray, followed=found.followed), 1
    )
    monkeypatch.setattr(SWAP, "show_more", lambda *_: False)
    other = replace(hard, by_size=cause.by_size)
    follow_neighbours(HypothesisPool(bound, [], {"": none, other.key: other}, [], path, stray), 1)
    assert not started


@pytest.mark.parametrize(
    ("number", "gains", "kept"),
    [
        (1, [1.0, 5.0, 3.0, 2.0, 4.0], [1, 4, 2]),
        (2, [1.0, 5.0, 3.0, 2.0], [1]),
        (4, [3.0], []),
        (1, [400.0, 1000.0, 600.0], [1, 2]),  # half of what the best one gains, however far behind it is
    ],
)
def test_variants_are_for_the_best_few_that_have_one(monkeypatch, number, gains, kept):
    bound = diagnosis_problem(recording_of(), PENDULUM)
    path, stray = data_path(bound)
    none, followed = refine(bound, (), {}, path, LOOSE, rounds=1), []
    monkeypatch.setattr(SWAP, "refine_regularised", lambda found, cause: followed.append(cause.key))
    monkeypatch.setattr(SWAP, "swap_each", lambda *_: None)
    left = np.eye(len(none.by_size))[-1] * 20.0  # a residual gains so many nats

    def cause(gain, *effects):
        return replace(none, effects=effects, log_evidence=none.log_evidence + gain, by_size=left)

    rigid, soft = ([e for e in considered(bound) if (nonideal(e) is None) is hard] for hard in (True, False))
    causes = [cause(gain, *soft[i : i + number]) for i, gain in enumerate(gains)]
    stiff = cause(max(gains), *rigid[:number])
    follow_neighbours(HypothesisPool(bound, [], {c.key: c for c in (none, stiff, *causes)}, [], path, stray), number)
    assert followed == [causes[i].key for i in kept]


@pytest.mark.parametrize("alike", [True, False])
def test_errors_that_are_alike_ask_for_a_variant_too(monkeypatch, alike):
    """Tissue that rings at 16 Hz leaves no residual torque, which is slower than that."""
    bound = diagnosis_problem(recording_of(), PENDULUM)
    path, stray = data_path(bound)
    none, followed = refine(bound, (), {}, path, LOOSE, rounds=1), []
    monkeypatch.setattr(SWAP, "refine_regularised", lambda found, cause: followed.append(cause.key))
    monkeypatch.setattr(SWAP, "show_more", lambda *_: alike)
    tissue = next(e for e in considered(bound) if e.name == "soft_tissue")
    nothing_left = np.where(np.arange(len(none.by_size)) == 0, 0.0, -1e4)
    names = tuple(f"{tissue.key}.{p.name}" for p in tissue.parameters(bound.model.scale))
    cause = replace(
        none, effects=(tissue,), names=names, mean=np.array([1e-4]), covariance=np.eye(1),
        log_evidence=none.log_evidence + 50, by_size=nothing_left,
    )  # fmt: skip
    assert cause.complete
    follow_neighbours(HypothesisPool(bound, [], {"": none, cause.key: cause}, [], path, stray), 1)
    assert followed == [cause.key] * alike


@pytest.mark.long
def test_a_relative_of_a_variant_is_as_soft(monkeypatch):
    """The ideal one would leave what the variant was found for, and never come near."""
    truth, wide = (nonideal(EFFECTS[name]("pivot")) for name in ("coulomb_friction", "stribeck_friction"))
    given = {"torque": 0.1, "settling": 0.02, "creep": 0.002}
    bound = diagnosis_problem(recording_of(truth, effort=0.3, rows=140, **given), PENDULUM)
    path, stray = data_path(bound)
    none = refine(bound, (), {}, path, LOOSE)
    values = {"coulomb": 0.1, "static": 0.1, "velocity": 1.0, "settling": 0.02, "creep": 0.002}
    wider = refine(bound, (wide,), {f"{wide.key}.{name}": value for name, value in values.items()}, path, LOOSE)
    monkeypatch.setattr(SWAP, "regularised", lambda *_, **__: None)
    found = HypothesisPool(bound, considered(bound), {"": none, wider.key: wider}, [], path, stray)
    follow_neighbours(found, 1)
    cause = found.pool["coulomb_friction.pivot"]
    assert cause.effects[0].variant
    assert cause.complete
    assert cause.log_evidence > wider.log_evidence
    assert np.all(np.abs(cause.mean - list(given.values())) < 4 * cause.sd)


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "levels"),
    [
        pytest.param("coulomb_friction", {"torque": 0.15}, marks=pytest.mark.slow),
        ("stribeck_friction", {"coulomb": 0.1, "static": 0.2, "velocity": 1.0}),
    ],
)
def test_what_a_friction_that_creeps_leaves_is_followed_by_one_with_bristles(name, levels):
    ideal = EFFECTS[name]("pivot")
    given = {**levels, "bristle_stiffness": 60.0, "bristle_damping": 0.3}
    bound = diagnosis_problem(recording_of(nonideal(nonideal(ideal)), rows=200, **given), PENDULUM)
    path, stray = data_path(bound)
    none, hard = (refine(bound, effects, {}, path, LOOSE) for effects in ((), (ideal,)))
    own = [effect for effect in considered(bound) if effect.key == ideal.key]
    found = HypothesisPool(bound, own, {"": none, hard.key: hard}, [], path, stray)
    follow_neighbours(found, 1)
    cause = found.pool[ideal.key]
    assert not hard.complete
    assert cause.complete
    assert cause.effects[0].variant == 2
    assert cause.names == tuple(f"{ideal.key}.{name}" for name in given)
    assert np.all(np.abs(cause.mean - list(given.values())) < 4 * cause.sd)
    assert cause.log_evidence > hard.log_evidence + 10


def test_each_of_two_effects_is_followed_by_its_variant(monkeypatch):
    bound = diagnosis_problem(recording_of(body=ARM), ARM)
    path, stray = data_path(bound)
    none = refine(bound, (), {}, path, LOOSE, rounds=1)
    both = tuple(e for e in considered(bound) if e.name == "coulomb_friction")
    names = tuple(f"{effect.key}.torque" for effect in both)
    left = np.where(np.arange(len(none.by_size)) == 1, 0.0, -1e3)
    cause = replace(
        none, effects=both, names=names, mean=np.array([0.1, 0.2]), covariance=1e-6 * np.eye(2), by_size=left
    )
    room, tried = SWAP, []
    monkeypatch.setattr(room, "refine", lambda *_, **__: None)
    monkeypatch.setattr(room, "regularised", lambda _, cause, mine, **__: tried.append(mine.key))
    found = HypothesisPool(bound, considered(bound), {"": none, cause.key: cause}, [], path, stray)
    for _ in range(2):
        follow_neighbours(found, 2)
    assert tried == [effect.key for effect in both]
    assert len(both) == 2
