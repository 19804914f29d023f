"""Motion within a step: exact for fourth order, of fifth order for others; and when it passes a stop."""

import math
from itertools import pairwise

import pytest
import torch

from invdyn.models.dynamics.integrators import Passage

F64 = torch.float64


def column(*values):
    return torch.tensor(values, dtype=F64).unsqueeze(-1)


def swing(h):
    """sin(3 t) from t = .1 on."""
    first, last = 0.3, 0.3 + 3 * h
    return Passage(
        *(column(v) for v in (math.sin(first), 3 * math.cos(first), -9 * math.sin(first))),
        *(column(v) for v in (math.sin(last), 3 * math.cos(last))),
        column(h),
    )


def test_a_motion_of_fourth_order_is_itself():
    def x(t):
        return 1.0 - 2.0 * t + 0.7 * t**2 + 5.0 * t**3 - 9.0 * t**4

    def v(t):
        return -2.0 + 1.4 * t + 15.0 * t**2 - 36.0 * t**3

    h = 0.25
    passage = Passage(*(column(value) for value in (x(0), v(0), 1.4, x(h), v(h), h)))
    for share in (0.0, 0.2, 0.7, 1.0):
        there, moved = passage.at(column(share))
        torch.testing.assert_close(there, column(x(share * h)))
        torch.testing.assert_close(moved, column(h * v(share * h)))


def test_any_other_is_followed_to_fifth_order():
    errors = [abs(float(swing(h).at(column(0.4))[0]) - math.sin(0.3 + 1.2 * h)) for h in (0.2, 0.1, 0.05)]
    for coarse, fine in pairwise(errors):
        assert 27 < coarse / fine < 37


def test_where_not_asked_for_it_is_at_its_end():
    passage, share = swing(0.2), column(0.4)
    x, v = passage.until(share, torch.tensor([[True]]))
    there, moved = passage.at(share)
    assert torch.equal(x, there)
    torch.testing.assert_close(v, moved / 0.2)
    x, v = passage.until(share, torch.tensor([[False]]))
    assert torch.equal(x, passage.x1)
    assert torch.equal(v, passage.v1)


@pytest.mark.parametrize("bend", [-0.9, 0.0, 0.9, 30.0])
def test_a_stop_is_passed_where_the_motion_says(bend):
    """x = (1 + bend) t − bend t² or, far beyond, one that first goes back: to the last digits."""
    h, x, v = 1.0, 1.0, 1.0 - bend if bend < 1 else 1.0 + bend
    begun, bent = (1 + bend, -2 * bend) if bend < 1 else (1.0 - bend, 2 * bend)
    passage = Passage(*(column(value) for value in (0.0, begun, bent, x, v, h)))
    stop = 0.35
    share = passage.reaches(column(stop), torch.tensor([[True]]))
    there, _ = passage.at(share)
    assert 0 < float(share) < 1
    assert float(there) == pytest.approx(stop, abs=1e-9)


def test_many_at_once_and_one_of_several_coordinates():
    one, two = swing(0.2), swing(0.1)
    both = Passage(*(torch.stack([a, b]) for a, b in zip(one, two, strict=True)))
    both = Passage(*(torch.cat([torch.zeros_like(each), each], -1) for each in both[:-1]), both.h)
    stop, where = torch.tensor([0.5, 0.45], dtype=F64).reshape(2, 1, 1), torch.tensor([True, False]).reshape(2, 1, 1)
    shares = both.only(1).reaches(stop, where)
    torch.testing.assert_close(shares[0], one.reaches(stop[0], where[0]))
    assert float(shares[1]) == 1.0


def test_the_time_of_passing_has_its_slope():
    """In the first velocity, against a difference."""

    def reached(v0):
        h, x1 = 0.2, 0.3 + 0.2 * v0
        values = (torch.tensor([value], dtype=F64) for value in (0.3, 0.5, 0.2))
        x0, a0, h = values
        x1, v1 = x0 + h * v0 + h**2 / 2 * a0, v0 + h * a0
        return Passage(x0, v0, a0, x1, v1, h).reaches(torch.tensor([0.45], dtype=F64), torch.tensor([True]))

    v0 = torch.tensor([1.1], dtype=F64, requires_grad=True)
    (slope,) = torch.autograd.grad(reached(v0), v0)
    eps = 1e-6
    with torch.no_grad():
        expected = (reached(v0 + eps) - reached(v0 - eps)) / (2 * eps)
    torch.testing.assert_close(slope, expected, rtol=1e-6, atol=1e-9)
