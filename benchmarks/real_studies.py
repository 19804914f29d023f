"""Real recordings as studies: do they run, what do they say beside sensors, how long do they take.

    ibm     ten swings of a toy double pendulum, the last 1 s at 100 rows/s: no motor, so the torque is its friction
    dfki    nine runs of a real two-joint arm, 1 s of keypoints made of its encoders, 60 frames/s and 3 mm
    kuka    two trials of a KUKA iiwa from its seven encoders, 1 s at 20 rows/s

Each is a table of files that `invdyn trials` reads. A trial's impulse ∫ τ dt stands beside that of its sensors (of the
toy: zero), and so does the study's average. Torques of sensors are hidden.

    INVDYN_DATA=… python benchmarks/real_studies.py [ibm dfki kuka]
"""

import argparse
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np
import pandas as pd
from board import DFKI, PENDULUM
from sensor_cases import made

import invdyn
from invdyn.recordings import load, write_table

SECONDS = 1


def swings():
    """Body, and by trial a recording and its torque (T, K)."""
    cases = {f"swing-{n}": load(f"ibm-{n}").at(slice(-400, None, 4)) for n in range(10)}
    return PENDULUM, {name: (own, np.zeros((len(own.time), 2))) for name, own in cases.items()}


def of_sensors(names):
    """The same of cases of `sensor_cases`, the first seconds of each."""
    cases = {name: made(name) for name in names}
    first = {name: case.recording.time < case.recording.time[0] + SECONDS for name, case in cases.items()}
    parts = {name: (case.recording.at(first[name]), case.torque[first[name]]) for name, case in cases.items()}
    return next(iter(cases.values())).body, parts


STUDIES = {
    "ibm": swings,
    "dfki": lambda: of_sensors([f"dfki {run}" for run in DFKI]),
    "kuka": lambda: of_sensors(["kuka 1", "kuka 2"]),
}


def columns(recording):
    """Of a recording's file."""
    found = {"time": recording.time}
    for p, name in enumerate(recording.keypoint_names):
        found |= {
            f"{name}_{axis}": recording.keypoints[:, p, k]
            for k, axis in enumerate("xyz"[: recording.keypoints.shape[-1]])
        }
    if recording.angles is not None:
        found |= {f"{name}_angle": own for name, own in zip(recording.joint_names, recording.angles.T, strict=True)}
    return found


def line(name):
    body, parts = STUDIES[name]()
    begun = time.process_time()
    with tempfile.TemporaryDirectory() as where:
        folder = Path(where)
        for trial, (recording, _) in parts.items():
            write_table(columns(recording), folder / f"{trial}.csv")
        pd.DataFrame({"recording": [f"{trial}.csv" for trial in parts]}).to_csv(folder / "table.csv", index=False)
        study = invdyn.trials(folder / "table.csv", body, filters=16)
    seconds = time.process_time() - begun
    true = {f"{trial}.csv": np.trapezoid(torque, own.time, axis=0) for trial, (own, torque) in parts.items()}
    own = study.table[study.table["quantity"] == "impulse"]
    truth = np.array([true[each.trial][body.joint_names.index(each.joint)] for each in own.itertuples()])
    held = ((own["q05"] <= truth) & (truth <= own["q95"])).sum()
    averages = []
    for row in study.summary().query("quantity == 'impulse'").itertuples():
        of_sensor = np.mean([true[trial][body.joint_names.index(row.joint)] for trial in own["trial"].unique()])
        averages.append(f"{row.joint} {row.mean:.2g} ({row.q05:.2g} to {row.q95:.2g}; {of_sensor:.2g})")
    for reason in study.reasons.itertuples():
        print(f"{name}: {reason.trial} is left out: {reason.reason}")
    rows = sum(len(recording.time) for recording, _ in parts.values())
    return (
        f"| {name} | {len(parts)}, {rows} | {len(study.left_out)}, {study.doubts['trial'].nunique()} | "
        f"{held} of {len(own)} | {'; '.join(averages)} | {seconds:.0f} |"
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", default=list(STUDIES))
    warnings.simplefilter("ignore")
    lines = [line(name) for name in parser.parse_args().names]
    print(
        "\n| study | trials, rows | left out, in doubt | impulses of trials within their 90 % intervals | "
        "average impulse, N·m·s (90 %; sensors') | CPU s |\n|---|---|---|---|---|---|"
    )
    print("\n".join(lines))


if __name__ == "__main__":
    main()
