"""A formula for what the catalogue lacks."""

import re

import numpy as np
import pytest
from pendulum import ARM, LOOSE, recording_of
from pyro.distributions import Normal

from invdyn.diagnosis.assessment.symbolic_regression import (
    LIBRARY,
    Motion,
    describe,
    library_of_terms,
    written_coefficient,
)
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.inference.smoothing.gauss_newton import gauss_newton
from invdyn.models.effects import EFFECTS
from invdyn.models.effects.base import Effect, Parameter


class CubicSpring(Effect):
    """Torque −k θ³ at a joint: in no catalogue."""

    def parameters(self, scale):
        return (Parameter("stiffness", "N·m/rad³", Normal(0.0, 10.0)),)

    def force(self, p, now):
        j = self.place[0]
        return now.at(j, -p["stiffness"] * now.q[..., j : j + 1] ** 3)


def described(recording):
    here = diagnosis_problem(recording, ARM)
    path = gauss_newton(here.with_residual(LOOSE), here.observations).path
    none = refine(here, (), {}, path, LOOSE)
    return describe(here, none, none.path), here, none


def test_a_cubic_spring_is_put_into_a_formula():
    stiffness = 1.5
    recording = recording_of(CubicSpring("elbow"), ARM, rows=100, effort=1.0, stiffness=stiffness)
    formula, here, none = described(recording)
    assert formula.variables[0] == "position:elbow"
    first, (coefficient, sd, unit) = next(iter(formula.terms.items()))
    assert first.endswith(" on elbow")
    assert "θ[elbow]" in first
    assert first in formula.text
    assert unit in formula.text
    assert formula.gain_per_frame > 0
    # Whatever terms there are, they give about the torque that acted.
    terms, features = library_of_terms(none, none.path)
    values = {name: feature for (name, *_), feature in zip(terms, features, strict=True)}
    said = sum(c * values[name] for name, (c, *_) in formula.terms.items() if name.endswith(" on elbow"))
    angle = here.model.split(none.path)[1][:, 1].numpy()
    acted = -stiffness * ((angle[1:] + angle[:-1]) / 2) ** 3
    assert np.linalg.norm(said - acted) < 0.3 * np.linalg.norm(acted)
    assert 0 < sd < abs(coefficient) / 3


def test_a_coefficient_is_that_of_the_torque():
    """Alone, and as large: a residual that decays between rows, or a motion taken at their beginning, would be off."""
    damping = 0.3
    rubbing = recording_of(EFFECTS["viscous_friction"]("elbow"), ARM, rows=100, effort=1.0, damping=damping)
    formula, *_ = described(rubbing)
    assert list(formula.terms) == ["dθ[elbow]/dt on elbow"]
    coefficient, *_ = formula.terms["dθ[elbow]/dt on elbow"]
    assert -coefficient == pytest.approx(damping, rel=0.05)


def test_where_nothing_is_left_there_is_no_formula():
    formula, *_ = described(recording_of(body=ARM, rows=60))
    assert formula is None


def test_a_rotor_follows_the_acceleration():
    inertia = 0.02
    rotor = EFFECTS["armature"]("elbow")
    formula, *_ = described(recording_of(rotor, ARM, rows=150, effort=1.0, inertia=inertia))
    coefficient, _, unit = formula.terms["d²θ[elbow]/dt² on elbow"]
    assert unit == "N·m·s²/rad"
    assert formula.variables[0] == "acceleration:elbow"
    assert inertia / 2 < -coefficient < 2 * inertia  # terms beside it take a part


@pytest.mark.quick("viscous*")
@pytest.mark.parametrize(
    ("effect", "seed", "term", "size", "values"),
    [
        ("viscous_friction", 1, "dθ[elbow]/dt on elbow", -0.3, {"damping": 0.3}),
        ("armature", 2, "d²θ[elbow]/dt² on elbow", -0.02, {"inertia": 0.02}),
    ],
)
def test_a_coefficient_is_as_sure_as_it_says(effect, seed, term, size, values):
    """Where a term stands in another's place, or the path's errors take a part of it, whitened rows alone say too much:
    by them these two would be 6 and 10 standard deviations off.
    """
    formula, *_ = described(recording_of(EFFECTS[effect]("elbow"), ARM, rows=100, effort=1.0, seed=seed, **values))
    coefficient, sd, _ = formula.terms[term]
    assert abs(coefficient - size) < 2.5 * sd


@pytest.mark.parametrize(
    ("mean", "sd", "told"),
    [(-0.29512, 0.00897, "-0.295 ± 0.009"), (1.0357, 1.4142, "+1.0 ± 1.4"), (1234.5, 123.0, "+1230 ± 120")],
)
def test_a_coefficient_has_the_digits_that_its_error_supports(mean, sd, told):
    assert written_coefficient(mean, sd) == told


def test_a_part_of_the_command_is_named_as_the_torque_alone():
    """Of a motor that gives a third less, a share −1/3 of its command is missing: u, no angle, and no unit."""
    weak = recording_of(EFFECTS["actuator_gain"]("elbow"), ARM, rows=150, effort=1.0, gain=-1 / 3)
    formula, *_ = described(weak)
    first, (coefficient, _, unit) = next(iter(formula.terms.items()))
    assert (first, unit) == ("u[elbow] on elbow", "1")
    assert coefficient == pytest.approx(-1 / 3, abs=0.05)
    assert formula.text.startswith("-0.3")
    assert " × u[elbow] on elbow" in formula.text
    assert " 1 " not in formula.text


class Offset(Effect):
    """A constant torque at a joint: in no catalogue."""

    def parameters(self, scale):
        return (Parameter("torque", "N·m", Normal(0.0, 1.0)),)

    def force(self, p, now):
        return now.at(self.place[0], p["torque"].expand_as(now.q[..., :1]))


def test_a_constant_torque_is_a_number_of_newton_metres():
    formula, *_ = described(recording_of(Offset("elbow"), ARM, rows=100, effort=1.0, torque=0.4))
    coefficient, _, unit = formula.terms["constant on elbow"]
    assert (coefficient, unit) == (pytest.approx(0.4, abs=0.02), "N·m")
    first = formula.text.split("; ")[0]
    assert re.fullmatch(r"\+0\.[34]\d* ± \S+ N·m on elbow", first)


def test_every_term_says_what_its_function_reads():
    """Changing the command changes the terms in u alone; changing angles, those in θ alone."""
    rng = np.random.default_rng(1)
    q, qd, qdd, u = rng.normal(size=(4, 30, 2))
    t = np.arange(30.0)
    base = Motion(q, qd, qdd, u, t)
    moved = Motion(q + 1, qd + 1, qdd + 1, u, t)
    pushed = Motion(q, qd, qdd, u + 1, t)
    for pattern, (variable, unit, function) in LIBRARY.items():
        assert unit
        assert ("{q}" in pattern) != np.array_equal(function(base, 0), function(moved, 0)), pattern
        assert ("{u}" in pattern) != np.array_equal(function(base, 0), function(pushed, 0)), pattern
        assert (variable == "") == (pattern == "constant")
