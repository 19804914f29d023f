"""The pool of causes: what is considered, what is kept, and what is no rival."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from pendulum import LOOSE, PENDULUM, recording_of

from invdyn.diagnosis.hypotheses.pool import HypothesisPool, considered
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.problem.regime import COMMANDED, UNKNOWN_TORQUE


def pool(**evidence):
    """A search whose pool has causes with such evidences: "none", "a", "b", "ab", "abc"."""
    here = diagnosis_problem(recording_of(), PENDULUM)
    letters = dict(zip("abc", considered(here), strict=False))
    path = torch.zeros(80, 3, dtype=torch.float64)
    plain = refine(here, (), {}, path, LOOSE, rounds=1)
    found = HypothesisPool(here, considered(here), {}, [], path, has_outliers=False)
    for name, value in evidence.items():
        effects = () if name == "none" else tuple(letters[letter] for letter in name)
        found.add(replace(plain, effects=effects, log_evidence=value))
    return found, {effect.key: letter for letter, effect in letters.items()}


def test_what_is_left_out_is_not_considered():
    here = diagnosis_problem(recording_of(), PENDULUM)
    everything, fewer = considered(here), considered(here, ["viscous_friction", "camera_roll"])
    assert {e.name for e in everything} - {e.name for e in fewer} == {"viscous_friction", "camera_roll"}
    assert not {e.name for e in everything} & {"joint_coupling", "label_swap"}  # they need two joints


def test_a_push_is_considered_where_encoders_alone_are_read():
    """It acts on a point that need not be tracked; what only a camera shows needs one."""
    seen = recording_of()
    read = {"angles": np.zeros((seen.num_frames, 1)), "joint_names": PENDULUM.joint_names}
    log = replace(seen, keypoints=np.empty((seen.num_frames, 0, 2)), keypoint_names=(), **read)
    known = {effect.key for effect in considered(diagnosis_problem(log, PENDULUM, force=True))}
    assert "external_push.tip" in known
    assert not known & {"keypoint_offset.tip", "camera_roll"}


def test_a_set_that_a_part_of_it_beats_is_no_rival():
    found, letters = pool(none=0.0, a=20.0, b=19.0, ab=21.0, abc=40.0)
    names = ["".join(sorted(letters[e.key] for e in cause.effects)) for cause in found.ranked]
    assert names == ["abc", "a", "b", ""]  # ab gains one nat, which a second effect does not earn
    found, letters = pool(none=0.0, a=20.0, b=0.0, ab=60.0)
    names = ["".join(sorted(letters[e.key] for e in cause.effects)) for cause in found.ranked]
    assert names == ["ab", "a", ""]


def test_a_single_effect_that_surely_leaves_something_gives_way_to_two_that_leave_nothing():
    """Beside it another is at work, and that has its prior; not so beside none, nor where a torque is always left."""
    found, letters = pool(none=0.0, a=200.0, ab=204.0)
    none, single, both = sorted(found.pool.values(), key=lambda cause: len(cause.effects))
    first, prior = np.arange(len(none.by_size)) == 0, COMMANDED.log_prior

    def left(cause, nats):
        return replace(cause, by_size=prior - np.where(first, nats, 0.0))

    before = found.score(single)
    found.pool |= {none.key: left(none, 1000.0), single.key: left(single, 14.0)}
    assert not found.leaves(found.pool[single.key])
    assert [letters.get(e.key) for e in found.ranked[0].effects] == ["a"]
    found.pool[single.key] = left(single, 16.0)  # more than five, and a hundredth of what none leaves
    assert found.leaves(found.pool[single.key])
    assert not found.leaves(found.pool[none.key])
    unknown = replace(found, problem=replace(found.problem, regime=UNKNOWN_TORQUE))
    assert not unknown.leaves(replace(single, by_size=np.r_[np.zeros(14), 9e3]))
    assert found.score(found.pool[single.key]) == pytest.approx(before + np.log(0.08 / 0.5))
    assert found.ranked[0].key == both.key


def test_stray_detections_are_measured_apart():
    """Thousands of nats for them leave what ten of another effect say as it is; thousands for another do not."""
    here = diagnosis_problem(recording_of(), PENDULUM)
    outliers, payload, friction = (
        next(e for e in considered(here) if e.name == name) for name in ("outliers", "payload", "viscous_friction")
    )
    plain = refine(here, (), {}, torch.zeros(80, 3, dtype=torch.float64), LOOSE, rounds=1)
    for first, second_is_believed in ((outliers, True), (payload, False)):
        found = HypothesisPool(here, considered(here), {}, [], plain.path, has_outliers=True)
        for effects, nats in (((), 0.0), ((first,), 9000.0), ((friction,), 12.0), ((first, friction), 9012.0)):
            found.add(replace(plain, effects=effects, log_evidence=nats))
        assert (len(found.ranked[0].effects) == 2) is second_is_believed
        assert found.temper_within(friction) == pytest.approx(8000 / (8000 + (12.0 if first is outliers else 9012.0)))
        # Of as many effects those with more evidence rank higher, whatever their sort.
        scores = [found.score(replace(plain, effects=(friction,), log_evidence=e)) for e in (0.0, 12.0, 8999.0, 9100.0)]
        assert scores == sorted(scores)
        assert found.temper_within(outliers) == pytest.approx(8000 / (8000 + 9012.0))


@pytest.mark.parametrize("gain", [9.0, 9000.0])
def test_however_large_a_gap_its_parameters_are_paid_for(gain):
    """Evidence counts the less the larger the gap, and parameters cost what they do in a small one."""
    found, _ = pool(none=0.0, a=gain)
    plain = next(cause for cause in found.pool.values() if cause.effects)
    far, known = replace(plain, far=12.5), replace(plain, learned=np.array([1e6]))
    assert plain.log_evidence == far.log_evidence == known.log_evidence  # which has them in it
    share = 1 - found.temper
    assert found.score(plain) - found.score(far) == pytest.approx(12.5 * share)
    nats = 0.5 * (np.log1p(found.temper * 1e6) - found.temper * np.log1p(1e6))
    assert found.score(plain) - found.score(known) == pytest.approx(nats)


def test_of_two_versions_the_better_is_kept():
    found, _ = pool(none=0.0, a=20.0)
    (cause,) = (c for c in found.pool.values() if c.effects)
    found.add(replace(cause, log_evidence=10.0))
    assert found.pool[cause.key].log_evidence == 20.0
    found.add(replace(cause, log_evidence=30.0))
    assert found.pool[cause.key].log_evidence == 30.0
