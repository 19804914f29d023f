"""Commands with groups of options, and rare settings that stand in ``--set NAME=VALUE``.

A command whose first parameter is a dataclass has its fields as options. A parameter or field that is a
:class:`Setting` has no option of its own; the help lists it under ``--set``.
"""

import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import update_wrapper
from typing import Annotated, Any, get_args, get_type_hints

import typer
from typer.core import TyperCommand

COLUMN = 26  # characters of a help's first column
MIN_GROUPED = 12  # options of a command from which on they stand in groups
GROUPS = {
    "Recording": "body height mass sex units fps scale frames calibration tracker mapping others held_out camera",
    "Model": "zero_torque learn torque recipe",
    "Scene": "length refine fit",
    "Search": "exclude estimate max_effects budget force",
    "Computation": "filters particles replicates workers seed seed_file checkpoint",
}
"""Which group of a help an option stands in; the others stand at the end."""


@dataclass(frozen=True)
class Setting:
    """What a rare setting is, how its text is read, its least value, and whether it may be given several times."""

    help: str
    kind: Callable[[str], Any] = str
    least: float | None = None
    repeatable: bool = False

    def read(self, name: str, text: str) -> Any:
        """The value of a text. Raises InputError for one that is none."""
        from invdyn.recordings import InputError

        try:
            value = self.kind(text)
        except ValueError:
            value = None
        if value is None or (self.least is not None and not value >= self.least):
            what = {int: "a whole number", float: "a number", yes: "yes or no"}.get(self.kind, "a value")
            least = "" if self.least is None else f" from {self.least:g} on"
            raise InputError(f"--set {name}: expected {what}{least}, got {text!r}")
        return value


def spelled(kind: type, name: str) -> str:
    """What a command line calls a field of a dataclass of options: "--set forces", "--map", "--zero-torque"."""
    notes = get_args(get_type_hints(kind, include_extras=True)[name])[1:]
    if any(isinstance(each, Setting) for each in notes):
        return f"--set {name}"
    # an Option in an annotation has its first name in the place of a default
    declared = [first for each in notes if isinstance(first := getattr(each, "default", None), str)]
    return declared[0] if declared else f"--{name.replace('_', '-')}"


def yes(text: str) -> bool:
    """Whether a text is "yes"; raises ValueError unless it is that or "no"."""
    if text not in ("yes", "no"):
        raise ValueError(text)
    return text == "yes"


def after_a_recipe(context: typer.Context, given: list[str] | None) -> list[str]:
    """Settings of the recipe that this call follows, if any, then those that are given."""
    return [*(context.default_map or {}).get("settings", ()), *(given or ())]


Assignments = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="NAME=VALUE", callback=after_a_recipe, help="A rare setting, of those listed; repeatable."
    ),
]


class GroupedCommand(TyperCommand):
    """A command whose help shows options in groups, and its settings."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write each group under its title, in at most the width of the formatter."""
        parameters = self.get_params(ctx)
        known = {name: title for title, names in GROUPS.items() for name in names.split()}
        few = len(parameters) < MIN_GROUPED
        groups: dict[str, list[tuple[str, str]]] = {title: [] for title in ("Arguments", *GROUPS)}
        for parameter in parameters:
            if (record := parameter.get_help_record(ctx)) is not None:
                title = "Options" if few else known.get(parameter.name, "Options")
                title = "Arguments" if parameter.param_type_name == "argument" else title
                groups.setdefault(title, []).append(record)
        if settings := getattr(self.callback, "settings", None):
            groups["Settings, each as --set NAME=VALUE"] = [(name, each.help) for name, each in settings.items()]
        groups["Options"] = groups.pop("Options")  # the last: it ends with --help
        for title, rows in groups.items():
            if not rows:
                continue
            with formatter.section(title):
                formatter.write_dl(rows, col_max=COLUMN)


def with_settings(command: Callable[..., None]) -> Callable[..., None]:
    """The command as typer can take it: dataclasses as options, and all settings as one option."""
    signature, hints = inspect.signature(command), get_type_hints(command, include_extras=True)
    groups = {name: hints[name] for name in signature.parameters if is_dataclass(hints[name])}
    own = [(each.name, each.default, hints[each.name]) for each in signature.parameters.values()]
    declared: list[tuple[str, Any, Any]] = []
    for name, default, kind in own:
        if name not in groups:
            declared.append((name, default, kind))
            continue
        kinds = get_type_hints(kind, include_extras=True)
        for field in fields(kind):
            empty = inspect.Parameter.empty if field.default is MISSING else field.default
            declared.append((field.name, empty, kinds[field.name]))
    settings = {name: found[0] for name, _, kind in declared if (found := _settings(kind))}
    options = [each for each in declared if each[0] not in settings]
    if settings:
        options.append(("assignments", None, Assignments))

    def expanded(**given: Any) -> None:
        given |= read_settings(settings, given.pop("assignments", None) or ())
        for name, kind in groups.items():
            names = [field.name for field in fields(kind)]
            given[name] = kind(**{each: given.pop(each) for each in names if each in given})
        command(**given)

    update_wrapper(expanded, command)
    del vars(expanded)["__wrapped__"]
    keyword = inspect.Parameter.KEYWORD_ONLY
    parameters = [inspect.Parameter(name, keyword, default=d, annotation=kind) for name, d, kind in options]
    vars(expanded).update(__signature__=inspect.Signature(parameters), settings=settings)
    expanded.__annotations__ = {name: kind for name, _, kind in options}
    return expanded


def read_settings(settings: Mapping[str, Setting], assignments: Iterable[str]) -> dict[str, Any]:
    """Values of texts "name=value".

    Raises InputError for a name that is not known, listing all, or a text that is no value.
    """
    from invdyn.recordings import InputError

    found: dict[str, Any] = {}
    for text in assignments:
        name, equals, value = text.partition("=")
        name = name.strip().replace("-", "_")
        if not equals or name not in settings:
            raise InputError(f"--set: expected NAME=VALUE with a name of {', '.join(settings)}, got {text!r}")
        read = settings[name].read(name, value.strip())
        found[name] = [*found.get(name, ()), read] if settings[name].repeatable else read
    return found


def _settings(kind: Any) -> list[Setting]:
    return [each for each in get_args(kind)[1:] if isinstance(each, Setting)]
