"""A pendulum under friction, and a wheel: a linear-Gaussian chain whose answers are exact."""

from functools import cache

import numpy as np
import torch
from oracles import Chain

from invdyn.diagnosis import diagnose
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.problem.regime import COMMANDED, PASSIVE
from invdyn.inference.smoothing.gauss_newton import gauss_newton
from invdyn.models import Link, planar_body
from invdyn.models.effects import EFFECTS
from invdyn.recordings import Recording
from invdyn.simulate import random_arm, record

LOOSE = COMMANDED.path_size
ROD = Link("rod", "pivot", "tip", length=0.3, mass=1.0)
PENDULUM = planar_body("pendulum", [ROD], gravity=(0.0, -9.81))
UPPER, FORE = Link("upper_arm", "shoulder", "elbow", 0.3, 1.5), Link("forearm", "elbow", "wrist", 0.25, 1.0)
ARM = planar_body("arm", [UPPER, FORE], gravity=(0.0, -9.81))
FRICTION = EFFECTS["viscous_friction"]("pivot")
DAMPING = 0.05
FEW = {"viscous_friction", "coulomb_friction", "drifting_friction", "joint_stiffness", "payload", "gravity_tilt"}
FEW |= {"camera_roll", "camera_scale", "keypoint_offset", "varying_noise"}
MANY = tuple(name for name in EFFECTS if name not in FEW)
"""Effects that a test leaves out of the catalogue where the whole of it would take long and show no more."""
ALL_BUT_THREE = tuple(name for name in EFFECTS if name not in {"viscous_friction", "payload", "camera_roll"})
WHEEL = planar_body(
    "wheel", [Link("rod", "pivot", "tip", length=0.3, mass=1.0, com=0.15, inertia=0.0075)], gravity=(0, 0)
)
INERTIA = 0.03  # about the pivot
BRAKE = 0.02


ARMS = {}


def commanded(body=PENDULUM, rows=80, effort=0.5, seed=0):
    """An arm under known commands, filmed with 2 mm of noise: one for all tests, as to draw its commands takes long."""
    key = id(body), rows, effort, seed
    if key not in ARMS:
        arm = random_arm(body, duration=rows / 50, fps=50, noise=0.002, torque_scale=effort, commanded=True, seed=seed)
        ARMS[key] = arm, body  # kept, so that no other body gets its id
    return ARMS[key][0]


def recorded(damping=0.0, seed=0, mass=1.0, rows=80):
    """A pendulum under known commands, filmed with 2 mm of noise."""
    arm = commanded(PENDULUM if mass == 1.0 else PENDULUM.with_values(mass=[mass]), rows, seed=seed)
    values = {"effect.viscous_friction.pivot.damping": torch.tensor([damping], dtype=torch.float64)}
    return record(arm.with_effects(FRICTION).replace(**values), seed)[0]


def recording_of(effect=None, body=PENDULUM, rows=80, effort=0.5, seed=0, **values):
    """A recording of a body with an effect at these values, under known commands, filmed with 2 mm of noise."""
    arm = commanded(body, rows, effort, seed)
    if effect is not None:
        named = {f"effect.{effect.key}.{name}": torch.tensor([v], dtype=torch.float64) for name, v in values.items()}
        arm = arm.with_effects(effect).replace(**named)
    return record(arm, seed)[0]


def driven(*effects, rows=80, **values):
    """A pendulum with effects at values "<effect>_<parameter>", under known commands, filmed with 2 mm of noise."""
    arm = commanded(rows=rows)
    parts = [EFFECTS[name]("pivot") for name in effects]
    given = {n: v for part in parts for n, v in values.items() if n.startswith(part.name)}
    named = {f"effect.{n.rpartition('_')[0]}.pivot.{n.rpartition('_')[2]}": v for n, v in given.items()}
    arm = arm.with_effects(*parts).replace(**{n: torch.tensor([v], dtype=torch.float64) for n, v in named.items()})
    return record(arm, 0)[0]


def path_of(here):
    return gauss_newton(here.with_residual(LOOSE), here.observations).path


@cache
def causes(damping=DAMPING):
    """The pendulum's problem, "no effect" and viscous friction."""
    here = diagnosis_problem(recorded(damping), PENDULUM)
    path = path_of(here)
    return here, refine(here, (), {}, path, LOOSE), refine(here, (FRICTION,), {}, path, LOOSE)


@cache
def diagnosed():
    """What is said of the pendulum when it rubs and nobody knows: for tests that look at it from several sides."""
    return diagnose(recording_of(FRICTION, damping=DAMPING), PENDULUM, without=ALL_BUT_THREE)


@cache
def wheel(commanded=False):
    """A wheel that turns freely but for viscous friction, seen by an encoder: a linear-Gaussian chain."""
    rng = np.random.default_rng(0)
    time = 0.02 * np.arange(60)
    angle = 0.3 + 2.0 * INERTIA / BRAKE * -np.expm1(-BRAKE / INERTIA * time) + 0.002 * rng.normal(size=60)
    torques = np.zeros((60, 1)) if commanded else None
    recording = Recording(
        time, np.zeros((60, 0, 2)), (), angles=angle[:, None], torques=torques, joint_names=("pivot",)
    )
    return diagnosis_problem(recording, WHEEL, passive=not commanded)


def wheel_chain(model, kappa=1.0, damping=0.0):
    """The same as numbers: Runge–Kutta steps on unit vectors, the torque on a straight line within a row.

    All noise is ``kappa`` times as large, but for what is not known of the torque where it begins.
    """
    p = {name: value.numpy() for name, value in model.parameters.items()}
    dt, steps = 0.02, model.substeps
    keep = np.exp(-PASSIVE.decay * dt)

    def rate(state, s, torque):
        return np.array([state[1], (torque * (1 - s + s * keep) - damping * state[1]) / INERTIA])

    columns = []
    for torque, *state in np.eye(3):
        state, h = np.array(state), dt / steps
        for i in range(steps):
            s = i / steps
            k1 = rate(state, s, torque)
            k2 = rate(state + h / 2 * k1, s + 0.5 / steps, torque)
            k3 = rate(state + h / 2 * k2, s + 0.5 / steps, torque)
            k4 = rate(state + h * k3, s + 1 / steps, torque)
            state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        columns.append([keep * torque, *state])
    stationary = p["torque.scale"].item() / np.sqrt(2 * PASSIVE.decay)
    noise = [stationary * np.sqrt(1 - keep**2), p["noise.angle"].item(), p["noise.velocity"].item()]
    begun = np.hypot(stationary, p.get("torque.initial_scale", np.zeros(1)).item())
    first = [begun, p["initial.angle_scale"].item(), p["initial.velocity_scale"].item()]
    sd = p["emission.angle_scale"].item()
    return Chain(
        np.array(columns).T,
        np.diag(np.square(noise)) * kappa**2,
        np.array([[0.0, 1.0, 0.0]]),
        np.array([[sd**2]]) * kappa**2,
        np.array([0.0, p["initial.angle"].item(), p["initial.velocity"].item()]),
        np.diag(np.square(first)) * kappa**2,
    )


def at_best(here, cause):
    """A cause's log evidence at its best size without memory of errors, and that size."""
    top = int(cause.by_size.argmax())
    levels = here.regime.sizes
    return cause.by_size[top] - here.regime.log_prior[top] - cause.of_memory, levels[top]
