"""A cause, and what it is without one of its effects."""

from dataclasses import replace

import numpy as np
import torch
from pendulum import ARM, LOOSE, path_of, recording_of

from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.problem.unknowns import expanded_about
from invdyn.models.effects import EFFECTS


def test_without_one_effect_the_others_keep_names_values_and_model():
    """In the order of the unknowns, so that a screen may be expanded about them."""
    places = ("viscous_friction", "elbow"), ("joint_stiffness", "elbow"), ("payload",)
    effects = tuple(EFFECTS[name](*where).bound(ARM) for name, *where in places)
    here = diagnosis_problem(recording_of(effects[0], ARM, damping=0.05), ARM)
    cause = refine(here, effects, {}, path_of(here), LOOSE, rounds=2)
    for gone in effects:
        rest = cause.less(here, gone)
        assert [effect.key for effect in rest.effects] == [e.key for e in cause.effects if e.key != gone.key]
        model, among, point = expanded_about(here, rest)
        assert among.names == rest.names
        kept = [cause.names.index(name) for name in rest.names]
        assert 0 < len(kept) < len(cause.names)
        np.testing.assert_array_equal(point, cause.mean[kept])
        np.testing.assert_array_equal(rest.sd, cause.sd[kept])
        np.testing.assert_array_equal(rest.about, cause.about[kept])
        for name in (f"effect.{name}" for name in rest.names):
            assert torch.equal(model.parameters[name], cause.model.parameters[name])
        assert not any(name.startswith(f"effect.{gone.key}.") for name in model.parameters)


def test_a_screen_beside_nothing_is_about_the_body_as_it_is_stated():
    """What was found of its numbers has stood in for a cause."""
    one = EFFECTS["viscous_friction"]("elbow").bound(ARM)
    doubted = replace(ARM, uncertainty={"mass": 0.05})
    here = diagnosis_problem(recording_of(one, ARM, damping=0.05), doubted)
    bare = refine(here, (one,), {}, path_of(here), LOOSE, rounds=2).less(here, one)
    assert len(bare.mean) == 2
    model, among, point = expanded_about(here, bare)
    assert model is here.model
    np.testing.assert_array_equal(point, among.mean)
    assert not np.isclose(bare.mean, point, rtol=1e-6).any()
