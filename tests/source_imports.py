"""Who imports whom, read from the source: lazy imports count too, and nothing is run."""

import ast
from pathlib import Path

ROOT = Path(__file__).parents[1]
ROOMS = ("recordings", "models", "inference", "diagnosis", "blindcheck", "invdyn")


def module_name(path):
    """invdyn.models.torques.base for models/torques/base.py; the front door's own are invdyn.cli, …"""
    parts = list(path.relative_to(ROOT).with_suffix("").parts)
    if parts[-1] == "__init__":
        parts.pop()
    return ".".join(parts if parts[0] == "invdyn" else ["invdyn", *parts])


FILES = {module_name(path): path for room in ROOMS for path in sorted((ROOT / room).rglob("*.py"))}
"""Files by module; those of a room once, by its own folder and not by the link to it."""


def room_of(module):
    """recordings, models …, or invdyn for the front door's own."""
    second = [*module.split("."), ""][1]
    return second if second in ROOMS and second != "invdyn" else "invdyn"


def inner_room(module):
    """filters for invdyn.inference.filters.weights; None for a file at the top of its room."""
    parts = module.split(".")
    return parts[2] if len(parts) > 3 or (len(parts) == 3 and FILES[module].name == "__init__.py") else None


def imported(module, tree, names=FILES):
    """Modules of ours that a syntax tree imports, relative imports resolved; a package and its parts alike."""
    package = module if names[module].name == "__init__.py" else module.rpartition(".")[0]
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                up = package.split(".")[: len(package.split(".")) - node.level + 1]
                base = ".".join([*up, base] if base else up)
            for alias in node.names:
                whole = f"{base}.{alias.name}"
                found.add(whole if whole in names else base)
    return {name for name in found if name in names}


IMPORTS = {name: imported(name, ast.parse(path.read_text("utf-8"))) for name, path in FILES.items()}
