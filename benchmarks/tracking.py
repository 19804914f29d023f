"""Films tracked by our own networks, against the tracks that others published and a robot's own sensors.

dfki: the robot's swing-up. 100 pictures that `invdyn label` would choose take their labels from the published tracks
(where those call themselves reliable); a network is trained on them; then one round of relabelling takes 25 pictures
more, those whose tracks surprise the arm's model most. Errors are against the published tracks of all other reliable
pictures. Torques are inferred from t = 0 to 5 s (or 4.45 s, where the controller begins to chatter), hidden, and
compared with the measured ones less friction, as in `sensor_cases.py`.

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
from sensor_cases import film as recorded_film

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


def calibration(confidence: np.ndarray, error: np.ndarray) -> None:
    """Rows: how many of the points of some confidence are right (T, P), within 2 % of the picture's side."""
    print("| confidence | points | said | right |\n|---|---|---|---|")
    for low, high in ((0.0, 0.5), (0.5, 0.8), (0.8, 0.95), (0.95, 1.0)):
        here = (confidence >= low) & (confidence < high)
        if here.any():
            said, right = confidence[here].mean(), np.mean(error[here] <= 0.02 * 1080)
            print(f"| {low:.2f} to {high:.2f} | {here.sum()} | {said:.3f} | {right:.3f} |", flush=True)


def torques(recording: Recording, method: str) -> str:
    """RMSE against the measured ones less friction, in all five seconds and before the chatter."""
    film = recorded_film()
    recording = recording.at(np.isin(recording.time, film.recording.time))
    idata = infer(recording, film.body, method=method, family="student_t", hide_torque=True, seed=0)
    mean = pooled(idata)["torque"].transpose("sample", "time", "joint").values.mean(0)
    squares = (mean - film.torque) ** 2
    parts = (squares, squares[recording.time < CHATTER])
    return " | ".join("{:.3f} / {:.3f}".format(*np.sqrt(part.mean(0))) for part in parts)


def dfki(steps: int, method: str, seed: int) -> None:
    rows, labels, reliable = published()
    film = Film(DATA / "dfki_double_pendulum/video/experiment_swingup_pendubot_tvlqr.m4v")
    body = Body.from_toml(files("invdyn.models") / "bodies" / "dfki_design_a0.toml")
    table = [f"| published | | | | | | {torques(metres(rows, labels.points), method)} |"]
    unlabelled = np.setdiff1d(np.arange(film.expected), labels.frames[reliable])  # a person would skip these, too
    chosen = set(different(film, 100, unlabelled.tolist()))
    for turn in ("100 labels", "one round of relabelling"):
        mine = np.isin(labels.frames, list(chosen))
        held_out = reliable & ~mine
        start = time.process_time()
        trained = train(examples([film], [labels.chosen(mine)]), steps=steps, seed=seed, progress=_say)
        training = time.process_time() - start
        start = time.process_time()
        times, tracks = track_film(film, trained.tracker)
        pace = len(times) / (time.process_time() - start)
        points, confidence = tracks[labels.frames, :, :2], tracks[labels.frames, :, 2]
        error = np.linalg.norm(points - labels.points, axis=-1)
        print(f"\nconfidence, {turn}")
        calibration(confidence[held_out], error[held_out])
        elbow, tip = np.median(error[held_out], 0)
        table.append(
            f"| {turn} ({mine.sum()}) | {training:.0f} | {pace:.0f} | {held_out.sum()} | {elbow:.2f} / {tip:.2f} | "
            f"{np.mean(error[held_out] > FAR):.2%} | {torques(metres(rows, points), method)} |"
        )
        longer = body.with_values(length=[0.3, 0.22])  # the tracked disc sits beyond the link's end
        options = {"method": "laplace", "family": "student_t", "hide_torque": True, "seed": 0}
        idata = infer(metres(rows, points), longer, **options)
        worst = surprising(np.where(reliable, surprise(idata), -np.inf), labels.frames, 25, chosen)
        off = reliable & (error.max(1) > FAR)
        print(
            f"of the 25 most surprising pictures {off[np.isin(labels.frames, worst)].sum()} are off, of all {off.sum()}"
        )
        chosen |= set(worst)
    print(
        "\n| tracks (labels) | training, CPU-s | pictures a core-second | held out | median px, elbow / tip "
        "| off by > 20 px | torque RMSE, 0–5 s, N·m | 0–4.45 s |\n|---|---|---|---|---|---|---|---|"
    )
    print("\n".join(table))


def people() -> None:
    films = [f"multiview_walker/cam0{number}" for number in (1, 2, 3, 4)] + ["sports2d/demo"]
    print("| film | arm | found, theirs | median px apart, shoulder / elbow / wrist | pictures a core-second |")
    print("|---|---|---|---|---|")
    for name in films:
        reference, _ = read_table(DATA / f"{name}_mediapipe2d.csv")
        for arm in ("left", "right"):
            start = time.process_time()
            times, tracks = track_film(Film(DATA / f"{name}.mp4"), person_tracker(arm, "largest"))
            pace = len(times) / (time.process_time() - start)
            columns = [f"{arm[0].upper()}_{point}_{axis}" for point in ("shoulder", "elbow", "wrist") for axis in "xy"]
            theirs = np.stack([reference[column] for column in columns], -1).reshape(-1, 3, 2)[: len(times)]
            # MediaPipe counts pixels from the first one's corner
            apart = np.nanmedian(np.linalg.norm(tracks[..., :2] + 0.5 - theirs, axis=-1), 0)
            found = [int(np.isfinite(each[:, 0, 0]).sum()) for each in (tracks, theirs)]
            median = " / ".join(f"{each:.1f}" for each in apart)
            print(f"| {name} | {arm} | {found[0]}, {found[1]} of {len(times)} | {median} | {pace:.0f} |", flush=True)


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
