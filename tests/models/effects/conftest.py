"""Arms to put effects on."""

import numpy as np
import pytest
import torch

from invdyn.models import ArmModel, Encoders, Keypoints, Link, Observation, planar_body

LENGTHS, MASSES = (0.3, 0.25, 0.2), (1.5, 1.0, 0.6)


def make_arm(joints=2, rows=12, step=0.01, size=1.0, weight=1.0, seed=0, **kwargs):
    """An arm with keypoints and encoders under commands of its own size; ``size`` and ``weight`` scale the links."""
    links = [
        Link(f"link{k}", f"joint{k}", f"tip{k}", length=LENGTHS[k] * size, mass=MASSES[k] * weight)
        for k in range(joints)
    ]
    body = planar_body("arm", links, gravity=(0.0, -9.81), base=(0.02 * size, -0.01 * size))
    rng = np.random.default_rng(seed)
    held = np.array([9.81 * weight * size * (0.4, 0.15, 0.06)[k] for k in range(joints)])
    command = rng.normal(size=(rows, joints)) * held
    options = {"observation": Observation(Keypoints(range(joints)), Encoders()), "command": command, **kwargs}
    return ArmModel(body, step * np.arange(rows) + 0.5, **options)


@pytest.fixture
def arm():
    return make_arm


@pytest.fixture
def states():
    """States (*batch, D) of a model: moving angles, small torques, hidden coordinates at rest."""

    def draw(model, *batch, seed=0):
        generator = torch.Generator().manual_seed(seed)
        joints = model.body.num_joints
        scale = model.scale
        parts = [
            0.1 * torch.tensor(scale.torque),
            torch.zeros(model.state_dim - 3 * joints),
            torch.full((joints,), 0.8),
            torch.tensor(scale.speed),
        ]
        spread = torch.cat(parts).double()
        return (spread * torch.randn(*batch, model.state_dim, generator=generator).double()).to(model.dtype)

    return draw


@pytest.fixture
def widened():
    """States of a model, with room for the hidden coordinates of another."""

    def widen(states, model, other):
        more, torque = other.state_dim - model.state_dim, model.torque_size
        return torch.cat([states[..., :torque], states.new_zeros(*states.shape[:-1], more), states[..., torque:]], -1)

    return widen


@pytest.fixture
def having():
    """The model with one effect, at these values: ``having(model, ViscousFriction("joint0"), damping=0.1)``."""

    def have(model, effect, **values):
        model = model.with_effects(effect)
        named = {
            f"effect.{effect.key}.{name}": torch.as_tensor(value, dtype=torch.float64) for name, value in values.items()
        }
        return model.replace(**{name: value.to(model.dtype).reshape(-1) for name, value in named.items()})

    return have
