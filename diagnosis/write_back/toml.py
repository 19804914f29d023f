"""Changes written into a copy of a body's TOML: gravity and keys of the link's table, with a comment behind each."""

import re
import tomllib
from collections.abc import Sequence

from invdyn.diagnosis.write_back.changes import ZERO, ZERO_ELSEWHERE, FileChange
from invdyn.models import ArticulatedBody
from invdyn.models.bodies.protocol import AXES

JOINT = ("damping", "friction", "armature", "stiffness", "rest")
LINK = ("mass", "com", "inertia")
HEADER = re.compile(r"^\s*\[\[\s*links\s*\]\]")
WHOLE = re.compile(r"^\s*gravity\s*=\s*\[[^\]]*\]\s*(#.*)?$")
TABLE = re.compile(r"^\s*\[")


def rewritten(content: bytes, body: ArticulatedBody, changes: Sequence[FileChange]) -> tuple[bytes, dict[str, str]]:
    """The content with the changes; and what could not be written: words → why."""
    lines = content.decode("utf-8").splitlines()
    names = [link["name"] for link in tomllib.loads(content.decode("utf-8"))["links"]]
    unsaid: dict[str, str] = {}
    gravity = [change for change in changes if change.quantity.startswith("gravity")]
    if gravity and not _gravity(lines, body, gravity):
        unsaid |= {change.words: "change it among the file's first lines" for change in gravity}
    for change in (each for each in changes if each not in gravity):
        if change.quantity in JOINT:
            joint = body.joint_names.index(change.place)
            link = next(k for k in range(len(body.link_names)) if joint in body.moved_by(k))
        elif change.quantity in LINK and not (body.dimensions == 3 and change.quantity == "inertia"):
            link = body.link_names.index(change.place)
        else:
            by_hand = change.quantity == "inertia" or change.quantity.startswith("com")
            why = "change it among the link's numbers" if by_hand else "a body's TOML has no word for it"
            why = ZERO_ELSEWHERE if change.quantity == ZERO else why
            unsaid[change.words] = why
            continue
        starts = [n for n, line in enumerate(lines) if HEADER.match(line)]
        begin = starts[names.index(body.link_names[link])] + 1
        stop = next((n for n in range(begin, len(lines)) if TABLE.match(lines[n])), len(lines))
        line_of = f"{change.quantity} = {change.after!r}  # {change.comment}"
        at = [n for n in range(begin, stop) if re.match(rf"^\s*{change.quantity}\s*=", lines[n])]
        if at:
            lines[at[0]] = line_of
        else:
            last = max((n for n in range(begin, stop) if lines[n].strip()), default=begin - 1)
            lines.insert(last + 1, line_of)
    return ("\n".join(lines) + "\n").encode(), unsaid


def _gravity(lines: list[str], body: ArticulatedBody, changes: Sequence[FileChange]) -> bool:
    """Whether the body's gravity could be written; a key of several lines cannot."""
    to = dict(zip(AXES, body.gravity, strict=False)) | {each.quantity[-1]: each.after for each in changes}
    line_of = f"gravity = [{', '.join(map(repr, to.values()))}]  # {'; '.join(each.comment for each in changes)}"
    first = next((n for n, line in enumerate(lines) if TABLE.match(line)), len(lines))
    at = [n for n, line in enumerate(lines[:first]) if re.match(r"^\s*gravity\s*=", line)]
    if not at:
        lines.insert(0, line_of)
    elif WHOLE.match(lines[at[0]]):
        lines[at[0]] = line_of
    else:
        return False
    return True
