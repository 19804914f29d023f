"""XML of a robot, read as data: bounded in size and depth, without entities, and nothing from outside its folder.

A robot's file comes from anywhere. Entities are refused, because a few lines of them stand for gigabytes; so is depth
that no robot has, and a file that it names and that lies elsewhere, is a device, or is too large. Text between elements
is that of an OpenSim model; of others it says nothing and is dropped. A prefix stays part of a tag: "xacro:macro".
"""

from pathlib import Path
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

from invdyn.models.bodies.scalars import BodyError
from invdyn.models.bodies.whole_file import read_whole

MOST_BYTES = 2**24
"""Bytes of a file in XML or TOML."""
MOST_ELEMENTS = 50_000
"""Elements of a file and what it includes: MuJoCo takes up to 2.3 kB for each."""
OSIM = "OpenSimDocument"
KINDS = {"mujoco": "MJCF", "robot": "URDF", OSIM: "an OpenSim model"}
DEEPEST = 200
"""Elements within each other."""
OTHERS = {
    "sdf": "SDF is not read; write the arm as URDF or MJCF, or as a body in TOML",
    "COLLADA": "this is a mesh, not a robot; give the URDF or MJCF that uses it",
}


def is_xml(content: bytes) -> bool:
    """Whether a file's content begins as XML does, after a byte-order mark and blanks."""
    return content.removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"<")


def parse(content: bytes, where: str) -> Element:
    """The root of an XML text. Raises `BodyError`, which begins with `where`, for what is broken or without bounds."""
    builder, open_tags, elements = TreeBuilder(), 0, 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal open_tags, elements
        open_tags, elements = open_tags + 1, elements + 1
        if elements > MOST_ELEMENTS:
            raise BodyError(f"{where}: expected at most {MOST_ELEMENTS} elements, got more")
        if open_tags > DEEPEST:
            raise BodyError(f"{where}: expected at most {DEEPEST} elements within each other, got more")
        if elements == 1 and tag == OSIM:
            parser.CharacterDataHandler = builder.data
        builder.start(tag, attributes)

    def end(tag: str) -> None:
        nonlocal open_tags
        open_tags -= 1
        builder.end(tag)

    def declared(name: str, *_: object) -> None:
        raise BodyError(f"{where}: declares the entity '{name}'; expected XML without entities: write its text out")

    parser = expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler, parser.EntityDeclHandler = start, end, declared
    try:
        parser.Parse(content, True)
    except (expat.ExpatError, LookupError, ValueError) as error:
        if isinstance(error, BodyError):
            raise
        raise BodyError(f"{where}: broken XML: {error}") from error
    return builder.close()


def check_root(root: Element, wanted: str, where: str) -> None:
    """Raise `BodyError`, with what to do instead, unless the root is `wanted`, a key of `KINDS`."""
    if root.tag == wanted:
        return
    if root.tag in OTHERS:
        raise BodyError(f"{where}: {OTHERS[root.tag]}")
    raise BodyError(f"{where}: expected {KINDS[wanted]}, with <{wanted}> around it, got <{root.tag:.60}>")


def nearby(name: str, folder: Path, where: str) -> Path:
    """The file called so within `folder`; raises `BodyError` for any other place, and for what is no file."""
    try:
        path = (folder / name).resolve()
        inside, there = path.is_relative_to(folder.resolve()), path.is_file()
    except (OSError, RuntimeError, ValueError) as error:  # a loop of links; a name with NUL
        raise BodyError(f"{where}: names '{name:.200}', which is no file") from error
    if not inside:
        raise BodyError(f"{where}: names '{name:.200}', outside its own folder; put that file next to it, or below")
    if not there:
        raise BodyError(f"{where}: names '{name:.200}', which is no file")
    return path


def read_nearby(name: str, folder: Path, most: int, where: str) -> bytes:
    """Content of such a file, of `most` bytes at most; raises `BodyError`, and `OSError` when it cannot be read."""
    return read_whole(nearby(name, folder, where), most)
