"""Body files in space: TOML text to plain tables and back, with every complaint naming the file.

    name = "paper's arm"
    dimensions = 3              # what tells such a file from a planar one, which has none of it
    gravity = [0.0, 0.0, -9.81] # m/s², in the world's frame; this is the default

    [[links]]
    name = "upper_arm"
    joint = "shoulder"
    parent = "world"            # a link's name; default the link before, the world for the first one
    type = "universal"          # hinge (default), slide, fixed, universal, ball, translation, free: see joints.py
    chart = "zy"                # of a universal, ball or free joint; these are the defaults: "zy" and "zyx"
    origin = [0.0, 0.0, 0.0]    # m, the joint in the parent's frame; default the parent's tip, where it has one
    rpy = [0.0, 0.0, 0.0]       # rad, the joint's frame in the parent's; or quaternion = [w, x, y, z],
                                # or axes = [[…], […], […]], its x, y and z axes
    length = 0.3                # m, a stick along x; its tip, com and inertia then follow (planar files' defaults)
    tip = "elbow"               # the site at its far end
    mass = 1.5                  # kg; default 0

    [[links]]
    name = "forearm"
    joint = "elbow"
    axis = [0.0, 1.0, 0.0]      # of a hinge or slide, in the joint's frame; default [0, 0, 1]
    mass = 1.0
    com = [0.12, 0.0, 0.0]      # m, in the link's frame
    inertia = [1e-4, 8e-3, 8e-3, 0.0, 0.0, 0.0]     # kg·m² about the com: xx, yy, zz, xy, xz, yz
    sites = {wrist = [0.25, 0.0, 0.0], watch = [0.22, 0.0, 0.03]}   # m, named points
    damping = 0.1               # of a hinge or slide: this and what else `joint_parts_toml.py` says

`reference = [[…], […], […]]`, axes too, turns the link's frame against its joint's (see `joints.py`). A scalar may be
a table, as in planar files: {mean = 1.5, sd = 0.1} or {start = 1.5}; each of com, inertia, origin and a site's too.
A load is `load = {mass = 2.0, at = [0.25, 0.0, 0.0]}`, at in the link's frame.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

from invdyn.models.bodies import joint_parts_toml
from invdyn.models.bodies.body_toml import (
    LOAD,
    literal,
    parse,
    scalar_from_table,
    scalar_to_table,
    uncertainty_lines,
    with_uncertainty,
)
from invdyn.models.bodies.body_xml import MOST_BYTES
from invdyn.models.bodies.joints import WORLD
from invdyn.models.bodies.rotations import UNTURNED, from_axes, from_quaternion, from_rpy
from invdyn.models.bodies.scalars import BodyError, check_keys
from invdyn.models.bodies.whole_file import read_whole, write_whole

TREE_KEYS = ("name", "dimensions", "gravity", "links", "uncertainty")
ROTATIONS = {"rpy": from_rpy, "quaternion": from_quaternion, "axes": from_axes}
JOINT_KEYS = ("type", "axis", "chart", "reference")
SCALARS = ("mass", "length")
VECTORS = ("origin", "com", "inertia")
LINK_KEYS = ("name", "parent", "joint", *JOINT_KEYS, *ROTATIONS, *SCALARS, "tip", *VECTORS, "sites")


def is_in_space(tables: dict, path: str | Path) -> bool:
    """Whether a body file's tables say dimensions = 3. Raises `BodyError` for another number than that and 2."""
    dimensions = tables.get("dimensions", 2)
    if isinstance(dimensions, bool) or dimensions not in (2, 3):
        raise BodyError(f"{path}: expected dimensions = 2 (the default) or 3, got {dimensions!r:.40}")
    return dimensions == 3


def read(path: str | Path) -> dict:
    """Return the tables of a body file. Raises `BodyError` for broken TOML, `OSError` when it cannot be read."""
    return parse(read_whole(path, MOST_BYTES), str(path))


def of(tables: dict, path: str | Path) -> dict:
    """Return gravity and links, and the name if it has one, of the tables of a body file in space.

    Each link is a dict of what `Link` takes, with its joint as a dict of what `Joint` takes. Raises `BodyError`
    for unknown or missing keys.
    """
    links = tables.get("links")
    if not isinstance(links, list) or not links or not all(isinstance(link, dict) for link in links):
        raise BodyError(f"{path}: expected links as [[links]] tables, in two brackets, one for each link")
    tables = with_uncertainty(tables, path)
    check_keys(tables, TREE_KEYS, str(path))
    found = []
    for place, link in enumerate(links, 1):
        before = links[place - 2].get("name") if place > 1 else WORLD
        found.append(_link({"parent": before, **link}, f"{path}: link {place}"))
    return {key: value for key, value in tables.items() if key != "dimensions"} | {"links": found}


def write(
    path: str | Path, name: str, gravity: Sequence[float], links: list[dict], uncertainty: Mapping[str, float]
) -> None:
    """Write links, dicts as `of` returns them. Raises `OSError`, and `BodyError` for an unknown kind of prior."""
    lines = [f"name = {literal(name)}", "dimensions = 3", f"gravity = {literal(gravity)}"]
    for link in links:
        lines += ["", "[[links]]", *(f"{key} = {literal(value)}" for key, value in _written(link).items())]
    lines += uncertainty_lines(uncertainty)
    write_whole(path, "\n".join(lines) + "\n")


def _written(link: dict) -> dict:
    joint = dict(link["joint"])
    values = {"name": link["name"], "parent": link["parent"], "joint": joint.pop("name")}
    for key, rows in (("axes", link["rotation"]), ("reference", joint.pop("reference"))):
        if rows != UNTURNED:
            values[key] = [list(column) for column in zip(*rows, strict=True)]
    values |= {key: value for key, value in joint.items() if value != ""}
    for key in (*SCALARS, *VECTORS, "tip"):
        value = link[key]
        if isinstance(value, tuple):
            values[key] = [scalar_to_table(each, key) for each in value]
        elif value is not None:
            values[key] = value if key == "tip" else scalar_to_table(value, key)
    values |= {key: link[key] for key in joint_parts_toml.KEYS if key in link}
    own = {name: [scalar_to_table(x, name) for x in at] for name, at in link["sites"].items()}
    return values | ({"sites": own} if own else {})


def _link(link: dict, where: str) -> dict:
    link = dict(link)
    parts = joint_parts_toml.taken(link, where)
    check_keys(link, (*LINK_KEYS, LOAD, *joint_parts_toml.KEYS), where)
    missing = [key for key in ("name", "joint") if key not in link]
    if missing:
        raise BodyError(f"{where}: expected the keys name and joint; missing: {', '.join(missing)}")
    said = [key for key in ROTATIONS if key in link]
    if len(said) > 1:
        raise BodyError(f"{where}: expected one of {', '.join(ROTATIONS)}, got {' and '.join(said)}")
    joint = {"name": link["joint"], **{key: link[key] for key in ("type", "axis", "chart") if key in link}}
    if "reference" in link:
        joint["reference"] = _rows(link["reference"], "axes", f"{where}: reference")
    made = {key: link[key] for key in ("name", "parent", "tip") if key in link} | {"joint": joint}
    for key in said:
        made["rotation"] = _rows(link[key], key, f"{where}: {key}")
    made |= {key: scalar_from_table(link[key], f"{where}: {key}") for key in SCALARS if key in link}
    made |= {key: _vector(link[key], f"{where}: {key}") for key in VECTORS if key in link}
    if parts is not None:
        made["parts"] = parts
    if LOAD in link:
        made[LOAD] = link[LOAD]
    if "sites" in link:
        if not isinstance(link["sites"], dict):
            raise BodyError(f"{where}: expected sites as a table, {{name = [x, y, z]}}, got {link['sites']!r:.60}")
        made["sites"] = {name: _vector(at, f"{where}: site '{name}'") for name, at in link["sites"].items()}
    return made


def _rows(value: object, key: str, where: str) -> tuple:
    return tuple(map(tuple, ROTATIONS[key](value, where).tolist()))


def _vector(values: object, where: str) -> object:
    if not isinstance(values, list):
        return values  # what is no vector at all, `Link` refuses
    return [scalar_from_table(value, where) for value in values]
