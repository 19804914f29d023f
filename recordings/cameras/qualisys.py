"""Calibrations of Qualisys Track Manager (`.qca.txt`, XML).

    K = value / 64 px, less the left and top edge of the film;   T mm;   x = diag(1, −1, −1) R (X − T / 1000)

for the file's own R: its camera looks along −z with y up, ours along z with y down. Layout: Qualisys' own files;
checked against a triangulation that comes with one. XML is read by the standard library, which fetches nothing from
outside; a file with a document type, the place where entities are defined, is refused in any encoding, since
entities can expand to fill the memory.
"""

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np

from ..errors import InputError, about, first_line
from .camera import Calibration, Camera

SUBPIXELS = 64  # units a pixel, of focal length and centre
FLIP = np.diag([1.0, -1.0, -1.0])


class _Plain(ElementTree.TreeBuilder):
    """Elements of a file without a document type."""

    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        """The parser's call where one begins."""
        raise InputError("expected a plain calibration, got XML that defines entities: it is not Qualisys' own")


def read_qualisys(path: str | Path) -> Calibration:
    """Read such a file; cameras that are switched off are left out.

    Raises InputError for another kind of file, a rotated view or a lens model of another kind, OSError if it cannot
    be opened.
    """
    raw = Path(path).read_bytes()
    with about(path), np.errstate(over="ignore", invalid="ignore"):  # `Camera` refuses what is not finite
        try:
            root = ElementTree.fromstring(raw, ElementTree.XMLParser(target=_Plain()))
        except InputError:
            raise
        except (ElementTree.ParseError, ValueError, LookupError) as error:  # the last two of an encoding
            raise InputError(f"expected a Qualisys calibration in XML ({first_line(error)})") from None
        found = [each for each in root.iterfind("cameras/camera") if each.get("active", "1") != "0"]
        if root.tag != "calibration" or not found:
            raise InputError(f"expected a Qualisys calibration with cameras, got <{root.tag[:40]}> without")
        return Calibration(tuple(_camera(each) for each in found), metric=True)


def _camera(element: ElementTree.Element) -> Camera:
    name = element.get("serial", "")
    where = f"camera {name!r}"
    if (model := element.get("model", "none")).lower() not in ("none", ""):
        raise InputError(f"{where}: its lens model is {model[:40]!r}; expected the standard one of Brown's law")
    if (angle := element.get("viewrotation", "0")) != "0":
        raise InputError(f"{where}: its view is rotated by {angle[:40]}°: export the calibration with viewrotation 0")
    pose, lens, edges = (_numbers(element, tag, where) for tag in ("transform", "intrinsic", "fov_video"))

    def values(table: dict[str, float], *keys: str) -> np.ndarray:
        if missing := [key for key in keys if key not in table]:
            raise InputError(f"{where}: {missing[0]!r} is missing")
        return np.array([table[key] for key in keys])

    if values(lens, "skew")[0]:
        raise InputError(f"{where}: skew is not supported, got {lens['skew']:g}")
    left, top, right, bottom = values(edges, "left", "top", "right", "bottom")
    focal = values(lens, "focalLengthU", "focalLengthV") / SUBPIXELS
    center = values(lens, "centerPointU", "centerPointV") / SUBPIXELS - [left, top]
    matrix = np.diag([*focal, 1.0])
    matrix[:2, 2] = center
    k1, k2, k3 = values(lens, "radialDistortion1", "radialDistortion2", "radialDistortion3")
    p1, p2 = values(lens, "tangentalDistortion1", "tangentalDistortion2")
    rotation = FLIP @ values(pose, *(f"r{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3))).reshape(3, 3)
    return Camera(
        name=name,
        matrix=matrix,
        distortion=np.array([k1, k2, p1, p2, k3]),
        rotation=rotation,
        translation=-rotation @ values(pose, "x", "y", "z") / 1000,
        size=(right - left + 1, bottom - top + 1),
    )


def _numbers(element: ElementTree.Element, tag: str, where: str) -> dict[str, float]:
    """Attributes of a child that are numbers; {} when there is no such child."""
    found = element.find(tag)
    numbers = {}
    for key, text in ({} if found is None else found.attrib).items():
        try:
            numbers[key] = float(text)
        except ValueError:
            raise InputError(f"{where}: {tag} {key} is {text[:40]!r}, expected a number") from None
    return numbers
