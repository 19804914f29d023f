"""Reality in space: without an effect it is the tree itself, with one what that does; cases can be judged."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

import invdyn.blindcheck.cases as cases
from invdyn.blindcheck.cases import effects_of, make_case, planned
from invdyn.blindcheck.commitment import canonical, read_opened
from invdyn.blindcheck.effects import IN_SPACE as INJECTED
from invdyn.blindcheck.engine import IN_SPACE
from invdyn.blindcheck.judge import judge
from invdyn.blindcheck.motion import random_plan, simulated
from invdyn.blindcheck.run import BlindRun
from invdyn.blindcheck.simulator import World
from invdyn.blindcheck.trees import SPACE, bodies, random_tree, with_damping, with_servos
from invdyn.blindcheck.worker import diagnose_case
from invdyn.models import dynamics_for, load_body
from invdyn.models.bodies.inertia import six
from invdyn.models.bodies.joint_parts import NOTHING
from invdyn.models.dynamics.integrators import rk4
from invdyn.models.effects import EFFECTS
from invdyn.recordings import read_keypoint_csv

pytest.importorskip("mujoco")
SPATIAL = IN_SPACE.name


def tree_of(joints, seed, branch=None):
    """A random tree; of several with the wanted fork, if that is said."""
    for stream in range(50):
        tree = random_tree(np.random.default_rng([seed, stream]), joints)
        if branch is None or branch == (tree.parents != tuple(range(-1, joints - 1))):
            return tree
    raise AssertionError("no such tree in fifty draws")


def ideal(tree, real, row, rows, resisted):
    """How far invdyn's dynamics part from so many rows, from one on: motors give commands, less `resisted`(q, q̇)."""
    dynamics, p = dynamics_for(tree), tree.parameters()
    per_row = (len(real.time) - 1) // (len(real.command) - 1)
    q, qd = (torch.tensor(state[row * per_row]) for state in (real.q, real.qd))
    dt = real.command_time[1] - real.command_time[0]
    path = []
    for u in torch.tensor(real.command[row : row + rows]):
        q, qd = rk4(
            lambda a, b, _, u=u: dynamics.forward(a, b, u - resisted(a, b), p), q, qd, dt, int(np.ceil(dt / 2e-3))
        )
        path.append(q)
    after = slice((row + 1) * per_row, (row + rows) * per_row + 1, per_row)
    return dynamics.keypoints(torch.stack(path), p).numpy() - real.points[after, 1:]


@pytest.mark.quick("3-*", "7-*")
@pytest.mark.parametrize(
    ("joints", "branch", "servos", "damped"),
    [(5, True, False, False), (4, False, True, True), (7, None, False, False), (3, False, False, True)],
)
def test_without_an_effect_it_is_the_tree(joints, branch, servos, damped):
    rng = np.random.default_rng([2, joints])
    tree = tree_of(joints, 2, branch)
    tree = with_servos(rng, tree) if servos else tree
    tree = with_damping(rng, tree) if damped else tree
    plan = replace(random_plan(rng, tree, False, World, SPACE.habits), duration=1.0)
    real = simulated(World(tree), World(tree), plan)
    assert (plan.targeted is not None) == servos
    own = [parts.damping if parts else 0.0 for parts in tree.joint_parts]
    assert (min(own) > 0) == damped
    damping = [b + (parts.motor.damping if servos else 0.0) for b, parts in zip(own, tree.joint_parts, strict=True)]
    stiffness = torch.tensor(plan.targeted if servos else [0.0] * joints)
    rows = int(0.2 * plan.command_rate)
    worst = [
        np.abs(ideal(tree, real, row, rows, lambda q, qd: stiffness * q + torch.tensor(damping) * qd)).max()
        for row in range(0, len(real.command) - rows, 2 * rows)
    ]
    assert max(worst) < 1e-6  # m; of 1e-4 and more of noise


def test_some_files_are_off_by_as_much_as_they_say():
    drawn = [bodies(np.random.default_rng([9, k]), (), (), False) for k in range(200)]
    pairs = [(true, file) for true, file in drawn if file is not true]
    assert 12 <= len(pairs) <= 40  # 25 in the mean; outside in one draw of a thousand
    assert all(file.has_priors and not true.has_priors for true, file in pairs)
    off = torch.cat([(file.parameters().mass / true.parameters().mass).log() for true, file in pairs])
    assert off.std().item() == pytest.approx(0.02, rel=3 / np.sqrt(2 * len(off)))
    stated = [float(link.mass.stddev / link.mass.mean) for _, file in pairs for link in file.links]
    np.testing.assert_allclose(stated, 0.02, rtol=1e-6)
    damped = sum(any(parts != NOTHING for parts in true.joint_parts) for true, _ in drawn)
    assert damped > 100  # by servos or joints: .6 of them


@pytest.mark.long
def test_friction_that_is_put_in_is_in_the_motion():
    """An exact replay of the recording's commands follows it with the answer's damping, and does not without."""
    case = make_case(31, "commanded", "viscous_friction", SPATIAL)
    (effect,) = case.answer["effects"]
    tree, joint = case.body, case.answer["joints"].index(effect["joint"])
    world = World(tree)
    INJECTED["viscous_friction"].install(world, joint, effect["parameters"]["damping"]["value"])
    rng = np.random.default_rng(1)
    plan = replace(random_plan(rng, tree, False, World, SPACE.habits), duration=1.0)
    real = simulated(world, World(tree), plan)
    damping = torch.zeros(tree.num_joints, dtype=torch.float64)
    damping[joint] = effect["parameters"]["damping"]["value"]
    rows = int(0.2 * plan.command_rate)
    with_it, without = (
        np.abs(ideal(tree, real, 30, rows, lambda q, qd, b=b: b * qd)).max() for b in (damping, 0 * damping)
    )
    assert with_it < 1e-6
    assert without > 100 * with_it


@pytest.mark.parametrize("name", ["payload", "inertial_error", "gravity_tilt"])
def test_inertias_and_gravity_are_those_of_the_catalogue(name):
    """Names, units, and what they do to a body's numbers: so that answers can be compared."""
    tree = tree_of(5, 3, branch=True)
    world, rng = World(tree), np.random.default_rng(4)
    plan = random_plan(rng, tree, False, World, SPACE.habits)
    scene = cases.scene(tree, plan, simulated(World(tree), World(tree), replace(plan, duration=0.5)), World)
    sizes = INJECTED[name].size(rng, scene, 2, 1.0)
    INJECTED[name].install(world, *([2] if name == "inertial_error" else []), **sizes)
    effect = EFFECTS[name](*(["link3"] if name == "inertial_error" else [])).bound(tree)
    theirs = effect.body({k: torch.tensor([v]).double() for k, v in sizes.items()}, tree.parameters())
    assert set(INJECTED[name].units) == set(sizes)
    for place, piece in enumerate(world.pieces):
        assert piece.mass == pytest.approx(theirs.mass[place].item())
        np.testing.assert_allclose(piece.com, theirs.com[place], atol=1e-12)
        np.testing.assert_allclose(six(piece.inertia), theirs.inertia[place], atol=1e-12)
    np.testing.assert_allclose(world.gravity, theirs.gravity, atol=1e-9)


def test_its_catalogue_is_that_of_the_diagnosis():
    tree = tree_of(3, 5)
    known = {name for name, kind in EFFECTS.items() if kind.fits(tree)}
    assert set(effects_of("commanded", SPATIAL)) == known
    assert "payload" in effects_of("passive", SPATIAL)
    assert "actuator_gain" not in effects_of("passive", SPATIAL)


@pytest.mark.quick("commanded-*", "passive-*")
@pytest.mark.parametrize(
    ("kind", "effect"), [("commanded", "label_swap"), ("passive", "coulomb_friction"), ("leave_one_out", "armature")]
)
def test_a_case_is_whole(kind, effect, tmp_path, monkeypatch):
    monkeypatch.setattr(cases, "MIN_DPRIME", 0.0)
    case = make_case(8, kind, effect, SPATIAL)
    case.write(tmp_path)
    canonical(case.answer)  # finite throughout, and plain JSON
    body = load_body(tmp_path / "body.toml")
    assert not body.is_chain
    assert 3 <= body.num_joints <= 7
    read = read_keypoint_csv(tmp_path / "recording.csv", joints=body.joint_names)
    assert (read.torques is not None) == (case.regime == "commanded")
    assert read.angles is not None or read.keypoints.shape[1:] == (len(body.keypoint_names), 3)
    (answer,) = case.answer["effects"]
    assert answer["effect"] == effect
    public = json.loads((tmp_path / "case.json").read_text())
    assert public["regime"] == case.regime
    assert (effect in public["without"]) == (kind == "leave_one_out")


def test_planned_cases_are_of_the_catalogue_in_space():
    plan = planned({"commanded": 30, "two": 3}, 5, SPATIAL)
    assert {effect for *_, kind, effect in plan if kind == "commanded"} == set(INJECTED)


@pytest.mark.long
def test_a_run_is_sealed_equally_in_another_process(tmp_path):
    """And its answers open to what was sealed."""
    run, alone = (
        BlindRun(tmp_path / name, {"none": 1}, seed=6, workers=workers, engine=SPATIAL)
        for name, workers in (("run", 2), ("alone", 1))
    )
    for each in (run, alone):
        each.check()
    sealed = run.make()
    assert alone.make() == sealed
    assert run.score().measure("all", "no diagnosis").value == 1
    assert sorted(read_opened(tmp_path / "run" / "answers.json", sealed)) == ["case-0000"]


@pytest.mark.long
def test_a_friction_is_diagnosed_and_judged(tmp_path, monkeypatch):
    """Of an arm of three hinges, among two effects: from the seed to the verdict."""
    few = {"viscous_friction", "coulomb_friction"}
    short = replace(SPACE, bodies=lambda rng, *_: (tree_of(3, 7),) * 2, habits=replace(SPACE.habits, seconds=(2, 2)))
    monkeypatch.setitem(cases.ENGINES, SPATIAL, replace(IN_SPACE, setting=short))
    case = make_case(31, "commanded", "viscous_friction", SPATIAL)
    case.write(tmp_path)
    diagnose_case(tmp_path, tmp_path / "out", [name for name in EFFECTS if name not in few])
    found = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    verdict = judge("case", case.answer, found)
    assert (verdict.detected, verdict.exact, verdict.joint, verdict.side) == (True, True, True, True)
    assert verdict.closed > 0.5  # of the last third, which is short
    assert set(verdict.covered) == {"damping"}
