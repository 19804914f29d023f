"""The ground's force on a walker, from markers alone, compared with the plates that measured it.

`opensim_gait10`: 2.5 s of walking, 41 markers at 60/s, plates under both feet in all rows, and a model of ten degrees
of freedom in the sagittal plane. The plates are read for the score alone. Two answers:

- `engine`: MuJoCo's own step is the transition, and what acts on the pelvis from outside is unknown, as are the torques
  of hips, knees, ankles and back: its three numbers are the ground's force, and the moment, which together tell the
  centre of pressure c. All ten numbers are Matérn processes, whose scale is fitted.
- `momentum`: the trivial answer, mass × (g + the centre of mass's acceleration), by inverse kinematics of the same
  markers after a Butterworth filter at 6 Hz, as is usual. It has no band, and does not know the feet apart.

Assumed: markers move in the plane; each is moved on its link to where it is on average, and has as noise what inverse
kinematics leave of it. Soles are below the markers of heel and toes by as much as these, at their lowest, are above the
floor. A foot stands while a place of its sole is within 2 cm of the floor, and while both stand, the front one's heel
and the rear one's ball carry the force f as the ends of a beam do:

    f_front = f (c − x_ball) / (x_heel − x_ball),  within 0 and f.

Contacts of MuJoCo's own (spheres as soles, on a plane) were tried in place of this and do not work: the page says why.

    INVDYN_DATA=… python benchmarks/gait.py [--methods laplace]
"""

import argparse
import os
import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import mujoco
import numpy as np
import torch
from leg import held, rms
from scipy.signal import butter, filtfilt

from invdyn.inference.infer_engine import infer_engine
from invdyn.models import EngineModel, JointTorques, Matern32, Observation, Scene
from invdyn.models.bodies.body import Body
from invdyn.models.bodies.mjcf_writer import write_mjcf
from invdyn.models.observation.keypoints import Keypoints
from invdyn.recordings import Recording, load
from invdyn.recordings.formats.opensim import read_sto

CUTOFF = 6.0
"""Hz."""
ROUNDS = 3
"""In which markers move to where they are on average."""
NEAR = 0.02
"""m above the floor, within which a sole stands."""
PLANE = [0, 2]
"""Forwards and up."""
ACTS = 0.05
"""Of the weight: a foot that carries as much is counted among the rows in its band."""


@dataclass(frozen=True)
class Walk:
    """Markers in the sagittal plane, and the plates' mean vertical forces (T − 1, 2) N, right and left, of each row."""

    recording: Recording
    plates: np.ndarray


def walk(folder: Path, names: Sequence[str]) -> Walk:
    """The trial, with those markers that the model has."""
    own = load(folder / "subject01_walk.trc")
    kept = [name for name in own.keypoint_names if name in names]
    points = own.keypoints[:, [own.keypoint_names.index(name) for name in kept]][..., PLANE]
    plates = read_sto(folder / "subject01_walk_grf.mot")
    both = np.stack([plates["ground_force_vy"], plates["1_ground_force_vy"]], 1)
    row = np.searchsorted(own.time, plates["time"] + 1e-6, side="right") - 1
    mean = [both[row == t].mean(0) for t in range(own.num_frames - 1)]
    return Walk(Recording(time=own.time, keypoints=points, keypoint_names=tuple(kept), name="walk"), np.array(mean))


def file_of(body: Body) -> Any:
    """A body as a ``mujoco.MjSpec``."""
    with TemporaryDirectory() as folder:
        write_mjcf(body, Path(folder) / "walker.xml")
        return mujoco.MjSpec.from_file(str(Path(folder) / "walker.xml"))


def poses(model: Any, configurations: np.ndarray) -> Iterator[Any]:
    """MuJoCo's data in each configuration in turn."""
    data = mujoco.MjData(model)
    for row in configurations:
        data.qpos[:] = row
        mujoco.mj_forward(model, data)
        yield data


def placed(spec: Any, recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Move sites to where markers are on average; return configurations (T, nv) and what they leave, rms (P,) m."""
    rows = torch.as_tensor(recording.keypoints.reshape(recording.num_frames, -1))
    for again in range(ROUNDS + 1):
        scene = Scene.of(spec.to_xml(), dimensions=2)
        seen = Keypoints([scene.keypoint_names.index(name) for name in recording.keypoint_names])
        model = EngineModel(scene, recording.time, Observation(seen), parameters={"emission.keypoint_scale": 0.01})
        found = model.split(model.initial_paths(rows)[0])[1].numpy()
        numbers = [scene.model.site(name).id for name in recording.keypoint_names]
        off, within = np.zeros((*recording.keypoints.shape[:2], 3)), np.zeros((len(numbers), 3))
        for t, data in enumerate(poses(scene.model, found)):
            off[t][:, PLANE] = recording.keypoints[t] - data.site_xpos[numbers][:, PLANE]
            axes = data.xmat.reshape(-1, 3, 3)[scene.model.site_bodyid[numbers]]
            within += np.einsum("pji,pj->pi", axes, off[t]) / len(found)
        if again < ROUNDS:
            for name, move in zip(recording.keypoint_names, within, strict=True):
                spec.site(name).pos = spec.site(name).pos + move
    return found, np.sqrt(np.mean(off[..., PLANE] ** 2, axis=(0, 2)))


def momentum(model: Any, configurations: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Mass × (g + a) of the centre of mass, (T − 1,) N, means of two rows."""
    height = np.array([data.subtree_com[0][2] for data in poses(model, configurations)])
    # Twice a Butterworth filter of order 2 is 3 dB down at the cutoff after this correction (D. A. Winter, 2009).
    smooth = filtfilt(*butter(2, CUTOFF / 0.802, fs=1 / np.median(np.diff(time))), height)
    force = float(model.body_mass.sum()) * (np.gradient(np.gradient(smooth, time), time) - model.opt.gravity[2])
    return (force[:-1] + force[1:]) / 2


def soles(model: Any, configurations: np.ndarray) -> np.ndarray:
    """Places (T, 2, 2, 2) m of right and left heel and ball, forwards and above the floor."""
    found = np.array([data.site_xpos[:, PLANE] for data in poses(model, configurations)])
    marks = {name: found[:, model.site(name).id] for name in (model.site(s).name for s in range(model.nsite))}
    feet = [(marks[f"{side}.Heel"], (marks[f"{side}.Toe.Lat"] + marks[f"{side}.Toe.Med"]) / 2) for side in "RL"]
    each = np.moveaxis(np.array(feet), 2, 0)
    each[..., 1] -= each[..., 1].min(0)
    return each


def split(force: np.ndarray, centre: np.ndarray, feet: np.ndarray) -> np.ndarray:
    """Forces (N, T, 2) on the right and the left foot, of their sum and its centre of pressure (N, T)."""
    stands = (feet[..., 1] < NEAR).any(-1)  # (T, 2)
    front = feet[..., 0].mean(-1).argmax(-1)
    rows = np.arange(len(feet))
    heel, ball = feet[rows, front, 0, 0], feet[rows, 1 - front, 1, 0]
    share = np.clip((centre - ball) / (heel - ball), 0.0, 1.0)
    share = np.where(stands[rows, front] & ~stands[rows, 1 - front], 1.0, share)
    share = np.where(~stands[rows, front] & stands[rows, 1 - front], 0.0, share)
    on_right = np.where(front == 0, share, 1 - share)
    return force[..., None] * np.stack([on_right, 1 - on_right], -1)


def inferred(own: Walk, spec: Any, left: np.ndarray, method: str) -> tuple[np.ndarray, float]:
    """Draws (N, T − 1, 2) N of the force under each foot, and CPU seconds."""
    begin = time.process_time()
    scene = Scene.of(spec.to_xml(), dimensions=2)
    idata = infer_engine(
        own.recording,
        scene,
        method=method,
        num_filters=16,
        num_particles=200,
        drive=JointTorques(scene.joint_names),
        torque=Matern32(),
        settings={"emission.keypoint_scale": left},
    )
    posterior = idata["posterior"].stack(sample=("chain", "draw"), create_index=False)

    def of(name: str, joint: str) -> np.ndarray:
        return np.asarray(posterior[name].sel(joint=f"pelvis_{joint}").transpose("sample", "time").values)

    up = of("torque", "ty")
    # The axis of the tilt points to the right: a force ahead of the pelvis lifts it.
    centre = of("angle", "tx") + (of("torque", "tilt") - of("angle", "ty") * of("torque", "tx")) / up
    angles = posterior["angle"].mean("sample").transpose("time", "joint").values
    draws = split(up, centre, soles(scene.model, angles))
    return (draws[:, :-1] + draws[:, 1:]) / 2, time.process_time() - begin


def cells(draws: np.ndarray, plates: np.ndarray, weight: float) -> str:
    """Of the sum: error, share of rows in its band, half its width; of each foot that carries: error, rows in band."""
    whole = draws.sum(-1)
    low, high = np.quantile(whole, [0.05, 0.95], axis=0)
    found = [f"± {50 * (high - low).mean() / weight:.1f}"]
    for values, truth in ((whole, plates.sum(-1)), (draws[..., 0], plates[:, 0]), (draws[..., 1], plates[:, 1])):
        acts = truth > ACTS * weight
        error = 100 * rms(np.median(values, 0) - truth) / weight
        found += [f"{error:.1f}", f"{held(values, truth)[acts].mean():.2f}"]
    return " | ".join(found)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--methods", nargs="+", default=["laplace"])
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    warnings.simplefilter("ignore")
    folder = Path(os.environ["INVDYN_DATA"]).expanduser() / "opensim_gait10"
    body = Body.load(folder / "subject01.osim")
    own, spec, begin = walk(folder, body.keypoint_names), file_of(body), time.process_time()
    configurations, left = placed(spec, own.recording)
    model = spec.compile()
    weight = float(-model.opt.gravity[2] * model.body_mass.sum())
    plain = momentum(model, configurations, own.recording.time)
    off = 100 * rms(plain - own.plates.sum(1)) / weight
    seconds = time.process_time() - begin
    print("Errors and half widths of bands in % of the body's weight:\n")
    print("| answer | band | sum, rms | in band | right, rms | in band | left, rms | in band | CPU s |")
    print("|---|---|---|---|---|---|---|---|---|")
    print(f"| momentum | | {off:.1f} | | | | | | {seconds:.0f} |", flush=True)
    for method in arguments.methods:
        draws, own_seconds = inferred(own, spec, left, method)
        print(f"| engine, {method} | {cells(draws, own.plates, weight)} | {seconds + own_seconds:.0f} |", flush=True)


if __name__ == "__main__":
    main()
