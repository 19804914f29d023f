"""The dynamics against MuJoCo, Pinocchio and printed equations."""

import numpy as np
import pytest
import torch
from chains import BOTH, F64, JOINTS, assert_close, random_case

from invdyn.models.dynamics.symbolic import SymbolicDynamics, derive


class MuJoCo:
    """The same chain, built in MuJoCo: hinges about z, gravity in the plane, no armature."""

    def __init__(self, p):
        self.mj = pytest.importorskip("mujoco")
        length, mass, com, inertia = (x.tolist() for x in (p.length, p.mass, p.com, p.inertia))
        xml, K = "", len(length)
        for k in reversed(range(K)):
            at = p.base.tolist() if k == 0 else [length[k - 1], 0]
            flat = 0.75 * inertia[k]  # moments about x and y play no part
            xml = (
                f'<body pos="{at[0]!r} {at[1]!r} 0"><joint type="hinge" axis="0 0 1"/>'
                f'<inertial pos="{com[k]!r} 0 0" mass="{mass[k]!r}" '
                f'diaginertia="{flat!r} {flat!r} {inertia[k]!r}"/>'
                f'<site name="tip{k}" pos="{length[k]!r} 0 0"/>{xml}</body>'
            )
        gx, gy = p.gravity.tolist()
        self.model = self.mj.MjModel.from_xml_string(
            f'<mujoco><compiler boundmass="0" boundinertia="0"/><option gravity="{gx!r} {gy!r} 0">'
            f'<flag energy="enable"/></option><worldbody>{xml}</worldbody></mujoco>'
        )
        self.data = self.mj.MjData(self.model)

    def __call__(self, q, qd, qdd):
        mj, model, data = self.mj, self.model, self.data
        data.qpos[:], data.qvel[:], data.qacc[:] = q, qd, qdd
        mj.mj_forward(model, data)
        D = np.zeros((model.nv, model.nv))
        for row, unit in zip(D, np.eye(model.nv), strict=True):
            mj.mj_mulM(model, data, row, unit)
        out = {
            "inertia_matrix": D,
            "load": data.qfrc_bias.copy(),
            "potential_energy": data.energy[0],
            "kinetic_energy": data.energy[1],
            "keypoints": data.site_xpos[:, :2].copy(),
        }
        data.qacc[:] = qdd
        mj.mj_inverse(model, data)
        return out | {"inverse": data.qfrc_inverse.copy()}


@JOINTS
@BOTH
def test_agrees_with_mujoco(kind, K):
    dynamics = kind(K)
    for seed in range(10):
        p, q, qd, qdd = random_case(K, seed)
        theirs = MuJoCo(p)(q, qd, qdd)
        assert_close(dynamics.inertia_matrix(q, p), theirs["inertia_matrix"], 1e-9)
        load = dynamics.coriolis(q, qd, p) + dynamics.gravity_load(q, p)
        assert_close(load, theirs["load"], 1e-9)
        assert_close(dynamics.inverse(q, qd, qdd, p), theirs["inverse"], 1e-9)
        assert_close(dynamics.kinetic_energy(q, qd, p), theirs["kinetic_energy"], 1e-9)
        assert_close(dynamics.potential_energy(q, p), theirs["potential_energy"], 1e-9)
        assert_close(dynamics.keypoints(q, p), theirs["keypoints"], 1e-9)
        assert_close(dynamics.forward(q, qd, torch.tensor(theirs["inverse"]), p), qdd, 1e-9)


@JOINTS
@BOTH
def test_agrees_with_pinocchio(kind, K):
    pin = pytest.importorskip("pinocchio")
    dynamics = kind(K)
    for seed in range(100, 110):
        p, q, qd, qdd = random_case(K, seed)
        model, parent = pin.Model(), 0
        for k in range(K):
            at = [*p.base.tolist(), 0.0] if k == 0 else [p.length[k - 1].item(), 0.0, 0.0]
            parent = model.addJoint(parent, pin.JointModelRZ(), pin.SE3(np.eye(3), np.array(at)), f"joint{k}")
            rotational = np.diag([0.75, 0.75, 1.0]) * p.inertia[k].item()
            inertia = pin.Inertia(p.mass[k].item(), np.array([p.com[k].item(), 0.0, 0.0]), rotational)
            model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
        model.gravity.linear = np.array([*p.gravity.tolist(), 0.0])
        data = model.createData()
        state = [x.numpy() for x in (q, qd, qdd)]
        upper = np.triu(pin.crba(model, data, state[0]))
        assert_close(dynamics.inertia_matrix(q, p), upper + np.triu(upper, 1).T, 1e-9)
        tau = pin.rnea(model, data, *state)
        assert_close(dynamics.inverse(q, qd, qdd, p), tau, 1e-9)
        assert_close(dynamics.gravity_load(q, p), pin.computeGeneralizedGravity(model, data, state[0]), 1e-9)
        coriolis = pin.computeCoriolisMatrix(model, data, *state[:2]) @ state[1]
        assert_close(dynamics.coriolis(q, qd, p), coriolis, 1e-9)
        some_torque = 3.0 * qdd
        theirs = pin.aba(model, data, *state[:2], some_torque.numpy())
        assert_close(dynamics.forward(q, qd, some_torque, p), theirs, 1e-9)


# --- closed forms ---------------------------------------------------------------------------------


@BOTH
def test_two_uniform_rods_are_the_equations_that_the_paper_prints(kind):
    p, q, qd, _ = random_case(2, 0, batch=(20,))
    p = p._replace(com=p.length / 2, inertia=p.mass * p.length**2 / 12, gravity=torch.tensor([0.0, -9.81], dtype=F64))
    (L1, L2), (M1, M2), (_, q2), (w1, w2) = p.length, p.mass, q.unbind(-1), qd.unbind(-1)
    cos, sin = q2.cos(), q2.sin()
    D11 = L1**2 * M1 / 3 + M2 * (3 * L1**2 + 3 * L1 * L2 * cos + L2**2) / 3
    D12 = L2 * M2 * (3 * L1 * cos + 2 * L2) / 6
    D22 = torch.full_like(cos, L2**2 * M2 / 3)
    h1, h2 = -L1 * L2 * M2 * w2 * (2 * w1 + w2) * sin / 2, L1 * L2 * M2 * w1**2 * sin / 2
    c2 = 9.81 * M2 * L2 / 2 * q.sum(-1).cos()
    c1 = 9.81 * (M1 * L1 / 2 + M2 * L1) * q[:, 0].cos() + c2
    dynamics = kind(2)
    D = torch.stack([torch.stack([D11, D12], -1), torch.stack([D12, D22], -1)], -2)
    assert_close(dynamics.inertia_matrix(q, p), D, 1e-14)
    assert_close(dynamics.coriolis(q, qd, p), torch.stack([h1, h2], -1), 1e-14)
    assert_close(dynamics.gravity_load(q, p), torch.stack([c1, c2], -1), 1e-14)


def test_the_symbolic_equations_of_one_rod_read_as_in_a_textbook():
    import sympy as sp

    equations = derive(1)
    D, h, c, (theta,), _ = equations.in_joint_angles()
    m, r, inertia = (equations.symbols[word][0] for word in ("mass", "com", "inertia"))
    gx, gy = equations.symbols["gravity"]
    assert sp.simplify(D[0] - (m * r**2 + inertia)) == 0
    assert h[0] == 0
    assert sp.simplify(c[0] - m * r * (gx * sp.sin(theta) - gy * sp.cos(theta))) == 0


@JOINTS
def test_the_symbolic_equations_in_joint_angles_are_what_is_evaluated(K):
    import sympy as sp

    equations = derive(K)
    D, h, c, theta, thetadot = equations.in_joint_angles()
    p, q, qd, _ = random_case(K, 3)
    values = dict(zip([*theta, *thetadot], [*q.tolist(), *qd.tolist()], strict=True))
    for word in ("length", "mass", "com", "inertia", "gravity"):
        values.update(zip(equations.symbols[word], getattr(p, word).tolist(), strict=True))
    numbers = [np.array(matrix.subs(values).evalf(), dtype=float) for matrix in (D, h, c)]
    dynamics = SymbolicDynamics(K)
    assert_close(dynamics.inertia_matrix(q, p), numbers[0], 1e-13)
    assert_close(dynamics.coriolis(q, qd, p), numbers[1][:, 0], 1e-13)
    assert_close(dynamics.gravity_load(q, p), numbers[2][:, 0], 1e-13)
    assert isinstance(D, sp.MatrixBase)
