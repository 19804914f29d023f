"""What a camera makes of the picture, and when."""

from invdyn.diagnosis.catalogue.entry import CatalogueEntry, Variant
from invdyn.models.effects.camera import (
    CameraLatency,
    CameraRoll,
    CameraScale,
    CameraYaw,
    LensDistortion,
    RollingShutter,
)

CENTRE = (
    Variant(
        {"centre_x": "about a centre of the picture that is not the frame’s origin"},
        {"centre_x": 0.0, "centre_y": 0.0},
    ),
)

ENTRIES = (
    CatalogueEntry(
        CameraLatency,
        phrase="camera latency",
        meaning="positions that are stamped later than they were",
        shown_by="a common clock of camera and motors, such as a light that the command switches",
        twins={"actuator_delay": {"latency": "delay"}},
    ),
    CatalogueEntry(
        CameraRoll,
        phrase="camera roll",
        meaning="a picture turned about the line of sight",
        shown_by="encoders and a camera together, or the base's own edges in view of the camera",
        variants=CENTRE,
        twins={"gravity_tilt": {"angle": "angle"}},
    ),
    CatalogueEntry(
        CameraScale,
        phrase="a camera scale error",
        meaning="positions larger or smaller by one factor",
        shown_by="an object of known size in view",
        variants=CENTRE,
    ),
    CatalogueEntry(
        CameraYaw,
        phrase="camera yaw",
        meaning="a plane of motion that is seen obliquely",
        shown_by="a grid of known size in the plane of motion",
        variants=CENTRE,
    ),
    CatalogueEntry(
        LensDistortion,
        phrase="lens distortion",
        meaning="positions bent outwards or inwards towards the picture's edge",
        shown_by="a grid of known size that fills the picture",
        variants=CENTRE,
    ),
    CatalogueEntry(
        RollingShutter,
        phrase="a rolling shutter",
        meaning="rows of the picture that are seen at different times",
        shown_by="the same motion with the camera turned upside down",
    ),
)
