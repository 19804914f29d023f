"""Recordings of an arm whose torques have known effects, for tests of the regression."""

from dataclasses import replace

import numpy as np

from invdyn.diagnosis.regression.linear_effects import expected, linear_effects
from invdyn.diagnosis.regression.low_pass import cutoff_of
from invdyn.diagnosis.regression.measured_motion import measured_motion
from invdyn.diagnosis.regression.regressors import inverse
from invdyn.diagnosis.regression.servo_gains import ServoGains
from invdyn.diagnosis.regression.weighted_fit import weighted_fit
from invdyn.diagnosis.rules import DEFAULT
from invdyn.models import Link, planar_body
from invdyn.models.bodies.joint_parts import JointParts
from invdyn.models.dynamics.registry import dynamics_for
from invdyn.recordings import Recording

BODY = planar_body(
    "arm",
    [Link("upper", "shoulder", "elbow", 0.4, 1.5), Link("fore", "elbow", "wrist", 0.3, 0.8)],
    gravity=(0.0, -9.81),
)
RATE = 200.0
FOUR = ("viscous_friction", "coulomb_friction", "joint_stiffness", "actuator_gain")
SAME = ServoGains(np.ones(2))


class Motion:
    """Sums of sines (T, 2), exactly."""

    def __init__(self, seed, seconds=6.0):
        rng = np.random.default_rng(seed)
        self.time = np.arange(0, seconds, 1 / RATE)
        w = 2 * np.pi * rng.uniform(0.15, 1.2, (5, 2))
        a, phase = rng.uniform(0.3, 1.0, (5, 2)) / w, rng.uniform(0, 2 * np.pi, (5, 2))
        angle = self.time[:, None, None] * w + phase
        self.q = (a * np.sin(angle)).sum(1) - np.array([1.2, 0.0])
        self.qd = (a * w * np.cos(angle)).sum(1)
        self.qdd = -(a * w**2 * np.sin(angle)).sum(1)


def recorded(seed, extra, body=BODY, noise=3e-4, torque_noise=0.05, seconds=6.0):
    """A recording of a body along such a motion with ``extra(motion)`` N·m besides."""
    motion = Motion(seed, seconds)
    rng = np.random.default_rng(seed + 1000)
    torque = inverse(dynamics_for(body), body.parameters(), motion) + extra(motion)
    torque = torque + torque_noise * rng.standard_normal(torque.shape)
    seen = motion.q + noise * rng.standard_normal(motion.q.shape)
    names = BODY.joint_names
    return Recording(motion.time, np.empty((len(seen), 0, 2)), (), angles=seen, torques=torque, joint_names=names)


def friction(m):
    return np.array([0.3, 0.1]) * m.qd + np.array([0.5, 0.25]) * np.sign(m.qd)


def found(result):
    return {(e.effect, e.place, e.parameter): e for e in result.numbers}


PARTS = JointParts(damping=0.4, friction=0.2, stiffness=2.0)
FILED = replace(BODY, links=tuple(replace(link, parts=PARTS) for link in BODY.links))


def of_parts(m):
    return 0.4 * m.qd + 0.2 * np.sign(m.qd) + 2.0 * m.q


def fitted_plainly(rows, body, kinds, others=False, tolerance=DEFAULT.evidence.tolerance):
    """Columns, and a fit of ``kinds`` at all places."""
    motion, dynamics = measured_motion(rows, body), dynamics_for(body)
    along = expected(dynamics, body, motion, False)
    rules = DEFAULT.replace(tolerance=tolerance)
    effects = linear_effects(body, motion, along, False, rules, cutoff_of(motion))
    return effects, weighted_fit(effects, motion, rules, kinds, others=others)


def by_name(numbers):
    return {(each.effect, each.place, each.parameter): each for each in numbers}
