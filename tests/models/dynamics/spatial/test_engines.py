"""Dynamics in space against MuJoCo and Pinocchio, and planar bodies laid into space against the planar dynamics."""

import numpy as np
import pytest
import torch
from chains import METHODS, call, random_case
from chains import assert_close as close
from trees import MuJoCo, mobile_arm, panda, parameters_in_space, pinocchio_of, random_state, random_tree

from invdyn.models.bodies.body import planar_body
from invdyn.models.bodies.link import Link
from invdyn.models.dynamics.planar import planar_dynamics
from invdyn.models.dynamics.spatial.dynamics import SpatialDynamics


def bodies(first_seed):
    """One test for each of a dozen random trees, the Panda and an arm on wheels."""
    trees = [*(random_tree(K, first_seed + K) for K in range(1, 13)), panda(), mobile_arm()]
    return pytest.mark.parametrize("tree", trees, ids=lambda tree: f"{tree.name}, {tree.num_joints} joints")


SAME = 1e-9  # of the largest entry: both sides are of float64, and D's condition is at most a few thousand


@pytest.mark.quick("*[2-5] joints", "panda*")
@bodies(0)
def test_agrees_with_mujoco(tree):
    dynamics, p, engine = SpatialDynamics(tree), tree.parameters(), MuJoCo(tree)
    for seed in range(3):
        q, qd, qdd = random_state(tree.num_joints, seed)
        theirs = engine(q, qd, qdd)
        close(dynamics.inertia_matrix(q, p), theirs["inertia_matrix"], SAME)
        close(dynamics.coriolis(q, qd, p) + dynamics.gravity_load(q, p), theirs["bias"], SAME)
        close(dynamics.inverse(q, qd, qdd, p), theirs["inverse"], SAME)
        close(dynamics.forward(q, qd, torch.tensor(theirs["inverse"]), p), qdd, SAME)
        close(dynamics.kinetic_energy(q, qd, p), theirs["kinetic_energy"], SAME)
        close(dynamics.keypoints(q, p), theirs["keypoints"], SAME)
        close(dynamics.jacobian(q, p), theirs["jacobian"], SAME)
        at_rest = engine(torch.zeros_like(q), qd, qdd)["potential_energy"]  # the engine counts what is fixed, too
        change = dynamics.potential_energy(q, p) - dynamics.potential_energy(torch.zeros_like(q), p)
        close(change, theirs["potential_energy"] - at_rest, SAME)


@pytest.mark.quick("*[2-5] joints", "panda*")
@bodies(100)
def test_agrees_with_pinocchio(tree):
    pin, model, order = pinocchio_of(tree)
    data, dynamics, p = model.createData(), SpatialDynamics(tree), tree.parameters()
    for seed in range(10, 13):
        q, qd, third = random_state(tree.num_joints, seed)
        place = np.argsort(order)
        theirs = [x.numpy()[place] for x in (q, qd, third)]
        close(dynamics.forward(q, qd, third, p), pin.aba(model, data, *theirs)[order], SAME)
        close(dynamics.inverse(q, qd, third, p), pin.rnea(model, data, *theirs)[order], SAME)
        close(dynamics.gravity_load(q, p), pin.computeGeneralizedGravity(model, data, theirs[0])[order], SAME)
        borne = dynamics.reactions(q, qd, third, p)
        pin.rnea(model, data, *theirs)
        pin.forwardKinematics(model, data, theirs[0])
        for (_, motion), wrench in zip(tree.motions(), borne, strict=True):
            number = model.getJointId(motion.name)
            turn, own = data.oMi[number].rotation, data.f[number]
            close(wrench, np.concatenate([turn @ own.linear, turn @ own.angular]), SAME)
        upper = np.triu(pin.crba(model, data, theirs[0]))
        close(dynamics.inertia_matrix(q, p), (upper + np.triu(upper, 1).T)[np.ix_(order, order)], SAME)
        own = torch.linspace(0.1, 0.5, tree.num_joints, dtype=q.dtype)
        model.armature = own.numpy()[place]
        close(dynamics.forward(q, qd, third, p, own), pin.aba(model, data, *theirs)[order], SAME)
        model.armature = np.zeros(model.nv)


@pytest.mark.parametrize("K", [1, 2, 3, 4, 6])
def test_planar_bodies_laid_into_space_are_the_planar_ones(K):
    p, *state = random_case(K, K, batch=(3, 50), body_batch=(3, 1))
    state = dict(zip(("q", "qd", "tau"), state, strict=True))
    links = [Link(f"link{k}", f"joint{k}", f"tip{k}", 1.0, 1.0) for k in range(K)]
    planar, spatial = planar_dynamics(K), SpatialDynamics(planar_body("chain", links).in_space())
    for method in METHODS:
        flat, deep = call(planar, method, state, p), call(spatial, method, state, parameters_in_space(p))
        if method == "keypoints":
            assert not deep[..., 2].any()
            deep = deep[..., :2]
        close(deep, flat, 1e-12)
    motion = state["q"], state["qd"], state["tau"]
    borne = spatial.reactions(*motion, parameters_in_space(p))
    close(borne[..., :2], planar.reactions(*motion, p), 1e-12)
    close(borne[..., 5], planar.inverse(*motion, p), 1e-12)
