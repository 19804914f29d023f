"""How far the gap closes on held-out rows, with an interval that respects serial correlation."""

import sys
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from pendulum import DAMPING, FRICTION, LOOSE, PENDULUM, causes, path_of, recorded

from invdyn.diagnosis import diagnose
from invdyn.diagnosis.assessment.findings import key
from invdyn.diagnosis.assessment.gap_closure import Closed, all_confirmed, by_effect, closed, split, unseen
from invdyn.diagnosis.hypotheses.pool import HypothesisPool
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.prediction.predict import Scores, scores
from invdyn.diagnosis.problem.diagnosis_problem import CannotFollow, diagnosis_problem
from invdyn.diagnosis.rules import DEFAULT
from invdyn.models.effects import EFFECTS
from invdyn.recordings import InputError
from invdyn.simulate import random_arm, record


def test_the_last_third_is_held_out():
    here, none, cause = causes()
    train, rows = split(here)
    assert np.flatnonzero(rows).tolist() == list(range(53, 80))
    assert torch.equal(train.observations, here.observations[:53])
    last = unseen(here, none, cause)
    assert np.array_equal(last.rows, rows)
    assert not last.leaves
    assert last.fresh
    result = closed(*last.scores, last.rows, here.model.time.numpy(), 0)
    assert 0.5 < result.share <= 1.0
    assert result.interval[0] <= result.share <= result.interval[1] <= 1.0
    per_frame = result.per_frame
    assert per_frame["nominal"] < per_frame["corrected"] < per_frame["noise_floor"] + 1.0


def test_what_was_seen_up_to_a_row():
    """Its evidence is that of as many rows of the recording; other recordings that start later are no part of it."""
    here, none, _ = causes()
    before = replace(here, starts=(20, 60)).until(53)
    assert before.starts == (20,)
    before = here.until(53)
    masked = torch.where(torch.arange(80)[:, None] < 53, here.observations, torch.nan)
    short = refine(before, (), {}, none.path[:53], LOOSE)
    long = refine(here.observing(masked), (), {}, none.path, LOOSE)
    assert len(short.path) == 53
    assert short.log_evidence == pytest.approx(long.log_evidence, abs=0.01)


def test_a_push_in_the_last_third_has_the_parameters_that_all_rows_give_it():
    push = EFFECTS["external_push"]("tip")
    arm = random_arm(PENDULUM, duration=1.6, fps=50, noise=0.002, torque_scale=0.5, commanded=True, seed=0)
    truth = {"impulse_x": 0.72, "impulse_y": 0.36, "moment": 1.28, "duration": 0.12}
    given = {f"effect.external_push.tip.{n}": torch.tensor([v], dtype=torch.float64) for n, v in truth.items()}
    here = diagnosis_problem(record(arm.with_effects(push).replace(**given), 0)[0], PENDULUM)
    path = path_of(here)
    none = refine(here, (), {}, path, LOOSE)
    cause = refine(here, (push,), {f"external_push.tip.{n}": v for n, v in truth.items()}, path, LOOSE)
    assert cause.log_evidence > none.log_evidence + 20
    last = unseen(here, none, cause)
    assert not last.fresh
    result = closed(*last.scores, last.rows, here.model.time.numpy(), 0)
    assert result.per_frame["noise_floor"] - result.per_frame["nominal"] > 0.5
    assert result.share > 0.5
    # What has seen these rows already has no more to learn from them.
    np.testing.assert_allclose(last.scores[1].score, scores(here, last.cause).score, rtol=1e-12)


def test_another_recording_is_held_out():
    here, none, cause = causes()
    other = diagnosis_problem(recorded(DAMPING, seed=5, rows=60), PENDULUM)
    there = unseen(here, none, cause, other)
    assert there.fresh
    without, with_cause = there.scores
    assert there.rows.all()
    assert len(there.rows) == len(without.score) == 60
    assert not there.leaves
    assert np.nansum(with_cause.score - without.score) > 5
    # Parameters are those of the first recording, not fitted again.
    carried = cause.carried_to(other).parameters["effect.viscous_friction.pivot.damping"].item()
    assert carried == pytest.approx(cause.mean[0])


def test_a_held_out_recording_has_torques_as_the_other_one_has():
    known = recorded()
    hidden = replace(known, torques=None, name="other")
    with pytest.raises(InputError, match=r"^other: expected a held-out .* with torques in .* --set hide_torque=yes$"):
        diagnose(known, PENDULUM, held_out=hidden)
    with pytest.raises(InputError, match=r"torques that are unknown, .* got commanded"):
        diagnose(hidden, PENDULUM, held_out=known)


def series(seed, rows=240, share=0.6):
    """Scores whose gap and gain wander as neighbours do: autoregressive, 0.05 s long at 100 rows a second."""
    rng = np.random.default_rng(seed)
    wander = np.zeros((rows, 2))
    for t in range(1, rows):
        wander[t] = 0.8 * wander[t - 1] + 0.6 * rng.normal(size=2)
    gap = 2.0 + wander[:, 0]
    gain = share * gap + 0.5 * wander[:, 1]
    zero = np.zeros(rows)
    return Scores(zero, zero), Scores(gain, gap), 0.01 * np.arange(rows)


def test_the_interval_covers():
    everything, found = np.ones(240, bool), []
    for seed in range(120):
        without, with_cause, time = series(seed)
        result = closed(without, with_cause, everything, time, seed)
        found.append((result.share, *result.interval))
    shares, low, high = np.array(found).T
    hits = int(((low <= 0.6) & (high >= 0.6)).sum())
    # 90 % by name; blocks of 40 rows in 240 are few, and such intervals too short by some per cent.
    assert hits / 120 > 0.9 - 0.1 - 4 * np.sqrt(0.09 / 120)
    # As wide as shares scatter, whose sd is known to 1/√240 of itself; blocks make it a tenth too narrow.
    width = (high - low).mean() / (2 * 1.645 * shares.std(ddof=1))
    assert width == pytest.approx(0.9, abs=3 / np.sqrt(240))


@pytest.mark.parametrize("rows", [24, 200])
def test_the_interval_holds_the_share_whichever_rows_close_it(rows):
    """The first and last ones count as often as others; and few rows are no single block."""
    zero, gap, end = np.zeros(rows), np.ones(rows), rows // 8
    for ends in (0.0, 1.0):
        gain = np.full(rows, 1 - ends)
        gain[:end] = gain[-end:] = ends
        scores = Scores(zero, gap), Scores(gain, gap)
        result = closed(*scores, np.ones(rows, bool), 0.02 * np.arange(rows), 0)
        low, high = result.interval
        assert low < result.share < high
        assert (low + high) / 2 == pytest.approx(result.share, abs=0.1)


def test_share_of_known_scores():
    time = 0.1 * np.arange(20)
    rows = np.arange(20) >= 5
    gain, gap = np.full(20, 0.5), np.full(20, 2.0)
    gain[:5] = 100.0  # not held out
    gain[7] = np.nan  # not seen
    result = closed(Scores(np.zeros(20), gap), Scores(gain, gap), rows, time, 0)
    assert result.share == pytest.approx(0.25)
    np.testing.assert_allclose(result.interval, 0.25)
    assert result.per_frame == pytest.approx({"nominal": 0.0, "corrected": 0.5, "noise_floor": 2.0})
    more = closed(Scores(np.zeros(20), gap), Scores(5 * gain, gap), rows, time, 0)
    assert more.share == 1.0  # not more than all
    nothing = closed(Scores(np.zeros(20), -gap), Scores(gain, -gap), rows, time, 0)
    assert (nothing.share, nothing.interval) == (None, None)


SPRING = EFFECTS["joint_stiffness"]("pivot")


@cache
def of_two():
    """A pendulum rubbed and on a spring, without cause and with both, and a pool that knows no other.

    And another recording, which has the friction alone.
    """
    values = {f"{FRICTION.key}.damping": DAMPING, f"{SPRING.key}.stiffness": 0.2, f"{SPRING.key}.torque": 0.02}
    arm = random_arm(PENDULUM, duration=1.6, fps=50, noise=0.002, torque_scale=0.5, commanded=True, seed=0)
    given = {f"effect.{name}": torch.tensor([value], dtype=torch.float64) for name, value in values.items()}
    here = diagnosis_problem(record(arm.with_effects(FRICTION, SPRING).replace(**given), 0)[0], PENDULUM)
    path = path_of(here)
    none = refine(here, (), {}, path, LOOSE)
    both = refine(here, (FRICTION, SPRING), values, path, LOOSE)
    return (
        here,
        none,
        both,
        HypothesisPool(here, [], {"": none}, [], path, False),
        diagnosis_problem(recorded(DAMPING, seed=5), PENDULUM),
    )


@pytest.mark.long
def test_each_of_two_closes_what_the_other_leaves():
    here, none, both, found, _ = of_two()
    there = unseen(here, none, both)
    shares = by_effect(here, found, both, there, None, 0)
    nothing, everything = there.scores
    gap = (everything.floor - nothing.score)[there.rows].sum()
    for effect, rest in ((FRICTION, SPRING), (SPRING, FRICTION)):
        lesser = refine(here, (rest,), both.values, both.path, DEFAULT.residual.min_path_size)
        less = unseen(here, none, lesser).scores[1]
        share, (low, high) = shares[effect.key].share, shares[effect.key].interval
        assert share == pytest.approx(min((everything.score - less.score)[there.rows].sum() / gap, 1.0), abs=1e-6)
        assert 0.02 < low <= share <= high


def test_what_another_recording_does_not_bear_out_closes_nothing_there():
    here, none, both, found, other = of_two()
    there = unseen(here, none, both, other)
    shares = by_effect(here, found, both, there, other, 0)
    assert shares[SPRING.key].share < 0
    assert shares[SPRING.key].interval[1] < 0


@pytest.mark.parametrize(
    ("names", "lows", "expected"),
    [
        (("viscous_friction", "armature", "payload"), (0.1, 0.2, 0.01), True),
        (("viscous_friction", "armature", "payload"), (0.1, 0.2, -0.01), False),
        (("viscous_friction", "armature", "payload"), (0.1, None, 0.2), True),  # one that was not measured
        (("viscous_friction", "armature"), (0.1, -0.01), True),
        (("viscous_friction", "armature", "outliers"), (0.1, -0.01, 0.3), True),
    ],
)
def test_held_out_rows_bear_out_each_of_three_effects(names, lows, expected):
    """Two, and two beside stray detections, are what they are; three may imitate what the catalogue lacks."""
    _, none, _ = causes()
    effects = [EFFECTS[name](*(("pivot",) if EFFECTS[name].site == "joint" else ())).bound(PENDULUM) for name in names]
    cause = replace(none, effects=tuple(effects))
    known = {key(e): Closed(0.3, (low, 0.5), {}) for e, low in zip(effects, lows, strict=True) if low is not None}
    assert all_confirmed(cause, known) is expected


def test_what_was_refined_is_not_refined_again(monkeypatch):
    """And what nothing can follow without an effect, here or on held-out rows, says nothing of it."""
    here, none, both, found, _ = of_two()
    there, room = unseen(here, none, both), sys.modules[by_effect.__module__]
    alone = refine(here, (FRICTION,), both.values, both.path, DEFAULT.residual.min_path_size)
    known = replace(found, pool=found.pool | {alone.key: alone})
    monkeypatch.setattr(room, "without", lambda *_: None)
    assert list(by_effect(here, known, both, there, None, 0)) == [SPRING.key]

    def astray(*_):
        raise CannotFollow("astray")

    monkeypatch.setattr(room, "fitted_before", astray)
    assert by_effect(here, known, both, there, None, 0) == {}
