"""`invdyn live`: lines in, lines out, from a file and by UDP."""

import json
import socket
import threading
import time

import numpy as np
import pytest
from typer.testing import CliRunner

from invdyn.cli import app
from invdyn.live_commands import rows
from invdyn.recordings import InputError, read_table


@pytest.fixture(name="there")
def recordings(folder, run):
    """A calibration and the rows that follow, in a folder."""
    for name, seconds, seed in (("before.csv", "3", "1"), ("now.csv", "1", "2")):
        made = run("simulate", "--body", "paper_planar_arm", "--out", name, "--duration", seconds, "--fps", "50",
                   "--seed", seed)  # fmt: skip
        assert made.exit_code == 0, made.stderr
    return folder


LIVE = ("live", "--body", "paper_planar_arm", "--calibration", "before.csv")


def test_lines_in_and_lines_out(there, run):
    outcome = run(*LIVE[:1], "now.csv", *LIVE[1:], "--out", "answers.csv")
    assert outcome.exit_code == 0, outcome.stderr
    assert "50 rows answered, 0 lost, 0 too late, 0 doubled, 0 restarts" in outcome.stderr
    found, _ = read_table(there / "answers.csv")
    assert found["time"] == pytest.approx(np.arange(50) / 50)
    assert (found["elbow_torque_q05"] < found["elbow_torque"]).all()
    assert (found["elbow_torque"] < found["elbow_torque_q95"]).all()
    assert not found["changed"].any()


@pytest.mark.long
def test_standard_input_and_output(there):
    outcome = CliRunner().invoke(app, LIVE, input=(there / "now.csv").read_text())
    assert outcome.exit_code == 0, outcome.stderr
    head, *lines = outcome.stdout.splitlines()
    assert head.startswith("time,shoulder_torque,")
    assert len(lines) == 50


def test_packets_in(there, run):
    """JSON by UDP, until an empty packet."""
    header, *lines = (there / "now.csv").read_text().splitlines()
    packets = [json.dumps(dict(zip(header.split(","), map(float, line.split(",")), strict=True))) for line in lines]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    done = threading.Event()

    def send():
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            while not done.is_set():  # what is sent before the command listens is lost
                for packet in [*packets, ""]:
                    sender.sendto(packet.encode(), ("127.0.0.1", port))
                    time.sleep(0.002)
                time.sleep(0.2)

    thread = threading.Thread(target=send)
    thread.start()
    try:
        outcome = run(*LIVE, "--udp", str(port), "--out", "answers.csv")
    finally:
        done.set()
        thread.join()
    assert outcome.exit_code == 0, outcome.stderr
    assert "rows answered" in outcome.stderr


def test_a_line_is_csv_or_json():
    read = list(rows(iter(["a,time\n", "1,0.5\n", "\n", '{"time": 1, "a": null}\n', ",2\n"]), ["time", "a"]))
    assert [time for time, _ in read] == [0.5, 1.0, 2.0]
    assert [values["a"] for _, values in read] == pytest.approx([1.0, np.nan, np.nan], nan_ok=True)
    assert list(rows(iter(["0.1,2"]), ["time", "a"])) == [(0.1, {"a": 2.0})]


def test_a_file_may_begin_with_a_mark():
    assert list(rows(iter(["\ufefftime,a\n", "0.1,2\n"]), ["time", "b"])) == [(0.1, {"a": 2.0})]


def test_a_unix_time_keeps_its_milliseconds(there, run):
    header, *lines = (there / "now.csv").read_text().splitlines()
    times = [1764470268.1 + n / 50 for n in range(len(lines))]
    moved = [f"{time},{line.partition(',')[2]}" for time, line in zip(times, lines, strict=True)]
    (there / "now.csv").write_text("\n".join([header, *moved]))
    outcome = run(*LIVE[:1], "now.csv", *LIVE[1:], "--out", "answers.csv")
    assert outcome.exit_code == 0, outcome.stderr
    found, _ = read_table(there / "answers.csv")
    assert found["time"] == pytest.approx(times, rel=0, abs=1e-3)


def test_what_cannot_be_read_is_one_line(there, run):
    (there / "noise.csv").write_bytes(bytes(range(128, 256)) * 9)
    for given, message in (
        (("noise.csv",), "error: line 1: expected 5 numbers"),
        (("now.csv", "--udp", "5005"), "error: expected rows from one place, got now.csv and --udp 5005"),
    ):
        outcome = run(*LIVE[:1], *given, *LIVE[1:])
        assert outcome.exit_code != 0
        assert outcome.stderr.startswith(message)


@pytest.mark.parametrize(
    "line", ["1,2,3", "1,x", "{", '{"a": 1}', "[1, 2]", '{"time": 1' + 400 * "0" + "}", 20000 * '{"a":']
)
def test_other_lines_are_refused(line):
    with pytest.raises(InputError, match="line 1: expected 2 numbers"):
        list(rows(iter([line]), ["time", "a"]))
