"""Films tracked by our own networks, against the tracks that others published and a robot's own sensors.

dfki: the robot's swing-up. 100 pictures that `invdyn label` would choose take their labels from the published tracks
(where those call themselves reliable); a network is trained on them; then one round of relabelling takes 25 pictures
more, those whose tracks surprise the arm's model most. Errors are against the published tracks of all other reliable
pictures. Torques are inferred from t = 0 to 5 s (or 4.45 s, where the controller begins to chatter), hidden, and
compared with the measured ones less friction, as in `dfki_torque.py`.

people: arms of the walker (four cameras) and of sports2d by BlazePose, against MediaPipe's own tracks of these films.

    INVDYN_DATA=… python benchmarks/tracking.py dfki|people [--steps 500] [--method laplace]
"""

import argparse
import csv
import json
import os
import time
from importlib.resources import files
from pathlib import Path

import numpy as np
import torch
from dfki_torque import case

from invdyn.inference import infer, pooled
from invdyn.models import Body
from invdyn.recordings import Recording, read_table
from invdyn.recordings.tracking.blazepose import person_tracker
from invdyn.recordings.tracking.choose import different, surprising
from invdyn.recordings.tracking.film import Film
from invdyn.recordings.tracking.labels import Labels
from invdyn.recordings.tracking.tracker import track_film
from invdyn.recordings.tracking.training import examples, train
from invdyn.surprise import surprise

DATA = Path(os.environ["INVDYN_DATA"])
FAR = 20.0  # px of 1,080
CHATTER = 4.45  # s
PUBLISHED = "published tracks"


def published() -> tuple[list[dict[str, str]], Labels, np.ndarray]:
    """Rows of the published table, their points as labels, and which of them are reliable (T,)."""
    with open(DATA / "dfki_double_pendulum/video/tracked_and_synced.csv", encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    points = [[[float(row[f"{p}_{a}"]) for a in "xy"] for p in ("elbow", "tip")] for row in rows]
    labels = Labels(np.array([int(row["frame"]) for row in rows]), np.array(points), ("elbow", "wrist"))
    return rows, labels, np.array([row["segment"] != "unreliable_tracking" for row in rows])


def metres(rows: list[dict[str, str]], points: np.ndarray) -> Recording:
    """All of the film in metres, as `public_recordings.read_dfki_film` makes them; times of the robot's log."""
    camera = json.loads((DATA / "dfki_double_pendulum/video/calibration.json").read_text(encoding="utf-8"))
    level = (points - camera["pivot_px"]) / camera["px_per_m"] * [1.0, -1.0]
    c, s = np.cos(camera["rotation_rad"]), np.sin(camera["rotation_rad"])
    times = np.array([float(row["t_log"]) for row in rows])
    return Recording(times, level @ np.array([[c, -s], [s, c]]), ("elbow", "wrist"))


def report(name: str, points: np.ndarray, confidence: np.ndarray, labels: Labels, held: np.ndarray) -> None:
    error = np.linalg.norm(points - labels.points, axis=-1)[held]
    sure = confidence[held]
    elbow, tip = np.median(error, 0)
    print(
        f"{name}: {held.sum()} pictures, median px elbow/tip {elbow:.2f}/{tip:.2f}, "
        f"off by > {FAR:g} px: {np.mean(error > FAR):.2%} of points",
        flush=True,
    )
    for low, high in ((0.0, 0.5), (0.5, 0.8), (0.8, 0.95), (0.95, 1.0)):
        here = (sure >= low) & (sure < high)
        if here.any():
            right = np.mean(error[here] <= 0.02 * 1080)
            said = sure[here].mean()
            print(f"  confidence {low:.2f} to {high:.2f}: {here.sum()} points, right {right:.3f}, said {said:.3f}")


def torques(name: str, recording: Recording, body: Body, method: str) -> None:
    film = case("film", body)
    recording = recording.at(np.isin(recording.time, film.recording.time))
    if name == PUBLISHED:
        np.testing.assert_allclose(recording.keypoints, film.recording.keypoints)
    idata = infer(recording, film.body, method=method, family="student_t", hide_torque=True, seed=0)
    mean = pooled(idata)["torque"].transpose("sample", "time", "joint").values.mean(0)
    for part, rows in (("0–5 s", slice(None)), (f"0–{CHATTER} s", recording.time < CHATTER)):
        error = np.sqrt(np.mean((mean - film.truth.torque)[rows] ** 2, 0))
        print(
            f"{name}: torque RMSE {part} against measured less friction {error[0]:.3f}/{error[1]:.3f} N·m", flush=True
        )


def dfki(steps: int, method: str, seed: int) -> None:
    rows, labels, reliable = published()
    film = Film(DATA / "dfki_double_pendulum/video/experiment_swingup_pendubot_tvlqr.m4v")
    body = Body.from_toml(files("invdyn.models") / "bodies" / "dfki_design_a0.toml")
    torques(PUBLISHED, metres(rows, labels.points), body, method)
    unlabelled = np.setdiff1d(np.arange(film.expected), labels.frames[reliable])  # a person would skip these, too
    chosen = set(different(film, 100, unlabelled.tolist()))
    for turn in ("100 labels", "after one round of relabelling"):
        mine = np.isin(labels.frames, list(chosen))
        start = time.process_time()
        given = examples([film], [labels.chosen(mine)])
        trained = train(given, steps=steps, seed=seed, progress=_say)
        print(f"{turn}: {mine.sum()} labels, training {time.process_time() - start:.0f} CPU-s", flush=True)
        print(f"  said of labels held out: median {np.median(trained.errors):.2f} px", flush=True)
        start = time.process_time()
        times, tracks = track_film(film, trained.tracker)
        print(f"  tracking {len(times) / (time.process_time() - start):.0f} frames a core-second", flush=True)
        points, confidence = tracks[labels.frames, :, :2], tracks[labels.frames, :, 2]
        report(turn, points, confidence, labels, reliable & ~mine)
        torques(turn, metres(rows, points), body, method)
        idata = infer(
            metres(rows, points),
            body.with_values(length=[0.3, 0.22]),
            method="laplace",
            family="student_t",
            hide_torque=True,
            seed=0,
        )
        far = np.where(reliable, surprise(idata), -np.inf)
        strays = np.linalg.norm(points - labels.points, axis=-1).max(1) > FAR
        worst = surprising(far, labels.frames, 25, chosen)
        hit = strays[np.isin(labels.frames, worst)].sum()
        print(f"  of the 25 most surprising pictures {hit} are off, of all others {(strays & reliable).sum() - hit}")
        chosen |= set(worst)


def people() -> None:
    films = [
        (f"multiview_walker/cam0{n}.mp4", f"multiview_walker/cam0{n}_mediapipe2d.csv", "largest") for n in (1, 2, 3, 4)
    ]
    films.append(("sports2d/demo.mp4", "sports2d/demo_mediapipe2d.csv", "largest"))
    for name, table, person in films:
        reference, _ = read_table(DATA / table)
        for arm in ("left", "right"):
            start = time.process_time()
            times, tracks = track_film(Film(DATA / name), person_tracker(arm, person))
            seconds = time.process_time() - start
            theirs = np.stack(
                [
                    np.stack([reference[f"{arm[0].upper()}_{point}_{axis}"] for axis in "xy"], -1)
                    for point in ("shoulder", "elbow", "wrist")
                ],
                1,
            )[: len(times)]
            apart = np.linalg.norm(
                tracks[..., :2] + 0.5 - theirs, axis=-1
            )  # MediaPipe counts from the first one's corner
            median = "/".join(f"{each:.1f}" for each in np.nanmedian(apart, 0))
            print(
                f"{name} {arm}: found in {np.isfinite(tracks[:, 0, 0]).sum()} of {len(times)} pictures (theirs "
                f"{np.isfinite(theirs[:, 0, 0]).sum()}), median px apart shoulder/elbow/wrist {median}, "
                f"{len(times) / seconds:.0f} frames a core-second",
                flush=True,
            )


def _say(done: int, total: int, what: str) -> None:
    if done % 100 == 0:
        print(f"  {what} ({done} of {total})", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=["dfki", "people"])
    parser.add_argument("--steps", type=int, default=500)
    parser.add_argument("--method", default="laplace")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    if arguments.what == "people":
        people()
    else:
        dfki(arguments.steps, arguments.method, arguments.seed)


if __name__ == "__main__":
    main()
