"""Options that have new names: the old ones work for one version, with a warning."""

from collections.abc import Callable, Collection, Sequence

RENAMED = {
    "--also": "--with",
    "--beside": "--camera",
    "--free": "--estimate",
    "--most": "--max-effects",
    "--passive": "--zero-torque",
    "--without": "--exclude",
    "--arm": "--tracker",
    "--network": "--tracker",
    "--scheduler": "--workers",
    "--body-lengths": "--scale body",
    "--learn-lengths": "--learn lengths",
    "--learn-cameras": "--learn",
    "--figure": "--out",
    "--film": "--out",
    "--sto": "--out",
    "--mot": "--out",
    "--csv": "--out",
    "--episode": "--set episodes=",
    "--kinematic": "--torque none",
    "--isolate": "--set isolate=yes",
    "--browser": "--set browser=yes",
    "--no-browser": "--set browser=no",
    "--confine": "--set confine=yes",
    "--hide-torque": "--set hide-torque=yes",
    "--no-confine": "--set confine=no",
}
"""Old option to new one; a flag may become an option with its value."""
SETTINGS = (
    *("base", "baseline", "bodies", "clock", "device", "dictionary", "draws", "encoders", "episodes", "every"),
    *("filters-per-task", "forces", "format", "individual", "marker", "method-user", "noise", "offset", "person"),
    *("plane", "sd", "size", "tolerance", "torque-scale", "tracks", "truth", "unit", "up"),
)
"""Old options that are settings now, each ``--set NAME=VALUE``."""


def with_new_names(
    words: Sequence[str], own: Collection[str], repeatable: Collection[str], warn: Callable[[str], None]
) -> list[str]:
    """A command's words with old options under their new names.

    Args:
        words: what follows the command's name.
        own: options that the command has, a setting as "--set name=".
        repeatable: those of them that may be given several times.
        warn: called with a sentence for each old option.

    Raises ValueError for an old option next to the new one, of which a command takes one, for a flag that became an
    option with its value and has another, and for a setting without its value.
    """
    found: list[str] = []
    given = {word.partition("=")[0] for word in words}
    rest = iter(words)
    for word in rest:
        if word == "--":
            return [*found, word, *rest]
        old, equals, value = word.partition("=")
        new = _new_name(old)
        name = new.partition(" ")[0]
        known = (f"{new.partition('=')[0]}=" if name == "--set" else name) in own
        if old in own or not known or (name == "--out" and name not in repeatable):
            found.append(word)
            continue
        if name in given and name not in repeatable:
            raise ValueError(f"{old} is {new} now, and {name} is given too: leave one of them out")
        if equals and " " in new and not new.endswith("="):
            raise ValueError(f"{old} is {new} now: expected no value of {old}, got {value!r}")
        if new.endswith("=") and not equals and (value := next(rest, "")) == "":
            raise ValueError(f"{old} is {new}… now: expected a value, got none")
        given.add(name)
        warn(f"{old} is now {new}{'…' * new.endswith('=')}; the old name works in this version alone")
        if new.endswith("="):
            found += [name, f"{new.split()[1]}{value}"]
        else:
            found += new.split() if not equals else [f"{name}={value}"]
    return found


def _new_name(old: str) -> str:
    return f"--set {old[2:]}=" if old[2:] in SETTINGS else RENAMED.get(old, "")
