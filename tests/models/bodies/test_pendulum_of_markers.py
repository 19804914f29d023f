"""A real pendulum whose hinges are parallel and whose robot's file has its 16 markers as sites.

Delft's triple pendulum (data/README.md): the frame of its OpenSim file is x, y up, z; here x is right, y into the
picture and z up. The hinges' axis in the laboratory was found from the markers (Kabsch), and so was the base.
"""

import csv
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from typer.testing import CliRunner

from invdyn.cli import app
from invdyn.inference import infer
from invdyn.inputs import load_body, load_recording

FIRST, ROWS = 1600, 60
"""Of the file, 400 rows a second: by then nobody holds the pendulum."""
ABOVE = {"upper": 0.5207, "middle": 0.5207, "lower": 0.07}  # of each body's joint over its origin, m
INERTIAL = {  # mass kg; centre of mass over the origin m; moments about x, y, z here kg·m²
    "upper": (1.169, 0.275, (0.029651, 0.029654, 0.000384)),
    "middle": (1.105, 0.26035, (0.025078, 0.025081, 0.000363)),
    "lower": (1.519, 0.0, (0.001873, 0.010184, 0.008806)),
}
BASE = (0.00990, -0.22218, 1.53039)


@pytest.fixture
def pendulum(data_folder, tmp_path, monkeypatch):
    """A folder with pendulum.xml and markers.csv, 100 rows a second."""
    pytest.importorskip("mujoco")
    folder = data_folder / "delft_pendulum"
    up, axis = np.array([0.0, 0.0, 1.0]), np.array([-0.0817, 0.9966, 0.0])
    axis /= np.linalg.norm(axis)
    frame = np.stack([np.cross(up, axis), -axis, up])
    rows = list(csv.reader((folder / "markers3.csv").read_text().splitlines()))
    values = np.array([[float(value or "nan") for value in row] for row in rows[FIRST : FIRST + 4 * ROWS : 4]])
    points = {c[:-2]: values[:, k : k + 3] @ frame.T for k, c in enumerate(rows[0]) if c.endswith("_x")}
    sites: dict[str, list[str]] = {link: [] for link in ABOVE}
    names = []
    for marker in ET.parse(folder / "pendulum.osim").iter("Marker"):
        name, link = marker.get("name").strip(), marker.findtext("socket_parent_frame").split("/")[-1]
        if link in ABOVE and name in points:
            x, y, z = map(float, marker.findtext("location").split())
            sites[link].append(f'<site name="{name}" pos="{x} {-z} {y - ABOVE[link]}"/>')
            names.append(name)
    xml = ""
    for k, (link, (mass, com, moments)) in reversed(list(enumerate(INERTIAL.items()))):
        place = " ".join(map(str, BASE if k == 0 else (0, 0, -0.5207)))
        xml = (
            f'<body name="{link}" pos="{place}"><joint name="j{k + 1}" axis="0 -1 0"/>'
            f'<inertial pos="0 0 {com - ABOVE[link]}" mass="{mass}" diaginertia="{" ".join(map(str, moments))}"/>'
            + "".join(sites[link])
            + f"{xml}</body>"
        )
    (tmp_path / "pendulum.xml").write_text(f"<mujoco><worldbody>{xml}</worldbody></mujoco>")
    with (tmp_path / "markers.csv").open("w") as file:
        file.write("time," + ",".join(f"{name}_{axis}" for name in names for axis in "xyz") + "\n")
        for n, time in enumerate(values[:, 0] - values[0, 0]):
            row = np.concatenate([points[name][n] for name in names])
            file.write(f"{time:.4f}," + ",".join("" if np.isnan(v) else f"{v:.5f}" for v in row) + "\n")
    monkeypatch.chdir(tmp_path)
    return names


@pytest.mark.long
def test_every_site_of_parallel_hinges_is_a_keypoint_and_all_of_them_are_inferred_from(pendulum):
    body = load_body("pendulum.xml", recording="markers.csv")
    assert set(body.keypoint_names) == set(pendulum)
    assert len(pendulum) == 16
    assert body.joint_names == ("j1", "j2", "j3")
    recording = load_recording("markers.csv", body)
    found = infer(recording, body, method="laplace", passive=True)
    assert found.posterior_predictive["position"].sizes["keypoint"] == 16
    off = (found.posterior_predictive["position"] - found.observed_data["position"]).mean(("chain", "draw"))
    assert float(np.sqrt((off**2).mean())) < 0.008  # m: the file's own misfit to its markers is 7 mm
    # Nothing drives it: what is left is friction and the file's misfit, against 15 N·m that its weight exerts.
    assert float(np.sqrt((found.posterior["torque"] ** 2).mean())) < 2


def test_a_check_reads_the_same_body(pendulum):
    arguments = ["check", "pendulum.xml", "markers.csv", "--zero-torque", "--no-effects"]
    outcome = CliRunner().invoke(app, arguments)
    assert outcome.exit_code == 0, outcome.output
