"""Programs as machine code: torch's numbers to the last bit, gradients where they are asked for, and when it pays."""

import logging
import math
import sys

import pytest
import torch
from torch.autograd import forward_ad
from torch.fx.experimental.proxy_tensor import make_fx
from trees import panda, paper_arm, random_state, random_tree

from invdyn.models.dynamics.interface import jvp
from invdyn.models.dynamics.spatial.dynamics import SpatialDynamics
from invdyn.models.dynamics.traced.compiled import PAYS, Compiled

K = 4
DTYPES = [torch.float32, torch.float64]


def both(tree):
    """Dynamics as machine code from the first call, and by torch alone."""
    pytest.importorskip("llvmlite")
    return SpatialDynamics(tree, compile_after=0), SpatialDynamics(tree, compile_after=math.inf)


def same(found, expected):
    """To the last bit, NaN where that is."""
    assert found.dtype == expected.dtype
    assert found.shape == expected.shape
    assert torch.equal(found.nan_to_num(7e7), expected.nan_to_num(7e7))


def test_mixed_types_are_torchs():
    """Machine code is of one type: it would read a float32's bytes as a float64's."""
    fast, slow = both(panda())
    q, qd, tau = random_state(7, 0, (50,), torch.float64)
    for p, own in ((panda().parameters(), torch.full((7,), 0.1)), (panda().parameters(torch.float32), None)):
        same(fast.forward(q, qd, tau, p, own), slow.forward(q, qd, tau, p, own))


@pytest.mark.quick("random*", "paper*")
@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("tree", [paper_arm(), panda(), random_tree(3, 5)], ids=lambda tree: tree.name)
def test_torchs_bits(tree, dtype):
    fast, slow = both(tree)
    p = tree.parameters(dtype)
    q, qd, tau = random_state(tree.num_joints, 0, (50,), dtype)
    own = torch.linspace(0.1, 0.7, tree.num_joints, dtype=dtype)
    same(fast.forward(q, qd, tau, p), slow.forward(q, qd, tau, p))
    same(fast.forward(q, qd, tau, p, own), slow.forward(q, qd, tau, p, own))
    same(fast.response(q, tau, p), slow.response(q, tau, p))
    for method in ("inverse", "coriolis", "inertia_matrix", "jacobian"):
        given = {"inverse": (q, qd, tau), "coriolis": (q, qd)}.get(method, (q,))
        same(getattr(fast, method)(*given, p), getattr(slow, method)(*given, p))


def test_any_layout_and_number_of_particles():
    fast, slow = both(paper_arm())
    p = paper_arm().parameters()
    state = random_state(K, 0, batch=(50,))
    whole = slow.forward(*state, p)
    turned = [x.movedim(-1, 0).contiguous().movedim(0, -1).reshape(5, 10, K) for x in state]
    same(fast.forward(*turned, p), whole.reshape(5, 10, K))
    for count in (0, 1, 7, 8, 9):
        same(fast.forward(*(x[:count] for x in state), p), whole[:count])
    same(fast.forward(*(x[7] for x in state), p), whole[7])
    same(fast.forward(state[0][:, None], state[1][None], state[2][0], p).diagonal().T[:1], whole[:1])


def test_each_body_and_each_particle_of_its_own():
    fast, slow = both(paper_arm())
    p = paper_arm().parameters()
    state = random_state(K, 1, batch=(6, 5))
    for batch in ((6, 1), (5,), (6, 5)):
        many = p._replace(mass=p.mass * torch.linspace(0.5, 2, 30)[: torch.Size(batch).numel()].reshape(*batch, 1))
        same(fast.forward(*state, many), slow.forward(*state, many))
    # the same numbers in another list, another batch
    same(fast.forward(*(x[0] for x in state), p), slow.forward(*(x[0] for x in state), p))


def test_gradients_come_from_torch():
    fast, _ = both(paper_arm())
    p, (q, qd, tau) = paper_arm().parameters(), random_state(K, 2)
    fast.forward(q, qd, tau.requires_grad_(), p).sum().backward()
    assert tau.grad.abs().sum() > 0
    mass = p.mass.clone().requires_grad_()
    fast.forward(q, qd, tau.detach(), p._replace(mass=mass)).sum().backward()
    assert mass.grad.abs().sum() > 0
    learned = p._replace(mass=mass)
    with torch.no_grad():
        fast.forward(q, qd, tau, learned)
    mass.grad = None
    fast.forward(q, qd, tau.detach(), learned).sum().backward()
    assert mass.grad.abs().sum() > 0


def test_a_tangent_comes_from_torch():
    """It is carried whatever no_grad says; machine code has none."""
    fast, slow = both(paper_arm())
    p, (q, qd, tau) = paper_arm().parameters(), random_state(K, 3, batch=(9,))
    jvp(torch.sin, (q,), (qd,))  # imports of torch that warn, once
    with torch.no_grad(), forward_ad.dual_level():
        moving = forward_ad.make_dual(q, qd)
        found, expected = (forward_ad.unpack_dual(d.forward(moving, qd, tau, p)) for d in (fast, slow))
    assert expected.tangent.abs().sum() > 0
    same(found.tangent, expected.tangent)


def test_recorded_and_mapped_operations_stay_torchs():
    fast, slow = both(paper_arm())
    p, state = paper_arm().parameters(), random_state(K, 5, batch=(9,))
    other = [x.flip(0).contiguous() for x in state]
    with torch.no_grad():
        recorded = make_fx(lambda *given: fast.forward(*given, p))(*state)
        mapped = torch.func.vmap(lambda *given: fast.forward(*given, p))
        # their cosines and sines are torch's own, which differ by rounding
        torch.testing.assert_close(recorded(*other), slow.forward(*other, p), rtol=1e-12, atol=1e-12)
        torch.testing.assert_close(mapped(*state), slow.forward(*state, p), rtol=1e-12, atol=1e-12)


def test_what_diverges_shows():
    fast, slow = both(paper_arm())
    q, qd, tau = random_state(K, 4, batch=(3,))
    qd[1] = torch.inf
    found = fast.forward(q, qd, tau, paper_arm().parameters())
    assert found[[0, 2]].isfinite().all()
    assert not found[1].isfinite().any()
    same(found, slow.forward(q, qd, tau, paper_arm().parameters()))


def test_compiled_once_torch_has_spent_what_it_costs(caplog):
    pytest.importorskip("llvmlite")
    caplog.set_level(logging.INFO, "invdyn.models.dynamics.traced.compiled")
    dynamics, p, state = SpatialDynamics(paper_arm()), paper_arm().parameters(), random_state(K, 0, batch=(50,))
    for _ in range(PAYS - 1):
        dynamics.forward(*state, p)
    assert not caplog.records
    for _ in range(3):
        found = dynamics.forward(*state, p)
    assert [record.args[0] for record in caplog.records] == ["forward"]
    same(found, SpatialDynamics(paper_arm(), compile_after=math.inf).forward(*state, p))
    # a call of very many particles is worth several
    compiled, traced = Compiled(), object()
    assert not compiled.pays(traced, (1000, 100))
    assert compiled.pays(traced, (1,))


def test_without_a_compiler_torch_does_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "llvmlite", None)
    dynamics, p, state = SpatialDynamics(paper_arm(), compile_after=0), paper_arm().parameters(), random_state(K, 0)
    same(dynamics.forward(*state, p), SpatialDynamics(paper_arm(), compile_after=math.inf).forward(*state, p))
