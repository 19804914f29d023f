"""How much of the nominal file's error a corrected file takes away, rolled out by MuJoCo on a log nobody has fitted.

    python benchmarks/write_back.py [--cases 40] [--seed 50000] [--workers 1] [--servo] [--told]

Each case: the robot of a file (two hinges with damping, rotors, a spring and motors), a true one that differs by one
effect, and two logs of the true one (encoders, .2 mrad). The first is diagnosed against the file; the corrected copy,
the file and the true file replay the second. Excess error: mean square angle error less the true file's, which is what
noise in the start states makes. An answer is right where its best cause is the effect at its joint and no other.
`--told` leaves all but the true effect out of the catalogue: it measures the writing, given a right answer.
"""

import argparse
import tempfile
import time as clock
import warnings
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np

from invdyn.diagnosis.diagnose import diagnose
from invdyn.diagnosis.write_back.rollout import commands, rollout
from invdyn.diagnosis.write_back.write_back import best, write_back
from invdyn.models import Body
from invdyn.models.effects import EFFECTS
from invdyn.recordings import Recording

FILE = """<mujoco model="robot"><compiler angle="radian"/><option timestep="0.002" gravity="0 0 -9.81"/><worldbody>
<body name="upper" pos="0 0 1"><joint name="shoulder" axis="0 1 0" damping="0.3" armature="0.02"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="1.2" contype="0" conaffinity="0"/>
<body name="fore" pos="0 0 -0.3"><joint name="elbow" axis="0 1 0" damping="0.1" stiffness="0.8" springref="0.4"/>
<inertial pos="0 0 -0.12" mass="0.8" diaginertia="0.005 0.005 0.0002"/><site name="tip" pos="0 0 -0.25"/>
</body></body></worldbody><actuator>{shoulder}<motor name="e" joint="elbow" gear="10"/></actuator></mujoco>"""
MOTOR = '<motor name="s" joint="shoulder"/>'
SERVO = '<position name="s" joint="shoulder" kp="40" kv="3" forcerange="-15 15"/>'
SERVOS = '<position name="s" joint="shoulder" kp="40" kv="3"/><position name="e" joint="elbow" kp="12" kv="0.6"/>'
RATE, SECONDS = 50.0, 4.0


def _joint(name: str, attribute: str, was: float, to: float) -> Callable[[str], str]:
    def changed(text: str) -> str:
        head = f'name="{name}" axis="0 1 0"'
        old, new = f'{attribute}="{was:g}"', f'{attribute}="{to:.6g}"'
        start = text.index(head)
        stop = text.index("/>", start)
        joint = text[start:stop]
        joint = joint.replace(old, new) if old in joint else f"{joint} {new}"
        return text[:start] + joint + text[stop:]

    return changed


def _replaced(old: str, new: str) -> Callable[[str], str]:
    return lambda text: text.replace(old, new)


def effects(rng: np.random.Generator, servo: bool) -> dict[str, tuple[str, Callable[[str], str]]]:
    """What may differ: name and place → the change of the text that makes the true file."""
    u = rng.uniform
    payload = (
        f'<body pos="0 0 -0.25"><inertial pos="0 0 0" mass="{u(0.08, 0.3):.5g}" diaginertia="1e-9 1e-9 1e-9"/></body>'
    )
    late = u(0.01, 0.04)
    found = {
        "viscous_friction.elbow": _joint("elbow", "damping", 0.1, u(0.2, 0.5)),
        "viscous_friction.shoulder": _joint("shoulder", "damping", 0.3, 0.3 + u(0.3, 1.0)),
        "coulomb_friction.shoulder": _joint("shoulder", "frictionloss", 0.0, u(0.2, 0.6)),
        "coulomb_friction.elbow": _joint("elbow", "frictionloss", 0.0, u(0.08, 0.25)),
        "armature.shoulder": _joint("shoulder", "armature", 0.02, 0.02 + u(0.03, 0.1)),
        "armature.elbow": _joint("elbow", "armature", 0.0, u(0.005, 0.02)),
        "payload": _replaced('<site name="tip"', payload + '<site name="tip"'),
        "actuator_delay": lambda text: (
            text.replace("/><motor name", f' delay="{late:.5g}" nsample="{int(late / 0.002) + 2}"/><motor name')
            .replace(
                'name="e" joint="elbow"', f'name="e" joint="elbow" delay="{late:.5g}" nsample="{int(late / 0.002) + 2}"'
            )
            .replace('kv="3"/><position', f'kv="3" delay="{late:.5g}" nsample="{int(late / 0.002) + 2}"/><position')
        ),
    }
    if not servo:
        found["actuator_gain.elbow"] = _replaced('gear="10"', f'gear="{10 * u(0.7, 0.9):.5g}"')
        found["joint_stiffness.elbow"] = _joint("elbow", "stiffness", 0.8, u(1.2, 2.0))
    return found


def log(text: str, rng: np.random.Generator, seconds: float, servo: bool, name: str) -> Recording:
    """Encoders and commands, in the body's angles: both hinges are clockwise, θ₁ = −π/2 − q₁, θ₂ = −q₂."""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    rows, per = round(seconds * RATE), round(1 / RATE / model.opt.timestep)
    time = np.arange(rows) / RATE
    size = np.array([[0.5], [0.5]]) if servo else np.array([[2.0], [0.06]])
    w = 2 * np.pi * rng.uniform([[0.2, 0.6, 1.2]], [[0.5, 1.1, 2.0]], (2, 3))
    control = (size * rng.uniform(0.4, 1, (2, 3)) * np.sin(time[:, None, None] * w + rng.uniform(0, 6, (2, 3)))).sum(-1)
    angles = np.zeros((rows, 2))
    for row in range(rows):
        angles[row], data.ctrl[:] = data.qpos[:2], control[row]
        for _ in range(per):
            mujoco.mj_step(model, data)
    zero = np.array([-np.pi / 2, 0.0])
    angles = zero - angles + rng.normal(0, 2e-4, angles.shape)
    given = np.array([40.0, 12.0]) * (zero - control) if servo else -control * [1.0, 10.0]
    return Recording(time, np.empty((rows, 0, 2)), (), None, angles, given, ("shoulder", "elbow"), name)


def case(seed: int, number: int, folder: Path, servo: bool, workers: int, told: bool) -> tuple[str, str, float, float]:
    """The effect; the answer; the share of the excess error that is left; and seconds."""
    rng = np.random.default_rng([seed, number])
    file, true = folder / "robot.xml", folder / "true.xml"
    text = FILE.format(shoulder=SERVOS if servo else MOTOR)
    text = text.replace('<motor name="e" joint="elbow" gear="10"/>', "") if servo else text
    known = effects(rng, servo)
    effect = list(known)[number % len(known)]
    file.write_text(text)
    true.write_text(known[effect](text))
    body = Body.load(file)
    first, second = (log(true.read_text(), rng, SECONDS, servo, name) for name in ("log", "held_out"))
    begun = clock.perf_counter()
    struck = [name for name in EFFECTS if name != effect.partition(".")[0]] if told else []
    found = diagnose(first, body, workers=workers, without=struck, most=1 if told else 4)
    seconds = clock.perf_counter() - begun
    cause = best(found)
    answer = "+".join(sorted(f.key for f in cause.effects)) if cause else "none"
    copy = folder / "corrected.xml"
    written = write_back(found, file, body, copy, second, True)
    if written.written is None or written.written.nothing:
        return effect, answer, 1.0, seconds
    given = commands(mujoco.MjModel.from_xml_path(str(file)), body, second)
    floor, nominal, corrected = (
        rollout(str(path), body, second.time, np.asarray(second.angles), given).total ** 2
        for path in (true, file, copy)
    )
    return effect, answer, max(corrected - floor, 0.0) / max(nominal - floor, 1e-12), seconds


def main() -> None:
    """Print a line a case and a summary."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--cases", type=int, default=40)
    options.add_argument("--seed", type=int, default=50_000)
    options.add_argument("--workers", type=int, default=1)
    options.add_argument(
        "--servo", action="store_true", help="Position servos at both joints; targets are the commands."
    )
    options.add_argument("--told", action="store_true", help="Look for the true effect alone.")
    given = options.parse_args()
    warnings.simplefilter("ignore", UserWarning)
    right, good, named = [], [], 0
    for number in range(given.cases):
        with tempfile.TemporaryDirectory() as folder:
            effect, answer, left, seconds = case(
                given.seed, number, Path(folder), given.servo, given.workers, given.told
            )
        named += effect in answer.split("+")
        right.append(effect == answer)
        good.append(left <= 0.1)
        print(f"{effect:<28} {answer:<44} excess left {100 * left:6.2f} %   {seconds:5.1f} s", flush=True)
    kept = [g for g, r in zip(good, right, strict=True) if r]
    print(
        f"right {sum(right)} of {len(right)}; named among others {named}; of right answers {sum(kept)} of {len(kept)}"
    )


if __name__ == "__main__":
    main()
