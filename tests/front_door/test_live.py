"""`invdyn live`: lines in, lines out, from a file and by UDP."""

import json
import socket
import threading
import time

import numpy as np
import pytest
from pages import ROOT, blocks
from typer.testing import CliRunner

from invdyn.cli import app
from invdyn.inference import LiveArm
from invdyn.inputs import load_body
from invdyn.live_commands import answers, rows
from invdyn.recordings import InputError, read_keypoint_csv, read_table


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


def send(packets, done, port):
    """Send packets to a port, each once: the first one again until somebody listens, which a refusal tells."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.connect(("127.0.0.1", port))
        first, *others = packets
        while not done.is_set():
            sender.send(first)
            if not sender.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
                break
            time.sleep(0.02)
        for packet in others:
            sender.send(packet)


def test_bad_packets_are_named_and_the_others_answered(there, run):
    """JSON by UDP, until an empty packet; among them a cut one, one without a time, one of no number, one of others."""
    header, *lines = (there / "now.csv").read_text().splitlines()
    made = [json.dumps(dict(zip(header.split(","), map(float, line.split(",")), strict=True))) for line in lines]
    packets = [packet.encode() for packet in made]
    bad = [
        packets[3][:40],
        b'{"elbow_x": 1}',
        b'{"time": NaN, "elbow_x": 1}',
        b'{"time": 0.1, "knee_x": 1}',
        b"\xff\x00",
    ]
    packets = [bad[0], *packets[:20], *bad[1:], b"1,2", *packets[20:], b""]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    done = threading.Event()
    thread = threading.Thread(target=send, args=(packets, done, port))
    thread.start()
    try:
        outcome = run(*LIVE, "--udp", str(port), "--out", "answers.csv")
    finally:
        done.set()
        thread.join()
    assert outcome.exit_code == 0, outcome.stderr
    assert "6 left out as they cannot be used" in outcome.stderr
    assert outcome.stderr.count("warning: left out: ") == 5  # the others are counted
    assert "expected the time of a row in seconds, got nan" in outcome.stderr
    found, _ = read_table(there / "answers.csv")
    assert found["time"][-1] == pytest.approx(49 / 50)
    assert len(found["time"]) == len(lines)


def raised(error):
    raise error


def test_a_bad_line_of_a_port_changes_no_answer(there):
    body, given = load_body("paper_planar_arm"), (there / "now.csv").read_text().splitlines()
    live = LiveArm(read_keypoint_csv(there / "before.csv"), body)
    names, refused = ["time", *live.columns], []
    whole = list(answers(live, iter(given), names, raised))
    live.forget()
    spoiled = ['{"time": 1e300, "elbow_x": 1}', *given[:9], "\x00", '{"time": 0.1, "knee_x": 1}', *given[9:]]
    again = list(answers(live, iter(spoiled), names, refused.append))
    assert len(refused) == 3
    assert str(refused[1]).startswith("line 11: expected 5 numbers")
    assert len(again) == len(whole) == 50
    for one, other in zip(again, whole, strict=True):
        assert one.time == other.time
        np.testing.assert_array_equal(one.torque, other.torque)


def test_a_line_is_csv_or_json():
    read = list(rows(iter(["a,time\n", "1,0.5\n", "\n", '{"time": 1, "a": null}\n', ",2\n"]), ["time", "a"], raised))
    assert [time for time, _ in read] == [0.5, 1.0, 2.0]
    assert [values["a"] for _, values in read] == pytest.approx([1.0, np.nan, np.nan], nan_ok=True)
    assert list(rows(iter(["0.1,2"]), ["time", "a"], raised)) == [(0.1, {"a": 2.0})]


def test_a_file_may_begin_with_a_mark():
    assert list(rows(iter(["\ufefftime,a\n", "0.1,2\n"]), ["time", "b"], raised)) == [(0.1, {"a": 2.0})]


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
        list(rows(iter([line]), ["time", "a"], raised))


class Reddest:
    """A network that finds the reddest place of pictures of 60 × 80 px, and is unsure of another one."""

    keypoint_names, picture_size = ("elbow", "wrist"), (60, 80)

    def track(self, picture):
        v, u = np.unravel_index(picture[..., 0].astype(int).argmax(), picture.shape[:2])
        return np.array([[u, v, 0.9], [u, v, 0.4]])


def test_the_guides_camera_gives_rows_in_metres(tmp_path, monkeypatch):
    """A red spot that moves to the right and up, 4 and 2 px a picture, at 25 pictures a second."""
    cv2 = pytest.importorskip("cv2")
    path, names = str(tmp_path / "spot.avi"), {}
    film = cv2.VideoWriter(path, cv2.VideoWriter_fourcc(*"MJPG"), 25, (160, 120))
    for n in range(10):
        picture = np.full((120, 160, 3), (255, 0, 0), np.uint8)  # blue
        cv2.circle(picture, (40 + 4 * n, 80 - 2 * n), 3, (0, 0, 255), -1)
        film.write(picture)
    film.release()
    (block,) = (each for each in blocks(ROOT / "docs" / "how-to" / "live.md", "python") if "camera_rows" in each)
    exec(block, names)
    monkeypatch.setattr(names["HeatmapTracker"], "load", lambda path: Reddest())
    found = list(names["camera_rows"](path, "network", 0.01, (40, 80)))
    assert np.diff([time for time, _ in found]) == pytest.approx(np.full(9, 0.04))
    assert [row["elbow_x"] for _, row in found] == pytest.approx(np.arange(10) * 0.04, abs=0.03)
    assert [row["elbow_y"] for _, row in found] == pytest.approx(np.arange(10) * 0.02, abs=0.03)
    assert all(np.isnan(row["wrist_x"]) for _, row in found)
