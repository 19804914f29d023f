"""Bodies in space to try the dynamics on, and the same in MuJoCo and Pinocchio."""

import math

import numpy as np
import pytest
import torch

from invdyn.models.bodies.dh import Inertial, Row, from_dh
from invdyn.models.bodies.joints import Joint
from invdyn.models.bodies.tree import SpatialLink, Tree

F64 = torch.float64
UPRIGHT = ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0))


def paper_arm(gravity=(0.0, 0.0, -1.0)):
    """The paper's arm in space: two joints with yaw and pitch, uniform thin rods of unit length."""
    return Tree(
        "paper's arm",
        [
            SpatialLink("upper_arm", Joint("shoulder", "universal"), length=1.0, tip="elbow_tip", mass=0.5),
            SpatialLink("forearm", Joint("elbow", "universal"), "upper_arm", length=1.0, tip="wrist", mass=0.3),
        ],
        gravity,
    )


def panda():
    """The Franka Emika Panda without its hand.

    Geometry: the maker's table of Denavit and Hartenberg, modified (frankaemika.github.io/docs/control_parameters).
    Inertial numbers: C. Gaz, M. Cognetti, A. Oliva, P. Robuffo Giordano, A. De Luca, "Dynamic identification of the
    Franka Emika Panda robot with retrieval of feasible parameters using penalty-based optimization", IEEE Robotics and
    Automation Letters 4 (2019), as printed in franka_description/robots/fer/inertials.yaml (Apache-2.0).
    """
    right = math.pi / 2
    table = [(0, 0, 0.333), (0, -right, 0), (0, right, 0.316), (0.0825, right, 0)]
    table += [(-0.0825, -right, 0.384), (0, right, 0), (0.088, right, 0)]
    inertials = [
        (4.970684, (0.003875, 0.002081, -0.04762), (0.70337, 0.70661, 0.009117, -0.000139, 0.006772, 0.019169)),
        (0.646926, (-0.003141, -0.02872, 0.003495), (0.007962, 0.02811, 0.025995, -0.003925, 0.010254, 0.000704)),
        (3.228604, (0.027518, 0.039252, -0.066502), (0.037242, 0.036155, 0.01083, -0.004761, -0.011396, -0.012805)),
        (3.587895, (-0.05317, 0.104419, 0.027454), (0.025853, 0.019552, 0.028323, 0.007796, -0.001332, 0.008641)),
        (1.225946, (-0.011953, 0.041065, -0.038437), (0.035549, 0.029474, 0.008627, -0.002117, -0.004037, 0.000229)),
        (1.666555, (0.060149, -0.014117, -0.010517), (0.001964, 0.004354, 0.005433, 0.000109, -0.001158, 0.000341)),
        (0.735522, (0.010517, -0.004252, 0.061597), (0.012516, 0.010027, 0.004815, -0.000428, -0.001196, -0.000741)),
    ]
    return from_dh("panda", [Row(*row) for row in table], [Inertial(*own) for own in inertials], tip="flange")
