"""Which recording would tell causes apart that this one does not.

Each effect says what brings it out and nothing like it (:attr:`.Effect.shown_by`). Of a set of rivals all are
named, the most probable one's first.
"""

from collections.abc import Sequence

from invdyn.models.effects.catalogue import EFFECTS


def separating_experiment(effects: Sequence[str]) -> str | None:
    """A sentence for rival effects' names; None for fewer than two."""
    wanted = list(dict.fromkeys(EFFECTS[name].shown_by for name in dict.fromkeys(effects) if name in EFFECTS))
    if len(effects) < 2 or not wanted:
        return None
    return "Record " + "; and ".join(wanted) + "."
