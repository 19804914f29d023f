"""Changes written into a copy of a URDF: damping and friction of `<dynamics>`, and the effort of `<limit>`.

What URDF has no word for (rotors, springs, delays, gains) is named, and so is what needs a link's inertia anew.
"""

from collections.abc import Sequence

from invdyn.diagnosis.write_back.changes import FileChange
from invdyn.diagnosis.write_back.xml_text import Element, XmlText

SAID = {"damping": ("dynamics", "damping"), "friction": ("dynamics", "friction"), "motor limit": ("limit", "effort")}
OTHERS = {"payload": "give the last link that mass", "mass": "change the link's inertial element"}


def rewritten(content: bytes, changes: Sequence[FileChange]) -> tuple[bytes, dict[str, str]]:
    """The content with the changes; and what could not be written: words → why."""
    text = XmlText(content)
    joints = {e.attributes.get("name"): e for e in text.found("joint") if e.parent and e.parent.tag == "robot"}
    unsaid: dict[str, str] = {}
    new: dict[tuple[int, str], tuple[Element, dict[str, str], list[str]]] = {}
    for change in changes:
        if change.quantity not in SAID:
            why = OTHERS.get(change.quantity, "URDF has no word for it")
            unsaid[f"{change.quantity} of {change.place}"] = why
            continue
        tag, attribute = SAID[change.quantity]
        joint, value = joints[change.place], f"{change.after:.7g}"
        own = [e for e in text.elements if e.parent is joint and e.tag == tag]
        if own:
            text.change(own[0], change.comment, **{attribute: value})
        else:
            _, attributes, told = new.setdefault((joint.start, tag), (joint, {}, []))
            attributes[attribute] = value
            told.append(change.comment)
    for (_, tag), (joint, attributes, told) in new.items():
        said = " ".join(f'{name}="{value}"' for name, value in attributes.items())
        text.insert(joint, f"<{tag} {said}/>", "; ".join(told))
    return text.changed(), unsaid
