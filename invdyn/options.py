"""Options that commands share: a dataclass whose fields are options, spread into a command by a decorator."""

import inspect
from collections.abc import Callable
from dataclasses import MISSING, fields
from functools import update_wrapper
from typing import Annotated, Any, get_type_hints

import typer

BodyFile = Annotated[
    str, typer.Option("--body", metavar="FILE", help="Body: .toml, .xml (MJCF), .urdf, or the name of one of ours.")
]
LARGEST_SEED = 2**63 - 1  # what torch and netCDF take alike
MOST_WORKERS = 1024
Seed = Annotated[int, typer.Option(min=0, max=LARGEST_SEED, help="Same seed, same result.")]


def with_option_groups(command: Callable[..., None]) -> Callable[..., None]:
    """Let typer see the fields of a command's first parameter, a dataclass, as options: the required ones before the
    command's own options, the others after them.
    """
    (first, *own) = inspect.signature(command).parameters.values()
    hints = get_type_hints(command, include_extras=True)
    group = hints.pop(first.name)
    kinds = get_type_hints(group, include_extras=True)

    def parameter(name: str, default: Any, kind: Any) -> inspect.Parameter:
        empty = inspect.Parameter.empty if default is MISSING else default
        return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=empty, annotation=kind)

    shared = [parameter(field.name, field.default, kinds[field.name]) for field in fields(group)]
    required = [one for one in shared if one.default is inspect.Parameter.empty]
    rest = [one for one in shared if one not in required]
    parameters = [*required, *(one.replace(kind=inspect.Parameter.KEYWORD_ONLY) for one in own), *rest]

    def spread_command(**options: Any) -> None:
        given = group(**{name: options.pop(name) for name in kinds})
        command(given, **options)

    update_wrapper(spread_command, command)
    vars(spread_command)["__signature__"] = inspect.Signature(parameters)
    spread_command.__annotations__ = {one.name: hints.get(one.name, one.annotation) for one in parameters}
    del vars(spread_command)["__wrapped__"]
    return spread_command
