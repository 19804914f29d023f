"""Chains of links to try the dynamics on: bodies and states at random, both implementations, all of their methods."""

import math

import numpy as np
import pytest
import torch

from invdyn.models.bodies.planar import BodyParameters
from invdyn.models.dynamics.planar import PlanarDynamics
from invdyn.models.dynamics.symbolic import SymbolicDynamics

F64 = torch.float64
BOTH = pytest.mark.parametrize("kind", [PlanarDynamics, SymbolicDynamics])
JOINTS = pytest.mark.parametrize("K", [1, 2, 3, 4])

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
