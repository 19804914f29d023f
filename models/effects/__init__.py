"""What a real arm has and an ideal rigid body lacks, one effect a file; all of them in :mod:`.catalogue`."""

from invdyn.models.effects.actuator import Actuator
from invdyn.models.effects.actuator_deadzone import ActuatorDeadzone
from invdyn.models.effects.actuator_delay import ActuatorDelay
from invdyn.models.effects.actuator_gain import ActuatorGain
from invdyn.models.effects.actuator_lag import ActuatorLag
from invdyn.models.effects.actuator_saturation import ActuatorSaturation
from invdyn.models.effects.armature import Armature
from invdyn.models.effects.backlash import Backlash
from invdyn.models.effects.base import Effect, Parameter, Values, effect_name
from invdyn.models.effects.base_motion import BaseMotion
from invdyn.models.effects.camera_latency import CameraLatency
from invdyn.models.effects.camera_roll import CameraRoll
from invdyn.models.effects.camera_scale import CameraScale
from invdyn.models.effects.camera_yaw import CameraYaw
from invdyn.models.effects.catalogue import EFFECTS
from invdyn.models.effects.clock_rate import ClockRate
from invdyn.models.effects.command import Command
from invdyn.models.effects.composition import PREFIX, Composition, own_values
from invdyn.models.effects.coulomb_friction import CoulombFriction
from invdyn.models.effects.drifting_friction import DriftingFriction
from invdyn.models.effects.effect_context import Situation
from invdyn.models.effects.external_push import ExternalPush
from invdyn.models.effects.gravity_tilt import GravityTilt
from invdyn.models.effects.hidden import Follower, HiddenHinge
from invdyn.models.effects.inertial_error import InertialError
from invdyn.models.effects.joint_coupling import JointCoupling
from invdyn.models.effects.joint_limit import JointLimit
from invdyn.models.effects.joint_stiffness import JointStiffness
from invdyn.models.effects.keypoint_offset import KeypointOffset
from invdyn.models.effects.label_swap import LabelSwap
from invdyn.models.effects.lens_distortion import LensDistortion
from invdyn.models.effects.link_flexibility import LinkFlexibility
from invdyn.models.effects.load_friction import LoadFriction
from invdyn.models.effects.outliers import Outliers
from invdyn.models.effects.payload import Payload
from invdyn.models.effects.quadratic_drag import QuadraticDrag
from invdyn.models.effects.rolling_shutter import RollingShutter
from invdyn.models.effects.scale import Scale
from invdyn.models.effects.soft_tissue import SoftTissue
from invdyn.models.effects.stribeck_friction import StribeckFriction
from invdyn.models.effects.timestamp_jitter import TimestampJitter
from invdyn.models.effects.torque_ripple import TorqueRipple
from invdyn.models.effects.varying_noise import VaryingNoise
from invdyn.models.effects.viscous_friction import ViscousFriction
from invdyn.models.observation.view import View

__all__ = [
    "EFFECTS",
    "PREFIX",
    "Actuator",
    "ActuatorDeadzone",
    "ActuatorDelay",
    "ActuatorGain",
    "ActuatorLag",
    "ActuatorSaturation",
    "Armature",
    "Backlash",
    "BaseMotion",
    "CameraLatency",
    "CameraRoll",
    "CameraScale",
    "CameraYaw",
    "ClockRate",
    "Command",
    "Composition",
    "CoulombFriction",
    "DriftingFriction",
    "Effect",
    "ExternalPush",
    "Follower",
    "GravityTilt",
    "HiddenHinge",
    "InertialError",
    "JointCoupling",
    "JointLimit",
    "JointStiffness",
    "KeypointOffset",
    "LabelSwap",
    "LensDistortion",
    "LinkFlexibility",
    "LoadFriction",
    "Outliers",
    "Parameter",
    "Payload",
    "QuadraticDrag",
    "RollingShutter",
    "Scale",
    "Situation",
    "SoftTissue",
    "StribeckFriction",
    "TimestampJitter",
    "TorqueRipple",
    "Values",
    "VaryingNoise",
    "View",
    "ViscousFriction",
    "effect_name",
    "own_values",
]
