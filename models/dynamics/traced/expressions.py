"""Straight-line programs out of ordinary Python arithmetic: a tracer of scalars that folds what need not be computed.

An algorithm runs once on `Expression`s instead of numbers. Each operation becomes a node of a `Graph`, unless it is

    known        x + 0, x · 0, x · 1, x · −1, x − x and operations on plain floats, which stay floats
    there        the same operation on the same operands: common sub-expressions are one node
    a sign       −x is carried outwards, so that it ends in a subtraction of what it is added to

Nodes that depend on no moving argument (angles, velocities, torques) are *numbers* of the body: computed once for
all particles. Articulated-body programs made in this way: R. Featherstone, Rigid Body Dynamics Algorithms (2008),
section 10.4, on the symbolic simplification of recursions.
"""

from collections.abc import Sequence
from functools import reduce
from operator import mul
from typing import Any, NamedTuple


class Node(NamedTuple):
    """`kind` is "argument", "+", "-", "*", "/", "neg" or a function; operands are numbers of nodes, or floats.

    Functions: "round" to the nearest integer, "floor", "clamp" (x, b) to [−b, b], "choose" (c, a, b): a where c ≠ 0.
    """

    kind: str
    operands: tuple
    moving: bool


class Graph:
    """The nodes of one program, in an order in which they can be computed."""

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self._places: dict[tuple, Expression] = {}

    def argument(self, name: Any, moving: bool) -> "Expression":
        """The argument of that name."""
        return self._node("argument", (name,), moving)

    def operation(self, kind: str, *operands: "Expression | float") -> "Expression":
        """The node of an operation, the one that is there or a new one."""
        places = tuple(x.place if isinstance(x, Expression) else x for x in operands)
        if kind in "+*":
            places = tuple(sorted(places, key=lambda place: (isinstance(place, float), place)))
        moving = any(isinstance(x, Expression) and self.nodes[x.place].moving for x in operands)
        return self._node(kind, places, moving)

    def _node(self, kind: str, operands: tuple, moving: bool) -> "Expression":
        key = (kind, operands)
        if key not in self._places:
            self._places[key] = Expression(self, len(self.nodes))
            self.nodes.append(Node(kind, operands, moving))
        return self._places[key]

    def needed(self, outputs: Sequence["Expression | float"]) -> list[int]:
        """Places of all nodes that the outputs depend on, in order."""
        found, waiting = set(), [x.place for x in outputs if isinstance(x, Expression)]
        while waiting:
            place = waiting.pop()
            if place not in found:
                found.add(place)
                if self.nodes[place].kind != "argument":
                    waiting += [x for x in self.nodes[place].operands if not isinstance(x, float)]
        return sorted(found)


class Expression:
    """A scalar that is not known yet. Arithmetic with plain numbers and others of its graph gives one, or a float."""

    __slots__ = ("graph", "place")

    def __init__(self, graph: Graph, place: int):
        self.graph, self.place = graph, place

    def _negated(self) -> "Expression | None":
        """X where this is −x."""
        node = self.graph.nodes[self.place]
        return Expression(self.graph, node.operands[0]) if node.kind == "neg" else None

    def __neg__(self) -> "Expression":
        if (inner := self._negated()) is not None:
            return inner
        node = self.graph.nodes[self.place]
        if node.kind == "-":
            one, other = (x if isinstance(x, float) else Expression(self.graph, x) for x in node.operands)
            return self.graph.operation("-", other, one)
        return self.graph.operation("neg", self)

    def __add__(self, other: "Expression | float") -> Any:
        if isinstance(other, float | int):
            return self if other == 0 else self.graph.operation("+", self, float(other))
        if (inner := other._negated()) is not None:
            return self - inner
        if (inner := self._negated()) is not None:
            return other - inner
        return self.graph.operation("+", self, other)

    __radd__ = __add__

    def __sub__(self, other: "Expression | float") -> Any:
        if isinstance(other, float | int):
            return self + -other
        if other.place == self.place:
            return 0.0
        if (inner := other._negated()) is not None:
            return self + inner
        if (inner := self._negated()) is not None:
            return -(inner + other)
        return self.graph.operation("-", self, other)

    def __rsub__(self, other: float) -> Any:
        return -self if other == 0 else self.graph.operation("-", float(other), self)

    def __mul__(self, other: "Expression | float") -> Any:
        if isinstance(other, float | int):
            if other == 0:
                return 0.0
            if abs(other) == 1:
                return self if other == 1 else -self
            return -(self * -other) if other < 0 else self.graph.operation("*", self, float(other))
        if (inner := self._negated()) is not None:
            return -(inner * other)
        if (inner := other._negated()) is not None:
            return -(self * inner)
        return self.graph.operation("*", self, other)

    __rmul__ = __mul__

    def __truediv__(self, other: "Expression | float") -> "Expression":
        return self.graph.operation("/", self, float(other) if isinstance(other, float | int) else other)

    def __rtruediv__(self, other: float) -> "Expression":
        return self.graph.operation("/", float(other), self)

    def rounded(self) -> "Expression":
        """The nearest integer, the even one of two."""
        return self.graph.operation("round", self)

    def floored(self) -> "Expression":
        """The integer at or below."""
        return self.graph.operation("floor", self)

    def clamped(self, bound: float) -> "Expression":
        """Within [−bound, bound]; NaN stays."""
        return self.graph.operation("clamp", self, bound)

    def chosen(self, one: "Expression", other: "Expression") -> "Expression":
        """``one`` where this is not 0, else the ``other``."""
        return self.graph.operation("choose", self, one, other)

    def __pow__(self, power: int) -> Any:
        """By multiplication, as torch has a square."""
        return reduce(mul, [self] * power, 1.0)


Scalar = Expression | float
