"""What an OpenSim model has and rigid links with simple joints lack, in words."""

from collections.abc import Sequence
from xml.etree.ElementTree import Element

from invdyn.models.bodies.parts import listed

OTHERS = {"constraints": "ConstraintSet", "controllers": "ControllerSet", "contact surfaces": "ContactGeometrySet"}


def named(model: Element, coupled: Sequence[str], unplaced: Sequence[str] = ()) -> list[str]:
    """Entries of what is left out of a <Model>: ``coupled`` are movements that follow another one by a curve.

    ``unplaced`` are markers on the ground, or on a frame of their own.
    """
    forces = model.findall("ForceSet/objects/*")
    muscles = [each for each in forces if each.tag.endswith("Muscle")]
    rest = [each for each in forces if each not in muscles]
    moves = [each for each in model.iter("Coordinate") if (each.findtext("prescribed") or "").strip() == "true"]
    limits = [each for each in model.iter("Coordinate") if (each.findtext("clamped") or "").strip() == "true"]
    return [
        *listed("movements that follow another, held where the model has them by default", coupled),
        *listed("markers on no body", unplaced),
        *listed("muscles", _names(muscles)),
        *listed("other forces", _names(rest)),
        *(entry for words, tag in OTHERS.items() for entry in listed(words, _names(model.findall(f"{tag}/objects/*")))),
        *listed("wrapping surfaces", _names(model.findall(".//WrapObjectSet/objects/*"))),
        *listed("prescribed motions", _names(moves)),
        *listed("limits", _names(limits)),
    ]


def _names(elements: Sequence[Element]) -> list[str]:
    return [each.get("name", each.tag) for each in elements]
