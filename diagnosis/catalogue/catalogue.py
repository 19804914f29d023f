"""The catalogue of a diagnosis, if no other one is given: all effects, in the order of :data:`.EFFECTS`."""

from invdyn.diagnosis.catalogue import camera, disturbances, friction, inertia, joints, motors, sensors
from invdyn.diagnosis.catalogue.entry import Catalogue
from invdyn.models.effects.catalogue import EFFECTS

_BY_CLASS = {
    entry.effect: entry
    for family in (friction, joints, inertia, motors, camera, sensors, disturbances)
    for entry in family.ENTRIES
}
CATALOGUE = Catalogue({name: _BY_CLASS.get(kind, kind) for name, kind in EFFECTS.items()})
