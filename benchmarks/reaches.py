"""Simulated reaches of a person's arm: do torques, their peaks, impulses and work lie in the intervals?

MuJoCo moves an arm of two links, from its file, in steps of half a millisecond: a plan's torques by MuJoCo's inverse
dynamics, and a weak spring and damper that hold the arm to the plan. A reach lasts .5 to 1 s between two rests. Styles:

    smooth     minimum jerk (Flash & Hogan 1985, J. Neurosci. 5, 1688–1703)
    rough      the same, and an Ornstein–Uhlenbeck torque of sd 8 % of the plan's largest, time constant 60 ms
    ballistic  full acceleration and braking in .25 to .4 s, through a muscle of second order, 25 ms
    tremor     minimum jerk, and a torque of 5 to 9 Hz, amplitude 4 to 12 % of the plan's largest
    load       minimum jerk; on the way the hand picks up .3 to 1 kg, and the muscles follow .1 s later

The truth is the net torque of the arm as its file has it: what the hand picks up is a force on that arm, which begins
at once. Markers at elbow and wrist have noise of 1 to 2 mm, at 100 frames a second; in space every fifth reach.

    python benchmarks/reaches.py [--reaches 200] [--smc 40] [--first 0] [--torque NAME] [--results FILE]

Coverage is the share of true values within 90 % intervals, of rows and of functionals (:mod:`.functionals`).
With `--results` a line a reach is kept, and the same call continues where it was stopped.
"""

import argparse
import json
import tempfile
import time
import warnings
from functools import partial
from pathlib import Path

import mujoco
import numpy as np
import torch
from kept import kept

from invdyn.inference import functional_table, infer, pooled
from invdyn.models import TORQUE_PROCESSES, Body, Joint, Link, planar_body, write_mjcf
from invdyn.recordings import Recording, Truth

STYLES = ("smooth", "rough", "ballistic", "tremor", "load")
RATE, STEP = 100.0, 5e-4
REST = 0.15
KEYPOINTS = ("elbow", "wrist")
HANGING = ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0))
UPPER, FORE = {"length": 0.30, "mass": 2.0}, {"length": 0.33, "mass": 1.6}
SPACE_EVERY = 5


def arm(space: bool) -> Body:
    """Upper arm and forearm with hand; in space the shoulder has yaw and pitch, and the elbow is a hinge."""
    if not space:
        return planar_body("arm", [Link("upper", "shoulder", "elbow", **UPPER), Link("fore", "elbow", "wrist", **FORE)])
    own = [(0.004, 0.015, 0.015, 0.0, 0.0, 0.0), (0.003, 0.0145, 0.0145, 0.0, 0.0, 0.0)]
    shoulder = Joint("shoulder", "universal")
    upper = Link("upper", shoulder, tip="elbow", rotation=HANGING, inertia=own[0], **UPPER)
    return Body("arm", [upper, Link("fore", "elbow", "wrist", parent="upper", inertia=own[1], **FORE)])


def engines(body: Body, load: float) -> tuple[mujoco.MjModel, mujoco.MjModel]:
    """The arm in MuJoCo, and the same with a load (kg) in its hand."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.xml"
        write_mjcf(body, path)
        specs = [mujoco.MjSpec.from_file(str(path)) for _ in range(2)]
    hand = next(each for each in specs[1].bodies if each.name == "fore").add_body(
        name="load", pos=[FORE["length"], 0, 0]
    )
    hand.mass, hand.inertia, hand.explicitinertial = load, [1e-6] * 3, True
    models = [spec.compile() for spec in specs]
    for model in models:
        model.opt.timestep, model.opt.integrator = STEP, mujoco.mjtIntegrator.mjINT_RK4
    return models[0], models[1]


def inverse(model: mujoco.MjModel, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
    """Torques (N, K) of a motion, by MuJoCo's inverse dynamics."""
    data, found = mujoco.MjData(model), np.empty_like(q)
    for row, motion in enumerate(zip(q, qd, qdd, strict=True)):
        data.qpos[:], data.qvel[:], data.qacc[:] = motion
        mujoco.mj_inverse(model, data)
        found[row] = data.qfrc_inverse
    return found


def plan(style: str, joints: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Angles, velocities and accelerations (N, K) of a reach that one plans, and how long the movement lasts, s."""
    lasts = rng.uniform(0.25, 0.4) if style == "ballistic" else rng.uniform(0.5, 1.0)
    t = np.arange(0, REST + lasts + 1.5 * REST, STEP)
    s = np.clip((t - REST) / lasts, 0, 1)[:, None]
    start = np.array([0.2, 0.3, 0.8]) if joints == 3 else np.array([-1.4, 0.6])
    far = rng.uniform(0.3, 1.0, joints) * rng.choice([-1, 1], joints)
    far[-1] = abs(far[-1])
    start = start + rng.uniform(-0.2, 0.2, joints)
    if style != "ballistic":
        q = start + far * (10 * s**3 - 15 * s**4 + 6 * s**5)
        qd = far / lasts * (30 * s**2 - 60 * s**3 + 30 * s**4)
        return q, qd, far / lasts**2 * (60 * s - 180 * s**2 + 120 * s**3), lasts
    pull = np.where((s > 0) & (s < 0.5), 1.0, 0.0) - np.where((s >= 0.5) & (s < 1), 1.0, 0.0)
    lag = STEP / 0.025
    for _ in range(2):  # two lags of first order are the muscle
        for row in range(1, len(pull)):
            pull[row] = pull[row - 1] + lag * (pull[row] - pull[row - 1])
    qd = STEP * np.cumsum(pull, 0)
    q = STEP * np.cumsum(qd, 0)
    return start + far * q / q[-1], far * qd / q[-1], far * pull / q[-1], lasts


def reach(number: int) -> tuple[Recording, Truth, Body, str]:
    """A recording, its truth, the arm and the style."""
    style, rng = STYLES[number % len(STYLES)], np.random.default_rng(number)
    body = arm((number // len(STYLES)) % SPACE_EVERY == SPACE_EVERY - 1)
    q, qd, qdd, lasts = plan(style, body.num_joints, rng)
    load = rng.uniform(0.3, 1.0)
    empty, loaded = engines(body, load)
    forward = inverse(empty, q, qd, qdd)
    largest, t = np.abs(forward).max(0), STEP * np.arange(len(q))
    torque = forward.copy()
    picked = len(q)
    if style == "rough":
        keep, shake = np.exp(-STEP / 0.06), np.zeros(body.num_joints)
        for row in range(len(q)):
            shake = keep * shake + np.sqrt(1 - keep**2) * rng.standard_normal(body.num_joints)
            torque[row] += 0.08 * largest * shake
    elif style == "tremor":
        phase = 2 * np.pi * (rng.uniform(5, 9) * t[:, None] + rng.uniform(0, 1, body.num_joints))
        torque += rng.uniform(0.04, 0.12) * largest * np.sin(phase)
    elif style == "load":
        picked = int((REST + lasts * rng.uniform(0.2, 0.6)) / STEP)
        follows = np.clip((t - picked * STEP - 0.1) / 0.1, 0, 1)[:, None]
        torque += follows * (inverse(loaded, q, qd, qdd) - forward)
    datas = [mujoco.MjData(model) for model in (empty, loaded)]
    datas[0].qpos[:], datas[0].qvel[:] = q[0], qd[0]
    every = round(1 / RATE / STEP)
    motion, points = [], []
    for row in range(len(q)):
        model, data = (empty, datas[0]) if row < picked else (loaded, datas[1])
        if row == picked:
            data.qpos[:], data.qvel[:] = datas[0].qpos, datas[0].qvel
        data.qfrc_applied[:] = torque[row] + 20.0 * (q[row] - data.qpos) + 1.0 * (qd[row] - data.qvel)
        if row % every == 0:
            mujoco.mj_forward(model, data)
            motion.append(np.stack([data.qpos, data.qvel, data.qacc]))
            points.append([data.site(name).xpos[: body.dimensions].copy() for name in KEYPOINTS])
        mujoco.mj_step(model, data)
    moved = np.array(motion).swapaxes(0, 1)
    rows, keypoints = np.arange(len(points)) / RATE, np.array(points)
    keypoints += rng.uniform(0.001, 0.002) * rng.standard_normal(keypoints.shape)
    truth = Truth(rows, moved[0], moved[1], inverse(empty, *moved), body.joint_names)
    return Recording(rows, keypoints, KEYPOINTS), truth, body, style


def run(number: int, method: str, torque: str) -> dict:
    """Of each joint whether its functionals lie within, the share of rows that do, error, half width; and seconds."""
    recording, truth, body, style = reach(number)
    process = None if torque == "default" else TORQUE_PROCESSES[torque]()
    started = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        idata = infer(recording, body, method=method, seed=number, torque=process, truth=truth)
    seconds = time.process_time() - started
    table = functional_table(idata)
    low, high = np.quantile(pooled(idata)["torque"].transpose("sample", "time", "joint").values, [0.05, 0.95], axis=0)
    middle = np.median(pooled(idata)["torque"].transpose("sample", "time", "joint").values, axis=0)
    inside = (low <= truth.torque) & (truth.torque <= high)
    found: dict = {"style": style, "seconds": seconds, "outer_ess": idata.attrs["outer_ess"], "joints": {}}
    found["settings"] = json.loads(idata.attrs["settings"])
    for k, joint in enumerate(body.joint_names):
        own = table[table["joint"] == joint].set_index("functional")
        found["joints"][joint] = {
            "rows": float(inside[:, k].mean()),
            "rmse": float(np.sqrt(((middle - truth.torque)[:, k] ** 2).mean())),
            "half": float((high - low)[:, k].mean() / 2),
            **{name: [row["q05"], row["median"], row["q95"], row["truth"]] for name, row in own.iterrows()},
        }
    return found


COLUMNS = ("rows", "peak", "peak_time", "impulse", "peak_rate", "work", "mean_power")


def line(name: str, found: list[dict]) -> str:
    """Shares within the intervals over reaches and joints, error and half width over the torque's rms."""
    joints = [own for each in found for own in each["joints"].values()]
    cells = []
    for column in COLUMNS:
        inside = [
            own[column] if column == "rows" else own[column][0] <= own[column][3] <= own[column][2] for own in joints
        ]
        cells.append(f"{np.mean(inside):.2f}")
    error, half = (np.mean([own[key] for own in joints]) for key in ("rmse", "half"))
    seconds = np.mean([each["seconds"] for each in found])
    return f"| {name} | {len(found)} | {' | '.join(cells)} | {error:.2f} | {half:.2f} | {seconds:.0f} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--reaches", type=int, default=200, help="by laplace")
    parser.add_argument("--smc", type=int, default=40, help="how many of them by smc, too")
    parser.add_argument("--first", type=int, default=0, help="number of the first")
    parser.add_argument("--torque", default="default")
    parser.add_argument("--results", type=Path)
    given = parser.parse_args()
    torch.set_num_threads(1)
    for method, count in (("laplace", given.reaches), ("smc", given.smc)):
        if not count:
            continue
        print(f"\n{method}, torque {given.torque}")
        print(
            f"| style, joint | reaches | {' | '.join(COLUMNS)} | rmse, N·m | ± 90 %, N·m | CPU s |\n"
            + "|---" * 12
            + "|"
        )
        found = [
            kept(given.results, f"{number}, {method}, {given.torque}", partial(run, number, method, given.torque))
            for number in range(given.first, given.first + count)
        ]
        for style in STYLES:
            if own := [each for each in found if each["style"] == style]:
                print(line(style, own))
        for joint in sorted({name for each in found for name in each["joints"]}):
            of_joint = [{**each, "joints": {joint: each["joints"][joint]}} for each in found if joint in each["joints"]]
            print(line(joint, of_joint))
        print(line("all", found), flush=True)


if __name__ == "__main__":
    main()
