"""The catalogue of effects on a compiled MuJoCo model, as data: numbers, places, priors and units.

An effect is one or more numbers ν of the model at a place, each with a Gaussian prior about the file's value ν₀,

    ν ~ N(ν₀, s²),  low ≤ ν ≤ high,     s = max(share · |ν₀|, typical size in this motion),

where typical sizes come from the motion and its forces (:class:`.Sizes`): a damping, say, whose force is .3 of the
joint's usual one at its usual speed.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from invdyn.diagnosis.catalogue import model_numbers as own
from invdyn.diagnosis.catalogue.engine_sizes import Sizes
from invdyn.diagnosis.catalogue.entry import CatalogueEntry
from invdyn.diagnosis.catalogue.model_numbers import HINGE, SLIDE, Place, Read, Write
from invdyn.diagnosis.rules import FIXED
from invdyn.models.effects.base import Effect
from invdyn.models.engine.contacts import is_fixed
from invdyn.models.engine.drives import is_muscle
from invdyn.models.engine.scene import geom_name

ROUND = (2, 3, 5)
"""Spheres, capsules and cylinders, in MuJoCo's numbers: shapes with a radius."""
SEVERAL = ", "
"""Between names of pairs."""
CONNECT, OF_JOINTS, OF_TENDONS = 0, 2, 3
OF_A_JOINT, INTEGRATOR = 1, 1
"""What a fixed tendon is wrapped by; an activation that has no time constant."""
Typical = Callable[[Sizes, Place], float]
Places = Callable[[Any, Sequence[own.Pair]], Iterator[Place]]


@dataclass(frozen=True)
class Number:
    """A number of an effect.

    Attributes:
        name: in the result.
        read, write: of the model.
        unit: with "F" for N or N·m and "x" for m or rad, whichever the place has.
        share: of the file's value, that its prior's sd is at least.
        typical: the other bound of that sd, in this motion.
        low, high: bounds.
    """

    name: str
    read: Read
    write: Write
    unit: str = "1"
    share: float = 0.5
    typical: Typical = lambda sizes, place: 0.0
    low: float = 0.0
    high: float = math.inf


@dataclass(frozen=True)
class FieldEffect:
    """An effect of this catalogue; words are those of :class:`.CatalogueEntry`."""

    name: str
    places: Places
    numbers: tuple[Number, ...]
    meaning: str
    shown_by: str
    phrase: str = ""

    def entry(self, place: Place) -> CatalogueEntry:
        """What a report says of it at a place."""
        return CatalogueEntry(
            Effect,  # type: ignore[type-abstract]  # MuJoCo plays it: of the entry its words alone are used
            phrase=self.phrase or self.name.replace("_", " "),
            meaning=self.meaning,
            shown_by=self.shown_by,
            body_file_fields={number.name: number.name for number in self.numbers},
            preposition="of" if place.kind in ("tendon", "link", "actuator") else "at",
        )


@dataclass(frozen=True)
class Candidate:
    """An effect at a place of a model."""

    effect: FieldEffect
    place: Place

    @property
    def name(self) -> str:
        """The effect's."""
        return self.effect.name

    @property
    def key(self) -> str:
        """Effect and place."""
        return f"{self.effect.name}.{self.place.name}" if self.place.name else self.effect.name

    def priors(self, model: Any, sizes: Sizes) -> tuple[np.ndarray, np.ndarray]:
        """The file's values, and standard deviations, (n,) each."""
        before = np.array([number.read(model, self.place) for number in self.effect.numbers])
        sds = [
            max(number.share * abs(value), number.typical(sizes, self.place))
            for number, value in zip(self.effect.numbers, before, strict=True)
        ]
        return before, np.array(sds)

    def units(self, model: Any) -> list[str]:
        """Of its numbers."""
        straight = self.place.kind in ("joint", "equality") and not _turns(model, self.place)
        straight |= self.place.kind == "tendon" and not _winds(model, self.place.number)
        force, way = ("N", "m") if straight else ("N·m", "rad")
        return [number.unit.replace("F", force).replace("x", way) for number in self.effect.numbers]


def candidates(model: Any, pairs: Sequence[own.Pair], sizes: Sizes, without: Sequence[str] = ()) -> list[Candidate]:
    """All effects at all places of a model, of which ``pairs`` of geoms touch; those alone that may have some size."""
    found = []
    for effect in EFFECTS:
        for place in effect.places(model, pairs) if effect.name not in without else ():
            candidate = Candidate(effect, place)
            sds = candidate.priors(model, sizes)[1]
            if np.isfinite(sds).all() and (sds > 0).all():
                found.append(candidate)
    return found


# -- places --------------------------------------------------------------------------------------
def _turns(model: Any, place: Place) -> bool:
    if place.kind == "equality":
        if int(model.eq_type[place.number]) != OF_JOINTS:
            return False
        return bool(model.jnt_type[int(model.eq_obj1id[place.number])] == HINGE)
    return bool(model.jnt_type[place.number] == HINGE)


def _winds(model: Any, tendon: int) -> bool:
    """Whether a tendon is a sum of hinges' angles."""
    first = int(model.tendon_adr[tendon])
    if model.wrap_type[first] != OF_A_JOINT:
        return False
    return bool(model.jnt_type[int(model.wrap_objid[first])] == HINGE)


def every(kind: str, count: str, acts: Callable[[Any, int], bool], word: str = "") -> Places:
    """Places of a kind, of which a model has ``count``, where something acts; ``word`` is MuJoCo's for it."""

    def places(model: Any, pairs: Sequence[own.Pair]) -> Iterator[Place]:
        for number in range(getattr(model, count)):
            if acts(model, number):
                name = getattr(model, word or kind)(number).name
                yield Place(kind, name or f"{word or kind}{number}", number)

    return places


def _moves(model: Any, joint: int) -> bool:
    return int(model.jnt_type[joint]) in (HINGE, SLIDE)


def _lags(model: Any, actuator: int) -> bool:
    timed = model.actuator_dyntype[actuator] != INTEGRATOR and model.actuator_dynprm[actuator, 0] > 0
    return bool(timed and model.actuator_actnum[actuator] == 1)


JOINTS = every("joint", "njnt", _moves)
SPRUNG_JOINTS = every("joint", "njnt", lambda m, j: _moves(m, j) and np.ravel(m.jnt_stiffness[j])[0] > 0)
LINKS = every("link", "nbody", lambda m, b: bool(m.body_weldid[b] and m.body_mass[b] > 0), "body")
TENDONS = every("tendon", "ntendon", lambda m, k: True)
SPRUNG_TENDONS = every("tendon", "ntendon", lambda m, k: np.ravel(m.tendon_stiffness[k])[0] > 0)
COUPLINGS = every("equality", "neq", lambda m, e: m.eq_active0[e] and m.eq_type[e] in (OF_JOINTS, OF_TENDONS))
LOOPS = every("equality", "neq", lambda m, e: m.eq_active0[e] and m.eq_type[e] == CONNECT)
MOTORS = every("actuator", "nu", lambda m, a: not is_muscle(m)[a])
MUSCLES = every("actuator", "nu", lambda m, a: is_muscle(m)[a])
LAGGING_MOTORS = every("actuator", "nu", lambda m, a: not is_muscle(m)[a] and _lags(m, a))
LAGGING_MUSCLES = every("actuator", "nu", lambda m, a: is_muscle(m)[a] and _lags(m, a))


def pair_name(model: Any, pair: own.Pair) -> str:
    """Of two shapes that touch."""
    return "-".join(geom_name(model, geom) for geom in pair)


def contacts(model: Any, pairs: Sequence[own.Pair]) -> Iterator[Place]:
    """Pairs that touch; and all pairs of a shape that touches several."""
    for pair in pairs:
        yield Place("contact", pair_name(model, pair), pair[0], (pair,))
    for geom in sorted({each for pair in pairs for each in pair}):
        mine = tuple(pair for pair in pairs if geom in pair)
        if len(mine) > 1:
            yield Place("contact", SEVERAL.join(pair_name(model, pair) for pair in mine), geom, mine)


def touching(acts: Callable[[Any, int], bool]) -> Places:
    """Shapes that touch something."""

    def places(model: Any, pairs: Sequence[own.Pair]) -> Iterator[Place]:
        for geom in sorted({each for pair in pairs for each in pair}):
            if acts(model, geom):
                yield Place("contact", geom_name(model, geom), geom)

    return places


GROUNDS = touching(lambda m, g: m.geom_bodyid[g] == 0)
"""Fixed in the world itself."""
FEET = touching(lambda m, g: not is_fixed(m, g) and m.geom_type[g] in ROUND)
"""Moving ones with a radius."""


# -- the catalogue -------------------------------------------------------------------------------
def usual(over: str = "") -> Typical:
    """A share of a place's usual force, or of that force over its usual speed, acceleration or way."""
    share = FIXED.engine_usual
    return lambda sizes, place: share * sizes.size("force", place) / (sizes.size(over, place) if over else 1.0)


EFFECTS: tuple[FieldEffect, ...] = (
    FieldEffect(
        "viscous_friction", JOINTS, (Number("damping", *own.DAMPING, "F·s/x", 0.5, usual("speed")),),
        "a force against the motion that grows with speed", "the same motion at several speeds",
    ),
    FieldEffect(
        "coulomb_friction", JOINTS, (Number("torque", *own.FRICTION, "F", 0.5, usual()),),
        "a force of one size against the motion, at any speed", "slow reversals at several amplitudes",
        "Coulomb friction",
    ),
    FieldEffect(
        "armature", JOINTS, (Number("armature", *own.ARMATURE, "F·s²/x", 0.5, usual("acceleration")),),
        "inertia of a motor's rotor, seen at the joint", "fast reversals",
        "rotor inertia",
    ),
    FieldEffect(
        "joint_stiffness", JOINTS, (Number("stiffness", *own.STIFFNESS, "F/x", 0.5, usual("way")),),
        "a spring at the joint of another stiffness", "the same motion at several amplitudes",
    ),
    FieldEffect(
        "joint_rest", SPRUNG_JOINTS,
        (Number("rest", *own.REST, "x", 0.0, lambda z, p: 0.5 * z.size("way", p), -math.inf),),
        "a joint's spring that rests elsewhere", "a pause at several angles",
        "rest of the spring",
    ),
    FieldEffect(
        "link_mass", LINKS, (Number("mass", own.MASS[0], own.write_mass, "kg", FIXED.engine_usual, low=1e-4),),
        "a link of another mass and the same shape", "poses in which it hangs in several ways",
        "mass",
    ),
    FieldEffect(
        "tendon_stiffness", TENDONS,
        (Number("stiffness", *own.entries("tendon_stiffness"), "F/x", 0.5, usual("way")),),
        "a tendon that is stiffer or softer", "pulls of several lengths",
    ),
    FieldEffect(
        "tendon_rest", SPRUNG_TENDONS,
        (Number("length", *own.entries("tendon_lengthspring", (0, 1)), "x", 0.0, lambda z, p: 0.5 * z.size("way", p),
                -math.inf),),
        "a tendon that is slack at another length", "a pause at several lengths",
        "rest length of the tendon",
    ),
    FieldEffect(
        "tendon_damping", TENDONS, (Number("damping", *own.entries("tendon_damping"), "F·s/x", 0.5, usual("speed")),),
        "a tendon that resists being pulled fast", "pulls at several speeds",
    ),
    FieldEffect(
        "tendon_friction", TENDONS, (Number("force", *own.entries("tendon_frictionloss"), "F", 0.5, usual()),),
        "a tendon that rubs in its sheath", "slow reversals",
    ),
    FieldEffect(
        "contact_friction", contacts,
        (Number("friction", lambda m, p: own.pair_friction(m, p.pairs[0]), own.write_friction, "1", 0.5,
                lambda z, p: 0.1, 1e-4),),
        "shapes that slide on one another more or less easily", "slips under several loads",
        "friction of the contact",
    ),
    FieldEffect(
        "contact_softness", contacts,
        (Number("time constant", own.as_filed(1), own.write_softness, "of the file's", 0.5, low=0.05),),
        "a contact that gives way and comes back more slowly or faster", "impacts of several strengths",
        "softness of the contact",
    ),
    FieldEffect(
        "contact_yielding", contacts,
        (Number("yielding", own.read_yielding, own.write_yielding, "1", 0.5, lambda z, p: 0.02, 1e-4, 0.9),),
        "a contact that sinks in further under the same load", "several loads at rest",
        "yielding of the contact",
    ),
    FieldEffect(
        "ground_height", GROUNDS,
        (Number("height", own.as_filed(0), own.write_height, "m", 0.0, lambda z, p: 0.02 * z.extent, -math.inf),),
        "a ground that is higher or lower", "steps at several places",
        "height of the ground",
    ),
    FieldEffect(
        "ground_tilt", GROUNDS,
        tuple(
            Number(f"about {name}", own.as_filed(0), own.tilted(axis), "rad", 0.0, lambda z, p: 0.05, -0.7, 0.7)
            for axis, name in enumerate("xy")
        ),
        "a ground that is not level", "slides in several directions",
        "tilt of the ground",
    ),
    FieldEffect(
        "foot_size", FEET, (Number("radius", own.entries("geom_size")[0], own.write_radius, "m", 0.2, low=1e-4),),
        "a foot or pad of another radius", "touches from several sides",
        "radius of the shape",
    ),
    FieldEffect(
        "equality_offset", COUPLINGS,
        (Number("offset", *own.entries("eq_data"), "x", 0.0, lambda z, p: 0.3 * z.size("way", p), -math.inf),),
        "two joints or tendons that are coupled at other positions", "a motion to both ends",
        "offset of the coupling",
    ),
    FieldEffect(
        "loop_offset", LOOPS,
        tuple(
            Number(name, *own.entries("eq_data", (axis,)), "m", 0.0, lambda z, p: 0.02 * z.extent, -math.inf)
            for axis, name in enumerate("xyz")
        ),
        "a loop whose ends meet at another point", "a whole turn of the loop",
        "offset of the loop's joint",
    ),
    FieldEffect(
        "actuator_gain", MOTORS, (Number("factor", own.as_filed(1), own.write_strength, "of the file's", 0.2),),
        "an actuator whose force is stronger or weaker than is said", "a known load",
        "gain of the actuator",
    ),
    FieldEffect(
        "muscle_strength", MUSCLES, (Number("factor", own.as_filed(1), own.write_strength, "of the file's", 0.3),),
        "a muscle that is stronger or weaker", "a known load",
        "strength of the muscle",
    ),
    FieldEffect(
        "actuator_lag", LAGGING_MOTORS,
        (Number("factor", own.as_filed(1), own.write_slower, "of the file's", 0.5, low=0.05),),
        "an actuator that follows its command more slowly or faster", "steps of the command",
        "lag of the actuator",
    ),
    FieldEffect(
        "muscle_lag", LAGGING_MUSCLES,
        (Number("factor", own.as_filed(1), own.write_slower, "of the file's", 0.5, low=0.05),),
        "a muscle that is activated more slowly or faster", "steps of the excitation",
        "activation time of the muscle",
    ),
)  # fmt: skip
"""In the order of the table in the docs."""
