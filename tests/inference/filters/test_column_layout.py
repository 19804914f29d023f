"""A row that was rewritten column by column is the row, whatever model it is of."""

import oracles
import pytest
import torch

from invdyn.inference import Bootstrap, Controlled
from invdyn.inference.filters.column_layout import by_columns, recorded, stored_by_columns
from invdyn.inference.filters.particles import take
from invdyn.inference.filters.weights import advanced
from invdyn.models import ArmModel, Keypoints, Link, Matern32, Observation, planar_body
from invdyn.models.effects import CoulombFriction, Outliers, SoftTissue, ViscousFriction
from invdyn.models.shapes import by_column, stacked

STEPS, M, N = 6, 3, 7


def arm(effects=(), tips=(0, 1), family="gaussian", joints=2, **options):
    links = [Link(f"link{k}", f"joint{k}", f"tip{k}", 0.4, 1.0) for k in range(joints)]
    model = ArmModel(
        planar_body("arm", links), 0.02 * torch.arange(STEPS), Observation(Keypoints(tips), family=family), **options
    )
    return model.with_effects(*effects)


MODELS = {
    "arm": arm,
    "one tip": lambda: arm(tips=[1]),
    "student_t": lambda: arm(family="student_t"),
    "correlated noise": lambda: arm(torque=Matern32()),
    "command": lambda: arm(command=torch.ones(STEPS, 2)),
    "Euler": lambda: arm(integrator="euler"),
    "long chain": lambda: arm(joints=3, tips=[0, 2]),
    "friction": lambda: arm([ViscousFriction("joint1"), CoulombFriction("joint0")]),
    "camera": lambda: arm([SoftTissue("tip1")]),
    "mixture": lambda: arm([Outliers()]),
    "linear": lambda: oracles.random_chain(seed=5).model(STEPS),
}


def rows(model, guide, y, seen):
    """Outputs of row 2, plain and by columns, from the same random numbers."""
    torch.manual_seed(0)
    before = guide.propose_initial((M, N))[0]
    before = guide.propose(1, before)[0]
    before = {name: stored_by_columns(value) for name, value in before.items()}
    log_weights = torch.log_softmax(torch.randn(M, N, dtype=torch.float64), -1)
    names = []

    def row(t, log_weights, *values):
        after, *others = advanced(model, guide, t, y, seen, dict(zip(before, values, strict=True)), log_weights)
        names[:] = after
        return *after.values(), *others

    example = (torch.tensor([2]), log_weights, *before.values())
    record = by_columns(recorded(row, example), example, log_weights.shape)
    outputs = []
    for function in (row, record):
        torch.manual_seed(1)
        outputs.append(function(*example))
    return names, outputs


@pytest.mark.quick("arm-*-False", "friction-*", "mixture-Bootstrap-*")
@pytest.mark.parametrize(
    ("name", "guide", "gaps"),
    [
        ("arm", Bootstrap, True),
        ("arm", Controlled, False),
        ("one tip", Controlled, True),
        ("student_t", Bootstrap, False),
        ("correlated noise", Controlled, False),
        ("command", Controlled, True),
        ("Euler", Controlled, False),
        ("long chain", Bootstrap, True),
        ("friction", Bootstrap, True),
        ("camera", Controlled, True),
        ("mixture", Bootstrap, False),
        ("mixture", Controlled, True),
        ("linear", Controlled, False),
    ],
)
def test_the_row_is_the_row(name, guide, gaps):
    model = MODELS[name]()
    torch.manual_seed(3)
    y = model.simulate()[1]
    if gaps:
        y[2, 0] = torch.nan
    seen = ~torch.isnan(y[2]) if gaps else None
    names, (plain, columns) = rows(model, guide(model) if guide is Bootstrap else guide(model, y), y[2], seen)
    assert len(plain) == len(columns) == len(names) + 3
    for expected, found in zip(plain, columns, strict=True):
        torch.testing.assert_close(found, expected, rtol=1e-9, atol=1e-9)
    for found, field in zip(columns, names, strict=False):
        assert field == "log_twist" or found.movedim(-1, 0).is_contiguous()


def filled(x):
    """Copies and their entries, changed in place."""
    copy, pair = x.clone(), torch.cat([x, x], -1)
    copy[..., 0] = 2.0
    pair.add_(1)
    pair[..., 1] += x[..., 0]
    return x, copy, pair


OPERATIONS = {
    "in place": filled,
    "no entries": lambda x: (x[..., 4:].sum(-1), torch.cat([x[..., :0], x + 1], -1), x[..., :1] * x[..., 4:]),
    "a count": lambda x: ((x > 0).sum(-1), (x > 0).any(-1), x.abs().sum((-2, -1))),
    "another type": lambda x: (x * torch.ones(4).double(), x * torch.ones(()).double(), torch.cat([x, x.double()], -1)),
    "fewer dimensions": lambda x: (x[:1, :1].sum(1) + x.unsqueeze(-1), x.unflatten(-1, (2, 2)) * x[..., 0, None, None]),
    "a constant's view": lambda x: (
        torch.cat([x, torch.ones(3, 7, 1)], -1)[..., 4].clone().view(21) + x.view(21, 4)[:, 0],
    ),
    "one entry": lambda x: (x[..., :1].reshape(21), x[..., 1:2].reshape(3, 7), x.transpose(0, 1).sum(0)),
    "stacked": lambda x: (torch.stack([x, 2 * x], -2), torch.stack([x[..., 0], x[..., 3]], 0), torch.stack([x, x])),
    "laid out": lambda x: (by_column(x.clone()), stacked(x.unbind(-1)), x.unflatten(-1, (2, 2)).transpose(-1, -2)),
    "turned": lambda x: (x.movedim(-1, 0), x.movedim(-1, 0) + 1, x.permute(2, 1, 0).movedim(0, -1), x.permute(1, 0, 2)),
    "products": lambda x: (x @ torch.ones(4, 2), x @ torch.ones(3, 4, 4), x @ torch.ones(4, 0), x @ torch.ones(4, 99)),
    "noise": lambda x: (torch.randn_like(x), torch.randn_like(x, dtype=torch.float64)),
}


@pytest.mark.parametrize("name", OPERATIONS)
def test_an_operation_is_the_operation(name):
    x = torch.linspace(-1, 1, 3 * 7 * 4).reshape(3, 7, 4)
    record = by_columns(recorded(OPERATIONS[name], (x,)), (x,), x.shape[:2])
    torch.manual_seed(1)
    expected = OPERATIONS[name](x.clone())
    torch.manual_seed(1)
    for found, value in zip(record(x), expected, strict=True):
        assert found.dtype == value.dtype
        torch.testing.assert_close(found, value)


@pytest.mark.parametrize("shape", [(3, 7, 4), (3, 7), (3, 7, 1)])
def test_taking_particles_does_not_mind_how_they_are_stored(shape):
    value, index = torch.randn(shape), torch.randint(0, 7, (3, 7))
    expected = torch.stack([value[m][index[m]] for m in range(3)])
    assert torch.equal(take(value, index), expected)
    assert torch.equal(take(stored_by_columns(value), index), expected)
