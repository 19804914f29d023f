"""The process that diagnoses: started by `python -m invdyn.blindcheck.worker`, it reads one case at a time.

It shares nothing with the process that knows the answers but two pipes. A line in: {"case": folder, "out": folder,
"without": [effects]}; a line back: {"seconds": …} or {"error": text}. What it reads is the case's folder.
"""

import json
import os
import sys
import time
import traceback
from collections.abc import Callable, Iterable
from pathlib import Path
from threading import Thread

from invdyn.models import BodyError, load_body
from invdyn.recordings import InputError, Recording, read_keypoint_csv, write_text


def diagnose_case(case: Path, out: Path, without: Iterable[str] = ()) -> None:
    """Diagnose what lies in `case` and write `out`/diagnosis.json. Raises as readers and `diagnose` do."""
    from invdyn.diagnosis.diagnose import diagnose

    public = json.loads((case / "case.json").read_text(encoding="utf-8"))
    body = load_body(case / "body.toml")

    def read(name: str) -> Recording:
        return read_keypoint_csv(case / name, joints=body.joint_names)

    found = diagnose(
        read("recording.csv"),
        body,
        held_out=read(public["held_out"]) if public["held_out"] else None,
        passive=public["regime"] == "passive",
        without=(*public["without"], *without),
        robot=public.get("robot", False),
        checked=True,  # a case's recording has no mistake, and no second is spent on looking for one
    )
    out.mkdir(parents=True, exist_ok=True)
    write_text(out / "diagnosis.json", json.dumps(found.to_json(), indent=1, ensure_ascii=False) + "\n")


def serve(jobs: Iterable[str], reply: Callable[[dict], None]) -> None:
    """Work off lines until there are no more."""
    for line in jobs:
        job, start = json.loads(line), time.monotonic()
        try:
            diagnose_case(Path(job["case"]), Path(job["out"]), job["without"])
        except (InputError, BodyError) as error:
            reply({"error": str(error)})
        except Exception:  # one case that fails must not end the others; the score counts it as wrong
            reply({"error": traceback.format_exc()})
        else:
            reply({"seconds": time.monotonic() - start})


def _end_with(parent: int) -> None:
    """End this process once its parent is gone, in the middle of a case too, as its answer would not be read."""
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)


def main() -> None:
    """Serve stdin. All printing is sent to stderr: stdout is the pipe for replies."""
    Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()
    pipe = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)

    def reply(answer: dict) -> None:
        pipe.write(json.dumps(answer) + "\n")
        pipe.flush()

    serve(sys.stdin, reply)


if __name__ == "__main__":
    main()
