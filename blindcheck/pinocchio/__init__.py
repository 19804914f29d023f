"""A second generator of reality: Pinocchio's dynamics, our own integrator, other forms of each effect.

What is tuned to one generator shows on the other. Nothing here knows the effects of `invdyn.models`, either.
"""

from invdyn.blindcheck.pinocchio import bodies_and_motors, dynamics, forms, joint_forces, simulator

__all__ = ["bodies_and_motors", "dynamics", "forms", "joint_forces", "simulator"]
