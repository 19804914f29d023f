"""Real arms whose joint torques a sensor measured, or physics tells: what each saw, its body, and the truth.

    kuka         a KUKA iiwa from its seven encoders, the first 10 s; its joint-torque sensors, whose signs are opposite
    keypoints    the same 10 s from keypoints made of its kinematics, two a link, with 2 mm of noise
    pendulum     three links from 16 markers, once a hand has let go: no torque but the bearings' friction
    dfki         two joints from keypoints made of the encoders, 60 frames/s and 3 mm; motor torque less friction
    dfki-cad     the same arm from its encoders, with the numbers of its drawings; all of the motors' torque
    film         the same arm from the pixels tracked in its film, 30 frames/s
    arm26        an elbow flexed, from two markers; what OpenSim computes from all of them, filtered

A sensor that is faster than the rows is averaged over each row, as no row tells more. The DFKI laboratory identified
its arm and its friction (model_2.0, b θ̇ + cf arctan(100 θ̇)), and does not say how well they are known: that body counts
as inexact, as those of the others' files do. Folders are those of `INVDYN_DATA`.

Shapes: T rows, K joints. Units: s, rad, m, N·m.
"""

import csv
import os
import warnings
from dataclasses import dataclass, field, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.signal import butter, filtfilt

from invdyn.models import Body, dynamics_for
from invdyn.recordings import Recording, Truth, load, load_truth
from invdyn.recordings.formats.opensim import read_sto

FRICTION = {"viscous": (0.001, 0.001), "coulomb": (0.093, 0.078)}  # model_2.0, N·m·s/rad and N·m
ROTOR = 7.659297952841183e-05  # kg·m², behind a gear of 6
GEAR = 6.0
KUKA_RATE, PENDULUM_RATE, FILE_RATE = 20, 100, {"kuka": 200, "pendulum": 400}
"""Rows/s: the KUKA turns by .42 rad/s at most, and yet 5 rows/s do not carry its motion."""
MARKED = {"a": (0.06, 0.0, 0.03), "b": (0.0, 0.06, -0.03)}
"""m, in each link's frame: two keypoints a link, off its axis."""
AXIS, BASE = (-0.0817, 0.9966, 0.0), (0.00990, -0.22218, 1.53039)
"""Direction of the pendulum's hinges in the laboratory's frame, and m, where the first one is in the body's."""
FREE = {3: 4.0, 4: 2.25}
"""s: from when on nobody has touched the pendulum; it swings through a blow before."""
CALM = 4.45
"""s: then the film's controller chatters at ± 4 N·m, frame by frame, as no camera at 30 frames/s shows."""


FILTERED = 0.15
"""s at each end where OpenSim's filter of 6 Hz makes the moments: the recording begins and ends in full motion."""


@dataclass
class Case:
    """A recording, its body, the true torque (T, K), which rows count, and options of `infer`."""

    name: str
    recording: Recording
    body: Body
    torque: np.ndarray
    counted: Any = field(default_factory=lambda: slice(None))
    options: dict[str, Any] = field(default_factory=dict)

    @property
    def truth(self) -> Truth:
        """The torque alone, as `infer` takes it."""
        nothing = np.full_like(self.torque, np.nan)
        return Truth(self.recording.time, nothing, nothing, self.torque, self.body.joint_names)


def folder(name: str) -> Path:
    return Path(os.environ["INVDYN_DATA"]) / name


def frame_means(times: np.ndarray, source: np.ndarray, values: np.ndarray, width: float) -> np.ndarray:
    """Mean of ``values`` (S, K) within ± width/2 of each time; robust to a fast, noisy log."""
    left = np.searchsorted(source, times - width / 2)
    right = np.maximum(np.searchsorted(source, times + width / 2), left + 1)
    total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    right = np.minimum(right, len(source))
    left = np.minimum(left, right - 1)
    return (total[right] - total[left]) / (right - left)[:, None]


# -- KUKA ------------------------------------------------------------------------------------------------------
def kuka(trial: int, seconds: float = 10.0) -> Case:
    body = Body.load(folder("delft_kuka") / "kuka.xml")
    table = np.genfromtxt(folder("delft_kuka") / f"trial{trial}.csv", delimiter=",", skip_header=1)
    rows = table[table[:, 0] < seconds][:: FILE_RATE["kuka"] // KUKA_RATE]
    time = rows[:, 0]
    nothing = np.empty((len(time), 0, 3))
    recording = Recording(time, nothing, (), angles=rows[:, 1:8], joint_names=body.joint_names)
    torque = -frame_means(time, table[:, 0], table[:, 8:15], 1 / KUKA_RATE)
    return Case(f"kuka {trial}", recording, body, torque)


def keypoints(trial: int, seconds: float = 10.0, noise: float = 0.002) -> Case:
    case = kuka(trial, seconds)
    links = [
        replace(link, sites={f"{link.name}_{which}": place for which, place in MARKED.items()})
        for link in case.body.links
    ]
    body = replace(case.body, links=links)
    angles = torch.as_tensor(case.recording.angles)
    points = dynamics_for(body).keypoints(angles, body.parameters()).numpy()
    points += noise * np.random.default_rng(trial).normal(size=points.shape)
    recording = Recording(case.recording.time, points, body.keypoint_names)
    return Case(f"kuka {trial}, keypoints", recording, body, case.torque)


# -- the pendulum ----------------------------------------------------------------------------------------------
def pendulum(trial: int, seconds: float = 4.0) -> Case:
    body = Body.load(folder("delft_pendulum") / "pendulum.osim")
    with (folder("delft_pendulum") / f"markers{trial}.csv").open() as file:
        header, *rows = csv.reader(file)
    values = np.array([[float(value or "nan") for value in row] for row in rows])
    values = values[(values[:, 0] >= FREE[trial] - 0.25) & (values[:, 0] < FREE[trial] + seconds)]
    values = values[:: FILE_RATE["pendulum"] // PENDULUM_RATE]
    up, axis = np.array([0.0, 0.0, 1.0]), np.array(AXIS) / np.linalg.norm(AXIS)
    frame = np.stack([np.cross(up, axis), -axis, up])
    shift = body.parameters().position[0].numpy() - np.array(BASE)
    moved = dict.fromkeys(body.keypoint_names)
    names = [c[:-2] for c in header if c.endswith("_x") and c[:-2] in moved]
    points = [values[:, header.index(f"{name}_x") :][:, :3] @ frame.T + shift for name in names]
    time = values[:, 0] - values[0, 0]
    recording = Recording(time, np.stack(points, 1), tuple(names))
    counted = values[:, 0] >= FREE[trial]
    return Case(f"pendulum {trial}", recording, body, np.zeros((len(time), 3)), counted)


# -- the DFKI arm ----------------------------------------------------------------------------------------------
def joint_torque(truth: Truth) -> np.ndarray:
    """Motor torque less identified friction, (T, K) N·m."""
    viscous, coulomb = (np.array(FRICTION[k]) for k in ("viscous", "coulomb"))
    friction = viscous * truth.velocity + coulomb * np.arctan(100 * truth.velocity)
    return truth.torque - friction


def rotor_torque(log: Truth, times: np.ndarray) -> np.ndarray:
    """Torque (T, K) that turns the rotors, N·m, from the encoders: low-passed at 15 Hz, differentiated twice."""
    fine = np.arange(log.time[0], log.time[-1], 0.002)
    q = filtfilt(*butter(2, 15.0, fs=500.0), log.at(fine).angle, axis=0)
    qdd = np.gradient(np.gradient(q, 0.002, axis=0), 0.002, axis=0)
    inertia = ROTOR * np.array([[GEAR**2 + 1, -GEAR], [-GEAR, GEAR**2]])
    return np.stack([np.interp(times, fine, column) for column in (qdd @ inertia).T], axis=-1)


def design_a0() -> Body:
    return Body.from_toml(files("invdyn.models") / "bodies" / "dfki_design_a0.toml")


def filmed(log: Truth, lengths: list[float], seed: int) -> Recording:
    """Tips of a planar chain as a camera with 3 mm of noise would see them in 60 frames/s, from the log's angles."""
    frames = np.floor((log.time[-1] - log.time[0]) * 60.0 + 1e-9) + 1  # 1e-9 keeps a last frame despite rounding
    time = np.minimum(log.time[0] + np.arange(frames) / 60.0, log.time[-1])
    heading = np.cumsum([np.interp(time, log.time, column) for column in log.angle.T], axis=0).T
    links = np.asarray(lengths)[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    tips = np.cumsum(links, axis=1)
    noise = 0.003 * np.random.default_rng(seed).normal(size=tips.shape)
    return Recording(time, tips + noise, (*log.joint_names[1:], "wrist"))


def dfki(run: str, seed: int = 0) -> Case:
    """The torque of the links: less what turns the rotors, which the body has none of."""
    body, log = design_a0(), load_truth(f"dfki-trajectory-{run}")
    lengths = [link.nominal("length") for link in body.links]
    recording = filmed(log, lengths, seed)
    torque = frame_means(recording.time, log.time, joint_torque(log), 1 / 60) - rotor_torque(log, recording.time)
    return Case(f"dfki {run}", recording, replace(body, exact=False), torque, options={"hide_torque": True})


def drawn_design(run: str) -> Case:
    """The same arm by encoders at 100 rows/s, with the file that was drawn before anything was identified."""
    mass, com, about = np.array([0.608, 0.63]), np.array([0.275, 0.166]), np.array([0.05472, 0.02522])  # model_1.0
    body = design_a0().with_values(mass=list(mass), com=list(com), inertia=list(about - mass * com**2))
    log = load_truth(f"dfki-trajectory-{run}")
    time = np.arange(log.time[0], log.time[-1], 0.01)
    angles = np.stack([np.interp(time, log.time, column) for column in log.angle.T], -1)
    recording = Recording(time, np.empty((len(time), 0, 2)), (), angles=angles, joint_names=body.joint_names)
    torque = frame_means(time, log.time, log.torque, 0.01) - rotor_torque(log, time)
    return Case(f"dfki-cad {run}", recording, replace(body, exact=False), torque)


def film() -> Case:
    recording, truth = load("dfki-film"), load_truth("dfki-film")
    body = design_a0().with_values(length=[0.3, 0.22])  # the tracked disc sits beyond the link's end
    return Case(
        "film", recording, replace(body, exact=False), joint_torque(truth), recording.time < CALM, {"hide_torque": True}
    )


# -- OpenSim's arm ---------------------------------------------------------------------------------------------
def arm26() -> Case:
    folder_ = folder("opensim_arm26")
    body, seen = Body.load(folder_ / "arm26.osim"), load(folder_ / "arm26_elbow_flex.trc")
    kept = [seen.keypoint_names.index(name) for name in body.keypoint_names]  # the acromion is of no moving link
    recording = replace(seen, keypoints=seen.keypoints[:, kept], keypoint_names=body.keypoint_names)
    table = read_sto(folder_ / "arm26_InverseDynamics_Filtered.sto")
    torque = np.stack([np.interp(seen.time, table["time"], table[f"{name}_moment"]) for name in body.joint_names], -1)
    counted = (seen.time >= FILTERED) & (seen.time <= seen.time[-1] - FILTERED)
    return Case("arm26", recording, body, torque, counted)


def made(name: str) -> Case:
    """The case of a name such as "kuka 1", "keypoints 2", "pendulum 3", "dfki 00", "film" or "arm26".

    A third word says of how many seconds: "kuka 1 60" is all of it.
    """
    kind, *which = name.split()
    makers: dict[str, Any] = {"film": film, "arm26": arm26, "kuka": kuka, "keypoints": keypoints, "pendulum": pendulum}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # what files have besides plays no part here
        if kind.startswith("dfki"):
            return {"dfki": dfki, "dfki-cad": drawn_design}[kind](*which)
        return makers[kind](*map(int, which))


NAMES = (
    *(f"{kind} {trial}" for kind in ("kuka", "keypoints") for trial in (1, 2)),
    *(f"pendulum {trial}" for trial in FREE),
    *(f"dfki {run}" for run in ("00", "02", "05")),
    "film",
    "arm26",
)
