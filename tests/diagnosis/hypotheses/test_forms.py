"""Other readings of an effect: considered where a recording could show them, found, and told by their own words."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from pendulum import ARM, LOOSE, PENDULUM, recording_of

from invdyn.diagnosis.assessment.findings import finding, key, place
from invdyn.diagnosis.hypotheses.continuation import data_path
from invdyn.diagnosis.hypotheses.pool import considered
from invdyn.diagnosis.hypotheses.profile_likelihood import refine_searched
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.problem.unknowns import unknowns
from invdyn.diagnosis.sensitivity.screen import screen
from invdyn.models.effects import ClockRate, SoftTissue
from invdyn.recordings import Recording

FORMS = {"clock_rate.frames", "varying_noise.confidence", "soft_tissue.tip.sliding", "actuator_gain.pivot.geared"}


def unsure(recording, seed=5):
    """The same, whose tracker is less sure in a third of the rows, where its noise is seven times as large."""
    rng = np.random.default_rng(seed)
    sure = np.where(rng.random(recording.keypoints.shape[:2]) < 0.3, 0.4, 1.0)
    more = 0.002 * np.sqrt(7**2 - 1) * (sure < 1)[..., None]
    noisy = recording.keypoints + more * rng.standard_normal(recording.keypoints.shape)
    return replace(recording, keypoints=noisy, confidence=sure)


def forms(recording, body, **options):
    return {
        effect.key for effect in considered(diagnosis_problem(recording, body, **options)) if effect.form is not None
    }


def test_forms_are_considered_where_a_recording_could_show_them():
    told = recording_of()
    assert forms(told, PENDULUM) == FORMS - {"varying_noise.confidence"}
    assert forms(unsure(told), PENDULUM) == FORMS
    still = Recording(told.time, told.keypoints, told.keypoint_names)
    assert forms(still, PENDULUM, passive=True) == {"soft_tissue.tip.sliding"}
    left = considered(
        diagnosis_problem(unsure(told), PENDULUM), ["clock_rate", "varying_noise", "soft_tissue", "actuator_gain"]
    )
    assert not [effect for effect in left if effect.form is not None]


def test_a_cameras_own_clock_is_screened_refined_and_told():
    """A twelfth fast, it is two commands late by the end: no straight line from the right clock."""
    bound = diagnosis_problem(recording_of(ClockRate("frames"), rows=200, rate=1.08), PENDULUM)
    path, _ = data_path(bound)
    none, common = refine(bound, (), {}, path, LOOSE), unknowns(bound, ())
    clocks = [effect for effect in considered(bound) if effect.name in ("clock_rate", "camera_latency")]
    best = screen(bound, bound.model, path, clocks, common, common.mean)[0]
    assert best.effect.key == "clock_rate.frames"
    values = {f"{best.effect.key}.{name}": value for name, value in best.values.items()}
    cause = refine(bound, (best.effect,), values, best.path, best.size)
    assert cause.complete
    assert cause.log_evidence > none.log_evidence + 20
    assert abs(cause.mean[0] - 1.08) < 4 * cause.sd[0]
    told = finding(bound, cause, best.effect, 0)
    assert (told.effect, told.where, told.key) == ("clock_rate", {"form": "frames"}, "clock_rate.frames")


@pytest.mark.long
def test_noise_as_the_tracker_says_is_found_and_not_where_it_says_nothing_new():
    for change, gained in ((unsure, True), (lambda r: replace(unsure(r), keypoints=r.keypoints), False)):
        bound = diagnosis_problem(change(recording_of(rows=150)), PENDULUM)
        path, _ = data_path(bound)
        none = refine(bound, (), {}, path, LOOSE)
        effect = next(e for e in considered(bound) if e.key == "varying_noise.confidence")
        cause = refine_searched(bound, none, effect)
        assert (cause is not None and cause.log_evidence > none.log_evidence + 3) == gained
        if gained:
            assert cause.noise[f"{effect.key}.slope"] == pytest.approx((7 - 1) / 0.6, rel=0.3)


def test_a_form_comes_after_its_place():
    sliding = SoftTissue("elbow", "sliding").bound(ARM)
    assert sliding.place == (0,)
    assert place(sliding) == {"keypoint": "elbow", "form": "sliding"}
    assert key(sliding) == sliding.key == "soft_tissue.elbow.sliding"
    assert [place(SoftTissue("elbow")), place(ClockRate())] == [{"keypoint": "elbow"}, {}]
    with pytest.raises(ValueError, match="expected a form among sliding, got 'falling'"):
        SoftTissue("elbow", "falling")
    with pytest.raises(ValueError, match="form among frames"):
        ClockRate("shoulder")


def test_one_clock_is_the_other_at_the_right_rate():
    bound = diagnosis_problem(recording_of(), PENDULUM)
    models = [bound.model.with_effects(clock) for clock in (ClockRate(), ClockRate("frames"))]
    x = torch.randn(5, 3, dtype=torch.float64)
    rows = torch.arange(20, 25)
    one, other = (model.transition_mean(x, rows) for model in models)
    torch.testing.assert_close(one, other)
