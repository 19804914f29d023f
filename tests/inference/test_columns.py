"""A row that was rewritten column by column is the row, whatever model it is of."""

import oracles
import pytest
import torch
from torch.fx.experimental.proxy_tensor import make_fx

from invdyn.inference import Bootstrap, Controlled, ParticleFilter
from invdyn.inference.columns import by_columns, stored_by_columns
from invdyn.inference.particles import take
from invdyn.models import ArmModel, Body, Emission, Link, Matern32
from invdyn.models.effects import CoulombFriction, Outliers, SoftTissue, ViscousFriction

STEPS, M, N = 6, 3, 7


def arm(effects=(), tips=(0, 1), family="gaussian", joints=2, **options):
    links = [Link(f"link{k}", f"joint{k}", f"tip{k}", 0.4, 1.0) for k in range(joints)]
    model = ArmModel(Body("arm", links), 0.02 * torch.arange(STEPS), Emission(tips, family=family), **options)
    return model.with_effects(*effects)


MODELS = {
    "arm": arm,
    "one tip": lambda: arm(tips=[1]),
    "student_t": lambda: arm(family="student_t"),
    "correlated noise": lambda: arm(torque=Matern32()),
    "command": lambda: arm(command=torch.ones(STEPS, 2)),
    "Euler": lambda: arm(integrator="euler"),
    "long chain": lambda: arm(joints=6, tips=[1, 3, 5]),
    "friction": lambda: arm([ViscousFriction("joint1"), CoulombFriction("joint0")]),
    "camera": lambda: arm([SoftTissue("tip1")]),
    "mixture": lambda: arm([Outliers()]),
    "linear": lambda: oracles.random_chain(seed=5).model(STEPS),
}


def rows(model, guide, y, seen):
    """Outputs of row 2, plain and by columns, from the same random numbers."""
    particle_filter = ParticleFilter(model, guide, N, num_filters=M)
    torch.manual_seed(0)
    before = guide.propose_initial((M, N))[0]
    before = guide.propose(1, before)[0]
    before = {name: stored_by_columns(value) for name, value in before.items()}
    log_weights = torch.log_softmax(torch.randn(M, N, dtype=torch.float64), -1)
    names = []

    def row(t, log_weights, *values):
        after, *others = particle_filter._advance(t, y, seen, dict(zip(before, values, strict=True)), log_weights)
        names[:] = after
        return *after.values(), *others

    example = (torch.tensor([2]), log_weights, *before.values())
    record = by_columns(make_fx(row)(*example), example, log_weights.shape)
    outputs = []
    for function in (row, record):
        torch.manual_seed(1)
        outputs.append(function(*example))
    return names, outputs


@pytest.mark.parametrize("gaps", [False, True])
@pytest.mark.parametrize("guide", [Bootstrap, Controlled])
@pytest.mark.parametrize("name", MODELS)
def test_the_row_is_the_row(name, guide, gaps):
    model = MODELS[name]()
    torch.manual_seed(3)
    y = model.simulate()[1]
    if gaps and name == "linear":
        pytest.skip("its noise is correlated: what is missing must be looked at")
    if gaps:
        y[2, 0] = torch.nan
    seen = ~torch.isnan(y[2]) if gaps else None
    names, (plain, columns) = rows(model, guide(model) if guide is Bootstrap else guide(model, y), y[2], seen)
    assert len(plain) == len(columns) == len(names) + 3
    for expected, found in zip(plain, columns, strict=True):
        torch.testing.assert_close(found, expected, rtol=1e-9, atol=1e-9)
    for found, field in zip(columns, names, strict=False):
        assert field == "log_twist" or found.movedim(-1, 0).is_contiguous()


@pytest.mark.parametrize("shape", [(3, 7, 4), (3, 7), (3, 7, 1)])
def test_taking_particles_does_not_mind_how_they_are_stored(shape):
    value, index = torch.randn(shape), torch.randint(0, 7, (3, 7))
    expected = torch.stack([value[m][index[m]] for m in range(3)])
    assert torch.equal(take(value, index), expected)
    assert torch.equal(take(stored_by_columns(value), index), expected)
