"""Which recording would tell causes apart that this one does not.

The catalogue has the recording that shows each effect and nothing like it (:attr:`.CatalogueEntry.shown_by`). Of a set
of rivals all are named, the most probable one's first.
"""

from collections.abc import Sequence

from invdyn.diagnosis.catalogue import CATALOGUE, Catalogue


def separating_experiment(effects: Sequence[str], catalogue: Catalogue = CATALOGUE) -> str | None:
    """A sentence for rival effects' names; None for fewer than two."""
    known = (catalogue[name].shown_by for name in effects if name in catalogue)
    wanted = list(filter(None, dict.fromkeys(known)))
    if len(effects) < 2 or not wanted:
        return None
    return "Record " + "; and ".join(wanted) + "."
