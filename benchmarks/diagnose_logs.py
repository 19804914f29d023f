"""What the default budget finds in real logs: DFKI's nine and IBM's ten swings, each diagnosed by itself.

A DFKI log and a swing are as in `board.py` (encoders at 100 rows/s under the measured torque, the rigid part of the
lab's model_2.0; 3 s, passive). Every recording has a process of its own, so that its
memory is its own: the largest resident sizes of it and of the second process, added up, in which what the two share
counts twice. Seconds of CPU are those of both; wall time says what else the machine did.

    INVDYN_DATA=… OMP_NUM_THREADS=1 python benchmarks/diagnose_logs.py [--workers 2] [--budget SECONDS] [NAME …]
    … NAME --one         one of them, in this process, as JSON

Names are "00" to "05" and "11" to "13" (DFKI), "ibm-0" to "ibm-9", and those of `ARMS`: a two-link arm that MuJoCo
moves by its usual steps, with encoders and torques at 500 rows/s and a camera of 60 frames/s (`tests/robot_log.py`),
whose truth is known.
"""

import argparse
import json
import resource
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

DFKI = ("00", "01", "02", "03", "04", "05", "11", "12", "13")
ARMS: dict[str, dict] = {  # s, and what a rigid arm lacks, (shoulder, elbow) in N·m·s/rad, N·m, kg·m² and s
    "nothing": {"seconds": 10},
    "heavy": {"seconds": 10, "friction": (0.0, 0.15)},  # and all masses of the body 10 % too large
    "stated": {"seconds": 10, "friction": (0.0, 0.15)},  # and the body says that they are known to 10 %
    "delay": {"seconds": 10, "damping": (0.0, 0.1), "friction": (0.15, 0.0), "delay": 0.01},
    "seven": {
        "seconds": 10,
        "damping": (0.1, 0.05),
        "friction": (0.15, 0.08),
        "armature": (0.02, 0.01),
        "delay": 0.01,
    },
    "long": {"seconds": 120, "damping": (0.0, 0.05)},
}
SWINGS = tuple(f"ibm-{number}" for number in range(10))


def given(name: str) -> tuple:
    """Recording, body and whether it is passive."""
    from invdyn.models import Body, planar_body

    if name in DFKI:
        from board import BODY, seen

        return seen(name), Body.from_toml(BODY), False
    if name in SWINGS:
        from board import PENDULUM, swing

        return swing(int(name.removeprefix("ibm-"))), PENDULUM, True
    sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
    from robot_log import ARM, MASSES, robot_log

    stated = {"mass": 0.1} if name == "stated" else {}
    factor = 1.1 if name in ("heavy", "stated") else 1.0
    links = [replace(link, mass=factor * mass) for link, mass in zip(ARM.links, MASSES, strict=True)]
    body = planar_body(ARM.name, links, gravity=ARM.gravity, uncertainty=stated)
    return robot_log(**ARMS[name]), body, False


def seconds_of_cpu() -> float:
    """Of this process and those that it has waited for."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)


def peak_mb(who: int) -> float:
    """The largest resident memory of this process, or of the largest one that it has waited for, MB."""
    unit = 1e6 if sys.platform == "darwin" else 1e3  # bytes there, kB elsewhere
    return resource.getrusage(who).ru_maxrss / unit


def diagnosed(name: str, workers: int, budget: float | None) -> dict:
    """What is said of one log, and what it took."""
    import torch

    from invdyn.diagnosis import diagnose
    from invdyn.diagnosis.report.sentences import verdict

    torch.set_num_threads(1)
    recording, body, passive = given(name)
    before, start = seconds_of_cpu(), time.perf_counter()
    found = diagnose(recording, body, passive=passive, workers=workers, budget=budget)
    wall, cpu = time.perf_counter() - start, seconds_of_cpu() - before
    answer = found.to_json()
    causes = [cause for cause in answer["causes"] if cause["effects"]]
    best = max(causes, key=lambda cause: cause["probability"] + cause["probability_in_part"], default=None)
    parameters = [
        f"{'.'.join([each['effect'], *(each[k] for k in ('joint', 'link', 'partner', 'form') if each.get(k))])} "
        + ", ".join(f"{key} {p['mean']:.3g}±{p['sd']:.1g} {p['unit']}" for key, p in each["parameters"].items())
        for each in (best["effects"] if best else [])
    ]
    return {
        "recording": recording.name if name in DFKI else name,
        "rows": len(found.tracks.time) if found.tracks is not None else 0,
        "wall s": wall,
        "CPU s": cpu,
        "memory MB": peak_mb(resource.RUSAGE_SELF) + peak_mb(resource.RUSAGE_CHILDREN),
        "likeliest": "; ".join(parameters) or "none",
        "probability": best["probability"] if best else 0.0,
        "in part": best["probability_in_part"] if best else 0.0,
        "outside": answer["outside_catalogue"]["probability"],
        "closed": found.shrinkage.gap_closed,
        "not looked at": found.not_looked_at,
        "verdict": verdict(found),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", default=[*DFKI, *SWINGS])
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--budget", type=float, help="seconds by the clock, in place of counted work")
    parser.add_argument("--one", action="store_true", help="in this process, as JSON")
    arguments = parser.parse_args()
    if arguments.one:
        print(json.dumps(diagnosed(arguments.names[0], arguments.workers, arguments.budget), ensure_ascii=False))
        return
    heads = ["recording", "rows", "wall s", "CPU s", "memory MB", "not looked at", "closed", "outside", "in part"]
    print(f"| {' | '.join(heads)} | likeliest cause |\n{'|---' * (len(heads) + 1)}|")
    for name in arguments.names:
        command = [sys.executable, "-W", "ignore", __file__, name, "--one", "--workers", str(arguments.workers)]
        command += [] if arguments.budget is None else ["--budget", str(arguments.budget)]
        row = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
        cells = [row["recording"], row["rows"], *(f"{row[head]:.0f}" for head in heads[2:5]), row["not looked at"]]
        cells += ["" if row["closed"] is None else f"{row['closed']:.0%}"]
        cells += [f"{row['outside']:.0%}", f"{row['in part']:.0%}", row["likeliest"]]
        print(f"| {' | '.join(map(str, cells))} |", flush=True)


if __name__ == "__main__":
    main()
