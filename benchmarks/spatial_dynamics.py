"""Dynamics of bodies in space side by side: particle-steps a core-second, all in one run, on one thread.

A step is one forward dynamics and one semi-implicit Euler step, of arms of 4 joints (the paper's, its rods with a
little inertia about themselves, which MuJoCo needs), 7 (the Panda) and 12 (that, and its first five links again), by

    torch           this project, eager, float32
    compiled        this project, as machine code, float32 and float64; compiling comes before the clock starts, and is
                    told
    gradient        this project, eager, float32, with the derivative of Σ q̈ by q, q̇ and τ
    MuJoCo          mujoco.rollout, float64, no contacts, no constraints, torques applied at the joints
    Pinocchio       its articulated bodies alone, float64, without a step: a loop in C++ where the wheel has one
                    (abaInParallel with one thread), else in Python

Body parameters are arguments of ours, constants of the engines'. They take turns; the best time of each counts, seconds
of CPU. The first table has operations a step, with the numbers of the body alone not counted.

    python benchmarks/spatial_dynamics.py [--particles 1000 10000 100000] [--turns 5]
"""

import argparse
import dataclasses
import math
import sys
import time
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import torch
from mujoco import rollout

from invdyn.models.bodies.body import Body
from invdyn.models.dynamics.spatial.dynamics import SpatialDynamics

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from trees import MuJoCo, panda, paper_arm, pinocchio_of, random_state, twelve_joints

DT = 1e-3


def arms() -> list[Body]:
    rod = (0.001, 0.04, 0.04, 0.0, 0.0, 0.0)
    paper = paper_arm()
    links = [dataclasses.replace(link, inertia=rod) for link in paper.links]
    return [Body("paper's arm", links, paper.gravity), panda(), twelve_joints()]


def ours(tree: Body, N: int, dtype: torch.dtype, compile_after: float, gradient: bool = False) -> Callable:
    dynamics, p = SpatialDynamics(tree, compile_after), tree.parameters(dtype)
    state = [x.movedim(-1, 0).contiguous().movedim(0, -1) for x in random_state(tree.num_joints, 0, (N,), dtype)]

    def step():
        q, qd, tau = state
        if gradient:
            inputs = [x.detach().requires_grad_() for x in state]
            torch.autograd.grad(dynamics.forward(*inputs, p).sum(), inputs)
            return
        qd = qd + DT * dynamics.forward(q, qd, tau, p)
        q + DT * qd

    return step


def by_mujoco(tree: Body, N: int) -> Callable:
    engine = MuJoCo(tree)
    model = engine.model
    model.opt.timestep = DT
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT) | int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    model.opt.enableflags = 0
    q, qd, tau = (x.numpy() for x in random_state(tree.num_joints, 0, (N,)))
    states = np.concatenate([np.zeros((N, 1)), q, qd], 1)
    spec = int(mujoco.mjtState.mjSTATE_QFRC_APPLIED)
    data = mujoco.MjData(model)
    return lambda: rollout.rollout(model, data, states, tau[:, None], control_spec=spec, skip_checks=False)


def by_pinocchio(tree: Body, N: int) -> Callable:
    pin, model, _ = pinocchio_of(tree)
    q, qd, tau = (np.asfortranarray(x.numpy().T) for x in random_state(tree.num_joints, 0, (N,)))
    if hasattr(pin, "abaInParallel"):
        pool, out = pin.ModelPool(model, 1), np.zeros_like(q, order="F")
        return lambda: pin.abaInParallel(1, pool, q, qd, tau, out)
    data, states = model.createData(), list(zip(q.T.copy(), qd.T.copy(), tau.T.copy(), strict=True))

    def loop():
        for state in states:
            pin.aba(model, data, *state)

    return loop


def _seconds(step: Callable) -> float:
    began = time.process_time()
    step()
    return time.process_time() - began


def rates(steps: dict[str, Callable], N: int, turns: int) -> dict[str, float]:
    """Million particle-steps a core-second, the best of the turns."""
    best = dict.fromkeys(steps, np.inf)
    for _ in range(turns):
        for name, step in steps.items():
            repeats = max(1, 20_000 // N)
            began = time.process_time()
            for _ in range(repeats):
                step()
            best[name] = min(best[name], (time.process_time() - began) / repeats)
    return {name: N / seconds / 1e6 for name, seconds in best.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--particles", type=int, nargs="+", default=[1_000, 10_000, 100_000])
    parser.add_argument("--turns", type=int, default=5)
    args = parser.parse_args()
    torch.set_num_threads(1)
    methods = ("forward", "inverse", "inertia_matrix", "keypoints", "jacobian")
    print(f"| operations | {' | '.join(methods)} |\n|---|{'---|' * len(methods)}")
    for tree in arms():
        dynamics = SpatialDynamics(tree)
        print(f"| K = {tree.num_joints} | {' | '.join(str(dynamics.operations(m)) for m in methods)} |")
    for tree in arms():
        for N in args.particles:
            steps = {
                "torch": ours(tree, N, torch.float32, math.inf),
                "gradient": ours(tree, N, torch.float32, math.inf, gradient=True),
                "compiled 32": ours(tree, N, torch.float32, 0),
                "compiled 64": ours(tree, N, torch.float64, 0),
                "MuJoCo": by_mujoco(tree, N),
                "Pinocchio": by_pinocchio(tree, N),
            }
            first = {name: _seconds(step) for name, step in steps.items()}
            found = rates(steps, N, args.turns)
            if args.particles[0] == N:
                times = " and ".join(f"{first[name]:.2f}" for name in ("compiled 32", "compiled 64"))
                print(f"\nK = {tree.num_joints} ({tree.name}); compiling and the first calls: {times} s of CPU\n")
                print(f"| N | {' | '.join(found)} | compiled 32 / MuJoCo | compiled 32 / Pinocchio |")
                print(f"|---|{'---|' * (len(found) + 2)}")
            ratios = [found["compiled 32"] / found[other] for other in ("MuJoCo", "Pinocchio")]
            print(
                f"| {N} | {' | '.join(f'{x:.3g}' for x in found.values())} | {ratios[0]:.1f} | {ratios[1]:.1f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
