"""How much of the nominal file's error a corrected file takes away, rolled out by MuJoCo on a log that was not fitted.

    python benchmarks/write_back.py [--cases 40] [--seed 50000] [--workers 1] [--told] [--results FILE]

Each case: the robot of a file (two hinges with damping, rotors, a spring and motors), a true one that differs by one
effect, and two logs of the true one (encoders, .2 mrad). The first is diagnosed against the file; the corrected copy,
the file and the true file replay the second. Excess error: mean square angle error less the true file's, which is what
noise in the start states makes. An answer is right where its best cause is the effect at its joint and no other.
`--told` leaves all but the true effect out of the catalogue: it measures the writing, given a right answer. Cases in
`--results`, a line each, are not simulated again. :mod:`servo` has robots whose motors are position servos.
"""

import argparse
import tempfile
import time as clock
import warnings
import xml.etree.ElementTree as ET
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from kept import kept

from invdyn.diagnosis.diagnose import diagnose
from invdyn.diagnosis.write_back.rollout import commands, rollout
from invdyn.diagnosis.write_back.write_back import best, write_back
from invdyn.models import Body
from invdyn.models.articulated.as_filed import servo_torque
from invdyn.models.effects import EFFECTS
from invdyn.recordings import Recording

FILE = """<mujoco model="robot"><compiler angle="radian"/><option timestep="0.002" gravity="0 0 -9.81"/><worldbody>
<body name="upper" pos="0 0 1"><joint name="shoulder" axis="0 1 0" damping="0.3" armature="0.02"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="1.2" contype="0" conaffinity="0"/>
<body name="fore" pos="0 0 -0.3"><joint name="elbow" axis="0 1 0" damping="0.1" stiffness="0.8" springref="0.4"/>
<inertial pos="0 0 -0.12" mass="0.8" diaginertia="0.005 0.005 0.0002"/><site name="tip" pos="0 0 -0.25"/>
</body></body></worldbody><actuator><motor name="s" joint="shoulder"/><motor name="e" joint="elbow" gear="10"/>
</actuator></mujoco>"""
RATE, SECONDS = 50.0, 4.0
STEP = 5e-4
"""s, of the engine where it stands for reality, by Runge–Kutta: Euler's own error there looks like friction."""
JOINTS = ("shoulder", "elbow")

Change = Callable[[ET.Element], None]


@dataclass(frozen=True)
class Robot:
    """A file's text, what may differ in reality (effect and place → change of the file), and its controls' sizes."""

    text: str
    effects: Mapping[str, Change]
    control: tuple[float, float]


def part(path: str, **values: float | str) -> Change:
    """Attributes of the element at a path of ElementTree's."""

    def change(root: ET.Element) -> None:
        found = root.find(path)
        assert found is not None, path
        found.attrib.update({name: v if isinstance(v, str) else f"{v:.6g}" for name, v in values.items()})

    return change


def joint(name: str, attribute: str, value: float) -> Change:
    """A number of a joint."""
    return part(f".//joint[@name='{name}']", **{attribute: value})


def late(by: float) -> Change:
    """All motors act so many seconds late."""

    def change(root: ET.Element) -> None:
        for name in JOINTS:
            part(f"./actuator/*[@joint='{name}']", delay=by, nsample=str(int(by / STEP) + 2))(root)

    return change


def payload(mass: float, place: str) -> Change:
    """A point mass at a place of the last link."""

    def change(root: ET.Element) -> None:
        link = root.find(".//body[@name='fore']")
        assert link is not None
        ET.SubElement(
            ET.SubElement(link, "body", pos=place),
            "inertial",
            pos="0 0 0",
            mass=f"{mass:.6g}",
            diaginertia="1e-9 1e-9 1e-9",
        )

    return change


def motors(rng: np.random.Generator) -> Robot:
    """The robot whose motors are given torques."""
    u = rng.uniform
    found = {
        "viscous_friction.elbow": joint("elbow", "damping", u(0.2, 0.5)),
        "viscous_friction.shoulder": joint("shoulder", "damping", 0.3 + u(0.3, 1.0)),
        "coulomb_friction.shoulder": joint("shoulder", "frictionloss", u(0.2, 0.6)),
        "coulomb_friction.elbow": joint("elbow", "frictionloss", u(0.08, 0.25)),
        "armature.shoulder": joint("shoulder", "armature", 0.02 + u(0.03, 0.1)),
        "armature.elbow": joint("elbow", "armature", u(0.005, 0.02)),
        "payload": payload(u(0.08, 0.3), "0 0 -0.25"),
        "actuator_delay": late(u(0.01, 0.04)),
        "actuator_gain.elbow": part("./actuator/*[@joint='elbow']", gear=10 * u(0.7, 0.9)),
        "joint_stiffness.elbow": joint("elbow", "stiffness", u(1.2, 2.0)),
    }
    return Robot(FILE, found, (2.0, 0.06))


def log(robot: Robot, true: str, body: Body, rng: np.random.Generator, name: str) -> Recording:
    """Encoders of the true robot, and commands as its file has them, in the body's angles: θ = zero − q."""
    nominal, model = (mujoco.MjModel.from_xml_string(text) for text in (robot.text, true))
    model.opt.timestep, model.opt.integrator = STEP, mujoco.mjtIntegrator.mjINT_RK4
    # dry friction that holds, as in the blind check: by default MuJoCo's lets a joint creep
    model.dof_solref[:], model.dof_solimp[:] = [2 * STEP, 1.0], [0.9999, 0.9999, 1e-3, 0.5, 2.0]
    data = mujoco.MjData(model)
    rows, per = round(SECONDS * RATE), round(1 / RATE / STEP)
    time = np.arange(rows) / RATE
    size = np.array(robot.control)[:, None]
    w = 2 * np.pi * rng.uniform([[0.2, 0.6, 1.2]], [[0.5, 1.1, 2.0]], (2, 3))
    control = (size * rng.uniform(0.4, 1, (2, 3)) * np.sin(time[:, None, None] * w + rng.uniform(0, 6, (2, 3)))).sum(-1)
    angles = np.zeros((rows, 2))
    for row in range(rows):
        angles[row], data.ctrl[:] = data.qpos[:2], control[row]
        for _ in range(per):
            mujoco.mj_step(model, data)
    given = np.zeros((rows, 2))
    for k, link in enumerate(body.links):
        own = link.parts
        assert own is not None
        assert own.sign == -1
        servo = own.servo
        torque = -control[:, k] * nominal.actuator_gear[k, 0]
        given[:, k] = torque if servo is None else servo_torque(servo, own.zero - control[:, k])
        angles[:, k] = own.zero - angles[:, k]
    angles += rng.normal(0, 2e-4, angles.shape)
    return Recording(time, np.empty((rows, 0, 2)), (), None, angles, given, JOINTS, name)


@dataclass(frozen=True)
class SimulatedCase:
    """A robot's file and the true one, its body, and two logs of the true one."""

    file: Path
    true: Path
    body: Body
    first: Recording
    second: Recording

    def left(self, copy: Path) -> float:
        """The share of the file's excess error that a corrected copy leaves on the second log."""
        given = commands(mujoco.MjModel.from_xml_path(str(self.file)), self.body, self.second)
        floor, nominal, corrected = (
            rollout(str(path), self.body, self.second.time, np.asarray(self.second.angles), given).total ** 2
            for path in (self.true, self.file, copy)
        )
        return max(corrected - floor, 0.0) / max(nominal - floor, 1e-12)


def simulated_case(rng: np.random.Generator, robot: Robot, effect: str, folder: Path) -> SimulatedCase:
    """Both files in a folder, and logs."""
    file, true = folder / "robot.xml", folder / "true.xml"
    root = ET.fromstring(robot.text)
    robot.effects[effect](root)
    file.write_text(robot.text)
    true.write_text(ET.tostring(root, "unicode"))
    body = Body.load(file)
    first, second = (log(robot, true.read_text(), body, rng, name) for name in ("log", "held_out"))
    return SimulatedCase(file, true, body, first, second)


def case(rng: np.random.Generator, robot: Robot, effect: str, workers: int = 1, known: bool = False) -> dict:
    """The effect; the answer; the share of the excess error that is left, with the corrected file; and seconds."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "corrected.xml"
        made = simulated_case(rng, robot, effect, Path(folder))
        file, body, first, second = made.file, made.body, made.first, made.second
        started = clock.process_time()
        struck = [name for name in EFFECTS if name != effect.partition(".")[0]] if known else []
        found = diagnose(first, body, workers=workers, without=struck, most=1 if known else 4)
        seconds = clock.process_time() - started
        cause = best(found)
        answer = sorted(f.key for f in cause.effects) if cause else []
        row = {"effect": effect, "answer": answer, "cpu_s": seconds, "changes": []}
        written = write_back(found, file, body, copy, second, True)
        if written.written is None or written.written.nothing:
            return row | {"left": 1.0}
        return row | {"left": made.left(copy), "changes": list(written.written.changes)}


def summary(results: Sequence[dict]) -> str:
    """A table: what differs, how often it is named, alone, and how often a right answer takes 90 % of the error."""
    groups: dict[str, list[dict]] = defaultdict(list)
    for result in results:
        groups[result["effect"]].append(result)
    lines = [
        "| what differs | cases | named | and nothing else | of these, excess ≤ 10 % | excess left, median | CPU s |"
    ]
    lines += ["|---|---|---|---|---|---|---|"]
    for name, rows in [*groups.items(), ("all", list(results))]:
        right = [r for r in rows if r["answer"] == [r["effect"]]]
        left = f"{100 * np.median([r['left'] for r in right]):.1f} %" if right else ""
        lines.append(
            f"| {name} | {len(rows)} | {sum(r['effect'] in r['answer'] for r in rows)} | {len(right)} | "
            f"{sum(r['left'] <= 0.1 for r in right)} | {left} | {np.mean([r['cpu_s'] for r in rows]):.0f} |"
        )
    return "\n".join(lines)


def run(make: Callable[[np.random.Generator], Robot], what: str, cases: int, seed: int) -> None:
    """Simulate, diagnose and print all cases, a line each, and a table."""
    options = argparse.ArgumentParser(description=what, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--cases", type=int, default=cases)
    options.add_argument("--seed", type=int, default=seed)
    options.add_argument("--workers", type=int, default=1)
    options.add_argument("--told", action="store_true", help="Look for the true effect alone.")
    options.add_argument("--results", type=Path, default=None, help="Where results are kept, a line a case.")
    given = options.parse_args()
    warnings.simplefilter("ignore", UserWarning)
    results = []
    for number in range(given.cases):
        rng = np.random.default_rng([given.seed, number])
        robot = make(rng)
        effect = list(robot.effects)[number % len(robot.effects)]
        name = f"{given.seed} {number}{' told' if given.told else ''}"
        result = kept(given.results, name, lambda r=rng, b=robot, e=effect: case(r, b, e, given.workers, given.told))
        results.append(result)
        answer, left = "+".join(result["answer"]) or "none", 100 * result["left"]
        print(f"{number:>3} {effect:<28} {answer:<44} excess left {left:6.2f} %   {result['cpu_s']:5.1f} s", flush=True)
    print(summary(results))


if __name__ == "__main__":
    run(motors, __doc__ or "", 40, 50_000)
