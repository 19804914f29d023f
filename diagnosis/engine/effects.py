"""The catalogue of effects on a compiled MuJoCo model, as data: fields, places, priors, units and the file's words.

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

from invdyn.diagnosis.engine import model_numbers as own
from invdyn.diagnosis.engine.model_numbers import HINGE, SLIDE, Place, Read, Write
from invdyn.diagnosis.engine.sizes import Sizes
from invdyn.diagnosis.rules import FIXED
from invdyn.models.engine.contacts import is_fixed
from invdyn.models.engine.drives import is_muscle
from invdyn.models.engine.scene import geom_name

ROUND = (2, 3, 5)
"""Spheres, capsules and cylinders, in MuJoCo's numbers: shapes with a radius."""
SEVERAL = ", "
"""Between names of pairs."""
CONNECT, OF_JOINTS, OF_TENDONS = 0, 2, 3
OF_A_JOINT = 1
"""What a fixed tendon is wrapped by."""


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
        attribute: in the file, of the place's element; "" where the file has no such word.
    """

    name: str
    read: Read
    write: Write
    unit: str = "1"
    share: float = 0.5
    typical: Callable[[Sizes, Place], float] = lambda sizes, place: 0.0
    low: float = 0.0
    high: float = math.inf
    attribute: str = ""


@dataclass(frozen=True)
class FieldEffect:
    """An effect of this catalogue; words are those of :class:`.CatalogueEntry`."""

    name: str
    places: Callable[[Any, Sequence[own.Pair]], Iterator[Place]]
    numbers: tuple[Number, ...]
    meaning: str
    shown_by: str
    phrase: str = ""

    @property
    def words(self) -> str:
        """In a sentence."""
        return self.phrase or self.name.replace("_", " ")


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


def joints(model: Any, pairs: Sequence[own.Pair]) -> Iterator[Place]:
    """Hinges and slides."""
    for j in range(model.njnt):
        if model.jnt_type[j] in (HINGE, SLIDE):
            yield Place("joint", model.joint(j).name or f"joint{j}", j)


def sprung_joints(model: Any, pairs: Sequence[own.Pair]) -> Iterator[Place]:
    """Those with a spring."""
    stiffness = own.of_row("jnt_stiffness", 0)[0]
    return (place for place in joints(model, pairs) if stiffness(model, place) > 0)


def links(model: Any, pairs: Sequence[own.Pair]) -> Iterator[Place]:
    """Bodies that move and weigh something."""
    for b in range(1, model.nbody):
        if model.body_weldid[b] and model.body_mass[b] > 0:
            yield Place("link", model.body(b).name or f"body{b}", b)


def tendons(model: Any, pairs: Sequence[own.Pair]) -> Iterator[Place]:
    """All."""
    for k in range(model.ntendon):
        yield Place("tendon", model.tendon(k).name or f"tendon{k}", k)


def sprung_tendons(model: Any, pairs: Sequence[own.Pair]) -> Iterator[Place]:
    """Those with a spring."""
    stiffness = own.of_row("tendon_stiffness", 0)[0]
    return (place for place in tendons(model, pairs) if stiffness(model, place) > 0)


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


def grounds(model: Any, pairs: Sequence[own.Pair]) -> Iterator[Place]:
    """Touched shapes that are fixed in the world itself."""
    for geom in sorted({each for pair in pairs for each in pair}):
        if model.geom_bodyid[geom] == 0:
            yield Place("contact", geom_name(model, geom), geom)


def feet(model: Any, pairs: Sequence[own.Pair]) -> Iterator[Place]:
    """Moving shapes with a radius that touch something."""
    for geom in sorted({each for pair in pairs for each in pair}):
        if not is_fixed(model, geom) and model.geom_type[geom] in ROUND:
            yield Place("contact", geom_name(model, geom), geom)


def equalities(*kinds: int) -> Callable[[Any, Sequence[own.Pair]], Iterator[Place]]:
    """Of some kinds, that act."""

    def places(model: Any, pairs: Sequence[own.Pair]) -> Iterator[Place]:
        for e in range(model.neq):
            if model.eq_active0[e] and model.eq_type[e] in kinds:
                yield Place("equality", model.equality(e).name or f"equality{e}", e)

    return places


def actuators(muscles: bool, lagging: bool = False) -> Callable[[Any, Sequence[own.Pair]], Iterator[Place]]:
    """Muscles, or all others; those with a time constant."""

    def places(model: Any, pairs: Sequence[own.Pair]) -> Iterator[Place]:
        for a in np.flatnonzero(is_muscle(model) == muscles).tolist():
            if not lagging or (model.actuator_actnum[a] == 1 and model.actuator_dynprm[a, 0] > 0):
                yield Place("actuator", model.actuator(a).name or f"actuator{a}", a)

    return places


# -- the catalogue -------------------------------------------------------------------------------
USUAL = FIXED.engine_usual
FIELD = {name: own.of_dofs(f"dof_{name}") for name in ("damping", "frictionloss", "armature")}
STIFFNESS = own.of_row("jnt_stiffness", 0)
OF_TENDON = {name: own.of_row(f"tendon_{name}", 0) for name in ("stiffness", "damping", "frictionloss")}
LENGTH = own.of_row("tendon_lengthspring", 0, 1)
OFFSET = own.of_row("eq_data", 0)

EFFECTS: tuple[FieldEffect, ...] = (
    FieldEffect(
        "viscous_friction",
        joints,
        (Number("damping", *FIELD["damping"], "F·s/x", 0.5, lambda z, p: USUAL * z.force(p) / z.speed(p),
                attribute="damping"),),
        "a force against the motion that grows with speed",
        "the same motion at several speeds",
    ),
    FieldEffect(
        "coulomb_friction",
        joints,
        (Number("torque", *FIELD["frictionloss"], "F", 0.5, lambda z, p: USUAL * z.force(p),
                attribute="frictionloss"),),
        "a force of one size against the motion, at any speed",
        "slow reversals at several amplitudes",
        "Coulomb friction",
    ),
    FieldEffect(
        "armature",
        joints,
        (Number("armature", *FIELD["armature"], "F·s²/x", 0.5, lambda z, p: USUAL * z.force(p) / z.acceleration(p),
                attribute="armature"),),
        "inertia of a motor's rotor, seen at the joint",
        "fast reversals",
        "rotor inertia",
    ),
    FieldEffect(
        "joint_stiffness",
        joints,
        (Number("stiffness", *STIFFNESS, "F/x", 0.5, lambda z, p: USUAL * z.force(p) / z.way(p),
                attribute="stiffness"),),
        "a spring at the joint of another stiffness",
        "the same motion at several amplitudes",
    ),
    FieldEffect(
        "joint_rest",
        sprung_joints,
        (Number("rest", own.read_rest, own.write_rest, "x", 0.0, lambda z, p: 0.5 * z.way(p), -math.inf,
                attribute="springref"),),
        "a joint's spring that rests elsewhere",
        "a pause at several angles",
        "rest of the spring",
    ),
    FieldEffect(
        "link_mass",
        links,
        (Number("mass", own.read_mass, own.write_mass, "kg", USUAL, low=1e-4, attribute="mass"),),
        "a link of another mass and the same shape",
        "poses in which it hangs in several ways",
        "mass",
    ),
    FieldEffect(
        "tendon_stiffness",
        tendons,
        (Number("stiffness", *OF_TENDON["stiffness"], "F/x", 0.5, lambda z, p: USUAL * z.force(p) / z.way(p),
                attribute="stiffness"),),
        "a tendon that is stiffer or softer",
        "pulls of several lengths",
    ),
    FieldEffect(
        "tendon_rest",
        sprung_tendons,
        (Number("length", *LENGTH, "x", 0.0, lambda z, p: 0.5 * z.way(p), -math.inf, attribute="springlength"),),
        "a tendon that is slack at another length",
        "a pause at several lengths",
        "rest length of the tendon",
    ),
    FieldEffect(
        "tendon_damping",
        tendons,
        (Number("damping", *OF_TENDON["damping"], "F·s/x", 0.5, lambda z, p: USUAL * z.force(p) / z.speed(p),
                attribute="damping"),),
        "a tendon that resists being pulled fast",
        "pulls at several speeds",
    ),
    FieldEffect(
        "tendon_friction",
        tendons,
        (Number("force", *OF_TENDON["frictionloss"], "F", 0.5, lambda z, p: USUAL * z.force(p),
                attribute="frictionloss"),),
        "a tendon that rubs in its sheath",
        "slow reversals",
    ),
    FieldEffect(
        "contact_friction",
        contacts,
        (Number("friction", own.read_friction, own.write_friction, "1", 0.5, lambda z, p: 0.1, 1e-4,
                attribute="friction"),),
        "shapes that slide on one another more or less easily",
        "slips under several loads",
        "friction of the contact",
    ),
    FieldEffect(
        "contact_softness",
        contacts,
        (Number("time constant", own.read_softness, own.write_softness, "of the file's", 0.5, low=0.05,
                attribute="solref"),),
        "a contact that gives way and comes back more slowly or faster",
        "impacts of several strengths",
        "softness of the contact",
    ),
    FieldEffect(
        "contact_yielding",
        contacts,
        (Number("yielding", own.read_yielding, own.write_yielding, "1", 0.5, lambda z, p: 0.02, 1e-4, 0.9,
                attribute="solimp"),),
        "a contact that sinks in further under the same load",
        "several loads at rest",
        "yielding of the contact",
    ),
    FieldEffect(
        "ground_height",
        grounds,
        (Number("height", own.nothing, own.write_height, "m", 0.0, lambda z, p: 0.02 * z.extent, -math.inf,
                attribute="pos"),),
        "a ground that is higher or lower",
        "steps at several places",
        "height of the ground",
    ),
    FieldEffect(
        "ground_tilt",
        grounds,
        tuple(
            Number(f"about {name}", own.nothing, own.tilted(axis), "rad", 0.0, lambda z, p: 0.05, -0.7, 0.7,
                   attribute="quat")
            for axis, name in enumerate("xy")
        ),
        "a ground that is not level",
        "slides in several directions",
        "tilt of the ground",
    ),
    FieldEffect(
        "foot_size",
        feet,
        (Number("radius", own.read_radius, own.write_radius, "m", 0.2, low=1e-4, attribute="size"),),
        "a foot or pad of another radius",
        "touches from several sides",
        "radius of the shape",
    ),
    FieldEffect(
        "equality_offset",
        equalities(OF_JOINTS, OF_TENDONS),
        (Number("offset", *OFFSET, "x", 0.0, lambda z, p: 0.3 * z.way(p), -math.inf, attribute="polycoef"),),
        "two joints or tendons that are coupled at other positions",
        "a motion to both ends",
        "offset of the coupling",
    ),
    FieldEffect(
        "loop_offset",
        equalities(CONNECT),
        tuple(
            Number(name, *own.of_row("eq_data", axis), "m", 0.0, lambda z, p: 0.02 * z.extent, -math.inf)
            for axis, name in enumerate("xyz")
        ),
        "a loop whose ends meet at another point",
        "a whole turn of the loop",
        "offset of the loop's joint",
    ),
    FieldEffect(
        "actuator_gain",
        actuators(muscles=False),
        (Number("factor", own.one, own.write_strength, "of the file's", 0.2, attribute="gear"),),
        "an actuator whose force is stronger or weaker than is said",
        "a known load",
        "gain of the actuator",
    ),
    FieldEffect(
        "muscle_strength",
        actuators(muscles=True),
        (Number("factor", own.one, own.write_strength, "of the file's", 0.3, attribute="force"),),
        "a muscle that is stronger or weaker",
        "a known load",
        "strength of the muscle",
    ),
    FieldEffect(
        "actuator_lag",
        actuators(muscles=False, lagging=True),
        (Number("factor", own.one, own.write_slower, "of the file's", 0.5, low=0.05, attribute="timeconst"),),
        "an actuator that follows its command more slowly or faster",
        "steps of the command",
        "lag of the actuator",
    ),
    FieldEffect(
        "muscle_lag",
        actuators(muscles=True, lagging=True),
        (Number("factor", own.one, own.write_slower, "of the file's", 0.5, low=0.05, attribute="timeconst"),),
        "a muscle that is activated more slowly or faster",
        "steps of the excitation",
        "activation time of the muscle",
    ),
)  # fmt: skip
"""In the order of the table in the docs."""
