"""Effects that torque is linear in, of which a regression of a robot's log has columns (:mod:`..regression`).

At each joint the columns are, in the order of :data:`JOINT_KINDS`: q̇; sgn q̇; q̈; q and a constant, −1; a constant, 1;
the torque that the file asks for. Those of links come last.
"""

INERTIAL, GAIN, DAMPING = "inertial_error", "actuator_gain", "viscous_friction"
FRICTION = (DAMPING, "coulomb_friction")
JOINT_KINDS = {
    "viscous_friction": (("damping", "N·m·s/rad"),),
    "coulomb_friction": (("torque", "N·m"),),
    "armature": (("inertia", "kg·m²"),),
    "joint_stiffness": (("stiffness", "N·m/rad"), ("torque", "N·m")),
    "constant_torque": (("torque", "N·m"),),
    "actuator_gain": (("gain", "1"),),
}
"""By effect, parameter and unit of each of its columns."""
WITHIN = {"constant_torque": "joint_stiffness"}
"""Effects whose column is among those of another."""
LINK_MASS = "link_mass"
"""Of a regression alone: all numbers of a link off by one factor, which is one column in place of three or ten."""
CONTAINED = WITHIN | {"coulomb_friction": "stribeck_friction", LINK_MASS: INERTIAL}
"""The same of all effects that a regression examines: a joint has one of the two."""
FILED = {
    "viscous_friction": "damping",
    "coulomb_friction": "friction",
    "armature": "armature",
    "joint_stiffness": "stiffness",
}
"""Of numbers that are never negative, what a body's file says of each joint."""
LOWER_BOUNDS = {GAIN: -0.9}
"""Of other numbers: what is commanded for a torque has its sign."""
USUAL = (*FRICTION, "armature")
"""What a robot's file usually lacks at every joint."""
ODD = ("actuator_saturation", "joint_limit", "joint_coupling")
"""Of effects that may be there besides these, those that imitate them where they are left out."""
SHOWN_BY = {"payload": INERTIAL, "stribeck_friction": "coulomb_friction", "load_friction": "coulomb_friction"}
"""Effects of the catalogue that torque is nearly linear in, by the kind that tells of them."""
