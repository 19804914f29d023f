"""Motions that `invdyn excite` designs, against multisines: what a regression learns of a robot from either.

The robot is the Panda, simulated by MuJoCo. Its file lacks viscous and dry friction at all seven joints and .8 kg at
the flange, and two motors give more or less than they are told to. It follows a motion of 20 s under the file's own
inverse dynamics and a PD controller; the log has encoders and commanded torques at 200 rows a second. A multisine has
five waves of random phase at each joint (.1 to .5 Hz), as large as the same limits allow.

    friction    joints, of seven, whose dry and viscous friction are right to 20 %
    mass        what is recovered of the added mass in the base parameter that has most of it
    gains       the largest error of both gains, in the gain's own units

    python benchmarks/excite.py [--seeds 5]
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

import mujoco
import numpy as np
import torch

from invdyn.diagnosis import design_motion
from invdyn.diagnosis.catalogue.linear_laws import FRICTION, INERTIAL
from invdyn.diagnosis.excite.limits import MotionLimits
from invdyn.diagnosis.regression.regress import regress
from invdyn.diagnosis.regression.stated_numbers import Estimated
from invdyn.models.bodies.inertia import NAMES
from invdyn.models.bodies.mjcf_writer import write_mjcf
from invdyn.models.bodies.point_mass import point_moments
from invdyn.models.bodies.protocol import AXES
from invdyn.models.dynamics.registry import dynamics_for
from invdyn.recordings import Recording

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from trees import panda

STEP, RATE, SECONDS = 5e-4, 200, 20.0
BANDWIDTH = 25.0  # rad/s, of the PD controller
LIMITS = MotionLimits(
    np.array([-2.7, -1.6, -2.7, -2.9, -2.7, 0.1, -2.7]),
    np.array([2.7, 1.6, 2.7, -0.2, 2.7, 3.6, 2.7]),
    np.full(7, 1.2),
    np.full(7, 4.0),
    np.array([80, 80, 80, 80, 11, 11, 11.0]),
    np.array([[-np.inf, np.inf], [-np.inf, np.inf], [0.05, np.inf]]),
)
ADDED = 0.8


def multisine(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Times and angles (R, 7): random phases, the largest swings that ranges, speeds and space allow."""
    rng = np.random.default_rng(seed)
    t = np.arange(0, SECONDS, 0.01)
    w = 2 * np.pi * np.array([0.1, 0.2, 0.3, 0.4, 0.5])
    waves = np.sin(w[:, None, None] * t[:, None] + rng.uniform(0, 2 * np.pi, (5, 1, 7))).sum(0)
    rise = np.clip(np.minimum(t, SECONDS - t) / 1.5, 0, 1)
    waves = waves * (rise**3 * (10 - 15 * rise + 6 * rise**2))[:, None]
    waves = waves / np.maximum(
        np.abs(waves).max(0) / LIMITS.half, np.abs(np.gradient(waves, 0.01, axis=0)).max(0) / LIMITS.speed
    )
    body = panda()
    dynamics, p = dynamics_for(body), body.parameters()
    share = 1.0
    while True:
        q = LIMITS.middle + share * waves
        points = dynamics.keypoints(torch.as_tensor(q), p).numpy()
        if (points[..., 2] > LIMITS.space[2, 0]).all():
            return t, q
        share *= 0.95


def recorded(time_of: np.ndarray, angles: np.ndarray, seed: int, folder: Path) -> tuple[Recording, dict]:
    """The log of the real robot along a motion, and its truth."""
    rng = np.random.default_rng(seed)
    body = panda()
    load = np.array([87, 87, 87, 87, 12, 12, 12.0])
    truth = {
        "coulomb_friction": rng.uniform(0.006, 0.02, 7) * load,
        "viscous_friction": rng.uniform(0.004, 0.015, 7) * load,
        "gain": np.ones(7),
    }
    truth["gain"][rng.choice(7, 2, replace=False)] = rng.choice([0.88, 0.92, 1.08, 1.12], 2, replace=False)
    path = folder / "panda.xml"
    write_mjcf(body, path)
    spec = mujoco.MjSpec.from_file(str(path))
    model = spec.compile()
    model.opt.timestep = STEP
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    model.dof_frictionloss[:], model.dof_damping[:] = truth["coulomb_friction"], truth["viscous_friction"]
    flange = model.nbody - 1
    model.body_mass[flange] += ADDED
    mujoco.mj_setConst(model, mujoco.MjData(model))
    data = mujoco.MjData(model)
    every = round(1 / RATE / STEP)
    steps = round(SECONDS / STEP)
    t = np.arange(steps) * STEP
    want = np.stack([np.interp(t, time_of, angles[:, k]) for k in range(7)], 1)
    kernel = np.hanning(101) / np.hanning(101).sum()  # interpolated lines have corners
    want = np.stack([np.convolve(np.pad(w, 50, "edge"), kernel, "valid") for w in want.T], 1)
    speed = np.gradient(want, STEP, axis=0)
    rise = np.gradient(speed, STEP, axis=0)
    given = [torch.as_tensor(each) for each in (want, speed, rise)]
    ahead = dynamics_for(body).inverse(*given, body.parameters()).numpy()
    poses = torch.as_tensor(want[::2000])
    inertia = dynamics_for(body).inertia_matrix(poses, body.parameters()).diagonal(dim1=1, dim2=2).numpy().mean(0)
    data.qpos[:] = want[0]
    rows, commands = [], []
    for at in range(steps):  # the controller runs at each step; the log has the command's mean over a row
        if at % every == 0:
            rows.append(data.qpos.copy())
            commands.append(np.zeros(7))
        off = BANDWIDTH**2 * (want[at] - data.qpos) + 2 * BANDWIDTH * (speed[at] - data.qvel)
        command = ahead[at] + inertia * off
        commands[-1] += command / every
        data.qfrc_applied[:] = truth["gain"] * command
        mujoco.mj_step(model, data)
    seen = np.array(rows) + 5e-5 * rng.standard_normal((len(rows), 7))
    torque = np.array(commands)
    log = Recording(
        np.arange(len(rows)) / RATE,
        np.empty((len(rows), 0, 3)),
        (),
        angles=seen,
        torques=torque,
        joint_names=body.joint_names,
    )
    return log, truth


def added_share(number: Estimated) -> tuple[float, float]:
    """By how much the added mass changes a base parameter, and which share of that the estimate has."""
    last = panda().links[-1]
    c = np.array(last.com)
    moments = point_moments(torch.as_tensor(c)).numpy()
    changes = {f"mass of {last.name}": ADDED}
    changes |= {f"first moment {a} of {last.name}": ADDED * v for a, v in zip(AXES, c, strict=True)}
    changes |= {f"second moment {a} of {last.name}": ADDED * v for a, v in zip(NAMES, moments, strict=True)}
    parts = {f"{number.parameter} of {number.place}": 1.0, **number.known_with}
    change = sum(factor * changes.get(name, 0.0) for name, factor in parts.items())
    return change, (number.value - number.of_file) / change if change else 0.0


def scored(log: Recording, truth: dict) -> dict[str, float]:
    """What a regression of the log has right."""
    joints = panda().joint_names
    began = time.process_time()
    found = regress(log, panda())
    seconds = time.process_time() - began
    own = {(e.effect, e.place): e.value for e in found.numbers if e.effect != INERTIAL}
    right = [
        all(abs(own.get((kind, joint), 0.0) - truth[kind][k]) <= 0.2 * truth[kind][k] for kind in FRICTION)
        for k, joint in enumerate(joints)
    ]
    gains = [1 + own.get(("actuator_gain", joint), 0.0) for joint in joints]
    moments = [added_share(e) for e in found.numbers if e.effect == INERTIAL and e.parameter.startswith("first")]
    mass = max(moments, key=lambda pair: abs(pair[0]), default=(0.0, 0.0))[1]
    return {
        "friction": float(sum(right)),
        "mass": mass,
        "gain error": float(np.abs(np.array(gains) - truth["gain"]).max()),
        "closed": found.torque.share,
        "CPU s": seconds,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5)
    options = parser.parse_args()
    torch.set_num_threads(1)
    rows: dict[str, list[dict[str, float]]] = {"designed": [], "multisine": []}
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(options.seeds):
            began = time.process_time()
            design = design_motion(panda(), limits=LIMITS, seconds=SECONDS, seed=seed)
            spent = time.process_time() - began
            for name, motion in (("designed", (design.time, design.angle)), ("multisine", multisine(seed))):
                scores = scored(*recorded(*motion, seed, Path(folder)))
                rows[name].append(scores | ({"design, CPU s": spent} if name == "designed" else {}))
                print(seed, name, {key: round(value, 3) for key, value in rows[name][-1].items()}, flush=True)
    names = list(rows["designed"][0])
    print(f"\n| mean of {options.seeds} robots | {' | '.join(names)} |\n|{'---|' * (len(names) + 1)}")
    for name, every in rows.items():
        means = [np.mean([each[key] for each in every]) if key in every[0] else np.nan for key in names]
        print(f"| {name} | {' | '.join('' if np.isnan(x) else f'{x:.3g}' for x in means)} |")


if __name__ == "__main__":
    main()
