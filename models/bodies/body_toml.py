"""Body files: TOML text to plain tables and back, with every complaint naming the file.

A chain in the plane:

    name = "bench arm"
    gravity = [0.0, -9.81]      # m/s², in the recording's frame; this is the default
    base = [0.0, 0.0]           # m, the first joint; this is the default
    [[links]]                   # one for each link, from the base outwards
    name = "upper_arm"
    joint = "shoulder"          # at its proximal end
    tip = "elbow"               # keypoint at its distal end
    length = 0.30               # m
    mass = 1.5                  # kg
    com = 0.15                  # m from the joint, along the link; default length/2
    inertia = 0.01125           # kg·m² about the centre of mass; default mass·length²/12
    [uncertainty]               # optional relative standard deviations, marginalised; damping.elbow = 0.3 of one joint
    mass = 0.05

A file without any may say `exact = true`, beside its name: its numbers are known as they stand.

Instead of a number, a link's length, mass, com or inertia may be one of two tables:

    mass = {mean = 1.5, sd = 0.1}   # a log-normal prior of that mean and sd (normal for a com ≤ 0)
    mass = {start = 1.5}            # learned from the recording, beginning here

A link of numbers may carry a load: `load = {mass = 2.0, at = 0.25}`, kg and m from its joint; see `load.py`. Its mass
may be uncertain, `{mean = 2.0, sd = 0.3}`, in a file that states no other certainty.

A tree in space:

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
    damping = 0.1               # of a hinge or slide: this and what else `joint_parts.py` says

`reference = [[…], […], […]]`, axes too, turns the link's frame against its joint's (see `joints.py`). A scalar may be
a table, as above; each of com, inertia, origin and a site's too. A load's `at` has three numbers, in the link's frame.
"""

import difflib
import json
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path

import pyro.distributions as dist

from invdyn.models.bodies.joint_parts import PART_KEYS, parts_table, parts_taken
from invdyn.models.bodies.joints import WORLD
from invdyn.models.bodies.link import Link
from invdyn.models.bodies.load import carrying
from invdyn.models.bodies.rotations import UNTURNED, from_axes, from_quaternion, from_rpy
from invdyn.models.bodies.scalars import QUANTITIES, BodyError, Learned, Scalar, check_keys, nominal, number, prior
from invdyn.models.bodies.tree_parameters import vector_of
from invdyn.models.bodies.whole_file import write_whole

REQUIRED = ("name", "joint")
PLANAR_REQUIRED = (*REQUIRED, "tip", "length", "mass")
ROTATIONS = {"rpy": from_rpy, "quaternion": from_quaternion, "axes": from_axes}
JOINT_KEYS = ("type", "axis", "chart")
VECTORS = ("origin", "com", "inertia")
LOAD = "load"
"""A point mass that a link carries, see :mod:`.load`."""
PLANAR_KEYS = (*PLANAR_REQUIRED, "com", "inertia")
TREE_KEYS = (*PLANAR_KEYS, "parent", *JOINT_KEYS, "reference", *ROTATIONS, "origin", "sites")


def parse(content: bytes, path: str) -> dict:
    """The tables of a file's content, of any TOML. Raises `BodyError`, which begins with `path`, for what is none."""
    try:
        return tomllib.loads(content.decode("utf-8"))
    except UnicodeDecodeError as error:
        raise BodyError(f"{path}: expected a body in TOML, got a file that is not UTF-8 text") from error
    except tomllib.TOMLDecodeError as error:
        raise BodyError(f"{path}: broken TOML: {error}") from error
    except RecursionError:
        raise BodyError(f"{path}: expected a body, got TOML nested too deep for one") from None
    except ValueError:  # Python turns no more than 4,300 digits into an integer
        raise BodyError(f"{path}: expected a body, got TOML with an integer too long to be read") from None


def of(tables: dict, path: str) -> tuple[dict, int]:
    """What a body is made of, its links as a list of dicts, and its dimensions, of a file's tables.

    A link's scalars come as float, prior or `Learned`, the joint of one in space as a dict. A body without a name is
    called as its file. Raises `BodyError` for tables that are no body, unknown or missing keys, and what is not a
    scalar.
    """
    dimensions = tables.get("dimensions", 2)
    if isinstance(dimensions, bool) or dimensions not in (2, 3):
        raise BodyError(f"{path}: expected dimensions = 2 (the default) or 3, got {dimensions!r:.40}")
    links = tables.get("links")
    if links is None:
        close = difflib.get_close_matches("links", list(tables), n=1, cutoff=0.7)
        hint = f" (is [[{close[0]}]] meant as [[links]]?)" if close else ""
        raise BodyError(f"{path}: not a body: expected [[links]] tables, one for each link, got none{hint}")
    if not isinstance(links, list) or not all(isinstance(link, dict) for link in links):
        raise BodyError(f"{path}: expected links as [[links]] tables, in two brackets, one for each link")
    tables = {key: value for key, value in _with_uncertainty(tables, path).items() if key != "dimensions"}
    base = ("base",) if dimensions == 2 else ()
    check_keys(tables, ("name", "gravity", *base, "links", "uncertainty", "exact"), path)
    if not isinstance(exact := tables.get("exact", False), bool):
        raise BodyError(f"{path}: expected exact = true or false, got {exact!r:.40}")
    found: list[dict] = []
    for place, link in enumerate(links, 1):
        before = {} if dimensions == 2 else {"parent": found[-1]["name"] if found else WORLD}
        found.append(before | _read_link(dict(link), dimensions == 2, f"{path}: link {place}"))
    return {"name": Path(path).stem, **tables, "links": found}, dimensions


def _with_uncertainty(tables: dict, path: str) -> dict:
    """A file's tables, with keys such as damping.elbow as one word each, which TOML takes for a table in a table.

    Raises `BodyError` for an [uncertainty] that is no table.
    """
    if "uncertainty" not in tables:
        return tables
    stated = tables["uncertainty"]
    if not isinstance(stated, dict):
        raise BodyError(f"{path}: expected [uncertainty] as a table of relative standard deviations")
    inner = {f"{key}.{joint}": sd for key, of in stated.items() if isinstance(of, dict) for joint, sd in of.items()}
    return tables | {"uncertainty": {key: sd for key, sd in stated.items() if not isinstance(sd, dict)} | inner}


def write(
    path: str | Path,
    name: str,
    dimensions: int,
    gravity: Sequence[float],
    links: Sequence[Link],
    uncertainty: Mapping[str, float],
    exact: bool,
) -> None:
    """Write a body's file. Raises `OSError`, and `BodyError` for a prior that no file can express."""
    lines = [f"name = {literal(name)}"]
    if dimensions == 3:
        lines += ["dimensions = 3", f"gravity = {literal(gravity)}"]
    else:
        base = [nominal(x) for x in links[0].origin or (0.0, 0.0)][:2]
        lines += [f"gravity = {literal(gravity)}", f"base = {literal(base)}"]
    lines += ["exact = true"] if exact else []
    for link in links:
        values = _written(link, dimensions == 2)
        lines += ["", "[[links]]", *(f"{key} = {literal(value)}" for key, value in values.items())]
    if uncertainty:
        lines += ["", "[uncertainty]", *(f"{_key(k)} = {literal(v)}" for k, v in uncertainty.items())]
    write_whole(path, "\n".join(lines) + "\n")


def _written(link: Link, planar: bool) -> dict:
    values: dict = {"name": link.name, "joint": link.joint.name}
    if link.load is not None:
        mass, at = link.load
        link = carrying(link, -nominal(mass), at)
        values[LOAD] = {"mass": scalar_to_table(mass, LOAD), "at": at if len(at) > 1 else at[0]}
    scalars = {key: getattr(link, key) for key in QUANTITIES}
    if not planar:
        values["parent"] = link.parent
        for key, rows in (("axes", link.rotation), ("reference", link.joint.reference)):
            if rows != UNTURNED:
                values[key] = list(zip(*rows, strict=True))
        values |= {key: value for key in JOINT_KEYS if (value := getattr(link.joint, key)) != ""}
        scalars |= {key: vector_of(link, key) for key in ("com", "inertia")} | {"origin": link.origin}
    values |= {"tip": link.tip} if link.tip else {}
    values |= {key: _scalars_to_table(value, key) for key, value in scalars.items() if value is not None}
    values |= parts_table(link.parts)
    sites = {name: _scalars_to_table(at, name) for name, at in link.sites.items()}
    return values | ({"sites": sites} if sites else {})


def _key(name: str) -> str:
    """A key as TOML has it: in quotes, where it is no plain word."""
    return name if name.isidentifier() and name.isascii() else literal(name)


def _read_link(link: dict, planar: bool, where: str) -> dict:
    parts = parts_taken(link, where)
    check_keys(link, (*(PLANAR_KEYS if planar else TREE_KEYS), LOAD, *PART_KEYS), where)
    required = PLANAR_REQUIRED if planar else REQUIRED
    if missing := [key for key in required if key not in link]:
        raise BodyError(f"{where}: expected the keys {', '.join(required)}; missing: {', '.join(missing)}")
    made = {key: link[key] for key in ("name", "joint", "parent", "tip", LOAD) if key in link}
    if isinstance(load := made.get(LOAD), dict) and isinstance(load.get("mass"), dict):
        made[LOAD] = load | {"mass": scalar_from_table(load["mass"], f"{where}: mass of its load")}
    for key in (key for key in QUANTITIES if key in link):
        several = not planar and key in VECTORS
        made[key] = (_vector if several else scalar_from_table)(link[key], f"{where}: {key}")
    if parts is not None:
        made["parts"] = parts
    return made if planar else made | _read_place(link, where)


def _read_place(link: dict, where: str) -> dict:
    """What a link in space says of its joint, its frame and its sites."""
    joint = {"name": link["joint"], **{key: link[key] for key in JOINT_KEYS if key in link}}
    if "reference" in link:
        joint["reference"] = _rows(link["reference"], "axes", f"{where}: reference")
    made: dict = {"joint": joint}
    said = [key for key in ROTATIONS if key in link]
    if len(said) > 1:
        raise BodyError(f"{where}: expected one of {', '.join(ROTATIONS)}, got {' and '.join(said)}")
    for key in said:
        made["rotation"] = _rows(link[key], key, f"{where}: {key}")
    if "origin" in link:
        made["origin"] = _vector(link["origin"], f"{where}: origin")
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


def scalar_from_table(value: object, what: str) -> object:
    """Return a scalar of a file: a table as prior or `Learned`, all else as it is. Raises `BodyError`."""
    if not isinstance(value, dict):
        return value  # a number, which `Link` checks
    if set(value) == {"start"}:
        return Learned(number(value["start"], f"{what}'s start"))
    if set(value) != {"mean", "sd"}:
        keys = ", ".join(value)
        raise BodyError(f"{what}: expected a number, {{mean = …, sd = …}} or {{start = …}}, got the keys {keys}")
    mean, sd = (number(value[key], f"{what}'s {key}") for key in ("mean", "sd"))
    if sd <= 0:
        raise BodyError(f"{what}: expected a positive sd, got {sd:g}; where it is known, write the number alone")
    try:
        return prior(mean, sd)
    except BodyError as error:
        raise BodyError(f"{what}: {error}") from None


def scalar_to_table(value: str | Scalar, key: str) -> object:
    """Return what a file says of a scalar. Raises `BodyError` for a prior that no file can express."""
    if isinstance(value, Learned):
        return {"start": value.start}
    if isinstance(value, dist.Distribution):
        mean, sd = nominal(value), float(value.stddev)
        if type(value) is not type(prior(mean, sd)):
            raise BodyError(f"a body file has log-normal priors, but {key} has a {type(value).__name__}")
        return {"mean": mean, "sd": sd}
    return value


def _scalars_to_table(value: object, key: str) -> object:
    """The same of one scalar or several."""
    return [scalar_to_table(each, key) for each in value] if isinstance(value, tuple) else scalar_to_table(value, key)


def literal(value: object) -> str:
    """Return a value as TOML."""
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")  # JSON's escapes are TOML's
    if isinstance(value, dict):
        return "{" + ", ".join(f"{literal(key)} = {literal(item)}" for key, item in value.items()) + "}"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list | tuple):
        return "[" + ", ".join(literal(item) for item in value) + "]"
    return repr(value)
