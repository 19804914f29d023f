"""Masses, inertias and gravity."""

import torch

from invdyn.diagnosis.catalogue import period_equivalents
from invdyn.diagnosis.catalogue.entry import CatalogueEntry, Numbers
from invdyn.models.effects.base import Effect, Scale
from invdyn.models.effects.disturbances import GravityTilt
from invdyn.models.effects.inertia import Armature, InertialError, Payload
from invdyn.models.effects.inertias import inertia_of, point_of


def same_load(mine: Effect, payload: Effect, values: Numbers, scale: Scale) -> list[Numbers]:
    """A payload on the link of an inertial error: from its weight, and from its inertia, as either may be known alone.

    A mass m at the tip, at t from the joint, adds m t to the first moment about the joint, and m t² to the second.
    """
    if mine.place != payload.place[:1]:
        return []
    own, at = inertia_of(scale.body, mine.place[0]), point_of(scale.body, *payload.place).double()
    coms = sorted(name for name in values if name.startswith("com"))
    com = own.com + torch.tensor([values[name] for name in coms], dtype=torch.float64)
    heavier, square = own.mass + values["mass"], at.square().sum()
    by_weight = (heavier * com - own.mass * own.com) @ at / square
    # the mean moment of a point in space is two thirds of m t²
    share = 1.0 if len(coms) == 1 else 2 / 3
    by_inertia = values["inertia"] / share + heavier * com.square().sum() - own.mass * own.com.square().sum()
    loads = (by_weight.item(), (by_inertia / square).item())
    return [{"mass": load} for load in loads if load > 0]


ENTRIES = (
    CatalogueEntry(
        Armature,
        phrase="rotor inertia",
        meaning="inertia of the motor that resists the joint's acceleration",
        shown_by="fast motion about a posture that needs no holding torque",
        same_period=period_equivalents.armature,
        body_file_fields={"inertia": "armature"},
        file_change="joint part",
    ),
    CatalogueEntry(
        InertialError,
        phrase="an inertial error",
        meaning="a link whose mass, centre of mass or inertia is not as stated",
        shown_by="two postures held still, then fast motion",
        starts={"payload": same_load},
        same_period=period_equivalents.inertial_error,
        file_change="inertia",
    ),
    CatalogueEntry(
        Payload,
        phrase="a payload",
        meaning="a mass at the tip that the simulation does not carry",
        shown_by="two postures and two speeds",
        same_period=period_equivalents.payload,
        file_change="payload",
        preposition="on",
    ),
    CatalogueEntry(
        GravityTilt,
        phrase="tilted gravity",
        meaning="gravity that points elsewhere than in the simulation",
        shown_by="encoders and a camera together, or the base's own edges in view of the camera",
        twins={"camera_roll": {"angle": "angle"}},
        file_change="gravity",
    ),
)
