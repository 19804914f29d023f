"""Body files: TOML text to plain tables and back, with every complaint naming the file.

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

Instead of a number, a link's length, mass, com or inertia may be one of two tables:

    mass = {mean = 1.5, sd = 0.1}   # a log-normal prior of that mean and sd (normal for a com ≤ 0)
    mass = {start = 1.5}            # learned from the recording, beginning here

A link of numbers may carry a load: `load = {mass = 2.0, at = 0.25}`, kg and m from its joint; see `load.py`.
"""

import difflib
import json
import tomllib
from collections.abc import Mapping
from pathlib import Path

import pyro.distributions as dist

from invdyn.models.bodies import joint_parts_toml
from invdyn.models.bodies.scalars import QUANTITIES, BodyError, Learned, Scalar, check_keys, nominal, number, prior
from invdyn.models.bodies.whole_file import write_whole

BODY_KEYS = ("name", "gravity", "base", "links", "uncertainty")
REQUIRED = ("name", "joint", "tip", "length", "mass")
LINK_KEYS = (*REQUIRED, "com", "inertia")
LOAD = "load"
"""A point mass that a link carries, see :mod:`.load`."""


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


def of(tables: dict, path: str) -> dict:
    """Return a body's tables under the keys of `BODY_KEYS`; `links` as a list of dicts.

    A link's scalars come as float, prior or `Learned`. A body without a name is called as its file. Raises `BodyError`
    for tables that are no body, unknown or missing keys, and what is not a scalar.
    """
    links = tables.get("links")
    if links is None:
        close = difflib.get_close_matches("links", list(tables), n=1, cutoff=0.7)
        hint = f" (is [[{close[0]}]] meant as [[links]]?)" if close else ""
        raise BodyError(f"{path}: not a body: expected [[links]] tables, one for each link, got none{hint}")
    if not isinstance(links, list) or not all(isinstance(link, dict) for link in links):
        raise BodyError(f"{path}: expected links as [[links]] tables, in two brackets, one for each link")
    tables = with_uncertainty(tables, path)
    check_keys(tables, BODY_KEYS, str(path))
    tables["links"] = [_read_link(link, f"{path}: link {place}") for place, link in enumerate(links, 1)]
    return {"name": Path(path).stem, **tables}


def with_uncertainty(tables: dict, path: str | Path) -> dict:
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


def uncertainty_lines(stated: Mapping[str, float]) -> list[str]:
    """Lines that say the same; none of nothing."""
    return ["", "[uncertainty]", *(f"{_key(k)} = {literal(v)}" for k, v in stated.items())] if stated else []


def write(path: str | Path, tables: dict) -> None:
    """Write tables as `of` returns them. Raises `OSError`, and `BodyError` for an unknown kind of prior."""
    lines = [f"{key} = {literal(tables[key])}" for key in ("name", "gravity", "base")]
    for link in tables["links"]:
        values = {key: scalar_to_table(value, key) for key, value in link.items() if value is not None}
        lines += ["", "[[links]]", *(f"{key} = {literal(value)}" for key, value in values.items())]
    lines += uncertainty_lines(tables["uncertainty"])
    write_whole(path, "\n".join(lines) + "\n")


def _key(name: str) -> str:
    """A key as TOML has it: in quotes, where it is no plain word."""
    return name if name.isidentifier() and name.isascii() else literal(name)


def _read_link(link: dict, where: str) -> dict:
    parts = joint_parts_toml.taken(link, where)
    check_keys(link, (*LINK_KEYS, LOAD, *joint_parts_toml.KEYS), where)
    missing = [key for key in REQUIRED if key not in link]
    if missing:
        raise BodyError(f"{where}: expected the keys {', '.join(REQUIRED)}; missing: {', '.join(missing)}")
    scalars = {k: scalar_from_table(v, f"{where}: {k}") if k in QUANTITIES else v for k, v in link.items()}
    return scalars if parts is None else scalars | {"parts": parts}


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
