"""A payload, and the errors of the last link's numbers that are one: with hypothesis."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pendulum import ARM, recording_of

from invdyn.diagnosis.hypotheses.continuation import data_path
from invdyn.diagnosis.hypotheses.load_equivalents import nearest_load
from invdyn.diagnosis.hypotheses.moves import refine_kin
from invdyn.diagnosis.hypotheses.pool import HypothesisPool, considered
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.problem.diagnosis_problem import LOOSE, diagnosis_problem
from invdyn.models.effects import EFFECTS
from invdyn.simulate import random_arm

ERROR, PAYLOAD = EFFECTS["inertial_error"]("forearm").bound(ARM), EFFECTS["payload"]().bound(ARM)
SCALE = random_arm(ARM, duration=0.1, fps=50).scale
M, C, LENGTH = 1.0, 0.125, 0.25  # the forearm's
SD = np.array([0.02, 0.004, 0.0005])


def cause(mean, covariance=None):
    """What nearest_load looks at: numbers of an error, and others beside them."""
    whole = np.eye(5)
    whole[1:4, 1:4] = np.diag(SD**2) if covariance is None else covariance
    names = ("x.a", *(f"{ERROR.key}.{name}" for name in ("mass", "com", "inertia")), "y.b")
    return SimpleNamespace(names=names, mean=np.array([7.0, *mean, -7.0]), covariance=whole)


def loaded(m):
    """Changes of mass, centre of mass and inertia by a point mass, by hand."""
    moment = C**2 * M + LENGTH**2 * m
    com = (M * C + m * LENGTH) / (M + m)
    return np.array([m, com - C, moment - (M + m) * com**2])


@settings(max_examples=40)
@given(st.floats(0.01, 3.0))
def test_errors_that_are_a_load_are_that_load(mass):
    found, off = nearest_load(cause(loaded(mass)), ERROR, PAYLOAD, SCALE)
    assert found == pytest.approx(mass, rel=1e-3)
    assert off < 0.05


def test_how_far_an_error_is_from_any_load():
    """In standard deviations, along what is known of the numbers together."""
    off = [nearest_load(cause(loaded(0.3) + SD * [0, by, 0]), ERROR, PAYLOAD, SCALE)[1] for by in (-1, 4, -4)]
    assert off[0] < 1
    assert min(off[1:]) > 3
    lighter = nearest_load(cause([-0.2, 0.0, 0.0]), ERROR, PAYLOAD, SCALE)
    assert lighter == (pytest.approx(0.0, abs=1e-3), pytest.approx(10.0, rel=0.01))
    # Known together far better than each: what is off along the worst-known direction is near.
    worst = np.array([0.1, 0.02, -0.002])
    wide = np.diag(SD**2) + np.outer(worst, worst) * 25
    assert nearest_load(cause(loaded(0.3) + worst, wide), ERROR, PAYLOAD, SCALE)[1] < 0.5


@pytest.mark.parametrize(("place", "load", "followed"), [("forearm", 0.4, True), ("upper_arm", 0.4, False)])
def test_a_payload_is_refined_from_the_error_that_found_it(place, load, followed):
    """No screen along the data's path sees a large one. An error of another link is none."""
    bound = diagnosis_problem(recording_of(PAYLOAD, body=ARM, rows=100, mass=load), ARM)
    path, stray = data_path(bound)
    none = refine(bound, (), {}, path, LOOSE)
    error = EFFECTS["inertial_error"]("forearm")
    wider = refine(bound, (error,), {f"{error.key}.mass": load}, path, 0.01)
    if place != "forearm":
        other = EFFECTS["inertial_error"](place).bound(ARM)
        wider = replace(wider, effects=(other,), names=tuple(n.replace("forearm", place) for n in wider.names))
    found = HypothesisPool(considered(bound), {c.key: c for c in (none, wider)}, [], path, stray)
    refine_kin(bound, found, 1)
    assert (PAYLOAD.key in found.pool) is followed
    if followed:
        payload = found.pool[PAYLOAD.key]
        assert payload.complete
        assert abs(payload.mean[0] - load) < 4 * payload.sd[0]
        assert found.ranked[0].key == PAYLOAD.key
        tried = found.relatives[PAYLOAD.key]
        refine_kin(bound, found, 1)
        assert found.relatives == {PAYLOAD.key: tried}
