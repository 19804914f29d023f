"""Changes written into a copy of a URDF: damping and friction of `<dynamics>`, the effort of `<limit>`, a link's mass
and its moments.

What URDF has no word for (rotors, springs, delays, gains, gravity) is named. So is a centre of mass that moved, with
all that depends on it, and a link whose mass is not that of one `<inertial>`: links fixed to each other are one.
"""

import math
from collections.abc import Sequence

from invdyn.diagnosis.write_back.changes import OF_LINK, ZERO, ZERO_ELSEWHERE, FileChange
from invdyn.diagnosis.write_back.xml_text import Element, XmlText

SAID = {"damping": ("dynamics", "damping"), "friction": ("dynamics", "friction"), "motor limit": ("limit", "effort")}
MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
ELSEWHERE = {
    ZERO: ZERO_ELSEWHERE,
    "payload": "give the last link that mass",
    "gravity": "URDF has no word for it; the simulator that reads the file has a gravity of its own",
}
BY_HAND = "change the link's inertial element"


def rewritten(content: bytes, changes: Sequence[FileChange]) -> tuple[bytes, dict[str, str]]:
    """The content with the changes; and what could not be written: words → why."""
    text = XmlText(content)
    joints = {e.attributes.get("name"): e for e in text.found("joint") if e.parent and e.parent.tag == "robot"}
    unsaid: dict[str, str] = {}
    new: dict[tuple[int, str], tuple[Element, dict[str, str], list[str]]] = {}
    of_links: dict[str, list[FileChange]] = {}
    for change in changes:
        if change.quantity.startswith(OF_LINK):
            of_links.setdefault(change.place, []).append(change)
            continue
        if change.quantity not in SAID:
            unsaid[change.words] = ELSEWHERE.get(change.quantity.partition("_")[0], "URDF has no word for it")
            continue
        tag, attribute = SAID[change.quantity]
        joint, value = joints[change.place], f"{change.after:.7g}"
        own = [e for e in text.elements if e.parent is joint and e.tag == tag]
        if own:
            text.change(own[0], change.comment, **{attribute: value})
        else:
            _, attributes, comments = new.setdefault((joint.start, tag), (joint, {}, []))
            attributes[attribute] = value
            comments.append(change.comment)
    for (_, tag), (joint, attributes, comments) in new.items():
        said = " ".join(f'{name}="{value}"' for name, value in attributes.items())
        text.insert(joint, f"<{tag} {said}/>", "; ".join(comments))
    for link, several in of_links.items():
        if not _weighed(text, link, several):
            unsaid |= {f"{change.quantity} of {link}": BY_HAND for change in several}
    return text.changed(), unsaid


def _weighed(text: XmlText, link: str, changes: Sequence[FileChange]) -> bool:
    """Whether a link's mass, and all its moments by one factor, could be changed; nothing is where not."""
    found = {e.tag: e for e in text.elements if e.inside("inertial") and _link_of(e) == link}
    by = {change.quantity: change for change in changes}
    if not by.keys() <= {"mass", "inertia"} or not {"mass", "inertia"} <= found.keys():
        return False
    own = float(found["mass"].attributes["value"])
    if "mass" in by and not math.isclose(own, by["mass"].before, rel_tol=1e-6):
        return False
    if "mass" in by:
        text.change(found["mass"], by["mass"].comment, value=f"{by['mass'].after:.7g}")
    if "inertia" in by:
        factor, moments = by["inertia"].after / by["inertia"].before, found["inertia"].attributes
        scaled = {name: f"{factor * float(moments[name]):.7g}" for name in MOMENTS if name in moments}
        text.change(found["inertia"], by["inertia"].comment, **scaled)
    return True


def _link_of(element: Element) -> str | None:
    """The name of the link that an element is of."""
    while element.parent is not None and element.tag != "link":
        element = element.parent
    return element.attributes.get("name")
