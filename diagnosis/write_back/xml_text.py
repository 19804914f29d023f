"""An XML file as text in which elements are found and changed, and all else stays as it was written.

Expat (the parser of Python's standard library) says at which byte each element begins and ends.
"""

import re
from dataclasses import dataclass
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

from invdyn.models.bodies.body_xml import is_xml


def is_mjcf(content: bytes) -> bool:
    """Whether a file's content is MuJoCo's."""
    return is_xml(content) and b"<mujoco" in content


@dataclass
class Element:
    """An element: its tag, attributes, the one that it stands in, and where its start tag and the whole of it end."""

    tag: str
    attributes: dict[str, str]
    parent: "Element | None"
    start: int
    head: int = 0
    stop: int = 0

    def inside(self, tag: str) -> bool:
        """Whether it stands, at any depth, in an element of that tag."""
        above = self.parent
        while above is not None and above.tag != tag:
            above = above.parent
        return above is not None


class XmlText:
    """A file's text, its elements in their order, and the changes to be made.

    Raises `expat.ExpatError` for what is no XML.
    """

    def __init__(self, content: bytes):
        self.content = content
        self.elements: list[Element] = []
        self._edits: list[tuple[int, int, bytes]] = []
        self._heads: dict[int, tuple[Element, dict[str, str | None], list[str]]] = {}
        parser, open_ones = expat.ParserCreate(), list[Element]()

        def start(tag: str, attributes: dict[str, str]) -> None:
            begin = parser.CurrentByteIndex
            element = Element(tag, attributes, open_ones[-1] if open_ones else None, begin, _head(content, begin))
            self.elements.append(element)
            open_ones.append(element)

        def end(tag: str) -> None:
            element = open_ones.pop()
            close = content.find(b">", parser.CurrentByteIndex) + 1
            element.stop = element.head if content[element.head - 2 : element.head] == b"/>" else close

        parser.StartElementHandler, parser.EndElementHandler = start, end
        parser.Parse(content, True)

    def found(self, tag: str, within: str | None = None) -> list[Element]:
        """Elements of a tag, in the file's order; those within an element of another tag alone."""
        return [e for e in self.elements if e.tag == tag and (within is None or e.inside(within))]

    def change(self, element: Element, comment: str, **attributes: str | None) -> None:
        """Set attributes of an element, or take those out that are None; the comment stands before it."""
        _, all_of_it, comments = self._heads.setdefault(element.start, (element, {}, []))
        all_of_it.update(attributes)
        comments.append(comment)

    def insert(self, element: Element, text: str, comment: str) -> None:
        """Put an element's text as the first child of another one."""
        indent = _indent(self.content, element.start) + "  "
        child = f"\n{indent}{_comment(comment)}\n{indent}{text}"
        if self.content[element.head - 2 : element.head] == b"/>":
            child = f">{child}\n{_indent(self.content, element.start)}</{element.tag}>"
            self._edits.append((element.head - 2, element.head, child.encode()))
        else:
            self._edits.append((element.head, element.head, child.encode()))

    def changed(self) -> bytes:
        """The text with all changes."""
        edits = list(self._edits)
        for element, attributes, comments in self._heads.values():
            head = self.content[element.start : element.head].decode("utf-8")
            for name, value in attributes.items():
                head = _with_attribute(head, name, value)
            indent = _indent(self.content, element.start)
            said = "".join(f"{_comment(each)}\n{indent}" for each in comments if each)
            closing = 2 if head.endswith("/>") else 1
            # what an insertion may change, the end of the tag, stays out of it
            was = 2 if self.content[element.head - 2 : element.head] == b"/>" else 1
            edits.append((element.start, element.head - was, (said + head[:-closing]).encode()))
        text = self.content
        for start, stop, new in sorted(edits, key=lambda edit: -edit[0]):
            text = text[:start] + new + text[stop:]
        return text


def _head(content: bytes, begin: int) -> int:
    """Where a start tag ends; a ">" may stand in a quoted value."""
    quote = None
    for at in range(begin, len(content)):
        char = content[at : at + 1]
        if quote:
            quote = None if char == quote else quote
        elif char in (b'"', b"'"):
            quote = char
        elif char == b">":
            return at + 1
    return len(content)


def _with_attribute(head: str, name: str, value: str | None) -> str:
    pattern = re.compile(rf"""\s{re.escape(name)}\s*=\s*("[^"]*"|'[^']*')""")
    if value is None:
        return pattern.sub("", head, count=1)
    new = f" {name}={quoteattr(value)}"
    if pattern.search(head):
        return pattern.sub(lambda _: new, head, count=1)
    closing = "/>" if head.endswith("/>") else ">"
    return head[: -len(closing)].rstrip() + new + closing


def _indent(content: bytes, start: int) -> str:
    line = content[content.rfind(b"\n", 0, start) + 1 : start].decode("utf-8", "replace")
    return line if not line.strip() else ""


def _comment(text: str) -> str:
    return f"<!-- {text.replace('--', '−−')} -->"
