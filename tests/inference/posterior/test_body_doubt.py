"""Torques of a robot whose file does not say how well its numbers are known."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from invdyn.cli import app
from invdyn.inference import infer, load_posterior, mechanics, pooled
from invdyn.inference.execution.seeds import seeded
from invdyn.inference.posterior import body_doubt
from invdyn.inference.posterior.body_doubt import CENTRE, CHANGED, FILED, JOINT, LEVEL, MASS, MOMENT, OF_JOINTS, SLOW
from invdyn.inference.posterior.initialise import arm_problem
from invdyn.inference.posterior.problem import Contents
from invdyn.models import ArmModel, Body, Joint, Link, planar_body, write_mjcf
from invdyn.models.articulated.moving_base import MovingBase
from invdyn.models.bodies.joint_parts import JointParts
from invdyn.models.effects.inertias import size_of
from invdyn.recordings import Recording
from invdyn.summary import summary_text

KNOWN = {"torque.scale": 3.0, "torque.decay": 3.0, "emission.angle_scale": 1e-4}
SIZES = {"num_filters": 40, "num_draws": 25, "seed": 1, "settings": KNOWN, "method": "laplace"}
TREE = Body(
    "robot",
    [
        Link(
            "upper",
            Joint("swing", axis=(0.0, 1.0, 0.0)),
            mass=2.0,
            com=(0.02, 0.0, -0.15),
            inertia=(0.02, 0.02, 0.004, 0.0, 0.0, 0.0),
            sites={"elbow": (0.0, 0.0, -0.3)},
        ),
        Link(
            "fore",
            Joint("bend", axis=(1.0, 0.0, 0.0)),
            parent="upper",
            origin=(0.0, 0.0, -0.3),
            mass=1.0,
            com=(0.0, 0.01, -0.1),
            inertia=(0.006, 0.006, 0.001, 0.0, 0.0, 0.0),
            sites={"wrist": (0.0, 0.0, -0.25)},
        ),
    ],
)
LINKS = [Link("a", "swing", "elbow", length=0.3, mass=2.0), Link("b", "bend", "wrist", length=0.25, mass=1.0)]
BODIES = {2: planar_body("chain", LINKS), 3: TREE}


def of_encoders(rows=25):
    time = 0.04 * np.arange(rows)
    angles = np.stack([0.5 * np.sin(3 * time) + 0.4, 0.7 * np.cos(2 * time)], -1)
    angles += 1e-4 * np.random.default_rng(0).normal(size=angles.shape)
    return Recording(time, np.empty((rows, 0, 3)), (), angles=angles, joint_names=TREE.joint_names)


@pytest.fixture
def file(tmp_path):
    write_mjcf(TREE, tmp_path / "robot.xml")
    return tmp_path / "robot.xml"


def band(idata, name="torque"):
    return pooled(idata)[name].transpose("sample", "time", "joint").values


def test_the_bands_hold_what_the_file_leaves_open(file):
    body = Body.load(file, dimensions=3)
    assert not body.exact
    found, exact = infer(of_encoders(), body, **SIZES), infer(of_encoders(), replace(body, exact=True), **SIZES)
    assert "by friction" in found.attrs["body_doubt"]
    text = summary_text(found)
    assert 0 <= text.index("torques are net") < text.index("Joint torques"), "what is in doubt comes first"
    np.testing.assert_allclose(band(found, "stated_torque"), band(exact), rtol=1e-12)
    wide, narrow = band(found).var(0)[:-1], band(exact).var(0)[:-1]  # nothing follows the last row, which tells least
    assert (wide > 2 * narrow).all()
    assert abs(band(found).mean(0) - band(exact).mean(0))[:-1].max() < 4 * np.sqrt(wide.max() / 1000)
    assert "body_doubt" not in exact.attrs
    assert "stated_torque" not in exact.posterior


def test_what_is_stated_or_commanded_is_left_as_it_is(file, tmp_path):
    body, recording = Body.load(file, dimensions=3), of_encoders()
    assert arm_problem(recording, body).doubted
    assert not arm_problem(recording, body, passive=True).doubted
    assert not arm_problem(recording, replace(body, uncertainty={"mass": 0.0})).doubted
    for exact in (False, True):  # a TOML can say which
        replace(body, exact=exact).to_toml(tmp_path / "robot.toml")
        assert arm_problem(recording, Body.load(tmp_path / "robot.toml")).doubted is not exact
    plain = infer(recording, body, **SIZES | {"method": "differentiate"})
    assert "stated_torque" not in plain.posterior


@pytest.mark.parametrize("parts", [None, JointParts(damping=0.4, armature=0.02, stiffness=0.7, rest=0.2)])
def test_each_draw_keeps_its_motion_under_its_own_body(file, parts):
    """D θ̈ + h + c = τ with the numbers of each draw, as :func:`.mechanics` takes them, and what the joints have."""
    body = Body.load(file, dimensions=3)
    body = replace(body, links=[replace(link, parts=parts) for link in body.links])
    found = infer(of_encoders(), body, **SIZES)
    own = mechanics(found, body)["acceleration"].values
    numbers = ["mass", "com", "inertia", "gravity", "torque", *OF_JOINTS]
    stated = found.copy()
    stated.posterior = found.posterior.drop_vars(numbers).rename(stated_torque="torque")
    np.testing.assert_allclose(own, mechanics(stated, body)["acceleration"].values, atol=1e-9)
    model = arm_problem(of_encoders(), body, parameters=KNOWN).model
    state = np.concatenate([found.posterior[name].values for name in ("angle", "velocity")], -1)
    torque = found.posterior["stated_torque"].values
    whole = np.concatenate([torque, np.zeros((*torque.shape[:-1], model.state_dim - 6)), state], -1)
    moved = model.acceleration(torch.as_tensor(whole), torch.arange(len(model.time)), model.body_parameters())
    np.testing.assert_allclose(own, moved, atol=1e-9)
    assert found.posterior["mass"].dims == ("chain", "draw", "link")


@pytest.mark.long
def test_the_command_line_says_it_and_takes_a_file_as_exact(file, tmp_path):
    recording = of_encoders(12)
    table = np.column_stack([recording.time, recording.angles])
    names = ",".join(f"{name}_angle" for name in TREE.joint_names)
    np.savetxt(tmp_path / "rec.csv", table, delimiter=",", header=f"time,{names}", comments="")
    asked = ["infer", str(tmp_path / "rec.csv"), "--body", str(file), "--method", "laplace"]
    asked += ["--out", str(tmp_path / "posterior.nc")]
    said = CliRunner().invoke(app, asked)
    assert said.exit_code == 0, said.output
    assert "does not say how well its numbers are known" in said.output
    assert "stated_torque" in load_posterior(tmp_path / "posterior.nc").posterior
    exact = CliRunner().invoke(app, [*asked, "--set", "exact_body=yes"])
    assert exact.exit_code == 0, exact.output
    assert "how well" not in exact.output
    wrong = CliRunner().invoke(app, [*asked, "--set", "exact_body=perhaps"])
    assert wrong.exit_code == 2
    assert "expected yes or no" in wrong.output


@pytest.mark.parametrize("dimensions", BODIES)
def test_a_load_of_uncertain_mass_widens_the_band_by_its_weight(dimensions, monkeypatch, tmp_path):
    """Of an arm at rest, all else known: sd of its mass times g times its horizontal distance from each joint."""
    for name in ("MASS", "MOMENT"):
        monkeypatch.setattr(body_doubt, name, 1e-6)
    for name in ("CENTRE", "LEVEL", "JOINT"):
        monkeypatch.setattr(body_doubt, name, 0.0)
    at, place = (0.2 if dimensions == 2 else [0.1, 0.0, -0.2]), tmp_path / "arm.toml"
    replace(BODIES[dimensions], exact=False).to_toml(place)
    place.write_text(place.read_text() + f"load = {{mass = {{mean = 0.5, sd = 0.1}}, at = {at}}}\n")
    body = Body.load(place)
    body.to_toml(place)
    one, other = (each.links[1] for each in (body, Body.load(place)))
    assert [other.nominal("mass"), other.load[0].mean] == pytest.approx([one.nominal("mass"), 0.5], rel=1e-12)
    np.testing.assert_allclose(other.com, one.com, rtol=1e-12)
    np.testing.assert_allclose(other.inertia, one.inertia, atol=1e-12)
    model = ArmModel(body, 0.04 * np.arange(3))
    with seeded(0):
        other = body_doubt.drawn(model, (20_000,))
    q, still = torch.tensor([0.4, 0.7]).double().expand(20_000, 2), torch.zeros(20_000, 2).double()
    torque = model.dynamics.inverse(q, still, still, other)
    if dimensions == 2:
        x = torch.tensor([0.3 * np.cos(0.4) + 0.2 * np.cos(1.1), 0.2 * np.cos(1.1)])
    else:
        links = [*body.links[:1], replace(body.links[1], sites={"tool": tuple(at)})]
        probe = model_of = replace(body, links=links)
        jacobian = ArmModel(model_of, model.time).dynamics.jacobian(q[0], probe.parameters())
        x = jacobian[list(probe.keypoint_names).index("tool"), 2]
    assert torque.std(0).numpy() == pytest.approx(0.1 * 9.81 * x.abs().numpy(), rel=0.02)
    for stated in ({"exact": True}, {"uncertainty": {"mass": 0.1}}):
        with pytest.raises(ValueError, match="a load of uncertain mass is for a body that states no other"):
            replace(body, **stated)


@pytest.mark.parametrize("dimensions", BODIES)
def test_the_share_of_the_body_is_that_of_its_linearisation(dimensions):
    """Y Σ Yᵀ, with Y by differences, and all rows of one draw moved together; joints by themselves besides."""
    body = replace(BODIES[dimensions], exact=False)
    problem = arm_problem(of_encoders(8), body, parameters=KNOWN)
    model = problem.model
    p = model.body_parameters()
    path = model.initial_paths(problem.observations)[0]
    draws = path.expand(4000, 1, -1, -1)
    with seeded(0):
        found = problem.contents(draws, torch.zeros(4000, 1, 8, model.observation_dim).double()).posterior
    change = (found["torque"][1] - found["stated_torque"][1])[:, 0].flatten(1)

    _, q, qd = model.split(path)
    qdd = model.acceleration(path, torch.arange(8), p)

    def slope(name, step):
        ends = [p._replace(**{name: getattr(p, name) + sign * 1e-3 * step}) for sign in (1, -1)]
        upper, lower = (model.dynamics.inverse(q, qd, qdd, end).flatten() for end in ends)
        return (upper - lower) / 2e-3

    units = torch.eye(2).double()
    columns = [slope("mass", MASS * p.mass * unit) for unit in units]
    columns += [slope("inertia", MOMENT * torch.einsum("l...,l->l...", p.inertia, unit)) for unit in units]
    for unit, size in zip(units, (size_of(p, 0), size_of(p, 1)), strict=True):
        steps = [unit] if dimensions == 2 else [torch.outer(unit, axis) for axis in torch.eye(3).double()]
        columns += [slope("com", CENTRE * size * step) for step in steps]
    level = torch.eye(dimensions).double()[: dimensions - 1]
    columns += [slope("gravity", 9.81 * LEVEL * way) for way in level]
    for unit, mass, size in zip(units, p.mass, (size_of(p, 0), size_of(p, 1)), strict=True):
        taken = JOINT * 9.81 * mass * size * unit
        columns += [taken.expand(8, 2).flatten(), (taken * torch.tanh(qd / SLOW)).flatten()]
    jacobian = torch.stack(columns, -1)
    expected, sampled = jacobian @ jacobian.mT, change.mT @ change / len(change)
    scale = expected.diagonal().sqrt()
    # 4,000 draws tell a correlation to 1.6 %, a variance to 2.2 %.
    assert ((expected - sampled) / torch.outer(scale, scale)).abs().max() < 0.08


def test_what_a_file_gives_joints_is_known_to_its_own_size():
    """Damping, dry friction and a rotor are off by factors whose relative sd is `FILED`, each by itself."""
    parts = JointParts(damping=0.4, friction=0.3, armature=0.02)
    links = [replace(link, parts=parts) for link in TREE.links[:1]] + list(TREE.links[1:])
    model = ArmModel(Body("robot", links), 0.04 * np.arange(3))
    with seeded(0):
        with_parts = body_doubt.drawn_joints(model, (40_000,))
    filed = {"viscous_friction": 0.4, "rotor_inertia": 0.02}
    own = JOINT * body_doubt.joint_weights(model)[0].item()
    for name, size in {**filed, "torque_offset": own, "dry_friction": np.hypot(0.3 * FILED, own)}.items():
        assert with_parts[name][:, 0].mean().item() == pytest.approx(0, abs=0.03 * size)
        # a log-normal of relative sd 1 has a kurtosis of 41, so that 40,000 draws tell its sd to 1.6 %
        assert with_parts[name][:, 0].std().item() == pytest.approx(size * (FILED if name in filed else 1), rel=0.06)
    assert not with_parts["viscous_friction"][:, 1].any()
    moved = {name: value[:2] for name, value in with_parts.items()}
    velocity = torch.tensor([2.0, -1.0], dtype=torch.float64)
    expected = moved["torque_offset"] + moved["dry_friction"] * velocity.sign() + moved["viscous_friction"] * velocity
    np.testing.assert_allclose(body_doubt.joint_losses(moved, velocity), expected, rtol=1e-9)


def test_a_joint_is_as_large_as_what_it_carries():
    """A frame without mass is that of the link on it, and a slide has a force."""
    carriage = Link("rail", Joint("along", "slide", axis=(1.0, 0.0, 0.0)), mass=3.0, com=(0.0, 0.0, 0.1))
    frame = Link("frame", Joint("lean", axis=(1.0, 0.0, 0.0)), parent="rail", mass=0.0)
    rod = Link(
        "rod",
        Joint("swing", axis=(0.0, 1.0, 0.0)),
        parent="frame",
        mass=0.5,
        com=(0.0, 0.0, -0.2),
        sites={"tip": (0.0, 0.0, -0.4)},
    )
    found = body_doubt.joint_weights(ArmModel(Body("cart", [carriage, frame, rod]), 0.1 * np.arange(3)))
    np.testing.assert_allclose(found, 9.81 * np.array([3.0, 0.5 * 0.4, 0.5 * 0.4]))


@pytest.mark.parametrize("base", [None, MovingBase(3)], ids=["at rest", "moving"])
def test_a_body_that_is_heavier_needs_as_much_more_torque(base, monkeypatch):
    """All masses and moments by a tenth: the same motion under a tenth more torque, on a base that moves, too."""
    model = ArmModel(replace(TREE, exact=False), 0.04 * np.arange(6), base=base)
    p = model.body_parameters()

    def heavier(model, shape):
        own = p._replace(mass=1.1 * p.mass, inertia=1.1 * p.inertia)
        return own._replace(**{name: getattr(own, name).expand(*shape, *getattr(own, name).shape) for name in CHANGED})

    monkeypatch.setattr(body_doubt, "drawn", heavier)
    monkeypatch.setattr(body_doubt, "JOINT", 0.0)
    paths = torch.as_tensor(np.random.default_rng(0).normal(size=(3, 2, 6, model.state_dim)))
    torque = {"torque": ([], model.net_torque(paths))}
    contents = Contents(torque, {}, {}, {}, {}, {"torque": "N·m"})
    found = body_doubt.with_doubted_body(contents, model, paths).posterior
    torch.testing.assert_close(found["torque"][1], 1.1 * found["stated_torque"][1])


def test_joints_take_torque_by_their_motion(monkeypatch):
    """Of a body as its file has it, a draw's torque is more by o + f tanh(θ̇/v) + b θ̇ + a θ̈."""
    model = ArmModel(replace(TREE, exact=False), 0.04 * np.arange(6))
    p = model.body_parameters()

    def same(model, shape):
        return p._replace(**{name: getattr(p, name).expand(*shape, *getattr(p, name).shape) for name in CHANGED})

    monkeypatch.setattr(body_doubt, "drawn", same)
    paths = torch.as_tensor(np.random.default_rng(0).normal(size=(3, 2, 6, model.state_dim)))
    contents = Contents({"torque": ([], model.net_torque(paths))}, {}, {}, {}, {}, {"torque": "N·m"})
    _, _, qd = model.split(paths)
    qdd = model.acceleration(paths, torch.arange(6), p)
    for name, expected in zip(OF_JOINTS, (torch.ones_like(qd), torch.tanh(qd / SLOW), qd, qdd), strict=True):
        taken = {each: torch.full((3, 2, 2), float(each == name)).double() for each in OF_JOINTS}
        monkeypatch.setattr(body_doubt, "drawn_joints", lambda model, shape, taken=taken: taken)
        found = body_doubt.with_doubted_body(contents, model, paths).posterior
        torch.testing.assert_close(found["torque"][1] - found["stated_torque"][1], expected, atol=1e-9, rtol=1e-9)


@pytest.mark.long
def test_it_agrees_with_filters_of_drawn_bodies(file, monkeypatch):
    """Masses alone, for few rows of which the torque's prior tells little."""
    for name in ("CENTRE", "MOMENT", "LEVEL", "JOINT"):
        monkeypatch.setattr(body_doubt, name, 1e-6)
    body, recording = Body.load(file, dimensions=3), of_encoders(12)
    found = infer(recording, body, **SIZES)
    drawn = infer(recording, replace(body, uncertainty={"mass": body_doubt.MASS}), **SIZES)
    assert "stated_torque" not in drawn.posterior
    ours, theirs = band(found), band(drawn)
    # 16 bodies tell a standard deviation to 18 %, and weigh a little by what the torque's prior makes of them.
    assert np.median(ours.std(0) / theirs.std(0)) == pytest.approx(1.0, abs=0.4)
    assert abs(ours.mean(0) - theirs.mean(0)).max() < 3 * ours.std(0).max() / 4
