"""Which recording would tell causes apart that this one does not.

One sentence for each effect says what brings it out and nothing like it; of a set of rivals all are asked for, the
most probable one's first.
"""

from collections.abc import Sequence

SHOWN_BY = {
    "viscous_friction": "the same motion at several amplitudes",
    "coulomb_friction": "slow reversals at several amplitudes",
    "stribeck_friction": "very slow reversals",
    "load_friction": "the same motion under a changed load",
    "quadratic_drag": "fast, large motion beside slow motion",
    "joint_stiffness": "holding still in several postures",
    "joint_coupling": "moving one joint while the other is held",
    "joint_limit": "repeated slow sweeps into the end of the range",
    "payload": "two postures and two speeds",
    "inertial_error": "two postures held still, then fast motion",
    "gravity_tilt": "a plumb line in view of the camera",
    "armature": "fast motion about a posture that needs no holding torque",
    "actuator_gain": "a known weight at the tip, or a passive swing",
    "actuator_delay": "a common clock of camera and motors, such as a light that the command switches",
    "actuator_lag": "a command that sweeps to high frequencies",
    "actuator_saturation": "a ladder of amplitudes",
    "actuator_deadzone": "small commands",
    "backlash": "slow reversals of the load",
    "torque_ripple": "a slow sweep through the whole range",
    "external_push": "the same motion again, untouched",
    "base_motion": "tracking the base and a point of the background",
    "link_flexibility": "a command that sweeps past the link's resonance",
    "drifting_friction": "the first motion again at the end",
    "keypoint_offset": "a measured length of the link",
    "soft_tissue": "fast and slow motion through the same postures",
    "camera_scale": "an object of known size in view",
    "camera_roll": "a plumb line in view of the camera",
    "camera_yaw": "a grid of known size in the plane of motion",
    "lens_distortion": "a grid of known size that fills the picture",
    "clock_rate": "a clock in view of the camera",
    "camera_latency": "a common clock of camera and motors, such as a light that the command switches",
    "rolling_shutter": "the same motion with the camera turned upside down",
    "timestamp_jitter": "a clock in view of the camera",
    "outliers": "the same motion filmed from elsewhere",
    "label_swap": "the same motion with markers that differ",
    "varying_noise": "the same postures held still",
}


def separating_experiment(effects: Sequence[str]) -> str | None:
    """A sentence for rival effects' names; None for fewer than two."""
    wanted = list(dict.fromkeys(SHOWN_BY[name] for name in dict.fromkeys(effects) if name in SHOWN_BY))
    if len(effects) < 2 or not wanted:
        return None
    return "Record " + "; and ".join(wanted) + "."
