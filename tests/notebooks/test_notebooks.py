"""Notebooks run from top to bottom, in a kernel of their own."""

import os
from pathlib import Path

import jupytext
import pytest
from nbclient import NotebookClient

FOLDER = Path(__file__).parents[2] / "notebooks"
SECONDS = 90  # a cell; a whole notebook takes about half of that


def run(notebook, **environment: str):
    client = NotebookClient(notebook, timeout=SECONDS, kernel_name="python3", resources={"metadata": {"path": FOLDER}})
    client.execute(env={**os.environ, "OMP_NUM_THREADS": "1", **environment})
    return notebook


def printed(notebook) -> str:
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    return "".join(output.get("text", "") for output in outputs)


@pytest.fixture
def planar_arm():
    return jupytext.read(FOLDER / "01_planar_arm.py")


def test_planar_arm_runs_and_finds_what_it_says(planar_arm, data_folder):
    text = printed(run(planar_arm, INVDYN_DATA=str(data_folder)))
    assert "skipped" not in text
    sizes = [
        float(line.split("outer sample size ")[1].split(" of 64")[0])
        for line in text.splitlines()
        if "outer sample size" in line
    ]
    bootstrap, controlled, human = sizes
    assert bootstrap < 8
    assert controlled > 50
    assert human > 50
    figures = [o for cell in planar_arm.cells for o in cell.get("outputs", ()) if "image/png" in o.get("data", {})]
    assert len(figures) == 6


def test_planar_arm_goes_on_without_the_real_recording(planar_arm, tmp_path):
    heading = next(k for k, cell in enumerate(planar_arm.cells) if cell.source.startswith("# A real arm"))
    imports = next(cell for cell in planar_arm.cells if cell.cell_type == "code")
    planar_arm.cells = [imports, *planar_arm.cells[heading:]]
    text = printed(run(planar_arm, INVDYN_DATA=str(tmp_path)))
    assert "cannot be had here" in text
    assert "human_arm" in text
