"""Elements of an MJCF file's text, by the numbers that the compiled model counts them by.

They are found by their names, or by their order where the file includes no other.
"""

from typing import Any

from invdyn.diagnosis.write_back.xml_text import Element, XmlText


class Elements:
    """Of a ``text``, whose compiled model is ``model``."""

    def __init__(self, text: XmlText, model: Any):
        self.text, self.model = text, model
        self.whole = not text.found("include")
        compilers = text.found("compiler")
        self.degrees = not any(each.attributes.get("angle") == "radian" for each in compilers)
        self.from_geoms = any(each.attributes.get("inertiafromgeom") == "true" for each in compilers)
        outside = [e for e in text.elements if not e.inside("default")]
        bodies = [e for e in outside if e.tag == "body" and e.inside("worldbody")]

        def within(section: str, *tags: str) -> list[Element]:
            own = [e for e in outside if e.parent is not None and e.parent.tag == section]
            return [e for e in own if not tags or e.tag in tags]

        def of_bodies(*tags: str) -> list[Element]:
            """In MuJoCo's order: body by body, and within one as the text has them."""
            own = [e for e in outside if e.tag in tags and e.inside("worldbody")]
            return sorted(own, key=lambda e: bodies.index(body) if (body := _body(e)) is not None else -1)

        self.kinds = {
            "joint": (of_bodies("joint", "freejoint"), model.njnt),
            "tendon": (within("tendon"), model.ntendon),
            "geom": (of_bodies("geom"), model.ngeom),
            "pair": (within("contact", "pair"), model.npair),
            "equality": (within("equality"), model.neq),
            "actuator": (within("actuator"), model.nu),
            "body": (bodies, model.nbody - 1),
        }

    def element(self, kind: str, number: int) -> Element | None:
        """Of that number in the compiled model; None where it cannot be found."""
        elements, count = self.kinds[kind]
        name = getattr(self.model, kind)(number).name
        named = [e for e in elements if name and e.attributes.get("name") == name]
        if len(named) == 1:
            return named[0]
        index = number - (kind == "body")
        return elements[index] if self.whole and len(elements) == count else None

    def child(self, parent: Element | None, tag: str) -> Element | None:
        """The last element of a tag that stands in another one itself."""
        own = [e for e in self.text.found(tag) if e.parent is parent]
        return own[-1] if own else None

    def weighed(self, body: Element | None) -> Element | None:
        """What a body has its mass by: its inertial element, or its only shape that weighs something."""
        if not self.from_geoms:
            return self.child(body, "inertial")
        shapes = [e for e in self.kinds["geom"][0] if _body(e) is body and float(e.attributes.get("mass", 1)) > 0]
        return shapes[0] if len(shapes) == 1 else None


def _body(element: Element) -> Element | None:
    """The body that an element stands in; None in the world."""
    parent = element.parent
    while parent is not None and parent.tag not in ("body", "worldbody"):
        parent = parent.parent
    return parent if parent is not None and parent.tag == "body" else None
