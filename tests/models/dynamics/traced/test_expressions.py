"""What the tracer folds, and that what it writes computes the same."""

import itertools
import operator

import pytest

from invdyn.models.dynamics.traced.expressions import Expression, Graph
from invdyn.models.dynamics.traced.programs import program


@pytest.fixture
def xy():
    graph = Graph()
    return graph, graph.argument(("x", 0), moving=True), graph.argument(("y", 0), moving=False)


def test_known_results_are_no_operations(xy):
    _, x, _ = xy
    assert x + 0.0 is x
    assert 0.0 + x is x
    assert x * 1.0 is x
    assert x - 0.0 is x
    assert x * 0.0 == 0.0
    assert x - x == 0.0
    assert (x * -1.0).place == (-x).place
    assert x.__neg__().__neg__().place == x.place


def test_common_expressions_and_signs_are_carried_outwards(xy):
    graph, x, y = xy
    outputs = [x * y + y * x, (-x) * y + x, x - (-y) * x]
    # x·y; x·y + x·y; x − x·y; x + x·y
    assert program(graph, outputs).operations == 4


def test_numbers_of_the_body_are_computed_apart(xy):
    graph, x, y = xy
    traced = program(graph, [x * (y * y * 3.0), y + 1.0, 2.0])
    assert traced.operations == 1
    assert traced.values([5.0], traced.numbers([2.0])) == [60.0, 3.0, 2.0]


def test_what_is_not_asked_for_is_not_computed(xy):
    graph, x, y = xy
    _ = x * y * y
    assert program(graph, [x]).constants == []
    assert program(graph, [x]).operations == 0


@pytest.mark.parametrize("seed", range(5))
def test_programs_compute_what_was_traced(seed):
    import random

    draw, graph = random.Random(seed), Graph()
    arguments = [graph.argument(("x", k), moving=k % 2 == 0) for k in range(4)]
    given = [draw.uniform(-2, 2) for _ in arguments]
    pairs = [*zip(arguments, given, strict=True), (0.0, 0.0), (1.0, 1.0), (-1.0, -1.0), (0.5, 0.5)]
    for _ in range(60):
        kind = draw.choice([operator.add, operator.sub, operator.mul, operator.neg])
        (a, x), (b, y) = draw.sample(pairs, 2)
        pairs.append((kind(a), kind(x)) if kind is operator.neg else (kind(a, b), kind(x, y)))
    pairs += [(1.0 / a, 1.0 / x) for a, x in pairs if isinstance(a, Expression) and abs(x) > 0.1]
    traced = program(graph, [a for a, _ in pairs])
    place = dict(zip([("x", k) for k in range(4)], given, strict=True))
    found = traced.values([place[k] for k in traced.moving], traced.numbers([place[k] for k in traced.constants]))
    assert found == pytest.approx([x for _, x in pairs], rel=1e-9, abs=1e-9)
    assert len(set(itertools.chain(traced.source.lines))) == traced.operations
