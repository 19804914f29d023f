"""Programs compiled by numba: torch's numbers, gradients where they are asked for, and a word without numba."""

import logging
import sys

import pytest
import torch
from chains import assert_close as close
from trees import mobile_arm, paper_arm, random_state

from invdyn.models.dynamics.spatial.compiled import LONG
from invdyn.models.dynamics.spatial.dynamics import Driven, SpatialDynamics

K = 4


@pytest.fixture(scope="module")
def fast():
    pytest.importorskip("numba")
    return SpatialDynamics(paper_arm(), fast=True)


def test_the_same_as_torch(fast, caplog):
    slow, p = SpatialDynamics(paper_arm()), paper_arm().parameters()
    caplog.set_level(logging.INFO, "invdyn.models.dynamics.spatial.compiled")
    state = random_state(K, 0, batch=(50,))
    close(fast.forward(*state, p), slow.forward(*state, p), 1e-9)  # thin rods: D's condition is large
    close(fast.keypoints(state[0], p), slow.keypoints(state[0], p), 1e-12)
    assert 0 < fast.compile_seconds["forward float64"] < 20
    told = {record.args[0]: record.levelno for record in caplog.records if "numba compiled" in record.msg}
    for method, level in told.items():  # who waits long is told without asking
        assert level == (logging.WARNING if fast.compile_seconds[f"{method} float64"] > LONG else logging.INFO)
    assert set(told) == {"forward", "keypoints"}
    # by row or by column, one at a time or in a table
    turned = [x.movedim(-1, 0).contiguous().movedim(0, -1).reshape(5, 10, K) for x in state]
    close(fast.forward(*turned, p).reshape(50, K), fast.forward(*state, p), 1e-15)
    close(fast.forward(*(x[7] for x in state), p), fast.forward(*state, p)[7], 1e-12)


def test_each_body_and_each_particle_of_its_own(fast):
    slow, p = SpatialDynamics(paper_arm()), paper_arm().parameters()
    state = random_state(K, 1, batch=(6, 5))
    for batch in ((6, 1), (5,), (6, 5)):
        many = p._replace(mass=p.mass * torch.linspace(0.5, 2, 30)[: torch.Size(batch).numel()].reshape(*batch, 1))
        close(fast.forward(*state, many), slow.forward(*state, many), 1e-9)
    # the same numbers in another list, another batch
    close(fast.forward(*(x[0] for x in state), p), slow.forward(*(x[0] for x in state), p), 1e-9)


def test_gradients_come_from_torch(fast):
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


def test_single_precision(fast):
    state = [x.float() for x in random_state(K, 3, batch=(20,))]
    found = fast.forward(*state, paper_arm().parameters(torch.float32))
    assert found.dtype == torch.float32
    close(found, SpatialDynamics(paper_arm()).forward(*state, paper_arm().parameters(torch.float32)), 1e-3)


def test_what_diverges_shows(fast):
    q, qd, tau = random_state(K, 4, batch=(3,))
    qd[1] = torch.inf
    found = fast.forward(q, qd, tau, paper_arm().parameters())
    assert found[[0, 2]].isfinite().all()
    assert not found[1].isfinite().any()


def test_driven_joints_and_places():
    pytest.importorskip("numba")
    tree = mobile_arm(driven=True)
    fast, slow, p = SpatialDynamics(tree, fast=True), SpatialDynamics(tree), tree.parameters()
    path = Driven(*random_state(1, 0, batch=(9,)))
    q, qd, qdd = random_state(tree.num_joints, 5, batch=(9,))
    close(fast.keypoints(q, p, path), slow.keypoints(q, p, path), 1e-12)
    close(fast.inverse(q, qd, qdd, p, path), slow.inverse(q, qd, qdd, p, path), 1e-12)


def test_without_numba_torch_does_it_and_says_so(monkeypatch):
    monkeypatch.setitem(sys.modules, "numba", None)
    with pytest.warns(UserWarning, match=r"pip install 'invdyn\[fast\]'") as told:
        dynamics = SpatialDynamics(paper_arm(), fast=True)
    assert len(told) == 1
    state, p = random_state(K, 0), paper_arm().parameters()
    close(dynamics.forward(*state, p), SpatialDynamics(paper_arm()).forward(*state, p), 0)
    assert dynamics.compile_seconds == {}
