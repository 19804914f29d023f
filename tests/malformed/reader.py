"""Reads files for tests, each in a process of its own whose memory and time are bounded: run by :mod:`.bounded`.

A line of JSON in, one out. The modules are loaded once; each file is read by a fork, which has `HEADROOM` more bytes of
addresses than this process, and `SECONDS` of its processor. A refusal is clear where it is an error of
ours, in one line. A MemoryError anywhere in its history says that the budget did not stop the reader.
"""

import json
import os
import resource
import signal
import sys
import tempfile
import warnings
from pathlib import Path

import mujoco  # noqa: F401 - loaded here, once
import pyarrow.parquet  # noqa: F401
import torch
from log_files import JOINTS, LEROBOT, bag, lerobot, mcap

from invdyn.inference.posterior.files import load_posterior
from invdyn.models.bodies import body_mjcf, body_xml
from invdyn.models.bodies.scalars import BodyError
from invdyn.models.bodies.whole_file import read_whole
from invdyn.recordings import InputError, load
from invdyn.recordings.logs import LogMap, recordings_of
from invdyn.recordings.tracking.heatmap import HeatmapTracker

HEADROOM = 2**31
"""Bytes: what a reader may take for a file of a few megabytes."""
SECONDS, WAITING = 120, 600
"""Of the processor; and altogether, for who waits for a pipe, however busy the machine."""


def read_log(path: Path) -> None:
    mapping = path.parent / "map.toml"
    if mapping.exists():
        recordings_of(path, JOINTS, LogMap.load(mapping))
    else:
        recordings_of(path, JOINTS, LogMap.of(LEROBOT) if path.suffix == ".parquet" or path.name == "set" else None)


def track(path: Path) -> None:
    tracker = HeatmapTracker.load(path)
    tracker.track_all(torch.zeros(1, *tracker.picture_size, 3, dtype=torch.uint8).numpy())


READERS = {
    "log": read_log,
    "body": lambda path: body_mjcf.of(body_xml.parse(read_whole(path, body_xml.MOST_BYTES), str(path)), str(path)),
    "network": track,
    "posterior": load_posterior,
    "recording": lambda path: load(path, units="px", fps=25),
}


def outcome(reader: str, path: Path) -> dict[str, str]:
    """What came of reading a file."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            READERS[reader](path)
    except (InputError, BodyError, OSError) as error:
        history: BaseException | None = error
        while history is not None:
            if isinstance(history, MemoryError) or "bad_alloc" in str(history):
                return {"outcome": "over budget", "message": f"{error} <- {history!r}"}
            history = history.__cause__ or history.__context__
        clear = len(str(error).splitlines()) == 1 and len(str(error)) < 2000
        return {"outcome": "clear line" if clear else "unclear", "message": str(error)[:500]}
    except BaseException as error:
        kind = "over budget" if isinstance(error, MemoryError) else "traceback"
        return {"outcome": kind, "message": f"{type(error).__name__}: {error}"[:500]}
    return {"outcome": "read", "message": ""}


def child(request: dict[str, str], answer: int) -> None:
    """Read in this process, with bounds, and end it."""
    size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (size + HEADROOM, resource.RLIM_INFINITY))
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS + 5))
    signal.alarm(WAITING)
    tempfile.tempdir = request["temporary"]
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    os.write(answer, json.dumps(outcome(request["reader"], Path(request["path"]))).encode())
    os._exit(0)


def log_readers() -> None:
    """Load what the readers of logs load when they are called first: each fork has it then."""
    with tempfile.TemporaryDirectory() as folder:
        for make, name in ((bag, "bag"), (mcap, "log.mcap"), (lerobot, "set")):
            read_log(make(Path(folder) / name))


def main() -> None:
    """Answer requests until there are no more."""
    torch.set_num_threads(1)
    log_readers()
    for line in sys.stdin:
        receive, send = os.pipe()
        if (pid := os.fork()) == 0:
            os.close(receive)
            child(json.loads(line), send)
        os.close(send)
        with os.fdopen(receive, "rb") as stream:
            content = stream.read()
        _, status, usage = os.wait4(pid, 0)
        found = json.loads(content) if content else {"outcome": "killed", "message": f"status {status}"}
        if os.WIFSIGNALED(status) and os.WTERMSIG(status) in (signal.SIGALRM, signal.SIGXCPU):
            found = {"outcome": "hang", "message": f"more than {SECONDS} s, or {WAITING} s of waiting"}
        print(json.dumps(found | {"peak": usage.ru_maxrss * 1024}), flush=True)


if __name__ == "__main__":
    main()
