"""Markers, trackers, clocks and encoders."""

import math

from invdyn.diagnosis.catalogue import period_equivalents
from invdyn.diagnosis.catalogue.entry import CatalogueEntry, Numbers, Variant
from invdyn.diagnosis.rules import FIXED
from invdyn.models.effects.base import Effect, Scale
from invdyn.models.effects.sensors import (
    ClockRate,
    EncoderOffset,
    KeypointOffset,
    LabelSwap,
    Outliers,
    TimestampJitter,
    VaryingNoise,
)
from invdyn.models.effects.soft_tissue import DAMPING_RATIOS, SoftTissue, Wobble


def bends(mine: Effect, link: Effect, values: Numbers, scale: Scale) -> list[Numbers]:
    """A flexible link whose tip carries the tissue: several stiffnesses, as from one too high no lower one is found.

    A screen sees little of what a bend explains along a path of its own: in one case with a stop 67 nats of 184.
    """
    if link.place != mine.place:
        return []
    stiffness, damping = link.parameters(scale)
    return [{"stiffness": start, "damping": damping.grid[0]} for start in stiffness.grid[1::2]]


def is_mistimed(effect: Effect, mean: Numbers, sd: Numbers, scale: Scale) -> bool:
    """Mistimed by a few frames each at most."""
    each = (mean["sd"] - FIXED.credible_sds * sd["sd"]) / math.sqrt(
        max(mean["rate"] + FIXED.credible_sds * sd["rate"], 1e-9)
    )
    return each <= FIXED.max_mistimed_frames * scale.time.diff().median().item()


ENTRIES = (
    CatalogueEntry(
        ClockRate,
        phrase="a clock-rate error",
        meaning="frames that are further apart in time, or less far, than stated",
        shown_by="a clock in view of the camera",
        forms={"frames": "of the sensors alone, while commands keep true time"},
        needs={"frames": "command"},  # else there is one clock
        same_period=period_equivalents.clock_rate,
    ),
    CatalogueEntry(
        EncoderOffset,
        phrase="an encoder offset",
        meaning="an encoder whose zero is not the simulation's",
        shown_by="encoders and a camera together, or the base's own edges in view of the camera",
        file_change="encoder zero",
    ),
    CatalogueEntry(
        KeypointOffset,
        phrase="a keypoint offset",
        meaning="a marker that is not at its joint",
        shown_by="a measured length of the link",
    ),
    CatalogueEntry(
        LabelSwap,
        phrase="swapped labels",
        meaning="two keypoints that are exchanged in some frames",
        shown_by="the same motion with markers that differ",
    ),
    CatalogueEntry(
        Outliers,
        phrase="outliers",
        meaning="some detections that are far from where the keypoint is",
        shown_by="the same motion filmed from elsewhere",
        outliers=True,
    ),
    CatalogueEntry(
        SoftTissue,
        phrase="soft-tissue motion",
        meaning="a marker that shifts on the skin",
        shown_by="fast and slow motion through the same postures",
        forms={"sliding": "that slides as the joint turns"},
        variants=(
            Variant(
                {"damping_ratio": "a mass on a spring, it swings on by itself after its bone"},
                {"damping_ratio": DAMPING_RATIOS[1]},
                of=Wobble.in_place_of,
            ),
        ),
        starts={"link_flexibility": bends},
    ),
    CatalogueEntry(
        TimestampJitter,
        phrase="timestamp jitter",
        meaning="frames that are dropped, doubled or mistimed",
        shown_by="a clock in view of the camera",
        credible=is_mistimed,
    ),
    CatalogueEntry(
        VaryingNoise,
        phrase="varying noise",
        meaning="positions that are less certain in some frames than in others",
        shown_by="the same postures held still",
        forms={"confidence": "as the tracker’s confidence falls", "joints": "with how fast the joints turn"},
        needs={"confidence": "confidence"},
    ),
)
