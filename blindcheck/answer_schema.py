"""Whether a diagnosis.json can be judged: the keys that are read, and what stands in them.

Methods of others write it too. What is wrong is said when a case is diagnosed, in one line, and not after hours, when
all are scored.
"""

from collections.abc import Mapping
from typing import Any

NUMBER, REAL = (int, float, type(None)), (int, float)
"""Null is what a number is that is not known."""

KEYS = {
    "gap": {"detected": bool},
    "causes": [{"effects": [{"effect": str, "parameters?": {"*": {"interval_90?": [NUMBER]}}}], "probability": NUMBER}],
    "where?": {
        "side?": {"*": NUMBER},
        "joints?": {"*": NUMBER},
        "keypoints?": {"*": NUMBER},
        "intervals?": [{"start": REAL, "end": REAL, "share": NUMBER}],
    },
    "ambiguity_set?": [[str]],
    "outside_catalogue?": {"probability?": NUMBER},
    "not_identifiable?": [str],
    "shrinkage?": {"gap_closed?": NUMBER},
    "regression?": {"statements": [{"effect": str, "places": [str]}]},
    "closing?": {"shown": str, "torque": {"*": {"closed": NUMBER}}},
}
"""Keys that are read; with "?" those that may be missing or null, "*" for any."""


def unreadable(found: object, keys: Any = KEYS, at: str = "diagnosis.json") -> str | None:
    """What keeps ``found``, parsed JSON, from being judged, and where; None where nothing does."""
    if isinstance(keys, Mapping):
        if not isinstance(found, Mapping):
            return f"{at}: expected an object, got {_shown(found)}"
        parts: list[tuple[Any, Any, str]] = []
        for name, inner in keys.items():
            key = name.rstrip("?")
            if name == "*":
                parts += [(value, inner, f"{at}: {each}") for each, value in found.items()]
            elif found.get(key) is not None or not name.endswith("?"):
                if key not in found:
                    return f"{at}: expected the key {key!r}, got {', '.join(map(repr, found)) or 'none'}"
                parts.append((found[key], inner, f"{at}: {key}"))
    elif isinstance(keys, list):
        if not isinstance(found, list):
            return f"{at}: expected a list, got {_shown(found)}"
        parts = [(value, keys[0], f"{at}[{place}]") for place, value in enumerate(found)]
    else:
        fits = isinstance(found, keys) and (keys is bool or not isinstance(found, bool))
        what = {bool: "true or false", str: "a text"}.get(keys, "a number")
        return None if fits else f"{at}: expected {what}, got {_shown(found)}"
    return next((wrong for part in parts if (wrong := unreadable(*part)) is not None), None)


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:40]}…"
