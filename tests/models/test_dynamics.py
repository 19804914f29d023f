import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from invdyn.models import euler_lagrange
from invdyn.models.body import BodyParameters
from invdyn.models.dynamics import RecursiveDynamics, SymbolicDynamics, dynamics_for

F64 = torch.float64
BOTH = pytest.mark.parametrize("kind", [SymbolicDynamics, RecursiveDynamics])
JOINTS = pytest.mark.parametrize("K", [1, 2, 3, 4])


def random_case(K, seed, batch=(), body_batch=(), dtype=F64):
    """A body of realistic and uneven links with tilted gravity, and a state: (p, q, qd, qdd)."""
    rng = torch.Generator().manual_seed(seed)

    def uniform(low, high, *shape):
        return (low + (high - low) * torch.rand(*shape, generator=rng, dtype=F64)).to(dtype)

    links = (*body_batch, K)
    length, mass = uniform(0.1, 1.5, *links), uniform(0.2, 3.0, *links)
    p = BodyParameters(
        length=length,
        mass=mass,
        com=uniform(-0.3, 1.2, *links) * length,
        inertia=uniform(0.02, 0.2, *links) * mass * length**2,
        gravity=uniform(-10, 10, *body_batch, 2),
        base=uniform(-1, 1, *body_batch, 2),
    )
    return p, *(uniform(-bound, bound, *batch, K) for bound in (math.pi, 5.0, 20.0))


def assert_close(ours, theirs, relative, least_scale=1e-3):
    """Equal to `relative` of the largest entry: small entries of a torque are differences of large ones."""
    ours, theirs = np.asarray(ours), np.asarray(theirs)
    assert ours.shape == theirs.shape
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=relative * max(np.abs(theirs).max(), least_scale))


# --- other engines --------------------------------------------------------------------------------


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

    equations = euler_lagrange.derive(1)
    D, h, c, (theta,), _ = equations.in_joint_angles()
    m, r, inertia = (equations.symbols[word][0] for word in ("mass", "com", "inertia"))
    gx, gy = equations.symbols["gravity"]
    assert sp.simplify(D[0] - (m * r**2 + inertia)) == 0
    assert h[0] == 0
    assert sp.simplify(c[0] - m * r * (gx * sp.sin(theta) - gy * sp.cos(theta))) == 0


@JOINTS
def test_the_symbolic_equations_in_joint_angles_are_the_generated_functions(K):
    import sympy as sp

    equations = euler_lagrange.derive(K)
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


# --- the two implementations ----------------------------------------------------------------------


METHODS = {
    "inertia_matrix": "q",
    "coriolis": "q qd",
    "gravity_load": "q",
    "forward": "q qd tau",
    "response": "q tau",
    "inverse": "q qd tau",
    "kinetic_energy": "q qd",
    "potential_energy": "q",
    "keypoints": "q",
}


def call(dynamics, method, state, p):
    return getattr(dynamics, method)(*(state[word] for word in METHODS[method].split()), p)


@JOINTS
@pytest.mark.parametrize("method", METHODS)
def test_symbolic_and_recursive_agree_for_every_way_to_batch(K, method):
    symbolic, recursive = SymbolicDynamics(K), RecursiveDynamics(K)
    for batch, body_batch in [
        ((), ()),
        ((7,), ()),
        ((), (3,)),
        ((3, 7), (3, 1)),
        ((2, 1, 7), (3, 1)),
        ((0,), ()),
    ]:
        p, q, qd, tau = random_case(K, 5, batch, body_batch)
        state = {"q": q, "qd": qd, "tau": tau}
        ours, theirs = call(symbolic, method, state, p), call(recursive, method, state, p)
        full = torch.broadcast_shapes(batch, body_batch)
        tail = {"inertia_matrix": (K, K), "keypoints": (K, 2), "kinetic_energy": (), "potential_energy": ()}
        assert ours.shape == theirs.shape == (*full, *tail.get(method, (K,)))
        torch.testing.assert_close(ours, theirs, rtol=1e-10, atol=1e-10)


@JOINTS
@BOTH
def test_a_response_is_what_a_torque_adds_to_the_acceleration(K, kind):
    dynamics = kind(K)
    p, q, qd, tau = random_case(K, 8, (5,), ())
    for own in (None, torch.linspace(0.1, 0.4, K, dtype=q.dtype)):
        without = dynamics.forward(q, qd, torch.zeros_like(tau), p, own)
        added = dynamics.forward(q, qd, tau, p, own) - without
        torch.testing.assert_close(dynamics.response(q, tau, p, own), added, rtol=1e-9, atol=1e-9)
        assert dynamics.response(q, tau[0], p, own).shape == (5, K)


@BOTH
def test_a_learned_body_is_differentiated_each_time_it_is_asked(kind):
    """Whether it was asked without gradients before or with them."""
    dynamics = kind(2)
    p, q, qd, tau = random_case(2, 9, (5,), ())
    mass = p.mass.clone().requires_grad_()
    learned = p._replace(mass=mass)
    with torch.no_grad():
        dynamics.forward(q, qd, tau, learned)
    first, second = (torch.autograd.grad(dynamics.forward(q, qd, tau, learned).sum(), mass)[0] for _ in range(2))
    assert (first != 0).all()
    torch.testing.assert_close(first, second, rtol=0, atol=0)


@BOTH
def test_joint_quantities_of_different_batch_shapes_broadcast(kind):
    dynamics = kind(2)
    p, q, qd, tau = random_case(2, 6, (3, 5), (3, 1))
    mixed = dynamics.forward(q[:, :1], qd[0], tau[0, 0], p)
    full = dynamics.forward(*torch.broadcast_tensors(q[:, :1], qd[0], tau[0, 0]), p)
    assert mixed.shape == (3, 5, 2)
    torch.testing.assert_close(mixed, full, rtol=1e-12, atol=1e-12)


def test_a_batch_of_bodies_is_each_body_by_itself():
    dynamics = SymbolicDynamics(3)
    p, q, qd, tau = random_case(3, 7, (4, 6), (4, 1))
    together = dynamics.forward(q, qd, tau, p)
    for m in range(4):
        alone = dynamics.forward(q[m], qd[m], tau[m], BodyParameters(*(value[m, 0] for value in p)))
        torch.testing.assert_close(together[m], alone, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("K", [5, 9])
def test_long_chains_invert(K):
    dynamics = dynamics_for(K)
    assert isinstance(dynamics, RecursiveDynamics)
    p, q, qd, tau = random_case(K, 8, (6,))
    torch.testing.assert_close(dynamics.inverse(q, qd, dynamics.forward(q, qd, tau, p), p), tau, rtol=1e-8, atol=1e-8)
    D, load = dynamics.inertia_matrix(q, p), dynamics.coriolis(q, qd, p) + dynamics.gravity_load(q, p)
    expected = torch.linalg.solve(D, tau - load)
    torch.testing.assert_close(dynamics.forward(q, qd, tau, p), expected, rtol=1e-8, atol=1e-8)


def test_the_choice():
    assert all(isinstance(dynamics_for(K), SymbolicDynamics) for K in (1, 2, 3, 4))
    for wrong in (0, -1, 2.5, "two"):
        with pytest.raises(ValueError, match="joints"):
            dynamics_for(wrong)
    with pytest.raises(ValueError, match="RecursiveDynamics takes any number"):
        SymbolicDynamics(5)


@BOTH
def test_a_state_of_another_number_of_joints_is_refused(kind):
    p, q, _, tau = random_case(2, 9)
    with pytest.raises(ValueError, match=r"expected qd of shape \(\.\.\., 2\).*got \(3,\)"):
        kind(2).forward(q, torch.zeros(3), tau, p)
    with pytest.raises(ValueError, match=r"expected q of shape \(\.\.\., 3\)"):
        kind(3).keypoints(q, p)
    with pytest.raises(ValueError, match="got"):
        kind(2).inertia_matrix(torch.tensor(1.0), p)


# --- precision and derivatives --------------------------------------------------------------------


@JOINTS
@BOTH
@pytest.mark.parametrize("method", METHODS)
def test_float32_stays_float32_and_is_right_to_its_precision(kind, K, method):
    dynamics = kind(K)
    p, q, qd, tau = random_case(K, 11, (50,), dtype=torch.float32)
    state = {"q": q, "qd": qd, "tau": tau}
    exact = call(dynamics, method, {name: value.double() for name, value in state.items()}, p.to(F64))
    result = call(dynamics, method, state, p)
    assert result.dtype == torch.float32
    # rounding of relative size ε, magnified in θ̈ by the condition of D
    bound = 30 * torch.finfo(torch.float32).eps
    if method == "forward":
        bound *= torch.linalg.cond(dynamics.inertia_matrix(q.double(), p.to(F64))).max().item()
    assert_close(result, exact, bound, least_scale=1.0)


def gradient_inputs(K, seed):
    p, q, qd, tau = random_case(K, seed, batch=(2,))
    return [x.detach().requires_grad_() for x in (q, qd, tau, *p)]


@JOINTS
@BOTH
def test_gradcheck_in_state_torque_and_every_body_parameter(kind, K):
    dynamics, inputs = kind(K), gradient_inputs(K, 12)
    for method in METHODS:

        def function(q, qd, tau, *p, method=method):
            return call(dynamics, method, {"q": q, "qd": qd, "tau": tau}, BodyParameters(*p))

        assert torch.autograd.gradcheck(function, inputs)


@pytest.mark.parametrize("K", [1, 2, 3])
@BOTH
def test_second_derivatives_of_forward(kind, K):
    dynamics, inputs = kind(K), gradient_inputs(K, 13)

    def function(q, qd, tau, *p):
        return dynamics.forward(q, qd, tau, BodyParameters(*p))

    assert torch.autograd.gradgradcheck(function, inputs)


@BOTH
def test_vmap_and_jacrev_work(kind):
    dynamics = kind(3)
    p, q, qd, tau = random_case(3, 14, (4,))

    def forward(q, qd, tau):
        return dynamics.forward(q, qd, tau, p)

    mapped = torch.func.vmap(forward)(q, qd, tau)
    jacobian = torch.func.vmap(torch.func.jacrev(forward, argnums=2))(q, qd, tau)
    torch.testing.assert_close(mapped, forward(q, qd, tau))
    # ∂θ̈/∂τ = D⁻¹
    torch.testing.assert_close(jacobian, torch.linalg.inv(dynamics.inertia_matrix(q, p)), rtol=1e-8, atol=1e-8)


# --- mechanics ------------------------------------------------------------------------------------


cases = given(K=st.integers(1, 4), seed=st.integers(0, 10**6))


@cases
@settings(max_examples=40, deadline=None)
def test_inertia_is_symmetric_positive_definite_and_gives_the_kinetic_energy(K, seed):
    p, q, qd, _ = random_case(K, seed)
    dynamics = SymbolicDynamics(K)
    D = dynamics.inertia_matrix(q, p)
    assert torch.equal(D, D.T)
    assert torch.linalg.eigvalsh(D).min() > 0
    torch.testing.assert_close(dynamics.kinetic_energy(q, qd, p), qd @ D @ qd / 2, rtol=1e-9, atol=1e-12)


@cases
@settings(max_examples=40, deadline=None)
def test_coriolis_torque_is_quadratic_in_velocity_and_does_not_depend_on_gravity(K, seed):
    p, q, qd, _ = random_case(K, seed)
    dynamics = SymbolicDynamics(K)
    h = dynamics.coriolis(q, qd, p)
    torch.testing.assert_close(dynamics.coriolis(q, -2.5 * qd, p), 6.25 * h, rtol=1e-9, atol=1e-9)
    assert torch.equal(dynamics.coriolis(q, torch.zeros_like(qd), p), torch.zeros_like(h))
    assert torch.equal(dynamics.coriolis(q, qd, p._replace(gravity=-p.gravity)), h)


@cases
@settings(max_examples=40, deadline=None)
def test_forward_undoes_inverse(K, seed):
    p, q, qd, qdd = random_case(K, seed)
    dynamics = SymbolicDynamics(K)
    back = dynamics.forward(q, qd, dynamics.inverse(q, qd, qdd, p), p)
    condition = torch.linalg.cond(dynamics.inertia_matrix(q, p)).item()
    assert (back - qdd).abs().max() < 1e-13 * condition * 100


@cases
@settings(max_examples=40, deadline=None)
def test_gravity_load_is_the_gradient_of_potential_energy(K, seed):
    p, q, _, _ = random_case(K, seed)
    dynamics = SymbolicDynamics(K)
    gradient = torch.func.grad(lambda q: dynamics.potential_energy(q, p))(q)
    torch.testing.assert_close(dynamics.gravity_load(q, p), gradient, rtol=1e-9, atol=1e-9)


@cases
@settings(max_examples=40, deadline=None)
def test_power_of_the_torques_is_the_rate_of_energy(K, seed):
    p, q, qd, tau = random_case(K, seed)
    dynamics = SymbolicDynamics(K)
    qdd = dynamics.forward(q, qd, tau, p)
    state = q.clone().requires_grad_(), qd.clone().requires_grad_()
    energy = dynamics.kinetic_energy(*state, p) + dynamics.potential_energy(state[0], p)
    by_angle, by_velocity = torch.autograd.grad(energy, state)
    rate = by_angle @ qd + by_velocity @ qdd
    scale = (tau.abs() * qd.abs()).sum() + dynamics.kinetic_energy(q, qd, p)
    assert abs(rate - dynamics.power(qd, tau).sum()) < 1e-11 * scale * 100


def test_keypoints_are_denavit_hartenberg():
    p = BodyParameters(
        *(torch.tensor(x) for x in ([2.0, 1.0], [1.0, 1.0], [1.0, 0.5], [0.1, 0.1], [0.0, 0.0], [3.0, 4.0]))
    )
    tips = SymbolicDynamics(2).keypoints(torch.tensor([0.0, math.pi / 2]), p)  # counter-clockwise is positive
    torch.testing.assert_close(tips, torch.tensor([[5.0, 4.0], [5.0, 5.0]]))


def test_a_hanging_limb_is_at_rest_and_swings_back():
    p = random_case(2, 15)[0]._replace(gravity=torch.tensor([0.0, -9.81], dtype=F64))
    p = p._replace(com=p.com.abs())
    hanging, still = torch.tensor([-math.pi / 2, 0.0], dtype=F64), torch.zeros(2, dtype=F64)
    dynamics = SymbolicDynamics(2)
    assert dynamics.gravity_load(hanging, p).abs().max() < 1e-14 * 100
    pushed = hanging + torch.tensor([0.1, 0.0], dtype=F64)
    assert dynamics.forward(pushed, still, still, p)[0] < 0


# --- the cache ------------------------------------------------------------------------------------


def evaluate(functions):
    """A number that every generated function takes part in."""
    p, q, qd, _ = random_case(2, 16)
    values = {"phi": q, "w": qd, **p._asdict()}
    total = 0.0
    for name, words in euler_lagrange.ARGUMENTS.items():
        moving, body = (
            [values[w].unbind(-1) for w in words if (w in euler_lagrange.MOVING) == m] for m in (True, False)
        )
        total += sum(float(x) for x in functions[name].values(*moving, functions[name].numbers(*body)))
    return total


def test_a_derivation_is_kept_and_read_back(tmp_path, monkeypatch):
    first = evaluate(euler_lagrange.torch_functions(2, tmp_path / "new" / "folder"))
    assert len(list((tmp_path / "new" / "folder").iterdir())) == 1

    def derived_again(num_joints):
        raise AssertionError("expected the cached derivation")

    monkeypatch.setattr(euler_lagrange, "generate", derived_again)
    assert evaluate(euler_lagrange.torch_functions(2, tmp_path / "new" / "folder")) == first


@pytest.mark.parametrize(
    "damage",
    [
        lambda text: "",
        lambda text: text[: len(text) // 2],
        lambda text: text.replace("phi1", "phi2", 1),
        lambda text: "[1, 2]",
        lambda text: '{"sources": 3, "sha256": 4}',
        lambda text: "\x00\x01",
    ],
)
def test_a_broken_cache_file_is_derived_again_and_mended(tmp_path, damage):
    whole = evaluate(euler_lagrange.torch_functions(2, tmp_path))
    (file,) = tmp_path.iterdir()
    good = file.read_text(encoding="utf-8")
    file.write_text(damage(good), encoding="utf-8")
    assert evaluate(euler_lagrange.torch_functions(2, tmp_path)) == whole
    assert euler_lagrange._read_cache(file) is not None


def test_a_cache_folder_that_cannot_be_written_does_not_matter(tmp_path):
    (tmp_path / "file").write_text("in the way")
    assert math.isfinite(evaluate(euler_lagrange.torch_functions(2, tmp_path / "file")))
