"""The effects that the blind check simulates, each with its size and units; `EFFECTS` has them all by name."""

from dataclasses import replace

# in this order cases draw them
from invdyn.blindcheck.effects import joints, inertia, motors, disturbances, sensors  # isort: skip
from invdyn.blindcheck.effects.effect import EFFECTS, Injected

PLANAR_ONLY = (
    "external_push",
    "base_motion",
    "link_flexibility",
    "backlash",
    "keypoint_offset",
    "soft_tissue",
    "camera_scale",
    "camera_roll",
    "camera_yaw",
    "lens_distortion",
    "rolling_shutter",
)
"""Effects that the catalogue knows in the plane alone."""

_UNITS_IN_SPACE = {
    "inertial_error": {"mass": "kg", "com_x": "m", "com_y": "m", "com_z": "m", "inertia": "kg·m²"},
    "gravity_tilt": {"about_x": "rad", "about_y": "rad"},
}

IN_SPACE = {
    name: replace(effect, units=_UNITS_IN_SPACE.get(name, effect.units))
    for name, effect in EFFECTS.items()
    if name not in PLANAR_ONLY
}
"""Those that the catalogue knows in space, too, with their units there."""

OBSERVATIONS = tuple(name for name, effect in EFFECTS.items() if effect.install is None)
"""Effects on what sensors show."""

__all__ = [
    "EFFECTS",
    "IN_SPACE",
    "OBSERVATIONS",
    "Injected",
    "disturbances",
    "inertia",
    "joints",
    "motors",
    "sensors",
]
