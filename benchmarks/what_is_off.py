"""What of a body's file makes inferred torques differ from the sensors', by a regression of the difference.

The sensors' torque less inverse dynamics of the filtered motion is explained by small changes of the file, each with
the prior of :mod:`invdyn.inference.posterior.body_doubt`, and by friction, with a wide one:

    τ_sensor − τ(φ̄) = Y δφ + b q̇ + f tanh(q̇/v) + e,     e ~ N(0, σ²) with one independent row each half second

Y by differences; φ are the lean of the base, masses and centres of mass. The table has the rms of what is left, N·m,
joint by joint, with each group alone and with all together; then what was found, where it is beyond two prior sds.

    INVDYN_DATA=… python benchmarks/what_is_off.py ["kuka 1 60" "pendulum 3" …]
"""

import argparse
import warnings

import numpy as np
import torch
from against_sensors import angles_of
from sensor_cases import Case, made

from invdyn.inference.methods.differentiate import derivatives
from invdyn.inference.posterior.body_doubt import CENTRE, LEVEL, MASS
from invdyn.models import dynamics_for
from invdyn.models.effects.inertias import size_of

NOISE, APART, SLOW, STEP = 0.2, 0.5, 0.05, 1e-3
"""N·m and s of the errors e; rad/s below which dry friction is not full; share of a prior sd that Y steps by."""
CUTOFF = {"kuka": 1.0, "pendulum": 6.0}
"""Hz: a KUKA that turns by .4 rad/s at most, and a pendulum that is let fall."""
GROUPS = {"lean": "g", "masses": "m", "masses and centres": "mc", "friction": "f", "all": "gmcf"}


def columns(case: Case) -> tuple[np.ndarray, np.ndarray, list[str], np.ndarray]:
    """The difference (T, K), Y in prior sds (T, K, P), names of the P changes and their sds in their units."""
    body, rate = case.body, 1 / np.median(np.diff(case.recording.time))
    numbers, dynamics = body.parameters(), dynamics_for(body)
    cutoff = min(CUTOFF[case.name.split()[0]], 0.4 * rate)
    path = derivatives(case.recording.time, angles_of(case), cutoff)
    q, qd, qdd = (torch.tensor(each[case.counted].copy()) for each in path)

    def torque(**other: torch.Tensor) -> np.ndarray:
        return dynamics.inverse(q, qd, qdd, numbers._replace(**other)).numpy()

    plain, found = torque(), []
    for axis in (0, 1):
        level = numbers.gravity.clone()
        level[axis] += STEP * LEVEL * numbers.gravity.norm()
        found.append((f"g {'xy'[axis]}", LEVEL, (torque(gravity=level) - plain) / STEP))
    for k, link in enumerate(body.link_names):
        mass = numbers.mass.clone()
        mass[k] *= 1 + STEP * MASS
        found.append((f"m {link}", MASS, (torque(mass=mass) - plain) / STEP))
        for axis in range(3):
            com, sd = numbers.com.clone(), CENTRE * size_of(numbers, k)
            com[k, axis] += STEP * sd
            found.append((f"c {link} {'xyz'[axis]}", sd, (torque(com=com) - plain) / STEP))
    for k, joint in enumerate(body.joint_names):
        for word, shape in (("viscous", qd[:, k]), ("dry", torch.tanh(qd[:, k] / SLOW))):
            at = np.zeros_like(plain)
            at[:, k] = shape.numpy()
            found.append((f"f {joint} {word}", 1.0, at))
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
                f"{names[k][2:]} {'lean ' if names[k][0] == 'g' else ''}{value * sds[k]:+.2g}"
                f"{' rad' if names[k][0] == 'g' else ' m' if names[k][0] == 'c' else ' of itself'}"
                for k, value in zip(own, values, strict=True)
                if names[k][0] != "f" and (abs(value) > 2 or names[k][0] == "g")
            ]
    return left, said


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", default=["kuka 1 60", "kuka 2 60", "pendulum 3", "pendulum 4"])
    arguments = parser.parse_args()
    warnings.filterwarnings("ignore", category=UserWarning)
    print(f"| recording | joint | {' | '.join(('nothing', *GROUPS))} | found |\n|{'---|' * (len(GROUPS) + 4)}")
    for name in arguments.names:
        case = made(name)
        left, said = explained(case)
        for k, joint in enumerate(case.body.joint_names):
            cells = " | ".join(f"{values[k]:.2f}" for values in left.values())
            print(f"| {name} | {joint} | {cells} | {'; '.join(said) if not k else ''} |", flush=True)


if __name__ == "__main__":
    main()
