"""What of a body's file makes inferred torques differ from the sensors', by a regression of the difference.

The sensors' torque less inverse dynamics of the filtered motion is explained by small changes of what the file has, and
by what joints have besides, each with the prior of :mod:`invdyn.inference.posterior.body_doubt`:

    τ_sensor − τ(φ̄) = Y δφ + o + f tanh(q̇/v) + e,     e ~ N(0, σ²) with one independent row each half second

Y by differences; φ are the lean of the base, masses, moments and centres of mass. The first table has the rms of what
is left, N·m, joint by joint, with each group alone and with all together, at σ = .2 N·m; then what was found, where it
is beyond two prior sds. The second one, of `--scales`, is how those priors were chosen: the evidence, nats, where the
sds of the body are so many times as large, and those of o and f these shares of a link's weight times its size, with σ
of each joint at its maximum likelihood, in a recording of each robot and in those of it that had no part in the choice.

    INVDYN_DATA=… python benchmarks/what_is_off.py ["kuka 1 60" "pendulum 3" …] [--scales]
"""

import argparse
import warnings
from itertools import product
from typing import Any

import numpy as np
import torch
from against_sensors import angles_of
from scipy.optimize import minimize
from sensor_cases import Case, made

from invdyn.inference.methods.differentiate import derivatives
from invdyn.inference.posterior.body_doubt import (
    CENTRE,
    JOINT,
    LEVEL,
    MASS,
    MOMENT,
    SLOW,
    joint_weights,
)
from invdyn.models import ArmModel, dynamics_for
from invdyn.models.effects.disturbances import GravityTilt
from invdyn.models.effects.inertias import size_of

NOISE, APART, STEP = 0.2, 0.5, 1e-3
"""N·m and s of the errors e; share of a prior sd that Y steps by."""
CUTOFF = {"kuka": 1.0, "pendulum": 6.0, "dfki-cad": 5.0}
"""Hz: a KUKA that turns by .4 rad/s at most, a pendulum that is let fall, and motors that excite an arm."""
BODY = "gmic"
GROUPS = {"lean": "g", "masses": "m", "masses and centres": "mc", "joints": "of", "all": "gmicof"}
ROBOTS = {
    "kuka 1 60": ("kuka 2 60",),
    "pendulum 3": ("pendulum 4",),
    "dfki-cad 01": ("dfki-cad 00", "dfki-cad 02", "dfki-cad 05"),
}
"""Recordings by which the priors were chosen, and others of the same robots."""
UNITS = {"g": " rad", "c": " m", "m": " of itself", "i": " of itself", "o": " N·m", "f": " N·m of friction"}
TIMES, SHARES = (
    (0.5, 1.0, 2.0, 4.0),
    ((0.01, 0.01), (0.03, 0.03), (0.03, 0.06), (0.1, 0.1)),
)


def columns(case: Case) -> tuple[np.ndarray, np.ndarray, list[str], np.ndarray]:
    """The difference (T, K), Y in prior sds (T, K, P), names of the P changes and their sds in their units."""
    body, rate = case.body, 1 / np.median(np.diff(case.recording.time))
    numbers, dynamics = body.parameters(), dynamics_for(body)
    cutoff = min(CUTOFF[case.name.split()[0]], 0.4 * rate)
    path = derivatives(case.recording.time, angles_of(case), cutoff)
    q, qd, qdd = (torch.tensor(each[case.counted].copy()) for each in path)

    def torque(other: Any) -> np.ndarray:
        return dynamics.inverse(q, qd, qdd, other).numpy()

    plain, found = torque(numbers), []

    def add(name: str, sd: float, other: Any) -> None:
        found.append((name, sd, (torque(other) - plain) / STEP))

    model = ArmModel(body, case.recording.time)
    tilt = GravityTilt().bound(body)
    axes = [each.name for each in tilt.parameters(model.scale)]
    for axis in axes:
        angles = {each: numbers.mass.new_tensor([STEP * LEVEL * (each == axis)]) for each in axes}
        add(f"g {axis}", LEVEL, tilt.body(angles, numbers))
    for k, link in enumerate(body.link_names):
        for letter, name, sd in (("m", "mass", MASS), ("i", "inertia", MOMENT)):
            value = getattr(numbers, name).clone()
            value[k] *= 1 + STEP * sd
            add(f"{letter} {link}", sd, numbers._replace(**{name: value}))
        for axis in range(numbers.com[k].numel()):
            com, sd = numbers.com.clone(), CENTRE * size_of(numbers, k)
            com[k].view(-1)[axis] += STEP * sd
            add(f"c {link} {'xyz'[axis]}", sd, numbers._replace(com=com))
    for k, (joint, size) in enumerate(zip(body.joint_names, joint_weights(model).tolist(), strict=True)):
        for letter, shape in (("o", 1.0), ("f", torch.tanh(qd[:, k] / SLOW).numpy())):
            at = np.zeros_like(plain)
            at[:, k] = JOINT * size * shape
            found.append((f"{letter} {joint}", JOINT * size, at))
    names, sds, changes = zip(*found, strict=True)
    return case.torque[case.counted] - plain, np.stack(changes, -1), list(names), np.array(sds)


def explained(case: Case) -> tuple[dict[str, np.ndarray], list[str]]:
    """Rms of what is left (K,) of the difference, by group, and what was found with all of them."""
    off, changes, names, sds = columns(case)
    weight = np.median(np.diff(case.recording.time)) / APART / NOISE**2
    left, said = {"nothing": np.sqrt((off**2).mean(0))}, []
    for group, letters in GROUPS.items():
        own = [k for k, name in enumerate(names) if name[0] in letters]
        x = changes[..., own].reshape(-1, len(own))
        values = np.linalg.solve(weight * x.T @ x + np.eye(len(own)), weight * x.T @ off.reshape(-1))
        left[group] = np.sqrt(((off - changes[..., own] @ values) ** 2).mean(0))
        if group == "all":
            said = [
                f"{names[k][2:]} {'lean ' if names[k][0] == 'g' else ''}{value * sds[k]:+.2g}{UNITS[names[k][0]]}"
                for k, value in zip(own, values, strict=True)
                if abs(value) > 2 or names[k][0] == "g"
            ]
    return left, said


def half_seconds(case: Case) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Means of the difference (R, K) and of Y (R, K, P) over half seconds, and the names of the changes."""
    rows = round(APART / np.median(np.diff(case.recording.time)))
    off, changes, names, _ = columns(case)
    kept = len(off) // rows * rows
    return *(each[:kept].reshape(-1, rows, *each.shape[1:]).mean(1) for each in (off, changes)), names


def evidence(
    off: np.ndarray, changes: np.ndarray, names: list[str], times: float, offset: float, friction: float
) -> float:
    """Log-evidence, nats, of half seconds' means, with priors so many times as wide and with these shares."""
    wide = {"o": offset / JOINT, "f": friction / JOINT}
    changes = changes * [wide.get(name[0], times) for name in names]

    def negative(log_sd: np.ndarray) -> float:
        x = (changes / np.exp(log_sd)[:, None]).reshape(-1, len(names))
        y = (off / np.exp(log_sd)).reshape(-1)
        root = np.linalg.cholesky(np.eye(len(names)) + x.T @ x)
        part = np.linalg.solve(root, x.T @ y)
        return 0.5 * (y @ y - part @ part) + np.log(np.diag(root)).sum() + len(off) * log_sd.sum()

    start = np.log(0.3 * off.std(0) + 1e-3)
    return -minimize(negative, start, method="L-BFGS-B", bounds=[(-6.0, 2.0)] * len(start)).fun


def print_scales() -> None:
    """The second table."""
    names = [name for chosen, others in ROBOTS.items() for name in (chosen, *others)]
    print(f"| times | o | f | {' | '.join(names)} | all chosen by |\n|{'---|' * (len(names) + 4)}")
    cases = {name: half_seconds(made(name)) for name in names}
    for times, (offset, friction) in product(TIMES, SHARES):
        found = {name: evidence(*case, times, offset, friction) for name, case in cases.items()}
        cells = " | ".join(f"{value:.1f}" for value in found.values())
        total = sum(found[name] for name in ROBOTS)
        print(f"| {times:.2g} | {offset:g} | {friction:g} | {cells} | {total:.1f} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", default=["kuka 1 60", "kuka 2 60", "pendulum 3", "pendulum 4"])
    parser.add_argument("--scales", action="store_true", help="how the priors were chosen")
    arguments = parser.parse_args()
    warnings.filterwarnings("ignore", category=UserWarning)
    if arguments.scales:
        return print_scales()
    print(f"| recording | joint | {' | '.join(('nothing', *GROUPS))} | found |\n|{'---|' * (len(GROUPS) + 4)}")
    for name in arguments.names:
        case = made(name)
        left, said = explained(case)
        for k, joint in enumerate(case.body.joint_names):
            cells = " | ".join(f"{values[k]:.2f}" for values in left.values())
            print(f"| {name} | {joint} | {cells} | {'; '.join(said) if not k else ''} |", flush=True)


if __name__ == "__main__":
    main()
