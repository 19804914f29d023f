"""Real recordings of others: what a plain fit, the regression and the diagnosis explain of the torque that is missing.

Each recording is measured on its last third, by fits to the first two: rms of the torque that the simulation misses
along the smoothed motion, N·m by joint, and of the angles' error in replays of 2 s, rad. *Plain* is viscous and dry
friction at all joints by weighted least squares, *regression* is `invdyn.diagnosis.regression`, *ours* the answer that
a diagnosis shows, with `--budget` seconds for its search. *Inside* counts published numbers in its 90 % intervals.

    dfki-NN   DFKI's double pendulum: encoders at 100 rows/s under the measured torque, the rigid part of the lab's
              model_2.0; published: its friction and rotors
    ibm-N     the last 3 s of a passive swing of a toy; masses are those of uniform rods, known to 30 %
    kuka-N    a KUKA iiwa 7 with torque sensors, the laboratory's model (Delft)
    wam       a Barrett WAM's joints 2 and 4, amir-noohian/dynamics-estimation @ 855e9e5:
              pest_2dof_nogravity/wam_data/state_4.json; masses of the maker, centres of mass of its own gravity model
    pendulum  DFKI's simple pendulum, dfki-ric-underactuated-lab/torque_limited_simple_pendulum @ ed17ea2:
              results/control_method_pd/system_identification/data_measured.csv, and what was identified from it

Numbers were set on `TUNING`; of the others ibm's swings, dfki-00 and the pendulum had been looked at, too. The last two
are read from ``--files``, a folder with these two files, and left out without it.

    INVDYN_DATA=… python benchmarks/board.py [NAME …] [--diagnose] [--budget 60] [--files FOLDER]
"""

import argparse
import json
import os
import time
import warnings
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path

import numpy as np
import torch
from sensor_cases import FRICTION, GEAR, ROTOR

from invdyn.diagnosis import diagnose
from invdyn.diagnosis.assessment.closing_measures import Closing, measured
from invdyn.diagnosis.regression.regress import Regression, regress
from invdyn.diagnosis.report.regression_sentences import regression_words
from invdyn.diagnosis.report.sentences import verdict
from invdyn.diagnosis.rules import DEFAULT
from invdyn.models import Body, Link, load_body, planar_body
from invdyn.recordings import Recording, load, load_truth

TUNING = ("dfki-01", "dfki-03", "ibm-0", "ibm-3", "wam")
DFKI = ("00", "01", "02", "03", "04", "05", "11", "12", "13")
ROWS, EVERY = 1200, 2  # of a swing the last 3 s, 200 rows/s: before, it whirls, and no simulation follows for long
BODY = files("invdyn.models") / "bodies" / "dfki_design_a0.toml"
PENDULUM = planar_body(
    "IBM's double pendulum",
    [Link("upper", "shoulder", "elbow", 0.091, 0.1), Link("lower", "elbow", "wrist", 0.070, 0.08)],
    gravity=(0.0, -9.81),
    uncertainty={"length": 0.01, "mass": 0.3, "com": 0.2, "inertia": 0.3},
)
WAM = """<mujoco model="wam"><compiler angle="radian"/><worldbody>
<body name="upper"><joint name="shoulder" axis="0 1 0"/>
<inertial pos=".0122 0 .1048" mass="5.677" fullinertia=".187 .187 .02 0 0 0"/>
<body name="fore" pos=".045 0 .55"><joint name="elbow" axis="0 1 0"/>
<inertial pos="-.0424 0 .2276" mass="4.2" fullinertia=".0727 .0727 .01 0 0 0"/>
<site name="wrist" pos="-.045 0 .3"/></body></body></worldbody>
<actuator><motor joint="shoulder"/><motor joint="elbow"/></actuator></mujoco>"""
ROBOTS = DEFAULT.replace(tolerance=DEFAULT.evidence.robot_tolerance)
Given = tuple[Recording, Body, bool]
"""Recording, body, and whether it is passive."""
Published = dict[tuple[str, str], float]
"""By effect and joint."""


def encoders(time: np.ndarray, angles: np.ndarray, torques: np.ndarray, body: Body, name: str) -> Recording:
    """A recording without keypoints."""
    nothing = np.empty((len(time), 0, body.dimensions))
    return Recording(time, nothing, (), angles=angles, torques=torques, joint_names=body.joint_names, name=name)


def seen(run: str, every: int = 5) -> Recording:
    """The run's encoders, every fifth row of them, under the measured torque of all rows."""
    truth = load_truth(f"dfki-trajectory-{run}")
    angles = np.full_like(truth.angle, np.nan)
    angles[::every] = truth.angle[::every]
    return encoders(truth.time, angles, truth.torque, Body.from_toml(BODY), f"dfki-{run}")


def swing(number: int) -> Recording:
    """The end of a swing."""
    return load(f"ibm-{number}").at(slice(-ROWS, None, EVERY))


def dfki(run: str) -> tuple[Given, Published]:
    """One of the lab's runs, and its friction and rotors."""
    joints = ("shoulder", "elbow")
    rotors = ROTOR * np.array([GEAR**2 + 1, GEAR**2])
    known = {("coulomb_friction", j): f * np.pi / 2 for j, f in zip(joints, FRICTION["coulomb"], strict=True)}
    known |= {("viscous_friction", j): b for j, b in zip(joints, FRICTION["viscous"], strict=True)}
    known |= {("armature", j): float(r) for j, r in zip(joints, rotors, strict=True)}
    return (seen(run), Body.from_toml(BODY), False), known


def ibm(number: int) -> tuple[Given, Published]:
    """A swing; friction is not documented."""
    return (swing(number), PENDULUM, True), {}


def kuka(trial: int) -> tuple[Given, Published]:
    """Seven encoders, and sensors that count the other way."""
    folder = Path(os.environ["INVDYN_DATA"]) / "delft_kuka"
    body = load_body(str(folder / "kuka.xml"))
    table = np.genfromtxt(folder / f"trial{trial}.csv", delimiter=",", skip_header=1)
    return (encoders(table[:, 0], table[:, 1:8], -table[:, 8:15], body, f"kuka-{trial}"), body, False), {}


def wam(folder: Path) -> tuple[Given, Published]:
    """Two joints, upright at zero, and the torques of its controller."""
    rows = json.loads((folder / "state_4.json").read_text("utf-8"))
    q, u = (np.array([[row[key][1], row[key][3]] for row in rows]) for key in ("position", "effort"))
    at = np.array([row["time"] for row in rows])
    file = folder / "wam.xml"
    file.write_text(WAM, "utf-8")
    body = load_body(str(file), dimensions=3)
    return (encoders(at - at[0], q, u, body, "wam"), body, False), {}


def pendulum(folder: Path) -> tuple[Given, Published]:
    """One joint, hanging at zero; Coulomb friction was fitted as Fc atan(100 q̇)."""
    at, q, _, u = np.genfromtxt(folder / "data_measured.csv", delimiter=",", skip_header=1).T
    com = 0.4
    mass = 0.1022 / com
    links = [Link("arm", "pivot", "tip", 0.5, mass, com, 0.0626 - mass * com**2)]
    body = planar_body("simple pendulum", links, gravity=(0.0, -9.81))
    known = {("coulomb_friction", "pivot"): 0.1839 * np.pi / 2, ("viscous_friction", "pivot"): 0.04707}
    new = np.diff(at, prepend=-np.inf) > 0
    angle = (q - np.pi / 2)[new, None]
    return (encoders(at[new], angle, u[new, None], body, "pendulum"), body, False), known


def recordings(folder: Path | None) -> dict[str, Callable[[], tuple[Given, Published]]]:
    """All of them by name, made when they are asked for."""
    found: dict[str, Callable[[], tuple[Given, Published]]] = {}
    found |= {f"dfki-{run}": lambda run=run: dfki(run) for run in DFKI}
    found |= {f"ibm-{number}": lambda number=number: ibm(number) for number in range(10)}
    found |= {f"kuka-{trial}": lambda trial=trial: kuka(trial) for trial in (1, 2)}
    if folder is not None:
        found |= {"wam": lambda: wam(folder), "pendulum": lambda: pendulum(folder)}
    return found


def inside(regression: Regression, known: Published) -> tuple[int, int]:
    """How many published numbers lie in 90 % intervals, of those of effects that are named there."""
    found = {(e.effect, e.place): e.interval_90 for e in regression.numbers}
    hits = [found[key][0] <= value <= found[key][1] for key, value in known.items() if key in found]
    return sum(hits), len(hits)


def torque(values: np.ndarray) -> str:
    return " / ".join(f"{value:.3g}" for value in values)


def row(name: str, made: Callable[[], tuple[Given, Published]], budget: float | None) -> list[str]:
    """Cells of one recording; with a ``budget``, s, the diagnosis too."""
    (recording, body, passive), known = made()
    start = time.process_time()
    regression = regress(recording, body, passive=passive, rules=ROBOTS)
    spent = time.process_time() - start
    half = "tuning" if name in TUNING else "other"
    if regression is None:
        return [name, half, *["–"] * 8]
    closing: Closing | None = measured(regression, body, passive)
    answer, ours, seconds = regression_words(regression), "", f"{spent:.1f}"
    if budget is not None:
        start = time.process_time()
        found = diagnose(recording, body, passive=passive, budget=budget, robot=True, force=True)
        seconds += f"; {time.process_time() - start:.0f}"
        closing, answer = found.closing, verdict(found)
        if closing is not None:
            ours = f"{torque(closing.torque[closing.shown].after)} ({closing.shown})"
    replays = "–"
    if closing is not None and closing.replay:
        rms = closing.replay[-1].rms
        replays = " → ".join(f"{rms[who]:.2g}" for who in ("nominal", "regression", "search") if who in rms)
    hits, of = inside(regression, known)
    left = regression.torque
    cells = [torque(left.before), torque(regression.plain.after), torque(left.after), ours, replays]
    return [name, half, *cells, f"{hits} of {of}" if of else "", seconds, answer]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*")
    parser.add_argument("--diagnose", action="store_true", help="the whole diagnosis, too")
    parser.add_argument("--budget", type=float, default=60.0, help="seconds of its search")
    parser.add_argument("--files", type=Path, help="folder with state_4.json and data_measured.csv")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    warnings.simplefilter("ignore")
    every = recordings(arguments.files)
    heads = ["recording", "half", "before", "plain", "regression", "ours", "replay", "inside", "CPU s", "answer"]
    print(f"| {' | '.join(heads)} |\n{'|---' * len(heads)}|")
    for name in arguments.names or every:
        cells = row(name, every[name], arguments.budget if arguments.diagnose else None)
        print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
