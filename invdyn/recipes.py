"""Recipes of `invdyn infer`: options that one kind of recording needs; `docs/how-to/recipes.md` says why.

What is given on the command line takes precedence. A recipe says nothing that a recording or a body's file has to say.
"""

from typing import Annotated, Any

import typer

RECIPES: dict[str, dict[str, Any]] = {
    "mouse": {"torque": "none", "learn": ["lengths"], "settings": ["noise=student_t"]},
    "reach": {"settings": ["noise=student_t"]},
    "panda": {"settings": ["hide_torque=yes"], "method": "laplace"},
}
"""Name -> option, by its name in `infer` -> value; `settings` are those of `--set`."""


def follow(context: typer.Context, name: str | None) -> str | None:
    """Make a recipe's values the defaults of this call. Raises InputError for a name that is not known."""
    if name is not None:
        if name not in RECIPES:
            from invdyn.recordings import InputError

            raise InputError(f"--recipe: expected one of {', '.join(RECIPES)}, got {name!r:.40}")
        context.default_map = RECIPES[name]
    return name


Recipe = Annotated[
    str | None,
    typer.Option(
        callback=follow,
        is_eager=True,
        help=f"Options for one kind of recording: {', '.join(RECIPES)}. Options that you give take precedence.",
    ),
]
