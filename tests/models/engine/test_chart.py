"""The tangent chart against MuJoCo's own integration and differences of configurations."""

import mujoco
import numpy as np
import pytest

from invdyn.models.engine.chart import Chart

MIXED = """<mujoco><worldbody>
  <body><freejoint name="root"/><geom size=".1"/>
    <body pos="1 0 0"><joint name="hinge" axis="0 1 0"/><geom size=".1"/>
      <body pos="1 0 0"><joint name="ball" type="ball"/><geom size=".1"/>
        <body pos="1 0 0"><joint name="slide" type="slide"/><geom size=".1"/></body></body></body></body>
</worldbody></mujoco>"""


@pytest.fixture(scope="module")
def mixed():
    model = mujoco.MjModel.from_xml_string(MIXED)
    return model, Chart.of(model.jnt_type, model.jnt_qposadr, model.jnt_dofadr)


def configurations(model, count, rng, size=1.0):
    """Random ones, quaternions of length one."""
    out = np.tile(model.qpos0, (count, 1))
    for own in out:
        mujoco.mj_integratePos(model, own, size * rng.normal(size=model.nv), 1.0)
    return out


def test_charts_are_mujocos_own(mixed):
    model, chart = mixed
    rng = np.random.default_rng(0)
    reference, others = configurations(model, 1, rng)[0], configurations(model, 50, rng)
    tangents = chart.tangent(reference, others)
    by_mujoco = np.empty_like(tangents)
    for own, other in zip(by_mujoco, others, strict=True):
        mujoco.mj_differentiatePos(model, own, 1.0, reference, other)
    assert tangents == pytest.approx(by_mujoco, abs=1e-12)
    moved = np.tile(reference, (50, 1))
    for own, tangent in zip(moved, tangents, strict=True):
        mujoco.mj_integratePos(model, own, tangent, 1.0)
    assert chart.configuration(reference, tangents) == pytest.approx(moved, abs=1e-12)


def test_a_chart_undoes_itself_up_to_half_a_turn(mixed):
    model, chart = mixed
    rng = np.random.default_rng(1)
    tangent = rng.normal(size=(200, model.nv))
    for v in chart.rotations:
        size = np.linalg.norm(tangent[:, v : v + 3], axis=1, keepdims=True)
        tangent[:, v : v + 3] *= rng.uniform(0, np.pi - 1e-6, (200, 1)) / size
    back = chart.tangent(model.qpos0, chart.configuration(model.qpos0, tangent))
    assert back == pytest.approx(tangent, abs=1e-9)


def test_small_rotations_are_exact(mixed):
    model, chart = mixed
    for size in (0.0, 1e-14, 1e-9, 1e-4):
        tangent = np.zeros((1, model.nv))
        tangent[:, chart.rotations[0]] = size
        back = chart.tangent(model.qpos0, chart.configuration(model.qpos0, tangent))
        assert back == pytest.approx(tangent, rel=1e-9, abs=1e-25)


def test_what_ran_away_is_no_number(mixed):
    model, chart = mixed
    lost = np.stack([np.full(model.nq, np.nan), model.qpos0])
    assert np.isnan(chart.tangent(model.qpos0, lost)).all(1).tolist() == [True, False]
    assert np.isnan(chart.configuration(model.qpos0, np.full((1, model.nv), np.nan))).all()
