"""The exact equivalences hold in the simulated reality itself: another effect, the same picture."""

import numpy as np
import pytest

from invdyn.blindcheck.camera import film
from invdyn.blindcheck.effects import EFFECTS as INJECTED
from invdyn.blindcheck.equivalence import NUMBERS, exactly_equivalent, stand_ins
from invdyn.blindcheck.simulator import World
from invdyn.diagnosis.catalogue import CATALOGUE
from invdyn.diagnosis.catalogue.neighbours import of_same_period
from invdyn.diagnosis.catalogue.period_equivalents import factor
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.models import Link, planar_body
from invdyn.models.effects import EFFECTS
from invdyn.recordings import Recording

pytest.importorskip("mujoco")
MECHANISMS = {name: effect.install for name, effect in INJECTED.items() if effect.install is not None}

TIME = np.arange(-100, 201) / 100
SEEN = np.arange(0, 101) / 50


def body(joints, gravity=(0.0, -9.81), base=(0.0, 0.0)):
    links = [Link(f"l{k}", f"p{k}", f"p{k + 1}", 0.3, 1.0 - 0.3 * k, 0.14, 0.008) for k in range(joints)]
    return planar_body("arm", links, gravity, base)


def picture(arm, effects=(), q=None, qd=None, torque=0.0, seen=SEEN, time=TIME):
    """Points (T, P, 2) without noise; `torque` is the size of a sine that begins with `time`."""
    joints = arm.num_joints
    world = World(arm)
    for name, place, parameters in effects:
        if name in MECHANISMS:
            MECHANISMS[name](world, *(() if place is None else (place,)), **parameters)
    q = np.full(joints, 0.4) if q is None else np.asarray(q)
    qd = np.full(joints, 0.3) if qd is None else np.asarray(qd)
    run = world.run(time, lambda row, t, *_: torque * np.full(joints, np.sin(5 * (t - time[0]))), q, qd)
    return film(run, seen, [e for e in effects if e[0] not in MECHANISMS], 0.0, (0,))


def check(one, other):
    assert np.ptp(one[:, -1], axis=0).min() > 0.05  # it moves
    np.testing.assert_allclose(one, other, atol=2e-5)


def test_gravity_tilt_is_camera_roll():
    arm, tilt = body(2), 0.07
    rolled = picture(arm, [("camera_roll", None, {"angle": tilt})], torque=0.5)
    check(rolled, picture(arm, [("gravity_tilt", None, {"angle": tilt})], q=[0.4 + tilt, 0.4], torque=0.5))


def test_delay_of_every_actuator_is_camera_latency():
    arm, late = body(2), 0.04
    rest = {"q": [-np.pi / 2, 0.0], "qd": [0.0, 0.0], "torque": 0.5}  # where a late beginning changes nothing
    seen = picture(arm, [("camera_latency", None, {"latency": late})], **rest)
    delays = [("actuator_delay", joint, {"delay": late}) for joint in (0, 1)]
    check(seen, picture(arm, delays, **rest))
    assert np.abs(seen - picture(arm, delays[:1], **rest)).max() > 1e-3  # of one alone it is not


def test_lens_distortion_is_scale_on_one_link():
    arm = body(1)
    scaled = picture(arm, [("camera_scale", None, {"scale": 1 + 0.3 * 0.3**2})])
    check(scaled, picture(arm, [("lens_distortion", None, {"k1": 0.3})]))


@pytest.mark.parametrize(
    "effect", [("inertial_error", 0, {"mass": 0.0, "com": 0.0}), ("armature", 0, {}), ("payload", None, {})]
)
def test_inertia_is_gain_on_one_link_without_gravity(effect):
    arm = body(1, gravity=(0.0, 0.0))
    inertia = 0.008 + 0.14**2
    more = 0.25 * inertia
    name, place, parameters = effect
    sizes = {"payload": {"mass": more / 0.3**2}}.get(name, {"inertia": more})
    heavier = picture(arm, [(name, place, parameters | sizes)], torque=0.3)
    check(heavier, picture(arm, [("actuator_gain", 0, {"gain": 1 / 1.25 - 1})], torque=0.3))


def test_inertia_of_the_first_link_is_armature_without_gravity():
    arm = body(2, gravity=(0.0, 0.0))
    heavier = picture(arm, [("armature", 0, {"inertia": 0.005})], torque=0.3)
    check(heavier, picture(arm, [("inertial_error", 0, {"mass": 0.0, "com": 0.0, "inertia": 0.005})], torque=0.3))
    other = picture(arm, [("inertial_error", 1, {"mass": 0.0, "com": 0.0, "inertia": 0.005})], torque=0.3)
    elbow = picture(arm, [("armature", 1, {"inertia": 0.005})], torque=0.3)
    assert np.abs(other - elbow).max() > 1e-3  # at the second one it is not


@pytest.mark.parametrize(
    ("name", "known"),
    [("armature", {"inertia": 0.006}), ("payload", {"mass": 0.4}), ("clock_rate", {"rate": 1.1})],
)
def test_effects_on_the_period_are_equal_on_one_passive_link(name, known):
    arm, time = body(1), np.arange(301) / 100
    scale = diagnosis_problem(Recording(SEEN, picture(arm)[:, -1:], ("p1",)), arm, passive=True).model.scale
    effect = next(iter(EFFECTS[name].everywhere(arm, ("p1",)))).bound(arm)
    rho = factor(effect, known, scale.body)
    sizes = of_same_period(effect, known, scale, CATALOGUE)
    assert set(sizes) == {"armature", "payload", "clock_rate", "inertial_error"}
    pictures = {}
    for other, values in sizes.items():
        rate = values.get("rate", 1.0)
        whole = {"mass": 0.0, "com": 0.0} | values if other == "inertial_error" else values
        place = None if other == "payload" else 0
        effects = [] if other == "clock_rate" else [(other, place, whole)]
        pictures[other] = picture(arm, effects, qd=[0.3 * rate / np.sqrt(rho)], seen=SEEN / rate, time=time)
    for other in pictures.values():
        check(pictures[name], other)


@pytest.mark.parametrize(
    ("special", "general", "joints"),
    [
        (
            ("coulomb_friction", 0, {"torque": 0.1}),
            ("stribeck_friction", 0, {"coulomb": 0.1, "static": 0.1, "velocity": 1.0}),
            2,
        ),
        (("viscous_friction", 1, {"damping": 0.05}), ("drifting_friction", 1, {"damping": 0.05, "slope": 0.0}), 2),
        (("armature", 0, {"inertia": 0.01}), ("inertial_error", 0, {"mass": 0.0, "com": 0.0, "inertia": 0.01}), 2),
        (("camera_scale", None, {"scale": 1.1}), ("keypoint_offset", 0, {"along": 0.03, "across": 0.0}), 1),
        (
            ("lens_distortion", None, {"k1": 0.3}),
            ("keypoint_offset", 0, {"along": 0.3 * 0.3 * 0.3**2, "across": 0.0}),
            1,
        ),
        (
            ("camera_roll", None, {"angle": 0.1}),
            ("keypoint_offset", 0, {"along": 0.3 * (np.cos(0.1) - 1), "across": 0.3 * np.sin(0.1)}),
            1,
        ),
    ],
)
def test_an_imitation_of_an_effect_is_left_out_with_it(special, general, joints):
    arm = body(joints)
    check(picture(arm, [special], torque=0.5), picture(arm, [general], torque=0.5))
    names = [f"j{k}" for k in range(joints)]
    answer = {
        "joints": names,
        "links": ["l0", "l1"][:joints],
        "body": {"gravity": [0.0, -9.81], "base": [0.0, 0.0]},
        "regime": "commanded",
    }
    truth = {"effect": special[0]} | ({} if special[1] is None else {"joint": names[special[1]]})
    assert general[0] in stand_ins(truth, answer)
    assert special[0] not in stand_ins({"effect": general[0], "joint": names[0], "link": "l0"}, answer)


def test_one_link_has_two_numbers():
    """What a payload of .2 kg does to a link of 1 kg, a weaker motor with a rotor does as well: struck with it."""
    arm, load, inertia = body(1), 0.2, 0.008 + 0.14**2
    share = 0.14 / (0.14 + 0.3 * load)
    rotor = share * (inertia + 0.3**2 * load) - inertia
    assert rotor > 0
    loaded = picture(arm, [("payload", None, {"mass": load})], torque=0.5)
    weaker = [("actuator_gain", 0, {"gain": share - 1}), ("armature", 0, {"inertia": rotor})]
    check(loaded, picture(arm, weaker, torque=0.5))
    denser = (
        "inertial_error",
        0,
        {"mass": load, "com": 0.16 * load / (1 + load), "inertia": 0.16**2 * load / (1 + load)},
    )
    check(loaded, picture(arm, [denser], torque=0.5))
    answer = {"joints": ["j0"], "links": ["l0"], "body": {"gravity": [0.0, -9.81], "base": [0.0, 0.0]}}
    for name in NUMBERS:
        assert {name, *stand_ins({"effect": name, "joint": "j0"}, answer | {"regime": "commanded"})} == NUMBERS


@pytest.mark.parametrize("pair", [("gravity_tilt", "camera_roll"), ("actuator_delay", "camera_latency")])
def test_encoders_tell_the_camera_from_the_arm(pair):
    answer = {"joints": ["j0"], "body": {"gravity": [0.0, -9.81], "base": [0.0, 0.0]}, "regime": "commanded"}
    one, other = ({"effect": name} for name in pair)
    for encoder, alike in ((None, True), (1e-3, False)):
        case = answer | {"noise": {"keypoint_sd": 1e-3, "encoder_sd": encoder}}
        assert exactly_equivalent(one, other, case) is alike
        assert (pair[1] in stand_ins(one, case)) is alike
    # What turns the picture turns a single link's tip alone, encoders or not.
    rolled = stand_ins({"effect": "camera_roll"}, case)
    assert "keypoint_offset" in rolled
    assert "keypoint_offset" not in stand_ins({"effect": "gravity_tilt"}, case)


def test_what_cannot_imitate_an_effect_stays():
    answer = {
        "joints": ["j0", "j1"],
        "links": ["l0", "l1"],
        "body": {"gravity": [0.0, -9.81], "base": [0.0, 0.0]},
        "regime": "commanded",
    }
    assert stand_ins({"effect": "armature", "joint": "j1"}, answer) == ()
    assert stand_ins({"effect": "actuator_gain", "joint": "j0"}, answer) == ()
    assert stand_ins({"effect": "actuator_delay", "joint": "j0"}, answer) == ()
    assert stand_ins({"effect": "camera_latency"}, answer) == ("actuator_delay",)
    assert stand_ins({"effect": "gravity_tilt"}, answer) == ("camera_roll",)
    assert stand_ins({"effect": "soft_tissue", "keypoint": "p1"}, answer) == ()
