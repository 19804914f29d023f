"""Notebooks run from top to bottom, in a kernel of their own."""

import os
import re
from pathlib import Path

import jupytext
import matplotlib.pyplot as plt
import numpy as np
import pytest
from nbclient import NotebookClient

from invdyn.inference import METHODS

FOLDER = Path(__file__).parents[2] / "notebooks"


def run(notebook, **environment: str):
    """One thread a kernel. Numba would set OpenMP's threads, and so those of torch, to the number of cores."""
    client = NotebookClient(notebook, timeout=None, kernel_name="python3", resources={"metadata": {"path": FOLDER}})
    client.execute(env={**os.environ, "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1", **environment})
    return notebook


def printed(notebook) -> str:
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    return "".join(output.get("text", "") for output in outputs)


def figures(notebook) -> int:
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    return sum("image/png" in output.get("data", {}) for output in outputs)


@pytest.fixture
def planar_arm():
    return jupytext.read(FOLDER / "01_planar_arm.py")


@pytest.mark.long
def test_planar_arm_runs_and_finds_what_it_says(planar_arm, with_human_arm):
    text = printed(run(planar_arm, INVDYN_DATA=str(with_human_arm)))
    assert "skipped" not in text
    sizes = [
        float(line.split("outer sample size ")[1].split(" of 64")[0])
        for line in text.splitlines()
        if "outer sample size" in line
    ]
    bootstrap, controlled, human, sharp_bootstrap, sharp_controlled = sizes
    assert bootstrap < 8
    assert controlled > 50
    assert human > 50
    assert figures(planar_arm) == 6
    filtered, smoothed, own = (
        np.array(re.findall(rf"{what}.*?\[ *(\S+) +(\S+?)\]", text)[0], float)
        for what in ("filter: rms error", "smoother: rms error", "the torques' own rms is")
    )
    assert (filtered > 0.8 * own).all()  # hardly better than guessing zero
    assert (smoothed < 0.8 * filtered).all()
    # the answers of the exercises
    assert sharp_bootstrap < 1.5 < 40 < sharp_controlled
    assert int(re.search(r"(\d+)% of the bootstrap runs lie below", text)[1]) > 50
    before, after = re.search(r"Gaussian smoother: (\S+) before, (\S+) after", text).groups()
    assert before == after


def test_planar_arm_goes_on_without_the_real_recording(planar_arm, tmp_path, monkeypatch, capsys):
    """Its cells run in this process: a kernel would import torch once more."""
    sections = [k for k, cell in enumerate(planar_arm.cells) if cell.source.startswith("## ")]
    heading = next(k for k in sections if planar_arm.cells[k].source.startswith("## A real arm"))
    end = next(k for k in sections if k > heading)
    imports = next(cell for cell in planar_arm.cells if cell.cell_type == "code")
    monkeypatch.setenv("INVDYN_DATA", str(tmp_path))
    names = {}
    with plt.rc_context():
        for cell in (imports, *planar_arm.cells[heading:end]):
            if cell.cell_type == "code":
                exec(cell.source.replace("%matplotlib inline", ""), names)
    text = capsys.readouterr().out
    assert "cannot be had here" in text
    assert "human_arm" in text


@pytest.mark.long
def test_compare_inference_runs_and_shows_who_is_too_sure(with_human_arm):
    notebook = jupytext.read(FOLDER / "02_compare_inference.py")
    text = printed(run(notebook, INVDYN_DATA=str(with_human_arm)))
    assert "failed:" not in text
    held = [float(share) for share in re.findall(r"90 % bands hold (0\.\d+) of the true torques", text)]
    smoother, mean_field = held
    # Of 200 ranks, two of each arm: 0.9 by three standard errors of a hundred.
    assert abs(smoother - 0.9) < 0.09
    assert mean_field < 0.4
    evidence = {row[0]: float(row[1]) for row in re.findall(r"^(smc|vsmc|svi-markov|svi) +(-\d+\.\d+)", text, re.M)}
    assert abs(evidence["smc"] - evidence["vsmc"]) < 0.1
    assert evidence["svi"] < evidence["svi-markov"] - 10 < evidence["smc"] - 10
    assert figures(notebook) == 3
    assert "cannot be had here" not in text
    # the answers of the exercises
    assert "right" in text
    together, apart = (float(found) for found in re.findall(r"row before by (\S+) rad rms", text))
    assert together == pytest.approx(0.01, rel=0.3)  # ε
    assert apart > 5 * together
    assert float(re.search(r"hump in the middle, and 90 % bands hold (\S+)\.", text)[1]) > 0.97


@pytest.mark.long
def test_a_model_variant_runs_by_every_method():
    notebook = jupytext.read(FOLDER / "03_write_a_model_variant.py")
    text = printed(run(notebook))
    assert set(METHODS) <= set(re.findall(r"^ *([a-z-]+): ", text, re.M))
    tremor, wander = (float(found) for found in re.findall(r"log evidence (-?\d+\.\d)", text))
    assert tremor > wander + 10
    frequency, sd = map(float, re.search(r"frequency (\d+\.\d+) ± (\d+\.\d+) Hz", text).groups())
    assert abs(frequency - 5.5) < 3 * sd < 1
    rows = re.findall(r"^ *([a-z-]+): +(\d\.\d+) +(\d\.\d+) +(-?\d+\.\d+|nan)", text, re.M)
    error = {name: float(elbow) for name, elbow, *_ in rows}
    assert max(error[name] for name in ("smc", "vsmc", "nuts", "particle-gibbs", "svi")) < 1.3 * error["smc"]
    assert figures(notebook) == 2
    # the answers of the exercises
    assert all(one == other for one, other in re.findall(r"of one step: (\S+) here, (\S+) of the Ornst", text))
    assert float(re.search(r"differ by (\S+) at most", text)[1]) < 1e-9
    assert re.search(r"standard deviation of (\S+); σ is 0.3", text)[1] == "0.3000"


def test_the_variant_is_under_forty_lines():
    notebook = jupytext.read(FOLDER / "03_write_a_model_variant.py")
    new = [c.source for c in notebook.cells if c.cell_type == "code" and ("class " in c.source or "Link(" in c.source)]
    lines = [line for source in new for line in source.splitlines() if line.strip()]
    assert 10 < len(lines) < 40


@pytest.mark.long
def test_diagnose_the_gap_says_what_was_put_in():
    notebook = jupytext.read(FOLDER / "04_diagnose_the_gap.py")
    text = printed(run(notebook))
    friction, twins, unknown, strange, explained = text.split("gap: ")[1:]
    first = re.compile(r"^  (\d\.\d\d)  (.+)$", re.M)
    assert first.findall(friction)[0][1] == "viscous_friction.elbow"
    assert float(first.findall(friction)[0][0]) > 0.5
    assert abs(float(re.search(r"truth 0.05: ([+-]\d\.\d) standard deviations", friction)[1])) < 4
    before, after = map(float, re.search(r"replay error: (\S+) mm before, (\S+) mm after", friction).groups())
    assert after < 0.05 * before
    assert "joint: shoulder 0.0" in friction
    pair = {name: float(p) for p, name in first.findall(twins)}
    assert min(pair["gravity_tilt"], pair["camera_roll"]) > 0.2
    assert "encoders" in twins
    assert "regime: unknown_torque" in twins  # printed before "gap: "
    assert "viscous_friction.elbow" in unknown.split("could not have been seen: ")[1].splitlines()[0]
    assert float(re.search(r"d' +(\S+)  soft_tissue.wrist", unknown)[1]) > 10
    outside = {name: float(p) for p, name in first.findall(strange)}
    assert outside["outside the catalogue"] > 0.5
    assert (
        abs(float(re.search(r"formula: (\S+) ± \S+ N·m·s/rad × dθ\[shoulder\]/dt on elbow", strange)[1]) + 0.1) < 0.05
    )
    assert first.findall(explained)[0][1].startswith("belt.")
    assert abs(float(re.search(r"damping (\S+)", explained)[1]) - 0.1) < 0.01
    assert figures(notebook) == 1
    assert "outside the catalogue, the sum of these: 0.31" in text  # an exercise: 0.7 × 0.1 + 0.3 × 0.8


@pytest.mark.long
def test_my_robot_gets_a_corrected_file():
    pytest.importorskip("mujoco")
    notebook = jupytext.read(FOLDER / "07_my_robot.py")
    text = printed(run(notebook))
    assert "torque sign | at joint 'elbow'" in text
    assert "mistakes: 0" in text
    assert re.search(r"^  [01]\.\d\d  (.+)$", text, re.M)[1] == "viscous_friction.elbow"
    told = re.search(r"from (\S+) to (\S+) \((\S+) to (\S+)\); truth (\S+)", text)
    before, after, low, high, truth = map(float, told.groups())
    assert before == 0.1
    assert low < after < high
    assert after == pytest.approx(truth, rel=0.01)
    written = float(re.search(r'<joint name="elbow".* damping="(\S+)"', text)[1])
    assert written == pytest.approx(after, abs=1e-4)
    assert float(re.search(r"corrected: damping of the elbow (\S+)", text)[1]) == pytest.approx(after, abs=1e-4)
    nominal, corrected = map(float, re.search(r"all angles: (\S+) rad before, (\S+) rad after", text).groups())
    assert corrected < 0.05 * nominal
    assert figures(notebook) == 1
    # the answers of the exercises
    assert float(re.search(r"zero at elbow: \+(\S+)°", text)[1]) == pytest.approx(30, abs=1)
    assert "0.0125 kg·m², 76%" in text


@pytest.mark.long
def test_any_state_space_model_runs_and_its_methods_agree():
    notebook = jupytext.read(FOLDER / "08_any_state_space_model.py")
    text = printed(run(notebook))
    evidence = {name: float(value) for name, value in re.findall(r"^(smc|bootstrap) +(-\d+\.\d+)", text, re.M)}
    assert abs(evidence["smc"] - evidence["bootstrap"]) < 0.5
    assert "Poisson predicts better" in text
    assert figures(notebook) == 1


@pytest.mark.long
def test_contact_and_muscles_run_and_find_the_floors_impulse():
    notebook = jupytext.read(FOLDER / "09_contact_and_muscles.py")
    text = printed(run(notebook))
    assert "kinks: True" in text
    assert "contact floor-foot: " in text
    ours, sd, true = map(float, re.search(r"impulse (\S+) ± (\S+) N·s, truly (\S+)", text).groups())
    assert abs(ours - true) < 3 * sd
    assert 0.1 < float(re.search(r"bands of activations are (\S+) wide", text)[1]) < 1
    assert figures(notebook) == 2


@pytest.mark.long
def test_a_study_finds_the_effect_that_was_put_in_and_no_other():
    notebook = jupytext.read(FOLDER / "10_a_study.py")
    text = printed(run(notebook))
    assert "12 trials inferred, 0 left out" in text
    rows = dict(re.findall(r"^(shoulder|elbow) +free +load +(.+)$", text, re.M))
    assert {joint: row.split()[4] for joint, row in rows.items()} == {"shoulder": "True", "elbow": "False"}
    held = re.findall(r"load − free \S+ N·m, 90 % between (\S+) and (\S+)$", text, re.M)
    (low, high), (elbow_low, elbow_high) = ([float(each) for each in row] for row in held)
    assert low < 0.5 < high  # half of 1 N·m; the other torques' part of the peak is the same
    assert elbow_low < 0 < elbow_high
    assert figures(notebook) == 1


@pytest.mark.parametrize("file", sorted(FOLDER.glob("[0-9]*.py")), ids=lambda file: file.stem)
def test_a_notebook_says_what_one_learns_and_folds_its_answers(file):
    cells = jupytext.read(file).cells
    assert "**You will learn**" in cells[0].source
    answers = [cell for cell in cells if "hide-cell" in cell.metadata.get("tags", ())]
    assert len(answers) >= 2
    assert all(cell.metadata["jupyter"] == {"source_hidden": True, "outputs_hidden": True} for cell in answers)


@pytest.mark.long
def test_three_d_holds_what_it_says():
    """The mouse is there or simulated; either way its hidden frames are predicted."""
    notebook = jupytext.read(FOLDER / "05_three_d.py")
    text = printed(run(notebook))
    rows = re.findall(r"outer sample size (\d+\.\d) of 16, 90 % bands hold (\d\.\d+) .* (\d+)% of the prior", text)
    sizes, held, removed = (np.array(column, dtype=float) for column in zip(*rows, strict=True))
    assert sizes.min() > 14
    assert abs(held.mean() - 0.9) < 0.12  # of 240 torques each, correlated over many rows
    assert removed[0] < removed[1] < removed[2]
    assert re.search(r"same points to \de-1[5-9] m", text)
    values = [float(value) for value in re.findall(r"smallest singular value (\d\.\d+) m/rad", text)]
    assert values[0] > values[1] > values[2] == 0
    assert "unseen: ['shoulder_roll']" in text
    lengths = dict(re.findall(r"(upper_arm|forearm): (\d\.\d\d) ±", text))
    assert float(lengths["upper_arm"]) == pytest.approx(2.5, abs=0.3)
    assert float(lengths["forearm"]) == pytest.approx(1.5, abs=0.3)
    assert 0.75 < float(re.search(r"90 % bands hold (\d\.\d+) of \d+ hidden", text)[1]) <= 1
    assert ("cannot be had here" in text) == ("INVDYN_DATA" not in os.environ)
    # the answers of the exercises
    noise, real = map(float, re.search(r"noise: (\d+) m/s². The wrist itself has (\S+) m/s²", text).groups())
    assert noise > 10 * real
    assert float(re.search(r"change their sign \(off by (\S+)\)", text)[1]) < 1e-9
    assert figures(notebook) == 3


@pytest.mark.long
def test_from_the_film_tells_strays_and_what_lasts():
    notebook = jupytext.read(FOLDER / "06_from_the_film.py")
    text = printed(run(notebook))
    medians = re.search(r"median error: elbow (\S+) px, wrist (\S+) px", text).groups()
    assert max(map(float, medians)) < 1.5  # px; a joint is a disc of five
    strays = [int(number) for number in re.search(r"3 px: pictures \[(.+)\]", text)[1].split(",")]
    assert min(strays) >= 50
    assert max(strays) < 65  # all while the ball rolls
    least, most = map(float, re.search(r"surprise of a stray: (\S+) and more; of the others: (\S+) at", text).groups())
    assert least > most
    assert float(re.search(r"picture before it: correlation (\S+)", text)[1]) > 0.3
    held = {name: float(share) for name, share in re.findall(r"^(.+): bands hold (\S+) of the torques", text, re.M)}
    assert held["film"] < held["white noise of that size"] - 0.03
    assert held["white noise of that size"] == pytest.approx(0.9, abs=0.08)  # of 180 torques, correlated
    assert held["triangulated points"] < held["pixels"] - 0.05
    assert held["pixels"] > 0.8
    # the answers of the exercises
    before, after = map(int, re.search(r"3 px: (\d+) before, (\d+) after", text).groups())
    assert after < before == len(strays)
    assert re.search(r"= 2\.5 of 45", text)
    assert held["white"] < held["pixels"]
    assert figures(notebook) == 4
