"""A page's content for the viewer Rerun."""

import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from invdyn.inference import save_posterior
from invdyn.page import write_rerun
from invdyn.plots import quantiles
from invdyn.view import of_posterior


def test_without_rerun_its_extra_is_named(run, make_posterior, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    save_posterior(make_posterior(2), tmp_path / "p.nc")
    said = run("view", tmp_path / "p.nc", "--out", tmp_path / "p.html", "--rerun", tmp_path / "p.rrd")
    assert said.exit_code == 2
    assert "invdyn[rerun]" in said.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["p.nc"]


def test_rerun_gets_what_the_page_shows(make_posterior, tmp_path, monkeypatch):
    """By a stand-in for the library, which keeps what it is told."""
    logged, now = [], [0.0]

    class RecordingStream:
        def __init__(self, name):
            self.path = None

        def save(self, path):
            self.path = Path(path)

        def set_time(self, timeline, *, duration):
            now[0] = duration

        def log(self, place, what):
            logged.append((now[0], "/".join(place), what))

        def disconnect(self):
            self.path.write_bytes(b"done")

    library = SimpleNamespace(RecordingStream=RecordingStream, Scalars=float, LineStrips3D=list, Points3D=np.array)
    monkeypatch.setitem(sys.modules, "rerun", library)
    idata = make_posterior(2, 20)
    write_rerun(of_posterior(idata, "p.nc"), tmp_path / "p.rrd")
    assert [path.name for path in tmp_path.iterdir()] == ["p.rrd"]
    time = idata.posterior.time.values
    told = {(t, place): what for t, place, what in logged}
    low, _, median, _, high = quantiles(idata, "torque")[:, 7, 1]
    found = [told[time[7], f"torque/elbow/posterior median/{name}"] for name in ("low", "middle", "high")]
    np.testing.assert_allclose(found, [low, median, high], atol=1e-2)
    (strip,) = told[time[7], "body/posterior mean"]
    np.testing.assert_allclose(strip[1:, :2], idata.posterior.position.mean(("chain", "draw")).values[7])
    assert (strip[:, 2] == 0).all()
    assert [len(told[t, "body/seen"]) for t in time[[5, 7]]] == [2, 1], "a missing keypoint is not drawn"
