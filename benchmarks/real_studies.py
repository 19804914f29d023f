"""Real recordings as studies: do they run, what do they say beside sensors, how long do they take.

    ibm     ten swings of a toy double pendulum, the last 1 s at 100 rows/s: no motor, so the torque is its friction
    dfki    nine runs of a real two-joint arm, 1 s of keypoints made of its encoders, 60 frames/s and 3 mm
    kuka    two trials of a KUKA iiwa from its seven encoders, 1 s at 20 rows/s
    beam    18 swings of the hind limbs of five mice on a beam, DeepLabCut at 100 frames/s, from lift to touch

Each is a table of files that `invdyn trials` reads. A trial's impulse ∫ τ dt stands beside that of its sensors (of the
toy: zero), and so does the study's average. Torques of sensors are hidden. The mice have no sensors: what is known of a
leg that swings is that the hip does work and the knee takes it (negative). Their data are those of AutoGaitA (Hosseini
and others; GPL 3), `example data/25mm` of github.com/mahan-hosseini/AutoGaitA at 13029c06, with its table of steps. No
mouse was weighed: masses of the limb are 5, 2 and .6 % of 25 g, lengths are learned, and 3.76 px are a millimetre.

    INVDYN_DATA=… python benchmarks/real_studies.py [ibm dfki kuka]
    python benchmarks/real_studies.py beam --beam FOLDER
"""

import argparse
import tempfile
import time
import warnings
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pandas as pd
from board import DFKI, PENDULUM
from sensor_cases import made

import invdyn
from invdyn.models import Link, planar_body
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


LIMB = ("Hip", "Knee", "Ankle", "Hind paw tao"), (0.0096, 0.0124, 0.0098), (1.25e-3, 0.5e-3, 0.15e-3)
"""Of a mouse: points from the base outwards, lengths, m, and masses, kg."""
TRACKED = {"units": "px", "fps": 100, "scale": "0.000266", "base": "Hip", "noise": "student_t", "learn": ["lengths"]}
"""How its tracks are read, and what is learned."""
PARTS = "sharedStrings", "worksheets/sheet1"
LIFTS = "EHKNQ"
"""Columns of a table of steps in which a swing begins; it ends in the next one. A has the mouse, C the run."""
STEP = "recording", "trial", "subject", "frames", "event_lift", "event_touch"


def cells(workbook):
    """Rows of the first sheet of a workbook (.xlsx), as texts by letter of their column."""
    mark = "{http://schemas.openxmlformats.org/spreadsheetml/2006/main}"
    with zipfile.ZipFile(workbook) as parts:
        strings, sheet = (ElementTree.fromstring(parts.read(f"xl/{name}.xml")) for name in PARTS)
    words = ["".join(text.text or "" for text in each.iter(f"{mark}t")) for each in strings]
    for row in sheet.iter(f"{mark}row"):
        known = {cell: value.text for cell in row if (value := cell.find(f"{mark}v")) is not None}
        texts = {cell: words[int(text)] if cell.get("t") == "s" else text for cell, text in known.items()}
        yield {cell.get("r").rstrip("0123456789"): text for cell, text in texts.items()}


def steps(folder):
    """One row a swing: file, mouse, rows from two before the lift until the touch, and the times of both, s."""
    mouse = ""
    for row in cells(folder / "25mm.xlsx"):
        mouse = row.get("A", mouse)
        for file in folder.glob(f"*_Mouse{mouse}_25mm_run{row.get('C')}-*_SIMI*.csv"):
            for number, column in enumerate(each for each in LIFTS if each in row):
                lift, touch = (float(row[letter]) for letter in (column, chr(ord(column) + 1)))
                frames = f"{round(100 * lift) - 2}:{round(100 * touch) + 1}"
                values = file, f"m{mouse}-{number}", f"m{mouse}", frames, lift, touch
                yield dict(zip(STEP, values, strict=True))


def mice(folder):
    """Body and table of the swings."""
    points, lengths, masses = LIMB
    links = [Link(*each) for each in zip(("thigh", "shank", "foot"), points, points[1:], lengths, masses, strict=False)]
    return planar_body("limb", links, gravity=(0.0, -9.81)), pd.DataFrame(steps(folder))


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


def study_of(name, beam):
    """The study, its body, and by trial the impulse of its sensors (K,), N·m·s; none of mice."""
    if name == "beam":
        body, table = mice(beam)
        return invdyn.trials(table, body, filters=16, **TRACKED), body, {}
    body, parts = STUDIES[name]()
    true = {f"{trial}.csv": np.trapezoid(torque, own.time, axis=0) for trial, (own, torque) in parts.items()}
    with tempfile.TemporaryDirectory() as where:
        for file, (recording, _) in zip(true, parts.values(), strict=True):
            write_table(columns(recording), Path(where, file))
        pd.DataFrame({"recording": [*true]}).to_csv(Path(where, "table.csv"), index=False)
        return invdyn.trials(Path(where, "table.csv"), body, filters=16), body, true


def line(name, beam):
    begun = time.process_time()
    study, body, true = study_of(name, beam)
    seconds = time.process_time() - begun
    averages = study.summary().set_index("quantity").loc["impulse" if true else "work"]
    said = [f"{row.joint} {row.mean:.2g} ({row.q05:.2g} to {row.q95:.2g}" for row in averages.itertuples()]
    held = "–"
    if true:
        own = study.table[study.table["quantity"] == "impulse"]
        truth = np.array([true[each.trial][body.joint_names.index(each.joint)] for each in own.itertuples()])
        held = f"{((own['q05'] <= truth) & (truth <= own['q95'])).sum()} of {len(own)}"
        of_sensors = np.mean([true[trial] for trial in own["trial"].unique()], axis=0)
        where = map(body.joint_names.index, averages["joint"])
        said = [f"{text}; {of_sensors[k]:.2g}" for text, k in zip(said, where, strict=True)]
    for reason in study.reasons.itertuples():
        print(f"{name}: {reason.trial} is left out: {reason.reason}")
    rows = sum(len(trial.recording.time) for trial in study.trials)
    return (
        f"| {name} | {len(study.trials)}, {rows} | {len(study.left_out)}, {study.doubts['trial'].nunique()} | "
        f"{held} | {'; '.join(f'{text})' for text in said)} | {seconds:.0f} |"
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", default=list(STUDIES))
    parser.add_argument("--beam", type=Path, help="AutoGaitA's folder `example data/25mm`")
    warnings.simplefilter("ignore")
    options = parser.parse_args()
    lines = [line(name, options.beam) for name in options.names]
    print(
        "\n| study | trials, rows | left out, in doubt | impulses of trials within their 90 % intervals | "
        "average impulse, N·m·s (90 %; sensors'), of beam work, J | CPU s |\n|---|---|---|---|---|---|"
    )
    print("\n".join(lines))


if __name__ == "__main__":
    main()
