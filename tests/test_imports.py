"""Imports go one way, and never in a circle; read from the source, so that lazy imports count too."""

import ast
import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

ROOMS = {
    "recordings": set(),
    "models": set(),
    "inference": {"recordings", "models"},
    "diagnosis": {"recordings", "models", "inference"},
    "blindcheck": {"recordings", "models", "inference", "diagnosis"},
    "invdyn": {"recordings", "models", "inference", "diagnosis", "blindcheck"},
}

ROOT = Path(__file__).parents[1]


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


@pytest.fixture(scope="module", name="imports")
def imports_of_all():
    """Modules of ours that each imports: read when a test needs it, for it takes two seconds."""
    return {name: imported(name, ast.parse(path.read_text("utf-8"))) for name, path in FILES.items()}


def test_all_rooms_are_found(imports):
    assert {room_of(name) for name in FILES} == set(ROOMS)
    assert len(FILES) > 40
    assert "invdyn.models.state_space" in imports["invdyn.models.articulated.arm"]
    assert "invdyn.recordings.errors" in imports["invdyn.recordings.recording"]
    assert "invdyn.models.bodies.body_toml" in imports["invdyn.models.bodies.from_files"]  # a module by its package


@pytest.mark.parametrize("room", ROOMS)
def test_imports_go_one_way(room, imports):
    wrong = {
        f"{name} imports {other}"
        for name in FILES
        if room_of(name) == room
        for other in imports[name]
        if room_of(other) not in ROOMS[room] | {room}
    }
    assert not wrong


STAGES = {
    "models": ["bodies", "torques", "dynamics", "observation", "effects", "articulated", "engine"],
    "inference": [
        "execution",
        "smoothing",
        "online",
        "filters",
        "fitting",
        "variational",
        "mcmc",
        "parameters",
        "posterior",
        "methods",
        "study",
    ],
    "diagnosis": [
        "catalogue",
        "problem",
        "regression",
        "excite",
        "sensitivity",
        "prediction",
        "hypotheses",
        "assessment",
        "check",
        "write_back",
        "engine",
        "report",
    ],
}
"""Rooms of a room, each importing only those before it; a file beside them stands after the last of what it imports."""


@pytest.mark.parametrize("room", STAGES)
def test_rooms_of_a_room_go_one_way(room, imports):
    stages = STAGES[room]
    modules = [name for name in FILES if room_of(name) == room and name != f"invdyn.{room}"]
    assert {inner_room(name) for name in modules} - {None} == set(stages)

    def rank(name):
        if (inner := inner_room(name)) is not None:
            return stages.index(inner)
        return max((rank(other) for other in imports[name] & set(modules)), default=-1)

    assert not [
        f"{name} imports {other}"
        for name in modules
        for other in imports[name] & set(modules)
        if rank(other) > rank(name)
    ]


def test_a_report_is_only_read(imports):
    """The page of a diagnosis is made of its result: no stage before knows it."""
    assert not [
        name
        for name in FILES
        if room_of(name) == "diagnosis" and inner_room(name) not in ("report", None)
        for other in imports[name]
        if inner_room(other) == "report"
    ]


GENERIC = ("execution", "smoothing", "online", "filters", "fitting", "variational", "mcmc", "parameters")
"""Rooms of inference that need no more than a ``StateSpaceModel``."""


def test_generic_inference_loads_no_body():
    """In a fresh interpreter: of our own, only state-space models, and how files and errors are written."""
    generic = [name for name in FILES if room_of(name) == "inference" and inner_room(name) in GENERIC]
    assert len(generic) > 30
    code = f"import importlib, sys\nfor name in {generic!r}: importlib.import_module(name)\nprint(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    ours = {name for name in loaded if name.startswith("invdyn.")}
    assert ours >= set(generic)
    assert {name for name in ours if room_of(name) == "recordings"} <= {
        "invdyn.recordings",
        "invdyn.recordings.errors",
        "invdyn.recordings.atomic",
        "invdyn.recordings.paths",
    }
    assert not [name for name in ours if name.startswith(("invdyn.models.bodies", "invdyn.models.articulated"))]
    assert {inner_room(name) for name in ours if room_of(name) == "inference"} <= {*GENERIC, None}


def cycle(graph):
    """Some cycle of a graph as a list of its nodes, or None: depth-first search."""
    state = {}

    def visit(node, trail):
        state[node] = "open"
        for after in sorted(graph[node]):
            if state.get(after) == "open":
                return [*trail[trail.index(after) :], after]
            if after not in state and (found := visit(after, [*trail, after])):
                return found
        state[node] = "done"
        return None

    for node in sorted(graph):
        if node not in state and (found := visit(node, [node])):
            return found
    return None


def test_there_is_no_import_cycle(imports):
    # A part may import from its own package's parts; the package's __init__ gathers them and is no part.
    parts = {
        name: {other for other in imports[name] if other != name} for name in FILES if FILES[name].name != "__init__.py"
    }
    graph = {name: after & set(parts) for name, after in parts.items()}
    assert cycle(graph) is None
    rooms = {
        room: {room_of(o) for name in FILES if room_of(name) == room for o in imports[name]} - {room} for room in ROOMS
    }
    assert cycle(rooms) is None


def test_no_part_imports_its_own_package(imports):
    """from invdyn.models import X inside models/ works only in the order in which __init__ happens to import."""
    assert not [
        f"{name} imports {other}: import from the file that defines the name, as {other}'s __init__.pyi has it"
        for name, others in imports.items()
        for other in others
        if FILES[other].name == "__init__.py" and name.startswith(f"{other}.") and other != "invdyn"
    ]


def test_the_search_for_cycles_finds_one():
    assert cycle({"a": {"b"}, "b": {"c"}, "c": set()}) is None
    assert cycle({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == ["b", "c", "b"]


def test_every_name_in_all_exists():
    import importlib

    for room in ("models", "models.effects", "models.torques", "inference", "recordings"):
        module = importlib.import_module(f"invdyn.{room}")
        assert not [name for name in module.__all__ if not hasattr(module, name)]
        assert sorted(set(module.__all__)) == sorted(module.__all__)


def is_module(name):
    try:
        return importlib.util.find_spec(name) is not None
    except ModuleNotFoundError:
        return False


@pytest.mark.long
@pytest.mark.parametrize("folder", ["notebooks", "benchmarks", "docs"])
def test_scripts_import_names_that_are_there(folder):
    """Benchmarks run by hand alone, and would show it then."""
    missing = set()
    for path in sorted((ROOT / folder).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.level == 0 and (node.module or "").startswith("invdyn"):
                module = importlib.import_module(node.module)
                missing |= {
                    f"{path.name}: {node.module}.{name.name}"
                    for name in node.names
                    if not (hasattr(module, name.name) or is_module(f"{node.module}.{name.name}"))
                }
    assert not missing
