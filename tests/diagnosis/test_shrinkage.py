"""How far the gap closes on held-out rows, with an interval that respects serial correlation."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from pendulum import ARM, DAMPING, MANY, PENDULUM, causes, path_of, recorded, recording_of

from invdyn.diagnosis import diagnose, elsewhere
from invdyn.diagnosis.elsewhere import carried
from invdyn.diagnosis.paths import FIRM, data_path
from invdyn.diagnosis.predict import Scores, scores
from invdyn.diagnosis.refine import refine
from invdyn.diagnosis.setting import LOOSE, setting
from invdyn.diagnosis.shrinkage import closed, split, unseen
from invdyn.models import Body, Link
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
    here = setting(record(arm.with_effects(push).replace(**given), 0)[0], PENDULUM)
    path = path_of(here)
    none = refine(here, (), {}, path, LOOSE)
    cause = refine(here, (push,), {f"external_push.tip.{n}": v for n, v in truth.items()}, path, LOOSE)
    assert cause.log_evidence > none.log_evidence + 20
    last = unseen(here, none, cause)
    result = closed(*last.scores, last.rows, here.model.time.numpy(), 0)
    assert result.per_frame["noise_floor"] - result.per_frame["nominal"] > 0.5
    assert result.share > 0.5
    # What has seen these rows already has no more to learn from them.
    np.testing.assert_allclose(last.scores[1].score, scores(here, last.cause).score, rtol=1e-12)


def test_another_recording_is_held_out():
    here, none, cause = causes()
    other = setting(recorded(DAMPING, seed=5, rows=60), PENDULUM)
    there = unseen(here, none, cause, other)
    without, with_cause = there.scores
    assert there.rows.all()
    assert len(there.rows) == len(without.score) == 60
    assert not there.leaves
    assert np.nansum(with_cause.score - without.score) > 5
    # Parameters are those of the first recording, not fitted again.
    carried = cause.carried_to(other).parameters["effect.viscous_friction.pivot.damping"].item()
    assert carried == pytest.approx(cause.mean[0])


def test_what_another_recording_does_not_bear_out_is_a_part():
    """An arm whose friction is another one there: what was found was not all there was."""
    first, same, other = recorded(DAMPING, rows=200), recorded(DAMPING, seed=5), recorded(3 * DAMPING, seed=5)
    borne_out, odd = (diagnose(first, PENDULUM, held_out=second, without=MANY) for second in (same, other))
    likely = borne_out.causes[0]
    assert [effect.effect for effect in likely.effects] == ["viscous_friction"]
    assert likely.probability > 0.9
    assert borne_out.outside.probability < 0.01
    part = next(cause for cause in odd.causes if cause.effects == likely.effects)
    assert (part.probability, part.in_part) == (0.0, pytest.approx(likely.probability))
    assert odd.outside.probability == pytest.approx(likely.probability)
    assert borne_out.method["held out"] == "another recording"
    assert odd.method["held out"] == "another recording, in which the best cause leaves something"
    # Predicted under the residual that the first recording needs, which is none.
    assert borne_out.shrinkage.gap_closed > 0.95
    assert odd.shrinkage.gap_closed < 0


def test_of_paths_elsewhere_one_with_unknown_scores_is_none(monkeypatch):
    here, _, cause = causes()
    other = setting(recorded(DAMPING, seed=5, rows=60), PENDULUM)
    start, _ = data_path(other)
    known = scores(other, carried(here, cause, other, start))
    unknown = replace(known, score=np.where(np.arange(60) > 5, np.nan, known.score))
    tried = []

    def scored(_, there, rows):
        tried.append(there)
        return unknown if len(tried) == 1 else known

    monkeypatch.setattr(elsewhere, "scores", scored)
    assert carried(here, cause, other, start) is tried[1]
    monkeypatch.setattr(elsewhere, "scores", lambda *_: unknown)
    with pytest.raises(InputError, match="cannot follow it"):
        carried(here, cause, other, start)


def test_a_push_is_not_missed_in_another_recording():
    """It came at a moment of the first one: that another one goes without it says nothing of the catalogue."""
    push = EFFECTS["external_push"]("tip")
    truth = {"impulse_x": 0.72, "impulse_y": 0.36, "moment": 0.7, "duration": 0.12}
    here = setting(recording_of(push, **truth), PENDULUM)
    path = path_of(here)
    none = refine(here, (), {}, path, LOOSE)
    cause = refine(here, (push,), {f"external_push.tip.{n}": v for n, v in truth.items()}, path, LOOSE)
    assert cause.log_evidence > none.log_evidence + 20
    there = unseen(here, none, cause, setting(recording_of(seed=5), PENDULUM))
    without, with_cause = there.scores
    assert np.nansum(with_cause.score - without.score) < -10
    assert not there.leaves


@pytest.mark.parametrize("seed", [10, 20])
def test_another_recording_has_its_own_swapped_labels(seed):
    """Its path is found as the first one's is: not along detections that stray."""
    swap = EFFECTS["label_swap"]("elbow", "wrist")
    here, other = (setting(recording_of(swap, body=ARM, rows=150, seed=s, rate=0.06), ARM) for s in (seed, seed + 1))
    path, stray = data_path(here)
    assert stray
    none = refine(here, (), {}, path, LOOSE)
    cause = refine(here, (swap,), {"label_swap.elbow.wrist.rate": 0.06}, path, FIRM)
    there = unseen(here, none, cause, other)
    without, with_cause = there.scores
    assert not there.leaves
    assert with_cause.score.mean() > without.score.mean() + 5
    # Half the squares of 600 unit innovations: sd √300; and as much for the noise scale, known from as many.
    assert abs((with_cause.score - with_cause.floor).sum()) < 4 * np.sqrt(2 * 300)


def test_the_noise_of_another_recording_is_no_part_of_the_prediction():
    """Its own jitter would be scaled by a factor that belongs to the first recording's."""
    here, none, cause = causes()
    quieter = setting(recorded(DAMPING, seed=5, rows=60), PENDULUM)
    name = "emission.keypoint_scale"
    assert not torch.equal(here.model.parameters[name], quieter.model.parameters[name])
    for each in (none, cause):
        assert torch.equal(each.carried_to(quieter).parameters[name], here.model.parameters[name])


def test_a_held_out_recording_has_torques_as_the_other_one_has():
    known = recorded()
    hidden = replace(known, torques=None, name="other")
    with pytest.raises(InputError, match=r"^other: expected a held-out .* with torques in it, .* --hide-torque$"):
        diagnose(known, PENDULUM, held_out=hidden)
    with pytest.raises(InputError, match=r"torques that are unknown, .* got commanded"):
        diagnose(hidden, PENDULUM, held_out=known)


def test_the_noise_goes_with_its_keypoint():
    """Another recording may have its columns in another order, or a keypoint that the first one did not track."""
    links = [Link("upper", "shoulder", "elbow", 0.3, 1.5), Link("fore", "elbow", "wrist", 0.25, 1.0)]
    body = Body("arm", links, gravity=(0.0, -9.81))
    arm = random_arm(body, duration=1.0, fps=50, noise=0.002, torque_scale=0.5, commanded=True, seed=0)
    both = record(arm, 0)[0]
    turned = replace(both, keypoints=both.keypoints[:, ::-1], keypoint_names=both.keypoint_names[::-1])
    one = replace(both, keypoints=both.keypoints[:, 1:], keypoint_names=both.keypoint_names[1:])
    name = "emission.keypoint_scale"

    def scales(first, second):
        here, other = setting(first, body), setting(second, body)
        carried = refine(here, (), {}, path_of(here), LOOSE, rounds=1).carried_to(other)
        return [
            dict(zip(model.emission_model.tips, model.parameters[name].tolist(), strict=True))
            for model in (here.model, other.model, carried)
        ]

    mine, _, carried = scales(both, turned)
    assert carried == mine
    mine, _, carried = scales(both, one)
    assert carried == {1: mine[1]}
    mine, own, carried = scales(one, both)
    assert carried == {0: own[0], 1: mine[1]}


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
