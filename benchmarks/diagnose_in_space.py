"""Diagnoses of robots in space: is the effect named at the right joint, with how much work, and what the copy is worth.

MuJoCo simulates the turret arm of `tests/in_space.py`, three hinges, the Franka Emika Panda of `tests/trees.py` (which
says where its numbers are from), seven, or twelve, that and its first five again, under torques that are constant for
10 ms. One thing is otherwise than in the file: friction or a rotor at some joint, a payload, late motors, or nothing.
Encoders have noise of .2 mrad. The whole catalogue is looked at with the default budget. For each case: the verdict's
effect, its probability, the parameter over the true one, how many candidates there were and how many the budget had no
time for, and seconds of CPU.

    python benchmarks/diagnose_in_space.py [--robots arm panda twelve] [--seconds 10] [--only 0 3] [--results FILE]
"""

import argparse
import sys
import tempfile
import time
import warnings
from functools import partial
from pathlib import Path
from typing import Any

import torch

from invdyn.diagnosis.diagnose import diagnose
from invdyn.models import load_body, write_mjcf

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from in_space import ARM, play
from kept import kept
from trees import panda, twelve_joints

PANDA = (0.0, -0.3, 0.0, -1.9, 0.0, 1.6, 0.8)
MIDDLE = {"arm": (0.0, -0.5, 0.9), "panda": PANDA, "twelve": (*PANDA, *PANDA[:5])}
"""rad: a pose in the middle of the joints' ranges."""
TIP = {"arm": ("fore", "tip"), "panda": ("link7", "flange"), "twelve": ("link5_again", "flange")}
CASES: dict[str, list[tuple[str, str, float, dict[str, Any]]]] = {
    "twelve": [
        ("viscous_friction.joint2_again", "damping", 1.0, {"damping": {"joint2_again": 1.0}}),
        ("", "", 0.0, {}),
    ],
    "panda": [
        ("viscous_friction.joint4", "damping", 1.0, {"damping": {"joint4": 1.0}}),
        ("coulomb_friction.joint2", "torque", 1.5, {"friction": {"joint2": 1.5}}),
        ("armature.joint6", "inertia", 0.05, {"armature": {"joint6": 0.05}}),
        ("actuator_delay", "delay", 0.02, {"late": 0.02}),
        ("payload", "mass", 0.5, {"payload": 0.5}),
        ("", "", 0.0, {}),
    ],
    "arm": [
        ("viscous_friction.lift", "damping", 0.3, {"damping": {"lift": 0.3}}),
        ("coulomb_friction.bend", "torque", 0.05, {"friction": {"bend": 0.05}}),
        ("armature.lift", "inertia", 0.02, {"armature": {"lift": 0.02}}),
        ("actuator_delay", "delay", 0.02, {"late": 0.02}),
        ("payload", "mass", 0.2, {"payload": 0.2}),
        ("", "", 0.0, {}),
    ],
}
"""Effect, its parameter and size, and what changes in MuJoCo."""


def run(robot: str, number: int, seconds: float, folder: Path, workers: int) -> dict[str, Any]:
    """One case."""
    effect, parameter, size, change = CASES[robot][number]
    path = folder / f"{robot}.xml"
    if robot == "arm":
        path.write_text(ARM, encoding="utf-8")
    else:
        write_mjcf(panda() if robot == "panda" else twelve_joints(), path)
    log = play(path.read_text(encoding="utf-8"), seconds, number, MIDDLE[robot], carried_by=TIP[robot], **change)
    body = load_body(path)
    began, clock = time.process_time(), time.monotonic()
    found = diagnose(log, body, workers=workers)
    took = time.process_time() - began
    best = max(found.causes, key=lambda cause: cause.probability + cause.in_part)
    said = "+".join(finding.key for finding in best.effects)
    own = best.effects[0].parameters.get(parameter) if best.effects and said == effect else None
    return {
        "robot": robot,
        "case": effect or "nothing",
        "said": said or "nothing",
        "right": said == effect,
        "probability": best.probability + best.in_part,
        "parameter over true": None if own is None else own.mean / size,
        "gap closed": found.shrinkage.gap_closed,
        "candidates": found.method["candidates"],
        "not looked at": found.not_looked_at,
        "CPU s": took,
        "seconds": time.monotonic() - clock,
    }


def table(rows: list[dict[str, Any]]) -> str:
    """Of the cases."""
    lines = ["| robot | the file lacks | the diagnosis says | parameter over true | gap closed | candidates | CPU s |"]
    lines.append("|---|---|---|---|---|---|---|")
    for row in rows:
        share = "" if row["parameter over true"] is None else f"{row['parameter over true']:.3f}"
        count = row["candidates"].split()[0]
        if missed := row["not looked at"]:
            count = f"{count}, {missed} not looked at"
        closed = f"{row['gap closed']:.2f}" if row["case"] != "nothing" else ""
        cells = (row["robot"], row["case"], row["said"], share, closed, count, f"{row['CPU s']:.0f}")
        lines.append(f"| {' | '.join(map(str, cells))} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", nargs="+", choices=sorted(CASES), default=list(MIDDLE))
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--only", type=int, nargs="*")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--results", type=Path)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    warnings.filterwarnings("ignore", category=UserWarning)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for robot in arguments.robots:
            for number in arguments.only or range(len(CASES[robot])):
                make = partial(run, robot, number, arguments.seconds, Path(folder), arguments.workers)
                rows.append(kept(arguments.results, f"{robot} {number} {arguments.seconds:g} s", make))
    print(table(rows))


if __name__ == "__main__":
    main()
