"""From the files of the named recordings to SI units: one function each, with the conventions of its source.

The robot's q₁ counts from hanging and its q₂ from the first link, both counter-clockwise (its film shows +q
towards +x), so θ₁ = q₁ − π/2 and θ₂ = q₂ in Denavit–Hartenberg angles.
"""

import json
from pathlib import Path

import numpy as np

from .formats.deeplabcut import read_deeplabcut_csv
from .recording import Recording
from .si import median_link_lengths, to_si
from .tables import read_numbers, read_rows, read_table
from .truth import Truth
from .units import Units

JOINTS = ("shoulder", "elbow")
HANGING = np.array([-np.pi / 2, 0.0])  # θ at q = 0
FILM_SECONDS = 5.0  # the swing-up; then the arm is caught
IBM_ARMS = np.array([0.091, 0.070])  # m
IBM_RATE = 400.0  # frames/s


def read_human_arm(path: Path) -> tuple[Recording, None]:
    """An arm seen from above, 30 frames/s. Its scale is not known: pixels, y up."""
    return to_si(read_deeplabcut_csv(path, fps=30.0), Units("px")), None


def read_dfki(path: Path) -> tuple[Recording, Truth]:
    """A log of the robot: encoders and command; the truth has the measured torque, NaN if none was logged."""
    columns, _ = read_table(path)
    new = np.diff(columns["time"], prepend=-np.inf) > 0  # one log repeats its first time
    measured = "tau_meas1" in columns  # the other day's logs hold the command alone

    def joints(label: str) -> np.ndarray:
        return np.stack([columns[f"{label}1"][new], columns[f"{label}2"][new]], axis=-1)

    angle = joints("pos_meas" if measured else "pos") + HANGING
    command = joints("tau_con" if measured else "tau")
    recording = Recording(
        time=columns["time"][new],
        keypoints=np.empty((len(angle), 0, 2)),
        keypoint_names=(),
        angles=angle,
        torques=command,
        joint_names=JOINTS,
    )
    velocity = joints("vel_filt" if measured else "vel")
    torque = joints("tau_meas") if measured else np.full_like(command, np.nan)
    return recording, Truth(recording.time, angle, velocity, torque, JOINTS)


def read_dfki_film(table: Path, calibration: Path) -> tuple[Recording, Truth]:
    """The swing-up on film; `wrist` is a disc .220 m from the elbow, beyond the link's nominal .2 m.

    The truth is the robot's log at the film's times, its torques averaged over the frame.
    """
    camera = json.loads(calibration.read_text(encoding="utf-8"))
    header, *rows = read_rows(table)
    numbers, _ = read_numbers([(line, cells[:-1]) for line, cells in rows], header[1][:-1])  # last: a word
    columns = dict(zip(header[1], numbers.T, strict=False))
    shown = (columns["t_log"] >= 0) & (columns["t_log"] <= FILM_SECONDS)

    def pair(first: str, second: str) -> np.ndarray:
        return np.stack([columns[first][shown], columns[second][shown]], axis=-1)

    pixels = np.stack([pair("elbow_x", "elbow_y"), pair("tip_x", "tip_y")], axis=1)
    level = (pixels - camera["pivot_px"]) / camera["px_per_m"] * [1.0, -1.0]  # m from the shoulder, y up
    c, s = np.cos(camera["rotation_rad"]), np.sin(camera["rotation_rad"])
    recording = Recording(
        time=columns["t_log"][shown],
        keypoints=level @ np.array([[c, -s], [s, c]]),  # rows times R(roll) turn by −roll
        keypoint_names=("elbow", "wrist"),
        confidence=pair("elbow_score", "tip_score"),
    )
    truth = Truth(
        recording.time,
        angle=pair("enc_pos_meas1", "enc_pos_meas2") + HANGING,
        velocity=pair("enc_vel_filt1", "enc_vel_filt2"),
        torque=pair("mean_tau_meas1", "mean_tau_meas2"),
        joint_names=JOINTS,
    )
    return recording, truth


def read_ibm(path: Path) -> tuple[Recording, None]:
    """A passive toy; the scale is the least-squares fit of the median arm lengths to the documented ones."""
    numbers, _ = read_numbers(read_rows(path), [f"{p} {axis}" for p in range(3) for axis in ("row", "column")])
    fifths = numbers.reshape(-1, 3, 2)[..., ::-1] * [1.0, -1.0]  # (row, column), rows down → (x, y), y up
    recording = Recording(
        time=np.arange(len(fifths)) / IBM_RATE,
        keypoints=fifths - np.median(fifths[:, :1], axis=0),
        keypoint_names=("shoulder", "elbow", "wrist"),
        torques=np.zeros((len(fifths), 2)),
        joint_names=JOINTS,
    )
    seen = median_link_lengths(recording)
    return recording.scaled(float(IBM_ARMS @ seen / (seen @ seen)), "m"), None
