"""OpenCV's own files (FileStorage), YAML and JSON, as plain dicts of numbers, texts, lists and matrices.

    %YAML:1.0
    ---
    image_width: 640
    camera_matrix: !!opencv-matrix
       rows: 3
       cols: 3
       dt: d
       data: [ 500., 0., 320., 0., 500., 240., 0., 0., 1. ]

Layout: OpenCV, "XML/YAML/JSON file storages". The part of YAML that these files use is read here line by line: blocks
of `key: value` by their indent, and lists in brackets over one line or more. No tag creates an object. Anything else is
an InputError with its line.

OpenCV's own FileStorage is not used: deeply nested lists crash the process in it (5.0.0), ROS's files, which lack the
first line, are refused, and reading a calibration needs no further package this way.
"""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError, about, first_line

MATRIX_TAG = re.compile(r"^!!opencv-(matrix|nd-matrix)$")
KEY = re.compile(r"^(?P<indent> *)(?P<key>[A-Za-z_][\w.-]*|\"[^\"]*\")\s*:(?:\s+(?P<value>.*))?$")


def read_storage(path: str | Path) -> dict[str, Any]:
    """Contents of such a file, its matrices as arrays (rows, cols).

    Raises InputError for another kind of file, OSError if it cannot be opened.
    """
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: expected OpenCV's YAML or JSON ({first_line(error)})") from None
    with about(path):
        if text.lstrip().startswith("{"):
            try:
                tree = json.loads(text)
            except (ValueError, RecursionError) as error:
                raise InputError(f"broken JSON: {first_line(error)}") from None
        else:
            tree = _yaml(text)
        return {key: _matrix(key, value) for key, value in tree.items()}


def _matrix(key: str, value: Any) -> Any:
    """An array where a table is a matrix; lists of equal lengths are matrices, too."""
    if isinstance(value, dict) and "data" in value:
        try:
            rows, cols = int(value["rows"]), int(value["cols"])
            return np.array(value["data"], dtype=np.float64).reshape(rows, cols)
        except (KeyError, TypeError, ValueError, OverflowError):
            raise InputError(f"{key!r} is no matrix: expected rows, cols and as many data") from None
    if isinstance(value, list):
        try:
            return np.array(value, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            return value
    return value


def _yaml(text: str) -> dict[str, Any]:
    tree: dict[str, Any] = {}
    blocks: list[tuple[int, dict[str, Any]]] = [(-1, tree)]
    lines = iter(enumerate(text.splitlines(), 1))
    for number, line in lines:
        line = _without_comment(line)
        if not line.strip() or line.startswith(("%YAML", "---", "...")):
            continue
        found = KEY.match(line)
        if found is None:
            raise InputError(f"line {number}: expected 'key: value' as OpenCV writes it, got {line.strip()[:40]!r}")
        indent, key, value = len(found["indent"]), found["key"].strip('"'), (found["value"] or "").strip()
        while indent <= blocks[-1][0]:
            blocks.pop()
        if value == "" or MATRIX_TAG.match(value):
            inner: dict[str, Any] = {}
            blocks[-1][1][key] = inner
            blocks.append((indent, inner))
            continue
        while value.startswith("[") and value.count("[") > value.count("]"):
            try:
                value += " " + _without_comment(next(lines)[1]).strip()
            except StopIteration:
                raise InputError(f"line {number}: the list of {key!r} does not end") from None
        blocks[-1][1][key] = _value(value, number)
    return tree


def _without_comment(line: str) -> str:
    return line if '"' in line else re.sub(r"(^|\s)#.*$", "", line)


def _value(text: str, line: int) -> Any:
    """A list, a number, or a text; OpenCV writes 1. and .Nan."""
    if text.startswith("["):
        # Numbers such as `1.` are no JSON, so they are completed first.
        plain = re.sub(r"(\d)\.(?=[\s,\]eE])", r"\1.0", text)
        plain = re.sub(r"(?<![\d])\.(\d)", r"0.\1", plain)
        plain = re.sub(
            r"-?\.(nan|inf)", lambda m: "-Infinity" if m[0][0] == "-" else _NAMES[m[1].lower()], plain, flags=re.I
        )
        try:
            return json.loads(plain)
        except (ValueError, RecursionError):
            raise InputError(f"line {line}: expected a list of numbers, got {text[:40]!r}") from None
    if text.startswith(("!", "&", "*", "{", "|", ">", "-")) and not re.match(r"^-\.?\d", text):
        raise InputError(f"line {line}: expected a number, a text or a list, got {text[:40]!r}")
    try:
        return float(text)
    except ValueError:
        return text.strip("\"'")


_NAMES = {"nan": "NaN", "inf": "Infinity"}
