"""An arm of two links that swings, and what is compared of its answers, by Laplace's method."""

import numpy as np
import torch

from invdyn.inference import pooled
from invdyn.models import ArmModel, Link, planar_body
from invdyn.models.linear_gaussian import LinearGaussian
from invdyn.recordings import Recording

EXACT = 1e-6
"""Relative tolerance: the search for parameters repeats its steps, and rounding is all that differs."""


STEP = 1 / 64  # s, so that sums of times have no rounding
ROWS = 24
NOISE = 0.005
TIPS, JOINTS = ("elbow", "wrist"), ("shoulder", "elbow")
SMALL = {"method": "laplace", "num_filters": 2, "num_draws": 3, "seed": 1}


def arm(lengths=(0.35, 0.3), masses=(1.5, 1.0), tips=TIPS, joints=JOINTS, **options):
    """An arm of two uniform rods."""
    links = [
        Link(f"link{k}", joint, tip, length=length, mass=mass)
        for k, (joint, tip, length, mass) in enumerate(zip(joints, tips, lengths, masses, strict=True))
    ]
    return planar_body("arm", links, **options)


ARM = arm()


def swing(rows=ROWS, seed=0):
    """Angles (T, 2) of a limb that swings, at times (T,), and its keypoints with noise."""
    time = STEP * np.arange(rows)
    angle = np.array([-1.2, 0.8]) + np.array([0.5, 0.6]) * np.sin(np.outer(time, [2.0, 3.0]))
    model = ArmModel(ARM, time)
    tips = model.dynamics.keypoints(torch.as_tensor(angle), model.body_parameters()).numpy()
    points = tips + NOISE * np.random.default_rng(seed).normal(size=tips.shape)
    return angle, Recording(time, points, TIPS, name="swing")


ANGLE, SWING = swing()


def evidence(idata):
    """Log p(y), nats."""
    return idata.attrs["log_evidence"]


def draws(idata, name="torque"):
    """Draws (S, …) of a variable."""
    return pooled(idata)[name].values


def bits(idata):
    """All numbers of a posterior."""
    groups = {group: idata[group].data_vars for group in idata.groups()}
    return {(group, name): own[name].values.tobytes() for group, own in groups.items() for name in own}


def rotated(degrees, dimensions=2):
    """A rotation in the plane of x and y."""
    angle = np.deg2rad(degrees)
    cos, sin = np.cos(angle), np.sin(angle)
    matrix = np.eye(dimensions)
    matrix[:2, :2] = [[cos, -sin], [sin, cos]]
    return matrix


A = torch.tensor([[0.9, 0.2], [-0.1, 0.8]]).double()
Q = torch.tensor([[0.3, 0.1], [0.1, 0.2]]).double()
C = torch.tensor([[1.0, 0.5], [0.2, 1.0], [0.0, 1.0]]).double()
R = torch.diag(torch.tensor([0.1, 0.2, 0.3]).double())
START = torch.tensor([1.0, -1.0]).double()
EYES = torch.eye(2).double(), torch.eye(3).double()


def states(S, T, rows):
    """The model of states S x whose rows are T y; all matrices follow."""
    back = torch.linalg.inv(S)
    return LinearGaussian(S @ A @ back, S @ Q @ S.T, T @ C @ back, T @ R @ T.T, S @ START, S @ S.T, rows)


def simulated(rows):
    """Rows (T, 3) of the model as it is."""
    torch.manual_seed(0)
    return states(*EYES, rows).simulate()[1]
