"""What an effect may be taken for, and from where: exact where it is exact, with hypothesis."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from pendulum import ARM, PENDULUM

from invdyn.diagnosis.catalogue import CATALOGUE
from invdyn.diagnosis.catalogue.neighbours import neighbours, of_same_period
from invdyn.diagnosis.catalogue.period_equivalents import factor
from invdyn.diagnosis.rules import FIXED
from invdyn.models import Body, Joint, Link
from invdyn.models.effects import EFFECTS
from invdyn.models.effects.inertias import inertia_of
from invdyn.simulate import random_arm

BODIES = {"one link": PENDULUM, "two links": ARM, "flat": replace(PENDULUM, gravity=(0.0, 0.0))}
SCALES = {name: random_arm(body, duration=0.1, fps=50).scale for name, body in BODIES.items()}
CANDIDATES = {
    name: [e.bound(body) for kind in EFFECTS.values() for e in kind.everywhere(body, body.keypoint_names)]
    for name, body in BODIES.items()
}
SCALE = SCALES["one link"]
NAMES = [name for name, entry in CATALOGUE.items() if entry.same_period]


def equivalents(rho, body=SCALE.body):
    """What gives the pendulum a period of factor ρ, from the clock that does."""
    clock = next(e for e in CANDIDATES["one link"] if e.name == "clock_rate" and e.form is None)
    return of_same_period(clock, {"rate": rho**0.5}, replace(SCALE, body=body), CATALOGUE)


M, C, LENGTH = 1.0, 0.125, 0.25  # the forearm's
AT, MOMENTS = (0.2, -0.1, 0.05), (0.02, 0.03, 0.04, 0.0, 0.0, 0.0)
"""m, of a tip in space; kg·m² of its link."""


def around(key, values, where="two links", sd=0.01, passive=False):
    mine = next(e for e in CANDIDATES[where] if e.key == key)
    found = neighbours(mine, values, dict.fromkeys(values, sd), CANDIDATES[where], SCALES[where], passive, CATALOGUE)
    return {(each.effect.key, each.kind): list(each.starts) for each in found}


def whole(name, values):
    """An effect on the pendulum, and all its parameters: those not said change nothing."""
    effect = next(e for e in CANDIDATES["one link"] if e.name == name)
    return effect, {p.name: values.get(p.name, 0.0) for p in effect.parameters(SCALE)}


def loaded(m):
    """Changes of the forearm's mass, centre of mass and inertia by a point mass at its tip, by hand."""
    moment = C**2 * M + LENGTH**2 * m
    com = (M * C + m * LENGTH) / (M + m)
    return {"mass": m, "com": com - C, "inertia": moment - (M + m) * com**2}


@given(st.floats(0.01, 3.0))
def test_errors_that_are_a_load_begin_at_that_load(mass):
    starts = around("inertial_error.forearm", loaded(mass))["payload", "similar"]
    assert [start["mass"] for start in starts] == pytest.approx([mass, mass], rel=1e-9)
    assert around("inertial_error.upper_arm", loaded(mass)) == {}


@pytest.mark.long
@given(st.floats(0.01, 3.0))
def test_in_space_too_by_weight_and_by_inertia(mass):
    """The exact load is an error of mass and com, and of the moments' mean, whatever its direction."""
    link = Link("a", Joint("j"), mass=1.2, com=(0.1, 0.02, 0.0), inertia=MOMENTS, sites={"tip": AT})
    body = Body("hinge", [link])
    mine = next(e for e in EFFECTS["inertial_error"].everywhere(body, ())).bound(body)
    payload = EFFECTS["payload"]().bound(body)
    own = inertia_of(body.parameters(), 0)
    other = own.loaded(torch.tensor([mass], dtype=torch.float64), torch.tensor(AT, dtype=torch.float64))
    values = dict(zip(mine.coms, (other.com - own.com).tolist(), strict=True))
    values |= {"mass": mass, "inertia": (other.mean - own.mean).item()}
    starts = CATALOGUE.of(mine).starts["payload"](mine, payload, values, random_arm(body, duration=0.1, fps=50).scale)
    assert [start["mass"] for start in starts] == pytest.approx([mass, mass], rel=1e-6)


def test_a_link_that_is_lighter_carries_nothing():
    assert around("inertial_error.forearm", {"mass": -0.2, "com": 0.0, "inertia": -0.001}) == {}


def test_twins_have_the_values_of_each_other():
    assert around("actuator_delay", {"delay": 0.03}) == {("camera_latency", "twin"): [{"latency": 0.03}]}
    assert around("actuator_delay.elbow", {"delay": 0.03}) == {}  # of one motor of two
    assert around("actuator_delay.pivot", {"delay": 0.03}, "one link") == {
        ("camera_latency", "twin"): [{"latency": 0.03}]
    }
    assert around("camera_roll", {"angle": 0.1})["gravity_tilt", "twin"] == [{"angle": 0.1}]


def test_a_law_and_its_special_case_are_neighbours_where_parameters_allow_it():
    def loaded(level):
        return {("load_friction.elbow", "similar"): [{"coefficient": level / SCALES["two links"].torque[1]}]}

    wider = {("stribeck_friction.elbow", "wider"): [{"coulomb": 0.2, "static": 0.2}]}
    assert around("coulomb_friction.elbow", {"torque": 0.2}) == wider | loaded(0.2)
    values = {"coulomb": 0.1, "static": 0.1 + 2 * FIXED.special_case_sds * 0.01, "velocity": 1.0}
    assert around("stribeck_friction.elbow", values) == loaded(0.1)
    near = values | {"static": 0.1 + 0.5 * FIXED.special_case_sds * 0.01}
    assert set(around("stribeck_friction.elbow", near)) == {("coulomb_friction.elbow", "narrower"), *loaded(0.1)}
    assert around("load_friction.elbow", {"coefficient": 0.1}) == {}


def test_friction_under_load_begins_as_large_as_what_stands_in_for_it():
    """Along a swing that a motor holds up, k of its load is the level in the mean."""
    arm = random_arm(ARM, duration=1.0, fps=50, commanded=True)
    coulomb, load = (EFFECTS[name]("elbow").bound(ARM) for name in ("coulomb_friction", "load_friction"))
    starts = CATALOGUE.of(coulomb).starts["load_friction"]
    (start,) = starts(coulomb, load, {"torque": 0.3}, arm.scale)
    carried = 2 * arm.scale.command[:, 1].abs()
    assert start["coefficient"] * carried.mean().item() == pytest.approx(0.3)
    assert list(starts(coulomb, load, {"torque": 0.0}, arm.scale)) == []


def test_soft_tissue_may_be_a_link_that_bends():
    """The one whose tip it is at, from stiffnesses of which each is at least that of the next frequency."""
    (starts,) = around("soft_tissue.wrist", {"kappa": 1e-4}).values()
    stiffness = [start["stiffness"] for start in starts]
    assert len(stiffness) == 3
    assert np.all(np.diff(stiffness) > 0)
    assert set(around("soft_tissue.elbow", {"kappa": 1e-4})) == {("link_flexibility.upper_arm", "similar")}


@pytest.mark.parametrize(
    ("where", "passive", "names"),
    [
        ("one link", True, {*NAMES} - {"clock_rate"}),
        ("one link", False, set()),
        ("two links", True, set()),
        ("flat", True, set()),
    ],
)
def test_only_what_hangs_and_is_left_to_itself_has_one_period(where, passive, names):
    found = around("clock_rate", {"rate": 1.08}, where, passive=passive)
    assert {key.partition(".")[0] for key, kind in found if kind == "twin"} == names


@given(st.floats(0.5, 2.0))
def test_each_equivalent_has_the_same_factor(rho):
    found = equivalents(rho)
    assert set(found) <= set(NAMES)
    for name, values in found.items():
        assert factor(*whole(name, values), SCALE.body) == pytest.approx(rho, rel=1e-9)


def test_a_swing_cannot_be_slower_than_its_weight_at_the_tip():
    """A load at the tip of a rod makes a pendulum of its length at most, which is half as long again; no more mass
    makes the swing faster."""
    assert set(equivalents(1.4)) == set(NAMES)
    assert set(equivalents(1.6)) == set(NAMES) - {"payload"}
    assert set(equivalents(0.9)) == {"clock_rate", "inertial_error"}
    assert set(equivalents(0.6)) == {"clock_rate"}  # a link's weight by itself resists as much


def test_a_link_that_does_not_hang_has_no_period():
    """Balanced, or turned over by a load beyond its joint."""
    for com in (0.0, -0.05):
        link = PENDULUM.with_values(com=[com]).parameters()
        effect = EFFECTS["payload"]().bound(PENDULUM)
        assert of_same_period(effect, {"mass": 0.4}, replace(SCALE, body=link), CATALOGUE) == {}
