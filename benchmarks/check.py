"""How often `invdyn check` finds a mistake in a log, and how often it finds one where there is none.

    python benchmarks/check.py [--robots] [--logs 20] [--clean 40] [--seed 40000] [--only zero,…] [--results FILE]

With `--robots` the logs are those of eleven robots of two to seven joints (`check_robots.py`), with mistakes that users
report (`robot_mistakes.py`). They are read from an MJCF, a CSV and a map as a user's are: torque motors and servos, a
passive joint, a slide, a coupled wrist, commands between rows.

Else MuJoCo simulates random arms of one to three joints that a controller moves (`blindcheck.motion`); each log has
encoders (noise of .1 to 2 mrad) and the torques given to the motors. Half of all logs, and half of those that are
right, are of an arm with an effect of the catalogue, so that a simulation which lacks something is no mistake. Arms in
a horizontal plane have no gravity to tell a zero by, and are left out for it.
"""

import argparse
import time as clock
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import robot_mistakes
from kept import kept

from invdyn.blindcheck.cases import _wild
from invdyn.blindcheck.effects import EFFECTS
from invdyn.blindcheck.injected_effects import drawn, world_with
from invdyn.blindcheck.motion import frame_times, random_body, random_plan, simulated
from invdyn.blindcheck.scene import scene
from invdyn.blindcheck.simulator import World
from invdyn.diagnosis.check.check import check
from invdyn.models import Body
from invdyn.recordings import Recording

JOINT_EFFECTS = tuple(
    n for n, e in EFFECTS.items() if e.install is not None and n not in ("external_push", "clock_rate")
)
SAID = {"direction": "angles and torques are counted the other way", "offset": "N·m off all along"}
"""Words of a second mistake that fits as well as the first."""
KINDS = ("torque sign", "direction", "zero", "degrees", "milliseconds", "exchanged", "gear", "offset")


def log(rng: np.random.Generator, joints: int, effect: bool) -> tuple[Recording, Body]:
    """A log that is right, and its body."""
    while True:
        body = random_body(rng, joints, False)
        plan = random_plan(rng, body, False)
        real = plain = simulated(World(body), World(body), plan)
        if _wild(plain):
            continue
        if effect:
            about = scene(body, plan, plain)
            names = [n for n in JOINT_EFFECTS if joints > 1 or "two joints" not in EFFECTS[n].needs]
            present = [drawn(rng, str(rng.choice(names)), about, 1.0)]
            world = world_with(body, present, about)
            if not world.possible:
                continue
            real = simulated(world, World(body), plan)
            if _wild(real):
                continue
        time = frame_times(plan)
        rows = [np.argmin(np.abs(real.command_time - t)) for t in time]
        angle = np.stack([np.interp(time, real.time, q) for q in real.q.T], -1)
        noise = float(np.exp(rng.uniform(np.log(1e-4), np.log(2e-3))))
        angle = angle + noise * rng.standard_normal(angle.shape)
        nothing = np.empty((len(time), 0, 2))
        names = body.joint_names
        return Recording(time, nothing, (), angles=angle, torques=real.command[rows], joint_names=names), body


def spoilt(rng: np.random.Generator, kind: str, right: Recording) -> tuple[Recording, str, tuple[str, ...]]:
    """The log with a mistake, the kind that `check` calls it, and the joints."""
    joints, k = len(right.joint_names), int(rng.integers(len(right.joint_names)))
    angles, torques = np.array(right.angles), np.array(right.torques)
    name = (right.joint_names[k],)
    if kind == "torque sign":
        torques[:, k] *= -1
    elif kind == "direction":
        angles[:, k] *= -1
        torques[:, k] *= -1
    elif kind == "zero":
        angles[:, k] += np.radians(rng.uniform(15, 165)) * rng.choice([-1, 1])
    elif kind == "degrees":
        return replace(right, angles=np.degrees(angles)), "degrees", ()
    elif kind == "milliseconds":
        return replace(right, time=right.time * 1e3), "time", ()
    elif kind == "exchanged":
        one, other = sorted(rng.choice(joints, 2, replace=False))
        order = np.arange(joints)
        order[[one, other]] = other, one
        names = (right.joint_names[one], right.joint_names[other])
        return replace(right, angles=angles[:, order], torques=torques[:, order]), "exchanged", names
    elif kind == "gear":
        torques[:, k] /= np.exp(rng.uniform(np.log(5), np.log(200)))
        return replace(right, torques=torques), "scale", name
    else:
        size = np.sqrt((torques[:, k] ** 2).mean())
        torques[:, k] += size * rng.uniform(0.3, 1.0) * rng.choice([-1, 1])
    return replace(right, angles=angles, torques=torques), kind, name


def main() -> None:
    """Print a table: found with the right joint, and what was found instead."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--logs", type=int, default=20)
    options.add_argument("--clean", type=int, default=40)
    options.add_argument("--seed", type=int, default=40_000)
    options.add_argument("--only", default="")
    options.add_argument("--robots", action="store_true", help="Logs of robots' own files.")
    options.add_argument("--results", type=Path, default=None, help="Where results are kept, a line a log.")
    given = options.parse_args()
    kinds = (*robot_mistakes.MISTAKES,) if given.robots else KINDS
    started, wanted = clock.perf_counter(), [k for k in given.only.split(",") if k] or [*kinds, "none"]
    answered = robot_mistakes.answered if given.robots else one
    print(
        "| what is wrong | named first | or as fitting as well | s a log | what else is said |\n|---|---|---|---|---|"
    )
    for kind in wanted:
        reported: Counter = Counter()
        spent = []
        for number in range(given.clean if kind == "none" else given.logs):
            reported_of = kept(
                given.results,
                f"{'robots ' * given.robots}{given.seed} {kind} {number}",
                lambda k=kind, n=number: answered(given.seed, k, n),
            )
            spent.append(reported_of["seconds"])
            reported[reported_of["answer"]] += 1
        instead = "; ".join(f"{name} ×{n}" for name, n in reported.items() if name != "right")
        total = sum(reported.values())
        beside = sum(n for name, n in reported.items() if name.endswith(", or that"))
        cells = kind, f"{reported['right']} of {total}", beside or "", f"{np.mean(spent):.1f}", instead
        print(f"| {' | '.join(map(str, cells))} |", flush=True)
    print(f"{clock.perf_counter() - started:.0f} s in all")


def one(seed: int, kind: str, number: int) -> dict:
    """What is found first in a log with a mistake of a kind: "right", or what else; and seconds of CPU."""
    rng = np.random.default_rng([seed, (*KINDS, "none").index(kind), number])
    joints = int(rng.choice([2, 3] if kind == "exchanged" else [1, 2, 3]))
    right, body = log(rng, joints, effect=number % 2 == 1)
    recording, called, names = (right, "none", ()) if kind == "none" else spoilt(rng, kind, right)
    start = clock.process_time()
    found = check(recording, body, effects=False).mistakes
    seconds = clock.process_time() - start
    first = (found[0].kind, found[0].joints) if found else ("none", ())
    answer = "right" if first == (called, names) else f"{first[0]} {','.join(first[1])}".strip()
    if found and any(SAID.get(called, called) in other for other in found[0].others):
        answer += ", or that"
    return {"answer": answer, "joints": joints, "seconds": seconds}


if __name__ == "__main__":
    main()
