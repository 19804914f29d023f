"""Changes written into a copy of a body's TOML: keys of the link's table, with a comment behind each."""

import re
from collections.abc import Sequence

from invdyn.diagnosis.write_back.changes import FileChange
from invdyn.models import Body

JOINT = ("damping", "friction", "armature", "stiffness", "rest")
LINK = ("mass", "com", "inertia")
HEADER = re.compile(r"^\s*\[\[\s*links\s*\]\]")
TABLE = re.compile(r"^\s*\[")


def rewritten(content: bytes, body: Body, changes: Sequence[FileChange]) -> tuple[bytes, dict[str, str]]:
    """The content with the changes; and what could not be written: words → why."""
    lines = content.decode("utf-8").splitlines()
    unsaid: dict[str, str] = {}
    for change in changes:
        if change.quantity in JOINT:
            link = body.joint_names.index(change.place)
        elif change.quantity in LINK:
            link = body.link_names.index(change.place)
        else:
            unsaid[f"{change.quantity} of {change.place}"] = "a body's TOML has no word for it"
            continue
        starts = [n for n, line in enumerate(lines) if HEADER.match(line)]
        begin = starts[link] + 1
        stop = next((n for n in range(begin, len(lines)) if TABLE.match(lines[n])), len(lines))
        told = f"{change.quantity} = {change.after!r}  # {change.comment}"
        at = [n for n in range(begin, stop) if re.match(rf"^\s*{change.quantity}\s*=", lines[n])]
        if at:
            lines[at[0]] = told
        else:
            last = max((n for n in range(begin, stop) if lines[n].strip()), default=begin - 1)
            lines.insert(last + 1, told)
    return ("\n".join(lines) + "\n").encode(), unsaid
