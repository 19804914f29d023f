"""What `invdyn check` prints."""

from collections.abc import Iterable
from textwrap import fill

from invdyn.diagnosis.check.check import Check

WIDTH, INDENT = 100, " " * 11
"""Columns of a line, and of its continuation."""
MAX_KNOWN_SD, MAX_LISTED = 0.2, 8
"""Relative sd under which a number is known, and how many of a kind are listed."""


def check_text(found: Check) -> str:
    """Mistakes first; then what the torques leave, what is excited, what would show, and what to record."""
    lines = [f"wrong      {wrong.sentence}" for wrong in found.mistakes]
    if found.unclear:
        lines = ["unclear    the torques are far from the motion, and no sign, zero, unit, column or gear explains it"]
        if found.nearest is not None and found.nearest.after < found.rules.check.max_right_misfit:
            lines.append(f"nearest    {found.nearest.sentence}")
    elif not lines:
        lines = ["right      nothing looks wrong" + (" in what could be looked at" if found.not_looked_at else "")]
    if found.not_looked_at is not None:
        lines.append(f"not seen   {found.not_looked_at}")
    if found.unexplained is not None:
        parts = ", ".join(f"{joint} {100 * share:.0f} %" for joint, share in found.by_joint.items())
        lines.append(f"torques    what the body and friction leave of their size: {parts}")
    if found.excited:
        known = [each for each in found.excited if each.value and each.sd < MAX_KNOWN_SD * abs(each.value)]
        weak = [each for each in found.excited if each not in known and each.value]
        lines += [f"excited    {e.words}: to {100 * e.sd / abs(e.value):.2g} %" for e in known[:MAX_LISTED]]
        lines += [f"weak       {e.words}: no better than {100 * e.sd / abs(e.value):.0f} %" for e in weak[:MAX_LISTED]]
    if (shown := found.visible) is not None:
        names = [name for name in shown.dprime if name not in shown.hidden]
        long = [f"would show {len(names)} effects of {len(shown.dprime)}: {_by_effect(names) or 'none'}"]
        long += [f"hidden     {_by_effect(of)}: record {what}" for what, of in shown.record.items()]
        lines += [fill(line, WIDTH, subsequent_indent=INDENT, break_long_words=False) for line in long]
    return "\n".join(lines)


def _by_effect(keys: Iterable[str]) -> str:
    """Each effect once, with its places: "payload (upper_arm, forearm), gravity_tilt"."""
    places: dict[str, list[str]] = {}
    for key in keys:
        effect, _, place = key.partition(".")
        places.setdefault(effect, []).extend([place] if place else [])
    return ", ".join(f"{effect} ({', '.join(at)})" if at else effect for effect, at in places.items())
