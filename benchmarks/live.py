"""What `invdyn live` takes and reports: latency of rows, bands of the lagged answer, delay until a change is reported.

Simulated replays, rows one after the other as fast as they are answered: planar arm of two joints at 100 rows/s by
keypoints, an arm of seven joints in space at 60 rows/s by keypoints and encoders, and the planar arm under known
commands. Times are those of the process's CPU on one thread, from a row's arrival to its answers.

A change is made after four of eight seconds: a forearm heavier by 30 % (a payload), or viscous friction at one joint
of 30 % of the command's rms.

    python benchmarks/live.py [--minutes 10] [--changes 10]
"""

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from trees import panda

from invdyn.inference.live import Z90, LiveArm
from invdyn.inputs import load_body
from invdyn.models import Body
from invdyn.models.bodies.joint_parts import JointParts
from invdyn.models.effects.friction import ViscousFriction
from invdyn.simulate import random_arm, record

SHARE = 0.3
"""Of a friction's torque in the rms of the command of its joint."""
CALIBRATION = 6.0
"""s of the recording that parameters are fitted on."""


def seven() -> Body:
    """The Panda with damping and rotors of mujoco_menagerie (Apache-2.0); without any its hand whirls in a minute."""
    parts = JointParts(damping=1.0, armature=0.1)
    return Body("panda", [replace(link, parts=parts) for link in panda().links])


def live_of(model, seed: int = 1) -> LiveArm:
    """Calibrated on a recording of a model."""
    recording, _ = record(model, seed)
    return LiveArm(recording, model.body)


def lines(live: LiveArm, model, observed: torch.Tensor):
    """Times and values of a model's rows."""
    names = live.columns + live.commands
    command = model.command
    for k, (time_of, row) in enumerate(zip(model.time.tolist(), observed.tolist(), strict=True)):
        own = row if command is None else [*row, *command[k].tolist()]
        yield time_of, dict(zip(names, own, strict=True))


def replay(live: LiveArm, model, observed: torch.Tensor):
    """Milliseconds of each row, and answers."""
    taken, answers = [], []
    for time_of, values in lines(live, model, observed):
        begin = time.process_time()
        answers += live.add(time_of, values)
        taken.append(1e3 * (time.process_time() - begin))
    return np.array(taken), answers


def latency(name: str, body, fps: float, minutes: float, **options) -> str:
    """One line of the first table, from a replay in stretches of a minute, half of them under each of two commands."""
    live = live_of(random_arm(body, duration=CALIBRATION, fps=fps, seed=0, **options))
    taken, inside, alarms = [], [], 0
    for half, count in enumerate((round(minutes / 2), round(minutes) - round(minutes / 2))):
        model = random_arm(body, duration=60, fps=fps, seed=100 + half, **options)
        for states, observed in zip(*model.simulate((count,), seed=half), strict=True):
            live.forget()
            own, answers = replay(live, model, observed)
            taken.append(own[20:])
            alarms += sum(each.changed for each in answers)
            truth = model.net_torque(states)[: len(answers)].numpy()
            mean, sd = (np.array([each.torque[k] for each in answers]) for k in (0, 1))
            inside.append(np.abs(truth - mean) < Z90 * sd)
    ms = np.concatenate(taken)
    quantiles = " | ".join(f"{np.quantile(ms, q):.2f}" for q in (0.5, 0.95, 0.99, 1.0))
    over, holds = (ms > 1e3 / fps).mean(), np.concatenate(inside).mean()
    return f"| {name} | {fps:.0f} | {len(ms)} | {quantiles} | {over:.2%} | {holds:.3f} | {alarms} |"


def changed(model, observed, states, row: int, other, parameters) -> torch.Tensor:
    """Rows of an arm that is another one from ``row`` on."""
    _, angle, velocity = model.split(states[row - 1])
    rest = other.at_times(model.time[row - 1 :] - model.time[row - 1]).commanded(model.command[row - 1 :])
    still = torch.full_like(angle, 1e-9)
    begin = {"angle": angle, "velocity": velocity, "angle_scale": still, "velocity_scale": still}
    _, after = rest.replace(**{f"initial.{name}": value for name, value in begin.items()}, **parameters).simulate()
    return torch.cat([observed[:row], after[1:]])


def changes(count: int) -> None:
    """The second table."""
    body = load_body("paper_planar_arm")
    options = {"fps": 100, "noise": 0.003, "commanded": True}
    live = live_of(random_arm(body, duration=CALIBRATION, seed=11, **options))
    factor = torch.tensor([1.0, 1.3], dtype=torch.float64)
    print("| change | reported within 2 s | delay s, median | 90 % | reported before it |\n|---|---|---|---|---|")
    for name in ("forearm 30 % heavier", "friction at the shoulder", "friction at the elbow"):
        delays, early = [], 0
        for seed in range(count):
            model = random_arm(body, duration=8, seed=20 + seed, **options)
            torch.manual_seed(seed)
            states, observed = model.simulate()
            other, parameters = model, {}
            if "heavier" in name:
                parameters = {key: model.parameters[key] * factor for key in ("body.mass", "body.inertia")}
            else:
                joint = int("elbow" in name)
                other = model.with_effects(ViscousFriction(body.joint_names[joint]))
                (damping,) = [key for key in other.parameters if key not in model.parameters]
                speed = model.split(states)[2][:, joint].square().mean().sqrt()
                size = SHARE * model.command[:, joint].square().mean().sqrt() / speed
                parameters = {damping: size.expand(other.parameters[damping].shape).clone()}
            observed = changed(model, observed, states, 400, other, parameters)
            live.forget()
            _, answers = replay(live, model, observed)
            alarms = [each.time - model.time[400].item() for each in answers if each.changed]
            early += sum(each < 0 for each in alarms)
            delays.append(next((each for each in alarms if each >= 0), np.inf))
        late = np.array(delays)
        median, most = np.median(late), np.quantile(late, 0.9)
        print(f"| {name} | {(late <= 2).sum()} of {count} | {median:.2f} | {most:.2f} | {early} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=10)
    parser.add_argument("--changes", type=int, default=10)
    parser.add_argument("--only", choices=("planar", "commanded", "seven"), nargs="*")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    planar = load_body("paper_planar_arm")
    if arguments.minutes:
        heads = "arm", "rows/s", "rows", "ms a row: median", "95 %", "99 %", "most", "over a row's time", "90 % holds"
        print(f"| {' | '.join(heads)} | false alarms |\n|" + "---|" * 10)
        arms = {
            "planar": ("planar, keypoints", planar, 100, {"noise": 0.003}),
            "commanded": ("planar, commanded", planar, 100, {"noise": 0.003, "commanded": True}),
            "seven": ("seven joints", seven(), 60, {"noise": 0.003, "encoder_noise": 1e-3}),
        }
        for name in arguments.only or arms:
            said, body, fps, options = arms[name]
            print(latency(said, body, fps, arguments.minutes, **options), flush=True)
        print()
    if arguments.changes:
        changes(arguments.changes)


if __name__ == "__main__":
    main()
