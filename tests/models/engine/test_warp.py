"""MuJoCo Warp's steps beside MuJoCo's own: contact, muscles, a free body under a wrench. Needs the extra `warp`."""

import legs
import muscled_arms
import numpy as np
import pytest
import torch

from invdyn.models import Controls, EngineModel, JointTorques, Scene, Wrench
from invdyn.models.bodies.scalars import BodyError

FREE = """<mujoco><option timestep="0.002"/><worldbody><body name="box" pos="0 0 1"><freejoint name="root"/>
<geom type="box" size=".1 .08 .05" mass="2"/><site name="a"/></body></worldbody></mujoco>"""
STRANGE = FREE.replace('timestep="0.002"', 'timestep="0.002" solver="PGS"')
CASES = {
    "leg": (legs.leg_file("hop"), JointTorques(("hip", "knee")), [-0.11, -0.6, 1.2], [0.5, 2, 2]),
    "muscles": (muscled_arms.SIX, Controls(), [0.8, 0.8], [1, 1]),
    "actuators at rest": (
        muscled_arms.SIX.replace("<option", '<option integrator="implicitfast"'),
        JointTorques(),
        [0.8, 0.8],
        [1, 1],
    ),
    "wrench": (FREE, Wrench("box"), [0.1] * 6, [1] * 6),
}


def model_of(text, drive, **options):
    known = {"torque.scale": 5.0} if isinstance(drive, JointTorques) else {}
    return EngineModel(Scene.of(text), np.arange(4) * 0.01, drive=drive, parameters=known, **options)


def states_of(model, pose, speed, count=40):
    rng = np.random.default_rng(0)
    z = rng.normal(size=(count, model.torque_size)) * model.parameters["torque.scale"].numpy()
    tangent = np.array(pose) + 0.03 * rng.normal(size=(count, model.nv))
    activation = rng.uniform(0.05, 0.5, (count, model.na))
    return torch.as_tensor(np.concatenate([z, tangent, rng.normal(size=(count, model.nv)) * speed, activation], -1))


@pytest.mark.long
@pytest.mark.parametrize("case", CASES)
def test_rows_are_mujocos(case):
    pytest.importorskip("mujoco_warp")
    text, drive, pose, speed = CASES[case]
    own, model = model_of(text, drive), model_of(text, drive, warp="cpu")
    states = states_of(own, pose, speed)
    wanted = own.moved(states, 1)
    moved = (wanted - states)[:, own.torque_size :].abs().amax(0)
    found = model.moved(states, 1)
    assert bool(((found - wanted)[:, own.torque_size :].abs().amax(0) < 1e-5 * moved + 1e-6).all())
    alone = model.moved(states[-3:], 1)
    assert torch.equal(alone, found[-3:])  # neighbours and earlier calls do not matter
    if case == "leg":
        again = model_of(text, drive, warp="cpu")
        again.simulator.room = 1  # too little for a foot and a trunk on the floor
        states[:, own.torque_size] = -0.4
        lying = own.moved(states, 1)
        assert bool(torch.isfinite(lying).all())
        assert float((again.moved(states, 1) - lying).abs().max()) < 1e-3
        assert again.simulator.room > 1


@pytest.mark.long
def test_what_warp_lacks_is_said():
    pytest.importorskip("mujoco_warp")
    for text, device, why in ((STRANGE, "cpu", "PGS"), (FREE, "abacus", "abacus")):
        with pytest.raises(BodyError, match=f"MuJoCo Warp cannot simulate this on {device}: .*{why}"):
            _ = model_of(text, Wrench("box"), warp=device).simulator


def test_it_asks_for_its_extra(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "mujoco_warp", None)
    with pytest.raises(BodyError, match=r"pip install 'invdyn\[warp\]', or leave warp= out"):
        _ = model_of(FREE, Wrench("box"), warp="cpu").simulator
