"""A robot that walks: joint torques and ground forces of a Unitree Go1 with a floating base, from keypoints.

MuJoCo simulates the public model (`unitree_go1` of MuJoCo Menagerie, BSD-3-Clause; meshes are for pictures and left
out) as it trots by its own position servos. Keypoints of feet, knees, hips and trunk at 100 Hz have 2 mm of noise.
Torques of the twelve joints and the force of the floor on each foot are inferred by `infer_engine`. A foot is what of
a shank touches the floor: its sphere is so soft that the shank's end presses on the floor, too, with a fifth of the
weight. The table has errors of the vertical force as shares of the body's weight, over rows in which a foot stands, and
of all feet's sum over all rows; the share of rows in which 90 % bands hold the truth; CPU seconds and peak memory.

    python benchmarks/quadruped.py [--method laplace] [--seconds 2] [--seeds 1] [--files FOLDER] [--results FILE]

With `--files` the model and the recording are written for `invdyn infer FOLDER/walk.csv --body FOLDER/go1.xml`.
"""

import argparse
import resource
import time
import warnings
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import torch
from kept import kept
from leg import PATHS, held, rms

from invdyn.inference.infer_engine import ENGINE_METHODS, infer_engine
from invdyn.models import Scene
from invdyn.recordings import Recording, write_keypoint_csv
from invdyn.recordings.catalogue import Source, fetch

GO1 = Source(
    "unitree_go1/go1.xml",
    "google-deepmind/mujoco_menagerie",
    "1f39894208d5c531328209961d4e930299d01c16",
    "unitree_go1/go1.xml",
    "d5a7466784c8e72fd174cc7fa5a92754a1a0a6d458a1dec79e7ca0abc9525c4a",
)
LEGS = ("FR", "FL", "RR", "RL")
TRUNK = {"neck": (0.25, 0, 0.06), "tail": (-0.25, 0, 0.06), "left": (0, 0.09, 0.06), "right": (0, -0.09, 0.06)}
INTERVAL, SETTLING = 0.01, 1.0
"""Time between rows, and of walking before the first one, s."""
SHANK = 0.213
"""Length of thigh and shank, m."""
PERIOD, DUTY, STRIDE, LIFT, HEIGHT = 0.5, 0.6, 0.12, 0.05, 0.27
"""The trot's period, s, share of it with a foot on the floor, step and lift of a foot, and height of the hips, m."""
STANDS = 5.0
"""Least true force on a foot that stands, N."""


@dataclass(frozen=True)
class Walk:
    """Rows (T, K, 3) m, joint torques (T, 12) N·m, mean vertical forces up to the next row (T, 4) N, weight N."""

    text: str
    names: tuple[str, ...]
    joints: tuple[str, ...]
    time: np.ndarray
    rows: np.ndarray
    torque: np.ndarray
    force: np.ndarray
    path: np.ndarray
    weight: float


def go1_text() -> str:
    """The MJCF without its meshes, with a floor, and with sites of knees, hips and trunk."""
    root = ElementTree.parse(fetch(GO1)).getroot()
    root.remove(root.find("asset"))
    for parent in list(root.iter()):
        for geom in [each for each in parent.findall("geom") if each.get("class") == "visual" or "mesh" in each.attrib]:
            parent.remove(geom)
        if parent.tag == "default" and parent.get("class") == "visual":
            parent.clear()
            parent.set("class", "visual")
    world = root.find("worldbody")
    world.insert(0, ElementTree.Element("geom", name="floor", type="plane", size="5 5 .1"))
    for body in world.iter("body"):
        leg, _, part = body.get("name").partition("_")
        points = {f"{leg}_{'hip' if part == 'thigh' else 'knee'}": (0, 0, 0)} if part in ("thigh", "calf") else {}
        for name, place in (TRUNK if body.get("name") == "trunk" else points).items():
            ElementTree.SubElement(body, "site", name=name, pos=" ".join(map(str, place)))
    return ElementTree.tostring(root, encoding="unicode")


def targets(clock: float) -> np.ndarray:
    """Joint angles (12,) of a trot at a time: diagonal legs together, each foot on a line and back through the air."""
    out = []
    for leg in LEGS:
        phase = (clock / PERIOD + (0.0 if leg in ("FR", "RL") else 0.5)) % 1.0
        share = phase / DUTY if phase < DUTY else (phase - DUTY) / (1 - DUTY)
        along = STRIDE * (0.5 - share if phase < DUTY else (1 - np.cos(np.pi * share)) / 2 - 0.5)
        down = HEIGHT - (0.0 if phase < DUTY else LIFT * np.sin(np.pi * share))
        bend = np.arccos(np.hypot(along, down) / (2 * SHANK))
        out += [0.0, np.arctan2(-along, down) + bend, -2 * bend]
    return np.array(out)


def walk(seconds: float, seed: int, noise: float = 0.002) -> Walk:
    """A trot along x. Raises RuntimeError where the robot falls."""
    text, rng = go1_text(), np.random.default_rng(seed)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    names = (*TRUNK, *(f"{leg}{part}" for leg in LEGS for part in ("_hip", "_knee", "")))
    sites = [model.site(name).id for name in names]
    shanks = [model.body(f"{leg}_calf").id for leg in LEGS]
    weight = float(model.body_subtreemass[1] * -model.opt.gravity[2])
    steps, total = round(INTERVAL / model.opt.timestep), round((seconds + SETTLING) / INTERVAL)
    rows, torques, forces, path = [], [], [], []
    for t in range(total):
        data.ctrl[:] = targets(t * INTERVAL)
        mujoco.mj_forward(model, data)
        rows.append(data.site_xpos[sites] + noise * rng.normal(size=(len(sites), 3)))
        torques.append(data.actuator_force.copy())
        path.append(np.concatenate([data.qpos, data.qvel]))
        force = np.zeros(len(LEGS))
        for _ in range(steps):
            mujoco.mj_step(model, data)
            force += vertical(model, data, shanks) / steps
        forces.append(force)
    first = round(SETTLING / INTERVAL)
    kept_rows = [np.array(each)[first:] for each in (rows, torques, forces, path)]
    high = kept_rows[3][:, 2]
    if high.min() < 0.2 or kept_rows[3][-1, 0] - kept_rows[3][0, 0] < 0.1 * seconds:
        raise RuntimeError(f"expected a robot that walks, got a trunk {high.min():.2f} m above the floor")
    joints = tuple(model.joint(int(j)).name for j in model.actuator_trnid[:, 0])
    return Walk(text, names, joints, np.arange(len(high)) * INTERVAL, *kept_rows, weight)


def vertical(model, data, shanks: list[int]) -> np.ndarray:
    """What the floor pushes the foot of each shank up with, N."""
    out, own = np.zeros(len(shanks)), np.zeros(6)
    for c in range(data.ncon):
        one, other = model.geom_bodyid[data.contact.geom[c]]
        if one == 0 and other in shanks:
            mujoco.mj_contactForce(model, data, c, own)
            out[shanks.index(other)] += (data.contact.frame[c].reshape(3, 3).T @ own[:3])[2]
    return out


def measured(method: str, seconds: float, filters: int, particles: int, seed: int) -> dict:
    """Figures of one walk."""
    walked = walk(seconds, seed)
    begin = time.process_time()
    sizes = {"num_filters": filters, "num_particles": particles, "num_draws": -(-PATHS // filters)}
    idata = infer_engine(recording(walked), Scene.of(walked.text), method=method, seed=seed, **sizes)
    took = time.process_time() - begin
    posterior = idata["posterior"].stack(sample=("chain", "draw"), create_index=False)
    torque = posterior["torque"].sel(joint=list(walked.joints)).transpose("sample", "time", "joint").values[:, :-1]
    pushed = posterior["contact_force"].sel(axis="z").transpose("sample", "time", "contact").values[:, :-1]
    names = [str(name) for name in posterior["contact"].values]
    of_leg = np.array([[name.startswith(f"floor-{leg}") for leg in LEGS] for name in names], float)
    force = pushed @ of_leg
    true_torque, true_force = walked.torque[:-1], walked.force[:-1]
    stands, total = true_force > STANDS, force.sum(-1)
    off = np.median(force, 0) - true_force
    stats = idata["sample_stats"].attrs  # the filters' own, or of the linearised model in their stead
    return {
        "feet": [rms(off[stands[:, k], k]) / walked.weight for k in range(len(LEGS))],
        "sum": rms(np.median(total, 0) - true_force.sum(-1)) / walked.weight,
        "impulse": float(force.mean(0).sum() / true_force.sum()),
        "torque_error": rms(np.median(torque, 0) - true_torque),
        "torque_size": rms(true_torque),
        "torque": float(held(torque, true_torque).mean()),
        "force": float(held(force, true_force)[stands].mean()),
        "total": float(held(total, true_force.sum(-1)).mean()),
        "filters": float(idata["sample_stats"]["log_evidence"].values.std(ddof=1)),
        "usable": float(stats.get("usable", stats.get("converged"))),
        "hidden": idata.attrs.get("hidden", ""),
        "seconds": took,
        "gigabytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
    }


def recording(walked: Walk) -> Recording:
    """The keypoints."""
    return Recording(time=walked.time, keypoints=walked.rows, keypoint_names=walked.names, name="go1")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--method", default="smc", choices=ENGINE_METHODS)
    parser.add_argument("--seconds", type=float, default=2.0)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--filters", type=int, default=16)
    parser.add_argument("--particles", type=int, default=200)
    parser.add_argument("--files", type=Path, help="folder to write the model and the recording to, and stop")
    parser.add_argument("--results", type=Path, help="file that keeps each walk's figures")
    arguments = parser.parse_args()
    if folder := arguments.files:
        walked = walk(arguments.seconds, 0)
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "go1.xml").write_text(walked.text, encoding="utf-8")
        write_keypoint_csv(recording(walked), folder / "walk.csv")
        return
    torch.set_num_threads(1)
    warnings.simplefilter("ignore")
    heads = ("seed", "each foot, % of weight", "all feet", "impulse", "torque rmse", "torque, foot, all feet in band")
    print(f"| {' | '.join((*heads, 'sd of log Ẑ', 'usable', 'CPU s', 'GB'))} |")
    print("|---" * 10 + "|")
    said = ""
    for seed in range(arguments.seeds):
        sizes = (arguments.method, arguments.seconds, arguments.filters, arguments.particles, seed)
        run = kept(arguments.results, f"go1 {sizes}", partial(measured, *sizes))
        feet = ", ".join(f"{100 * each:.1f}" for each in run["feet"])
        print(
            f"| {seed} | {feet} | {100 * run['sum']:.1f} | {run['impulse']:.3f} | "
            f"{run['torque_error']:.2g} of {run['torque_size']:.2g} N·m | "
            f"{run['torque']:.2f}, {run['force']:.2f}, {run['total']:.2f} | {run['filters']:.2f} | "
            f"{run['usable']:.0%} | {run['seconds']:.0f} | {run['gigabytes']:.1f} |"
        )
        said = said or run["hidden"]
    print(f"\nWhat the summary says of the first:\n\n{said}")


if __name__ == "__main__":
    main()
