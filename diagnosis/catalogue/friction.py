"""Friction of joints."""

from invdyn.diagnosis.catalogue.entry import CatalogueEntry, Numbers, Variant
from invdyn.diagnosis.rules import FIXED
from invdyn.models.effects.base import Effect, Scale
from invdyn.models.effects.friction import (
    CoulombFriction,
    DriftingFriction,
    LoadFriction,
    QuadraticDrag,
    StribeckFriction,
    ViscousFriction,
)
from invdyn.models.effects.regularised_friction import CREEP, SETTLING, BristleFriction

CREEPS = "regularised, it takes a moment to bring the joint to rest and lets it creep"
SHORT = {"settling": SETTLING / 2, "creep": CREEP / 2}
"""s: short times, from which a search finds longer ones."""
CREEPING = Variant({"settling": CREEPS}, SHORT)
BRISTLES = Variant(
    {"bristle_stiffness": "through bristles, it springs back by a little before it slips"},
    without=tuple(SHORT),
    of=BristleFriction.in_place_of,
)


def at_level(mine: Effect, load: Effect, values: Numbers, scale: Scale) -> list[Numbers]:
    """Friction under ``load`` as large, on average, as another dry friction of the same joint.

    That level over the typical load: a motor that holds the joint loads its gear twice. A servo's command is no torque
    of its motor; there, the torque that the joint needs is typical. A screen along the motion does not show how large
    friction under load is where joints stick.
    """
    if load.where != mine.where or mine.variant > 1:
        return []
    level = values["torque"] if "torque" in values else values["coulomb"]
    j, parts = load.place[0], scale.parts
    servo = bool(parts) and (own := parts[j]) is not None and own.servo is not None
    given = None if scale.command is None or servo else float(scale.command[:, j].abs().mean())
    typical = scale.torque[j] if given is None else 2 * given
    return [{"coefficient": level / typical}] if level > 0 and typical > 0 else []


def falls_with_speed(effect: Effect, mean: Numbers, sd: Numbers, scale: Scale) -> bool:
    """No less friction at rest than in motion."""
    return mean["static"] + FIXED.credible_sds * sd["static"] > mean["coulomb"] - FIXED.credible_sds * sd["coulomb"]


ENTRIES = (
    CatalogueEntry(
        ViscousFriction,
        phrase="viscous friction",
        meaning="a torque against the motion that grows with speed",
        shown_by="the same motion at several amplitudes",
        body_file_fields={"damping": "damping"},
        file_change="joint part",
    ),
    CatalogueEntry(
        CoulombFriction,
        phrase="Coulomb friction",
        meaning="a torque of one size against the motion, at any speed",
        shown_by="slow reversals at several amplitudes",
        variants=(CREEPING, BRISTLES),
        starts={"load_friction": at_level},
        body_file_fields={"torque": "friction"},
        file_change="joint part",
    ),
    CatalogueEntry(
        StribeckFriction,
        phrase="Stribeck friction",
        meaning="friction that is largest at low speed and falls once the joint moves",
        shown_by="very slow reversals",
        variants=(CREEPING, BRISTLES),
        special_cases={"coulomb_friction": {"coulomb": "torque", "static": "torque"}},
        starts={"load_friction": at_level},
        credible=falls_with_speed,
        file_change="friction in motion",
        said_in_part="its friction in motion is written; for what it has more near rest there is no word",
    ),
    CatalogueEntry(
        LoadFriction,
        phrase="load-dependent friction",
        meaning="friction that grows with the torque that the joint carries",
        shown_by="the same motion under a changed load",
        variants=(
            Variant(
                {
                    "settling": CREEPS,
                    "coriolis_share": "loaded by this share of the Coriolis and centrifugal torques",
                },
                SHORT | {"coriolis_share": 1.0},
            ),
            BRISTLES,
        ),
    ),
    CatalogueEntry(
        QuadraticDrag,
        phrase="quadratic drag",
        meaning="a torque against the motion that grows with the square of speed",
        shown_by="fast, large motion as well as slow motion",
    ),
    CatalogueEntry(
        DriftingFriction,
        phrase="drifting friction",
        meaning="friction that changes during the recording",
        shown_by="the first motion again at the end",
        per_recording=True,
    ),
)
