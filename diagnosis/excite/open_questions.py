"""What a diagnosis has left open: the effects that a next motion is to tell apart."""

import json
from pathlib import Path

from invdyn.diagnosis.excite.information import kinds_of
from invdyn.diagnosis.rules import FIXED
from invdyn.recordings import InputError


def open_effects(path: str | Path) -> list[str]:
    """Effects of a diagnosis (.json) that may act, or may not; of the rivals those that torque is linear in.

    An effect is open where the causes that name it have a probability of 5 to 95 % together, or where it stands in the
    ambiguity set. Raises InputError for what is no diagnosis, OSError for a file that cannot be opened.
    """
    try:
        found = json.loads(Path(path).read_text("utf-8"))
        causes = [({e["effect"] for e in cause["effects"]}, float(cause["probability"])) for cause in found["causes"]]
        rivals = {name.partition(".")[0] for names in found.get("ambiguity_set", []) for name in names}
    except (ValueError, KeyError, TypeError, AttributeError):
        raise InputError(f"{path}: expected a diagnosis of `invdyn diagnose`, diagnosis.json") from None
    names = {name for effects, _ in causes for name in effects}
    acts = {name: sum(p for effects, p in causes if name in effects) for name in names}
    sure = FIXED.excite_sure
    return kinds_of([*(name for name, p in acts.items() if 1 - sure < p < sure), *rivals])
