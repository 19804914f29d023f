"""An MJCF file and what it includes as one text that compiling reads nothing else for, and that has bounds.

Kept is what mass, hinges and the named forces of a body depend on; the rest (pictures, height fields, sensors, soft
bodies' grids, plugins) is dropped before MuJoCo sees it. What MJCF does not have stays, so that MuJoCo says so; numbers
must be numbers. Includes and meshes are read here, from the file's own folder alone, and handed over as bytes.
Elements that multiply themselves are refused: MuJoCo can write them out.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from xml.etree.ElementTree import Element, tostring

from invdyn.models.bodies.body_xml import DEEPEST, MOST_BYTES, MOST_ELEMENTS, check_root, nearby, parse, read_nearby
from invdyn.models.bodies.scalars import BodyError

UNREAD = ("size", "visual", "statistic", "custom", "extension", "deformable", "keyframe", "sensor")
"""Sections that are dropped where nobody asks for them."""
DROPPED = {"material", "texture", "hfield", "skin", "camera", "light", "plugin", "lengthrange", "model"}
MULTIPLE = {"replicate", "attach", "composite", "flexcomp"}
UNUSED = ("material", "user", "actdim", "nsample", "interp", "delay")
"""Attributes that name what is dropped, or ask for memory."""
MOST_BODIES = 1000
"""More is a scene, and no arm."""
ALL_MESHES = 2**28
"""Bytes of all meshes of a body."""


def one_text(root: Element, path: str, more: Sequence[str] = ()) -> tuple[str, dict[str, bytes], dict[str, list[str]]]:
    """The text, its meshes by name, and what was dropped though it acts on the body: words → names.

    ``more`` are sections that are kept too.

    Raises `BodyError`, which begins with `path`, for another file that may not be read, and what multiplies itself.
    """
    check_root(root, "mujoco", path)
    folder = Path(path).parent
    _include(root, folder, path, _Included({Path(path).resolve()}), 0)
    left_out: dict[str, list[str]] = {}
    for each in root.iter():
        if each.tag in MULTIPLE or (each.tag == "mesh" and "builtin" in each.attrib):
            what = f"<{each.tag}>" if each.tag in MULTIPLE else "a built-in mesh"
            raise BodyError(
                f"{path}: {what} is not read; let MuJoCo write the file out first: mujoco.mj_saveLastXML(FILE, model)"
            )
        if each.tag == "plugin":
            name = each.get("plugin") or each.get("name") or each.get("instance") or "?"
            left_out.setdefault("plugins", []).append(name)
        for name, value in each.attrib.items():
            if any(word.lstrip("+-").lower() == "nan" for word in value.split()):
                raise BodyError(f'{path}: expected numbers, got {name}="{value:.60}" of <{each.tag}>')
        if "delay" in each.attrib:
            left_out.setdefault("delays", []).append(each.get("name", each.tag))
    root[:] = [each for each in root if each.tag in more or each.tag not in UNREAD]
    if (count := sum(1 for _ in root.iter("body"))) > MOST_BODIES:
        raise BodyError(f"{path}: expected at most {MOST_BODIES} bodies, got {count}")
    where_meshes = _mesh_folder(root)
    _prune(root)
    meshes = _meshes(root, folder, where_meshes, path)
    return tostring(root, encoding="unicode"), meshes, left_out


@dataclass
class _Included:
    """The files so far, which have one limit together."""

    paths: set[Path]
    size: int = 0
    elements: int = 0

    def add(self, path: Path, content: bytes, where: str) -> Element:
        """The root of one more file."""
        self.paths.add(path)
        self.size += len(content)
        if len(self.paths) > DEEPEST:
            raise BodyError(f"{where}: expected at most {DEEPEST} included files, got more")
        if self.size > MOST_BYTES:
            raise BodyError(f"{where}: expected at most {MOST_BYTES / 2**20:g} MiB in its included files, got more")

        root = parse(content, str(path))
        self.elements += sum(1 for _ in root.iter())
        if self.elements > MOST_ELEMENTS:
            raise BodyError(f"{where}: expected at most {MOST_ELEMENTS} elements in its included files, got more")
        return root


def _include(parent: Element, folder: Path, where: str, seen: _Included, depth: int) -> None:
    """Put included elements in the places of `<include>`; each file once, as MuJoCo has it."""
    if depth > DEEPEST:
        raise BodyError(f"{where}: expected at most {DEEPEST} elements within each other, got more")
    children = []
    for child in parent:
        if child.tag != "include":
            _include(child, folder, where, seen, depth + 1)
            children.append(child)
            continue
        path = nearby(child.get("file", ""), folder, where)
        if path in seen.paths:
            raise BodyError(f"{where}: includes '{path.name}' twice")
        other = seen.add(path, read_nearby(child.get("file", ""), folder, MOST_BYTES, where), where)
        _include(other, folder, where, seen, depth + 1)
        children += other
    parent[:] = children


def _mesh_folder(root: Element) -> tuple[str, bool]:
    """Where meshes lie, as compilers say, the later one over the earlier; and whether only file names count."""
    found = {key: value for each in root.iter("compiler") for key, value in each.attrib.items()}
    for each in root.iter("compiler"):
        for key in ("meshdir", "assetdir", "texturedir", "strippath"):
            each.attrib.pop(key, None)
    return found.get("meshdir", found.get("assetdir", "")), found.get("strippath") == "true"


def _prune(parent: Element) -> None:
    """Drop elements and attributes that are not kept; a height field, which has no mass, becomes a ball without."""
    parent[:] = [each for each in parent if each.tag not in DROPPED]
    for each in parent:
        for attribute in UNUSED:
            each.attrib.pop(attribute, None)
        if each.attrib.pop("hfield", None) is not None or each.get("type") == "hfield":
            each.attrib |= {"type": "sphere", "size": "1", "mass": "0"}
        _prune(each)


def _meshes(root: Element, folder: Path, below: tuple[str, bool], where: str) -> dict[str, bytes]:
    """Read the files of meshes and call each by a name of its own."""
    place, bare = below
    found: dict[str, bytes] = {}
    room = ALL_MESHES
    for mesh in root.iterfind("asset/mesh"):
        if (file := mesh.get("file")) is None:
            continue
        file = PurePosixPath(file).name if bare else file
        mesh.attrib.setdefault("name", PurePosixPath(file).stem)
        content = read_nearby(str(PurePosixPath(place) / file), folder, room, where)
        room -= len(content)
        own = f"{len(found)}{PurePosixPath(file).suffix}"
        mesh.set("file", own)
        found[own] = content
    return found
