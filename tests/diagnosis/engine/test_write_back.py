"""Numbers that are changed in a compiled model are those of a file with that number, for every effect."""

import copy
from pathlib import Path

import linkages
import mujoco
import muscled_arms
import numpy as np
import pytest
from robot_xml import Older

from invdyn.diagnosis.assessment.result import Cause, Estimate, Finding
from invdyn.diagnosis.catalogue.engine_effects import EFFECTS, candidates
from invdyn.diagnosis.catalogue.engine_sizes import Sizes
from invdyn.diagnosis.catalogue.model_numbers import FRICTION, Place, changed, write_mass
from invdyn.diagnosis.engine.write_back import candidate_of, rewritten
from invdyn.diagnosis.write_back.mjcf_writer import DAMPING, FROM_GEOMS, SERVO, Writer
from invdyn.diagnosis.write_back.xml_text import XmlText
from invdyn.models import Scene

GROUND = """<mujoco><option timestep="0.002"/><compiler angle="radian"/><worldbody>
  <geom name="floor" type="plane" size="2 2 .1" friction=".7"/>
  <body name="leg" pos="0 0 .1"><joint name="up" type="slide" axis="0 0 1"/>
    <joint name="turn" axis="0 1 0" stiffness="2" springref=".3" damping=".1" armature=".01" frictionloss=".02"/>
    <inertial pos="0 0 0" mass="1.5" diaginertia=".1 .1 .1"/>
    <geom name="foot" size=".09" friction=".7"/><geom name="heel" size=".09" pos=".1 0 0" friction=".5"/></body>
</worldbody><actuator><position name="servo" joint="turn" kp="20" kv="1"/>
  <position name="slow" joint="turn" kp="2" kv=".1" timeconst=".05"/></actuator></mujoco>"""
UNNAMED = """<mujoco><option timestep="0.002"/><compiler angle="radian"/>
<default><default class="foot"><geom size=".09"/></default></default><worldbody>
  <body name="leg" pos="0 0 .1"><joint axis="0 0 1" type="slide"/>
    <inertial pos="0 0 0" mass="1.5" diaginertia=".1 .1 .1"/>
    <geom class="foot" friction=".7"/>
    <body name="toe" pos=".2 0 0"><joint axis="0 1 0"/><inertial pos="0 0 0" mass=".2" diaginertia=".01 .01 .01"/>
      <geom size=".05" friction=".6"/></body>
    <joint axis="0 1 0" damping=".3"/><geom class="foot" pos=".1 0 0" friction=".5"/></body>
  <geom type="plane" size="2 2 .1" friction=".7"/></worldbody></mujoco>"""
"""MuJoCo counts the floor first, and the leg's second joint and shape before the toe's."""
PAIR = GROUND.replace("</worldbody>", '</worldbody><contact><pair geom1="floor" geom2="heel" friction=".5"/></contact>')
GEOMS = """<mujoco><option timestep="0.002"/><compiler angle="radian" inertiafromgeom="true"/>
<worldbody><body name="leg"><joint name="turn" axis="0 1 0" damping=".1"/><inertial pos="0 0 0" mass="9"/>
    <geom name="shin" type="capsule" size=".02 .2" pos="0 0 -.2" density="700"/>
    <geom name="cover" size=".05" mass="0"/></body></worldbody>
<actuator><damper name="brake" joint="turn" kv="2" ctrlrange="0 1"/>
  <adhesion name="stick" body="leg" gain="5" ctrlrange="0 1"/>
  <intvelocity name="wheel" joint="turn" kp="3" kv=".2" actrange="-1 1"/></actuator></mujoco>"""
"""All inertias are the shapes', and gears count for no adhesion."""
MODELS = {
    "geoms": (GEOMS, []),
    "unnamed": (UNNAMED, [(0, 1), (0, 2), (0, 3)]),
    "ground": (GROUND, [(0, 1), (0, 2)]),
    "holding": (linkages.HOLDING, [(0, 2), (1, 2)]),
    "pair": (PAIR, [(0, 1), (0, 2)]),
    "rubbing": (linkages.RUBBING, []),
    "muscles": (muscled_arms.TWO, []),
}


def every(text, pairs):
    scene = Scene.of(text)
    model = scene.model
    sizes = Sizes(model, np.ones((4, model.nv)), np.ones((4, model.ntendon)), 1.0)
    return scene, candidates(model, pairs, sizes)


def pushed(model):
    """What actuators do at half of their control, in motion: in sum, by joint and each by itself."""
    data = mujoco.MjData(model)
    data.ctrl[:], data.act[:], data.qvel[:] = 0.5, 0.3, 0.1
    mujoco.mj_forward(model, data)
    return np.concatenate([data.qfrc_actuator, data.actuator_force])


def findings(model, candidate, step=0.2):
    before, sds = candidate.priors(model, Sizes(model, np.ones((4, model.nv)), np.ones((4, model.ntendon)), 1.0))
    values = [
        float(np.clip(b + step * s, n.low, n.high))
        for b, s, n in zip(before, sds, candidate.effect.numbers, strict=True)
    ]
    parameters = {n.name: Estimate(v, 0.1, (v, v), "1") for n, v in zip(candidate.effect.numbers, values, strict=True)}
    return Finding(candidate.name, "dynamics", {candidate.place.kind: candidate.place.name}, parameters), values


@pytest.mark.parametrize("name", MODELS)
def test_what_is_written_is_what_was_changed(name):
    text, pairs = MODELS[name]
    scene, found = every(text, pairs)
    model, written = scene.model, set()
    for candidate in found:
        finding, values = findings(model, candidate)
        assert candidate_of(model, finding).place.name == candidate.place.name
        new, done, unsaid = rewritten(text.encode(), scene, Cause((finding,), 1.0, 0.0, 0.0))
        if unsaid:
            assert not done
            assert new == text.encode()
            continue
        written.add(candidate.name)
        writes = [(n.write, candidate.place, v) for n, v in zip(candidate.effect.numbers, values, strict=True)]
        wanted, got = changed(model, writes), Scene.of(new.decode()).model
        differing = 0
        for field in dir(model):
            one, two, before = (getattr(each, field, None) for each in (wanted, got, model))
            if isinstance(one, np.ndarray) and one.dtype == np.float64 and not field.startswith(("cam_", "light_")):
                assert two == pytest.approx(one, rel=2e-5, abs=1e-6), (candidate.key, field)
                differing += not np.array_equal(one, before)
        assert differing, candidate.key
        assert pushed(got) == pytest.approx(pushed(wanted), rel=1e-4), candidate.key
    assert (
        len(written)
        >= {"geoms": 6, "unnamed": 9, "ground": 12, "holding": 13, "pair": 12, "rubbing": 10, "muscles": 6}[name]
    ), sorted(written)


def test_what_a_pair_of_the_file_has_is_not_that_of_its_shapes():
    scene, found = every(PAIR, [(0, 2)])
    for effect, array in (("friction", "friction"), ("softness", "solref"), ("yielding", "solimp")):
        (candidate,) = (each for each in found if each.key == f"contact_{effect}.floor-heel")
        finding, _ = findings(scene.model, candidate)
        new, _, unsaid = rewritten(PAIR.encode(), scene, Cause((finding,), 1.0, 0.0, 0.0))
        model = mujoco.MjModel.from_xml_string(new.decode())
        assert not unsaid
        for kind, moves in (("pair", True), ("geom", False)):
            name = f"{kind}_{array}"
            assert np.array_equal(getattr(model, name), getattr(scene.model, name)) != moves


def test_every_effect_is_somewhere():
    seen = {each.name for text, pairs in MODELS.values() for each in every(text, pairs)[1]}
    assert seen == {effect.name for effect in EFFECTS}
    page = (Path(__file__).parents[3] / "docs" / "how-to" / "wrong_contact.md").read_text("utf-8")
    assert all(f"`{name}`" in page for name in seen)


def test_a_limited_motors_gain_is_said_and_not_written():
    """Its force is limited before the gear: a larger gear would give more than was played."""
    text = GROUND.replace(
        '<position name="servo"', '<motor name="push" joint="turn" forcerange="-1 1"/><position name="servo"'
    )
    scene, found = every(text, [])
    (candidate,) = (each for each in found if each.key == "actuator_gain.push")
    finding, _ = findings(scene.model, candidate)
    new, done, unsaid = rewritten(text.encode(), scene, Cause((finding,), 1.0, 0.0, 0.0))
    assert (new, done) == (text.encode(), [])
    assert "limited before the gear" in next(iter(unsaid.values()))


@pytest.mark.parametrize("name", ["brake", "stick", "wheel"])
def test_a_gain_is_a_factor_on_the_force_that_depends_on_speed_or_on_no_gear(name):
    scene, found = every(GEOMS, [])
    (candidate,) = (each for each in found if each.key == f"actuator_gain.{name}")
    (number,) = candidate.effect.numbers
    model, (before, after) = scene.model, (candidate.place.number, candidate.place.number + 1)
    stronger = changed(model, [(number.write, candidate.place, 1.5)])
    one, other = (pushed(each)[model.nv :][before:after] for each in (model, stronger))
    assert other == pytest.approx(1.5 * one, rel=1e-12)
    assert np.array_equal(stronger.actuator_gear, model.actuator_gear)
    assert one != 0


def test_what_a_version_of_mujoco_lacks_is_not_written():
    model = mujoco.MjModel.from_xml_string(GROUND)
    after = changed(model, [(FRICTION[1], Place("joint", "turn", 1), 0.05)])
    text = XmlText(GROUND.encode())
    assert Writer(text, Older(model)).write(Older(model), Older(after), "why") is None
    assert 'frictionloss="0.05"' in text.changed().decode()


@pytest.mark.parametrize(
    ("own", "columns", "why"),
    [
        ('<general joint="turn" gainprm="20" biastype="affine" biasprm="0 -20 -1"/>', [2], DAMPING),
        ('<general joint="turn" gainprm="20" biastype="affine" biasprm="0 -20 -1"/>', [1, 2], SERVO),
        ('<velocity joint="turn" kv="20"/>', [2], DAMPING),
        ('<position joint="turn" kp="20" dampratio="1"/>', [2], DAMPING),
        ('<position joint="turn" class="damped" kp="20"/>', [1, 2], SERVO),
    ],
)
def test_a_damping_that_has_no_word_is_told_from_a_gain(own, columns, why):
    damped = '<default><default class="damped"><position dampratio="1"/></default></default><worldbody>'
    content = GROUND.replace("<worldbody>", damped).replace("</actuator>", f"{own}</actuator>")
    model = mujoco.MjModel.from_xml_string(content)
    after = copy.copy(model)
    after.actuator_biasprm[-1, columns] *= 0.5
    text = XmlText(content.encode())
    assert Writer(text, model).write(model, after, "") == why
    assert text.changed() == content.encode()


def test_a_mass_that_shapes_share_is_said_and_not_written():
    for text in (GEOMS.replace('mass="0"', 'mass=".1"'), GEOMS):
        model = mujoco.MjModel.from_xml_string(text)
        after = changed(model, [(write_mass, Place("link", "leg", 1), 0.4)])
        if text is GEOMS:  # heavier, and elsewhere
            after.body_ipos[1, 0] += 0.01
        found = XmlText(text.encode())
        assert Writer(found, model).write(model, after, "") == FROM_GEOMS
        assert found.changed() == text.encode()


def test_what_stands_in_a_frame_is_said_and_not_written():
    floor = '<geom name="floor" type="plane" size="2 2 .1" friction=".7"/>'
    text = GROUND.replace(floor, f'<frame pos="0 0 .01">{floor}</frame>')
    scene, found = every(text, [(0, 1)])
    (candidate,) = (each for each in found if each.key == "ground_height.floor")
    finding, _ = findings(scene.model, candidate)
    new, done, unsaid = rewritten(text.encode(), scene, Cause((finding,), 1.0, 0.0, 0.0))
    assert (new, done) == (text.encode(), [])
    assert "placed by a frame" in next(iter(unsaid.values()))


@pytest.mark.parametrize(("joint", "unit"), [("hinge", "N·m·s/rad"), ("slide", "N·s/m")])
def test_a_fixed_tendon_has_the_units_of_its_joints(joint, unit):
    text = f"""<mujoco><worldbody><body><joint name="j" type="{joint}" axis="0 1 0"/><geom size=".1"/></body>
      </worldbody><tendon><fixed name="t" stiffness="1"><joint joint="j" coef="1"/></fixed></tendon></mujoco>"""
    scene, found = every(text, [])
    (candidate,) = (each for each in found if each.key == "tendon_damping.t")
    assert candidate.units(scene.model) == [unit]


def test_friction_of_a_pair_is_the_larger_one():
    """Lowered at both shapes, raised at the one that has it; what touches alone is changed."""
    scene, found = every(GROUND, [(0, 1), (0, 2)])
    for name, value, expected in (
        ("floor-foot", 0.4, [0.4, 0.4, 0.5]),
        ("floor-foot", 0.9, [0.9, 0.9, 0.5]),
        ("floor-heel", 0.6, [0.6, 0.7, 0.5]),
        ("floor-foot, floor-heel", 0.3, [0.3, 0.3, 0.3]),
    ):
        (candidate,) = (each for each in found if each.key == f"contact_friction.{name}")
        (number,) = candidate.effect.numbers
        assert changed(scene.model, [(number.write, candidate.place, value)]).geom_friction[:, 0] == pytest.approx(
            expected
        )


def test_sizes_are_those_of_the_motion():
    model = mujoco.MjModel.from_xml_string(linkages.HOLDING)
    time = np.arange(50) * 0.01
    physics = np.zeros((50, 6))
    physics[:, 0] = physics[:, 1] = 0.01 * np.sin(10 * time)
    physics[:, 3] = physics[:, 4] = 0.1 * np.cos(10 * time)
    inputs = np.tile([4.0, 0.0], (50, 1))
    sizes = Sizes.of(model, physics, time, inputs, int(mujoco.mjtState.mjSTATE_CTRL))
    assert sizes.dofs[0, :2] == pytest.approx(2.0)  # half of the tendon's force
    assert sizes.tendons[0, 0] >= 4.0
    assert sizes.tendons[3, 0] == pytest.approx(0.01, rel=0.1)
    assert sizes.dofs[2, 0] == pytest.approx(0.72, rel=0.1)
