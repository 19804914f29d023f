"""Draw architecture.svg from the imports in the source: `python docs/architecture_picture.py`.

A room stands on what it imports. Inside it, its own rooms stand from left to right, each after all that it imports, and
an arc leads from each to those. A test holds the picture against the code.
"""

import ast
import sys
from graphlib import TopologicalSorter
from html import escape
from pathlib import Path

DOCS = Path(__file__).parent
sys.path.insert(0, str(DOCS.parent / "tests"))

from test_imports import FILES, ROOMS, imported, inner_room, room_of  # noqa: E402

PICTURE = DOCS / "architecture.svg"
WIDTH, MARGIN, GAP, BOX = 1000, 16, 34, 30
LOW, HIGH = 58, 130
"""Pixels: of the picture, around it, between rooms, of a room's own rooms; of a room without and with such."""
STYLE = """text{font:13px sans-serif;fill:#24292f}.name{font-weight:bold;font-size:16px}
.says{fill:#57606a;font-size:13px}
.room{fill:#f6f8fa;stroke:#8c959f}.inner{fill:#fff;stroke:#57606a}.arc{fill:none;stroke:#8c959f}
.down{fill:none;stroke:#24292f;stroke-width:1.5}.inner+text{text-anchor:middle}"""


def arrows() -> tuple[dict[str, set[str]], dict[str, dict[str, set[str]]]]:
    """What each room imports of others; and within each room, what each of its own rooms does."""
    between: dict[str, set[str]] = {room: set() for room in ROOMS}
    within: dict[str, dict[str, set[str]]] = {room: {} for room in ROOMS}
    for name, path in FILES.items():
        others = imported(name, ast.parse(path.read_text("utf-8")))
        room, inner = room_of(name), inner_room(name)
        if inner is not None:
            within[room].setdefault(inner, set())
        for other in others:
            between[room] |= {room_of(other)} - {room}
            if inner is not None and room_of(other) == room and inner_room(other) not in (None, inner):
                within[room][inner].add(str(inner_room(other)))
    return between, within


def floors(between: dict[str, set[str]]) -> list[list[str]]:
    """Rooms by how many stand under them, the ground floor first."""
    level: dict[str, int] = {}
    for room in TopologicalSorter(between).static_order():
        level[room] = max((level[other] + 1 for other in between[room]), default=0)
    return [[room for room in ROOMS if level[room] == floor] for floor in range(max(level.values()) + 1)]


def ordered(inner: dict[str, set[str]]) -> list[str]:
    """A room's own rooms, each after all that it imports; of several that might come, the one with the least below."""
    depth: dict[str, int] = {}
    for name in TopologicalSorter(inner).static_order():
        depth[name] = max((depth[other] + 1 for other in inner[name]), default=0)
    return sorted(depth, key=lambda name: (depth[name], name))


def says(room: str) -> str:
    """The first line of a room's own words."""
    name = "invdyn" if room == "invdyn" else f"invdyn.{room}"
    return (ast.get_docstring(ast.parse(FILES[name].read_text("utf-8"))) or "").splitlines()[0]


def drawn() -> str:
    """The picture."""
    between, within = arrows()
    place: dict[str, tuple[float, float, float, float]] = {}
    y = float(MARGIN)
    for rooms in reversed(floors(between)):
        tall = HIGH if any(within[room] for room in rooms) else LOW
        x, free = float(MARGIN), WIDTH - 2 * MARGIN - GAP * (len(rooms) - 1)
        share = {room: max(len(within[room]), 3) for room in rooms}
        for room in rooms:
            wide = free * share[room] / sum(share.values())
            place[room] = x, y, wide, tall
            x += wide + GAP
        y += tall + GAP
    height = y - GAP + MARGIN
    parts = [_room(room, within[room], *where) for room, where in place.items()]
    for room, others in between.items():
        reached = {far for other in others for far in between[other]}
        for other in sorted(others - reached):  # what it reaches through another goes without saying
            (x, y, wide, tall), (left, top, under, _) = place[room], place[other]
            start = min(max(left + under / 2, x + 20), x + wide - 20)
            parts.append(f'<path class="down" marker-end="url(#tip)" d="M{start:.0f} {y + tall:.0f}V{top - 4:.0f}"/>')
    tip = (
        '<marker id="tip" viewBox="0 0 8 8" refX="4" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        '<path d="M0 0L8 4L0 8Z" fill="#24292f"/></marker>'
    )
    body = "\n".join(parts)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height:.0f}" role="img">\n'
        f"<title>The rooms of invdyn, and what each imports</title>\n<defs>{tip}</defs>\n<style>{STYLE}</style>\n"
        f'<rect width="{WIDTH}" height="{height:.0f}" fill="#fff"/>\n{body}\n</svg>\n'
    )


def _room(room: str, inner: dict[str, set[str]], x: float, y: float, wide: float, tall: float) -> str:
    """A room with its own rooms in it, and arcs from each to those that it imports."""
    words = says(room)
    if len(words) > wide / 6.6:
        words = words.partition(":")[0] + "."
    parts = [
        f'<rect class="room" x="{x:.0f}" y="{y:.0f}" width="{wide:.0f}" height="{tall}" rx="6"/>',
        f'<text class="name" x="{x + 14:.0f}" y="{y + 24:.0f}">{room}</text>',
        f'<text class="says" x="{x + 14:.0f}" y="{y + 44:.0f}">{escape(words)}</text>',
    ]
    names = ordered(inner)
    top = y + tall - BOX - 12
    step = (wide - 28) / max(len(names), 4)
    middle = {name: x + 14 + (number + 0.5) * step for number, name in enumerate(names)}
    for name, others in inner.items():
        for other in sorted(others):
            far = abs(middle[name] - middle[other])
            rise = min(10 + far / 14, top - y - 48)
            parts.append(
                f'<path class="arc" d="M{middle[name]:.0f} {top:.0f}C{middle[name]:.0f} {top - rise:.0f} '
                f'{middle[other]:.0f} {top - rise:.0f} {middle[other]:.0f} {top:.0f}"/>'
            )
    for name, centre in middle.items():
        half = step / 2 - 4
        parts.append(
            f'<rect class="inner" x="{centre - half:.0f}" y="{top:.0f}" width="{2 * half:.0f}" height="{BOX}" rx="4"/>'
            f'<text x="{centre:.0f}" y="{top + 20:.0f}">{name}</text>'
        )
    return "\n".join(parts)


if __name__ == "__main__":
    PICTURE.write_text(drawn(), encoding="utf-8")
