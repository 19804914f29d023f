"""A traced graph as Python source: one function for the numbers of a body, one for what moves.

Both are straight lines of +, −, × and ÷ (and, of angles, ``FUNCTIONS``), written and compiled here at run time. The
first four know nothing of what they compute with. `machine_code.py` writes the same lines for LLVM.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import torch

from invdyn.models.dynamics.traced.expressions import Expression, Graph, Scalar

FUNCTIONS: dict[str, Callable] = {
    "round": torch.round,
    "floor": torch.floor,
    "clamp": lambda x, bound: x.clamp(-bound, bound),
    "choose": lambda condition, one, other: torch.where(condition != 0, one, other),
}
"""Operations that Python has no sign for."""


class Line(NamedTuple):
    """One operation: ``name`` = an operation of that ``kind`` (:class:`.Node`) on ``operands``, by their names."""

    name: str
    kind: str
    operands: tuple[str, ...]

    @property
    def text(self) -> str:
        """In Python."""
        if self.kind in FUNCTIONS:
            return f"{self.name} = {self.kind}({', '.join(self.operands)})"
        right = f"-{self.operands[0]}" if self.kind == "neg" else f" {self.kind} ".join(self.operands)
        return f"{self.name} = {right}"


@dataclass(frozen=True)
class Lines:
    """Source without its frame: names given as `arguments` and `numbers`, then `lines`, then names of `results`.

    `literals` are the plain numbers that stand in them, by name.
    """

    arguments: Sequence[str]
    numbers: Sequence[str]
    lines: Sequence[Line]
    results: Sequence[str]
    literals: dict[str, float]


@dataclass(frozen=True)
class Program:
    """`numbers` takes the values of `constants` and gives a list; `values` takes those of `moving`, and that list.

    Constants and moving are keys of arguments, (word, place), as the graph has them; `source` is that of `values`.
    """

    constants: Sequence
    moving: Sequence
    numbers: Callable[[Sequence], list]
    values: Callable[[Sequence, Sequence], list]
    source: Lines

    @cached_property
    def words(self) -> list:
        """The first parts of the keys of `moving`, each once."""
        return sorted({word for word, _ in self.moving})

    @property
    def operations(self) -> int:
        """How many operations one evaluation takes, those on the numbers of the body alone not counted."""
        return len(self.source.lines)


def program(graph: Graph, outputs: Sequence[Scalar]) -> Program:
    """Return the program that computes the outputs, and nothing that they do not need."""
    nodes = {place: graph.nodes[place] for place in graph.needed(outputs)}
    literals: dict[float, str] = {}

    def named(x: int | float) -> str:
        return literals.setdefault(x, f"k{len(literals)}") if isinstance(x, float) else f"t{x}"

    given: dict[bool, list[int]] = {True: [], False: []}
    lines: dict[bool, list[Line]] = {True: [], False: []}
    used = {x.place for x in outputs if isinstance(x, Expression)}
    for place, node in nodes.items():
        if node.kind == "argument":
            given[node.moving].append(place)
            continue
        lines[node.moving].append(Line(f"t{place}", node.kind, tuple(map(named, node.operands))))
        if node.moving:
            used.update(node.operands)
    carried = [named(place) for place, node in nodes.items() if place in used and not node.moving]
    results = [named(x.place if isinstance(x, Expression) else float(x)) for x in outputs]
    arguments = {moving: [named(place) for place in places] for moving, places in given.items()}
    known = {name: value for value, name in literals.items()}
    of_body = Lines(arguments[False], [], lines[False], carried, known)
    source = Lines(arguments[True], carried, lines[True], results, known)
    return Program(
        constants=[nodes[place].operands[0] for place in given[False]],
        moving=[nodes[place].operands[0] for place in given[True]],
        numbers=_function("numbers(arguments)", of_body),
        values=_function("values(arguments, numbers)", source),
        source=source,
    )


def _function(head: str, source: Lines) -> Callable:
    unpacked = {"arguments": source.arguments, "numbers": source.numbers}
    body = [f"{', '.join(names)}, = {word}" for word, names in unpacked.items() if names]
    body += [*(line.text for line in source.lines), f"return [{', '.join(source.results)}]"]
    text = f"def {head}:\n" + "".join(f"    {line}\n" for line in body)
    space: dict = FUNCTIONS | source.literals
    exec(compile(text, f"<traced {head}>", "exec"), space)
    return space[head.partition("(")[0]]
