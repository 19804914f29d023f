"""Trackers' own files by the same options for `infer`, `compare` and `diagnose`, on a two-link arm of our own."""

import warnings
from pathlib import Path

import numpy as np
import pytest

from invdyn.diagnosis_options import Diagnosed
from invdyn.inference_options import Inference

RATE = 25.0
TIME = np.arange(12) / RATE
ANGLES = np.stack([-1.2 + 0.3 * np.sin(4 * TIME), 0.5 * np.cos(3 * TIME)], -1)
NAMES = ("shoulder", "elbow", "wrist")


def places(base):
    """Of shoulder, elbow and wrist, m, (T, 3, 2), links 1 m long."""
    direction = np.cumsum(ANGLES, axis=-1)
    steps = np.stack([np.cos(direction), np.sin(direction)], -1)
    return np.concatenate([np.zeros((len(TIME), 1, 2)), np.cumsum(steps, axis=1)], axis=1) + np.asarray(base)


def write(kind, points):
    if kind == "deeplabcut":
        animals = {"ada": points, "bob": points[::-1] + 1}
        header = [["scorer"], ["individuals"], ["bodyparts"], ["coords"]]
        rows = [[str(t)] for t in range(len(TIME))]
        for animal, own in animals.items():
            for p, name in enumerate(NAMES):
                for cells, value in zip(header, ("net", animal, name), strict=False):
                    cells += [value] * 3
                header[3] += ["x", "y", "likelihood"]
                for row, place in zip(rows, own[:, p], strict=True):
                    row += [repr(float(v)) for v in (*(place * [200, -200]), 0.9)]
        Path("rec.csv").write_text("\n".join(",".join(cells) for cells in header + rows) + "\n")
        return "rec.csv", {"units": "px", "fps": RATE, "scale": "0.005", "individual": "ada"}
    if kind == "sleap":
        lines = ["track,frame_idx,instance.score," + ",".join(f"{n}.x,{n}.y,{n}.score" for n in NAMES)]
        for t, row in enumerate(points):
            lines.append(f"t0,{t},.9," + ",".join(f"{float(x * 200)!r},{float(-y * 200)!r},.8" for x, y in row))
        Path("rec.csv").write_text("\n".join(lines) + "\n")
        return "rec.csv", {"units": "px", "fps": RATE, "scale": "0.005"}
    if kind == "anipose":
        others = ["fnum", *(f"center_{i}" for i in range(3)), *(f"M_{i}{j}" for i in range(3) for j in range(3))]
        lines = [",".join([f"{n}_{end}" for n in NAMES for end in ("x", "y", "z", "error", "ncams", "score")] + others)]
        for t, row in enumerate(points):  # x right, y deep, z up
            cells = [f"{float(1000 * x)!r},{0.3 * t},{float(1000 * y)!r},.1,2,.9" for x, y in row]
            lines.append(",".join([*cells, str(t), *["0"] * 12]))
        Path("rec.csv").write_text("\n".join(lines) + "\n")
        return "rec.csv", {"units": "mm", "fps": RATE, "plane": "xz"}
    lines = ["PathFileType\t4\t(X/Y/Z)\trec.trc", "Units", "m"]
    lines += ["Frame#\tTime\t" + "\t\t\t".join(NAMES), "", ""]
    for t, row in enumerate(points):
        lines.append("\t".join([str(t), repr(t / RATE), *(f"{float(x)!r}\t{float(y)!r}\t0.0" for x, y in row)]))
    Path("rec.trc").write_text("\n".join(lines) + "\n")
    return "rec.trc", {}


@pytest.mark.parametrize("kind", ["deeplabcut", "sleap", "anipose", "trc"])
@pytest.mark.parametrize("group", [Inference, Diagnosed])
def test_a_trackers_file_becomes_the_arms_tips(folder, kind, group):
    if kind == "anipose":
        pytest.importorskip("movement.io")
    file, options = write(kind, places((2.0, 1.5)))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        recording = group(recordings=[file], body="arm.toml", **options).load()[0]["recording"]
    said = [str(each.message) for each in caught if each.category is UserWarning]
    assert said == (["coordinate z is 0 throughout: left out"] if kind == "trc" else [])
    # an inference keeps the base's track, as the base may move
    first = 0 if group is Inference else 1
    assert tuple(recording.keypoint_names) == tuple(NAMES[first:])
    np.testing.assert_allclose(recording.keypoints, places((0, 0))[:, first:], atol=1e-9)
    np.testing.assert_allclose(recording.time, TIME, atol=1e-12)


def test_options_that_a_file_has_no_use_for_are_said(folder, run):
    file, _ = write("trc", places((0, 0)))
    for option, words in (
        (("--set", "individual=ada"), "hold one body: leave individual out"),
        (("--set", "plane=xw"), "plane is two of the file's axes"),
    ):
        outcome = run("infer", file, "--body", "arm.toml", "--out", "p.nc", *option)
        assert outcome.exit_code == 2
        assert words in outcome.stderr
