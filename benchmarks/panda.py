"""A robot with seven joints from its encoders alone: the torques that moved it, against filter-and-differentiate.

The robot is the Franka Emika Panda of `tests/trees.py`, which says where its numbers are from. MuJoCo simulates it,
from our file of it (`write_mjcf`), in steps of 1 ms by Runge–Kutta: a computed torque follows sums of five sinusoids of
.1 to 1 Hz, each with an amplitude of sd .1 rad (as in J. Swevers and others, "Optimal robot excitation and
identification", IEEE Transactions on Robotics and Automation 13, 1997), and white torques of 2 % of each joint's, held
for 50 ms, disturb it. Its encoders are read at 100 Hz with the given noise; torques are hidden. For each seed, rms
errors of torque over joints, N·m, and the share of true torques in the 90 % intervals, of

    ours         `infer` from these encoders: noise, σ_τ and λ fitted; the smoothed mean torque
    hindsight    a Butterworth filter forth and back, differences, inverse dynamics; of 25 cut-offs, one for each joint,
                 those that come nearest to the truth, which no method could know
    residual     the same with Winter's cut-offs, by residual analysis, as one would choose them

and seconds of CPU of ours on one thread. A tenth of the rows at each end does not count: filters end badly there.

    python benchmarks/panda.py [--seeds 3] [--noise 1e-4 1e-3] [--seconds 2] [--torque matern32] [--method laplace]
                               [--results FILE]
"""

import argparse
import sys
import tempfile
import time
import warnings
from functools import partial
from itertools import product
from pathlib import Path

import mujoco
import numpy as np
import torch
from kept import kept

from invdyn.inference import METHODS, infer, pooled
from invdyn.inference.methods.differentiate import derivatives, winter_cutoff
from invdyn.models import TORQUE_PROCESSES, Body, TorqueProcess, dynamics_for, write_mjcf
from invdyn.recordings import Recording, Truth

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from trees import panda

RATE, STEP = 100, 1e-3
MIDDLE = np.array([0.0, -0.3, 0.0, -1.9, 0.0, 1.6, 0.8])
"""rad: a pose in the middle of the joints' ranges."""
CUTOFFS = np.geomspace(1.0, 45.0, 25)
"""Hz."""


def wanted(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frequencies (5,) rad/s, amplitudes (7, 5) rad and phases (7, 5) of the path that it should follow."""
    frequencies = 2 * np.pi * np.linspace(0.1, 1.0, 5)
    return frequencies, 0.1 * rng.normal(size=(7, 5)), rng.uniform(0, 2 * np.pi, (7, 5))


def simulated_case(tree: Body, seed: int, seconds: float) -> Truth:
    """What MuJoCo does with the robot: angles, velocities and torques at the encoders' times."""
    rng = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as folder:
        write_mjcf(tree, Path(folder) / "panda.xml")
        model = mujoco.MjModel.from_xml_path(str(Path(folder) / "panda.xml"))
    model.opt.timestep, model.opt.integrator = STEP, mujoco.mjtIntegrator.mjINT_RK4
    data = mujoco.MjData(model)
    frequencies, amplitudes, phases = wanted(rng)
    every, rows = round(1 / RATE / STEP), round(seconds * RATE)

    def path(t: float, order: int) -> np.ndarray:
        waves = np.sin(frequencies * t + phases + order * np.pi / 2) * frequencies**order
        return (amplitudes * waves).sum(1) + (MIDDLE if order == 0 else 0.0)

    data.qpos[:], data.qvel[:] = path(0.0, 0), path(0.0, 1)
    typical, kept = np.zeros(7), []
    for step in range(rows * every):
        t = step * STEP
        off, slip = path(t, 0) - data.qpos, path(t, 1) - data.qvel
        data.qacc[:] = path(t, 2) + 400 * off + 40 * slip
        mujoco.mj_inverse(model, data)
        computed = data.qfrc_inverse.copy()
        typical = np.maximum(typical, np.abs(computed))
        if step % 50 == 0:
            push = 0.02 * typical * rng.normal(size=7)
        data.qfrc_applied[:] = computed + push
        if step % every == 0:
            kept.append(np.stack([data.qpos, data.qvel, data.qfrc_applied]))
        mujoco.mj_step(model, data)
    angle, velocity, torque = np.array(kept).swapaxes(0, 1)
    return Truth(np.arange(rows) / RATE, angle, velocity, torque, tree.joint_names)


def score(tree: Body, seed: int, noise: float, seconds: float, torque: TorqueProcess, method: str) -> dict[str, float]:
    truth = simulated_case(tree, seed, seconds)
    measured = truth.angle + noise * np.random.default_rng(seed + 1000).normal(size=truth.angle.shape)
    recording = Recording(
        truth.time, np.empty((len(truth.time), 0, 3)), (), angles=measured, joint_names=tree.joint_names
    )
    began = time.process_time()
    sizes = {"num_filters": 16, "num_particles": 100, "num_draws": 8}
    idata = infer(recording, tree, truth=truth, torque=torque, method=method, seed=seed, **sizes)
    took = time.process_time() - began
    draws = pooled(idata)["torque"].transpose("sample", "time", "joint").values
    counted = slice(len(truth.time) // 10, -(len(truth.time) // 10))
    true = truth.torque[counted]
    low, high = np.quantile(draws, [0.05, 0.95], axis=0)[:, counted]

    def off(found: np.ndarray) -> np.ndarray:
        return np.sqrt(((found[counted] - true) ** 2).mean(0))

    def differentiated(cutoffs: np.ndarray) -> np.ndarray:
        state = [torch.tensor(x) for x in derivatives(truth.time, measured, cutoffs)]
        return dynamics_for(tree).inverse(*state, tree.parameters()).numpy()

    hindsight = np.min([off(differentiated(np.full(7, cutoff))) for cutoff in CUTOFFS], axis=0)
    residual = off(differentiated(winter_cutoff(truth.time, measured)))
    ours = off(draws.mean(0))
    return {
        "noise, rad": noise,
        "rms of true torque": float(np.sqrt((true**2).mean())),
        "ours": float(np.sqrt((ours**2).mean())),
        "hindsight": float(np.sqrt((hindsight**2).mean())),
        "residual": float(np.sqrt((residual**2).mean())),
        "joints nearer than hindsight": int((ours < hindsight).sum()),
        "90 % covers": float(((low <= true) & (true <= high)).mean()),
        "outer ESS of 16": idata.attrs["outer_ess"],
        "CPU s": took,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--noise", type=float, nargs="+", default=[1e-4, 1e-3])
    parser.add_argument("--seconds", type=float, default=2.0)
    usual = ["ornstein_uhlenbeck", "matern32"]
    parser.add_argument("--torque", nargs="+", choices=sorted(TORQUE_PROCESSES), default=usual)
    parser.add_argument("--method", choices=sorted(METHODS), default="smc")
    parser.add_argument("--results", type=Path)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    warnings.filterwarnings("ignore", category=UserWarning)
    method, seconds, started = arguments.method, arguments.seconds, False
    print(f"{seconds:g} s of encoders at {RATE} Hz, {method}, {arguments.seeds} seeds\n")
    for process, noise in product(arguments.torque, arguments.noise):
        rows = []
        for seed in range(arguments.seeds):
            case = f"{process} {method} {seconds:g} {noise:g} {seed}"
            make = partial(score, panda(), seed, noise, seconds, TORQUE_PROCESSES[process](), method)
            rows.append(kept(arguments.results, case, make))
        if not started:
            print(f"| torque process | {' | '.join(rows[0])} |\n|{'---|' * (len(rows[0]) + 1)}")
            started = True
        means = np.mean([list(row.values()) for row in rows], 0)
        print(f"| {process} | {' | '.join(f'{value:.3g}' for value in means)} |", flush=True)


if __name__ == "__main__":
    main()
