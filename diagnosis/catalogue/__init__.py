"""What a diagnosis knows of each effect, as data: one entry an effect, one file a family."""

from invdyn.diagnosis.catalogue import camera, disturbances, friction, inertia, joints, motors, sensors
from invdyn.diagnosis.catalogue.entry import Catalogue, CatalogueEntry, Variant
from invdyn.models.effects.catalogue import EFFECTS

__all__ = ["CATALOGUE", "Catalogue", "CatalogueEntry", "Variant"]

_FAMILIES = (friction, joints, inertia, motors, camera, sensors, disturbances)
_BY_CLASS = {entry.effect: entry for family in _FAMILIES for entry in family.ENTRIES}
CATALOGUE = Catalogue({name: _BY_CLASS.get(kind, kind) for name, kind in EFFECTS.items()})
"""All effects, in the order of :data:`.EFFECTS`: the catalogue of a diagnosis, if no other one is given."""
