"""Arithmetic as data: sums, products, quotients, whole powers, cosines and sines of named scalars, and nothing else.

A program is {"steps": {name: expression}, "results": [expression]}, each expression a text such as
"k0*cos(phi1 - phi2)/2" over the arguments and earlier steps. It may come from a file that anybody wrote: every text is
parsed, each node of its syntax tree is held against the list below, and the function is made from the trees alone. So
no call but cos and sin, no attribute, and no number that grows without bounds is ever run.
"""

import ast
import re
from collections.abc import Callable, Collection, Sequence
from operator import methodcaller
from typing import Any

FUNCTIONS = {"cos": methodcaller("cos"), "sin": methodcaller("sin")}
"""Of whatever has them: tensors, or angles whose cosine and sine are known."""
HIGHEST = 8
"""The largest power."""
LARGEST = 10**6
"""The largest number; a body's other ones are arguments."""
NAME = re.compile("[a-z]+(_[xy]|[0-9]+)")


def function(arguments: Sequence[Sequence[str]], program: dict) -> Callable[..., list]:
    """The function of a program, from lists of scalars (tensors or numbers), one for each list of names, to a list.

    Raises `ValueError`, `TypeError` or `KeyError` for what is no program, `RecursionError` for one nested too deeply.
    """
    known = {name for names in arguments for name in names}
    lines = [f"def program({', '.join(f'_{place}' for place in range(len(arguments)))}):"]
    lines += [f"    [{', '.join(_name(name) for name in names)}] = _{place}" for place, names in enumerate(arguments)]
    for name, text in program["steps"].items():
        lines.append(f"    {_name(name)} = {checked(text, known)}")
        known.add(name)
    lines.append(f"    return [{', '.join(checked(text, known) for text in program['results'])}]")
    namespace: dict[str, Any] = {"__builtins__": {}, **FUNCTIONS}
    exec("\n".join(lines), namespace)  # every word of it is ours, or has passed `checked`
    return namespace["program"]


def checked(text: str, known: Collection[str]) -> str:
    """The same expression, written anew from its tree. Raises as :func:`function` for what is no arithmetic."""
    try:
        tree = ast.parse(text, mode="eval").body
    except (SyntaxError, MemoryError) as error:  # the parser's own word for too deep
        raise ValueError(f"expected arithmetic, got {text:.60}") from error
    for node in ast.walk(tree):
        if not _allowed(node, known):
            raise ValueError(f"expected arithmetic of {', '.join(sorted(known))}, got {ast.unparse(node):.60}")
    return ast.unparse(tree)


def _allowed(node: ast.AST, known: Collection[str]) -> bool:
    match node:
        case ast.BinOp(left=base, op=ast.Pow(), right=ast.Constant(value=int(power))):
            # of a number alone it may fill the memory
            return 0 <= power <= HIGHEST and any(isinstance(part, ast.Name) for part in ast.walk(base))
        case ast.BinOp(op=ast.Add() | ast.Sub() | ast.Mult() | ast.Div()) | ast.UnaryOp(op=ast.USub()):
            return True
        case ast.Call(func=ast.Name(id=name), args=[_], keywords=[]):
            return name in FUNCTIONS
        case ast.Name(id=name, ctx=ast.Load()):
            return name in known or name in FUNCTIONS
        case ast.Constant(value=value):
            return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= LARGEST
        case ast.operator() | ast.unaryop() | ast.expr_context():
            return True
    return False


def _name(name: str) -> str:
    if not NAME.fullmatch(name):
        raise ValueError(f"expected a name such as x0 or base_x, got {name!r:.60}")
    return name
