"""How long a diagnosis takes: 6 s of a two-link arm at 100 frames/s, the whole catalogue, SMC and report included.

Imports are not counted: each effect is diagnosed in this process, after one that warms it up.

    OMP_NUM_THREADS=1 python benchmarks/diagnose_speed.py [--workers 1 2] [--repeat 3]
    OMP_NUM_THREADS=1 python benchmarks/diagnose_speed.py --growth        with rows, candidates and recordings, CPU s
    OMP_NUM_THREADS=1 python benchmarks/diagnose_speed.py --growth candidates recordings     these, and their figure
"""

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
import torch

from invdyn.diagnosis import diagnose, save
from invdyn.diagnosis.hypotheses.continuation import data_path
from invdyn.diagnosis.hypotheses.laws import finely_stepped
from invdyn.diagnosis.hypotheses.pool import considered
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.problem.noise import is_searched
from invdyn.diagnosis.problem.unknowns import unknowns
from invdyn.diagnosis.sensitivity.screen import screen
from invdyn.models import Link, planar_body
from invdyn.models.effects import EFFECTS
from invdyn.recordings import Recording
from invdyn.simulate import random_arm, record

UPPER, FORE = Link("upper_arm", "shoulder", "elbow", 0.3, 1.5), Link("forearm", "elbow", "wrist", 0.25, 1.0)
ARM = planar_body("arm", [UPPER, FORE], gravity=(0.0, -9.81))
CASES = {
    "no gap": None,
    "payload": (EFFECTS["payload"](), {"mass": 0.2}),
    "viscous friction": (EFFECTS["viscous_friction"]("elbow"), {"damping": 0.05}),
    "camera latency": (EFFECTS["camera_latency"](), {"latency": 0.02}),
    "dry friction": (EFFECTS["coulomb_friction"]("elbow"), {"torque": 0.15}),
    "spring": (EFFECTS["joint_stiffness"]("elbow"), {"stiffness": 0.5, "torque": 0.1}),
}


ROWS = (300, 600, 1200, 2400, 4800)
SHARES = (0.125, 0.25, 0.5, 1.0)  # of the catalogue
RECORDINGS = (1, 2, 4)
FIGURE = Path(__file__).parents[1] / "docs" / "cost_of_diagnosis.png"
CALM = 0.3  # effort with which an arm does not begin to whirl, however long: that would take more sub-steps a row


def recorded(name: str, duration: float = 6.0, effort: float = 0.7, seed: int = 3) -> Recording:
    """The arm under known random commands, with one effect or none, filmed with 2 mm of noise."""
    arm = random_arm(ARM, duration=duration, fps=100, noise=0.002, torque_scale=effort, commanded=True, seed=seed)
    if CASES[name] is not None:
        effect, values = CASES[name]
        given = {f"effect.{effect.key}.{n}": torch.tensor([v], dtype=torch.float64) for n, v in values.items()}
        arm = arm.with_effects(effect).replace(**given)
    return record(arm, seed)[0]


def seconds(recording: Recording, workers: int) -> tuple[float, str]:
    """Diagnosed and saved; what was said to be the cause."""
    start = time.perf_counter()
    found = diagnose(recording, ARM, workers=workers)
    with tempfile.TemporaryDirectory() as folder:
        save(found, folder, workers=workers)
    taken = time.perf_counter() - start
    effects = found.to_json()["causes"][0]["effects"]
    return taken, " + ".join(effect["effect"] for effect in effects) or "no gap"


def growth(kinds: list[str]) -> None:
    """Print seconds of CPU of a whole diagnosis against rows and recordings, and of the screen (one worker)."""
    if "rows" in kinds:
        against_rows()
    found: dict[str, list[tuple[int, float]]] = {}
    if "candidates" in kinds:
        print("\n| candidates | screen of 600 rows, CPU s |\n|---|---|")
        recording = recorded("payload", effort=CALM)
        for share in SHARES:
            found.setdefault("candidates", []).append(screened(recording, share))
            print("| {} | {:.2f} |".format(*found["candidates"][-1]), flush=True)
    if "recordings" in kinds:
        print("\n| recordings of 300 rows | diagnosis, CPU s |\n|---|---|")
        for count in RECORDINGS:
            several = [recorded("payload", 3.0, CALM, seed) for seed in range(3, 3 + count)]
            start = time.process_time()
            diagnose(several, ARM)
            found.setdefault("recordings", []).append((count, time.process_time() - start))
            print("| {} | {:.1f} |".format(*found["recordings"][-1]), flush=True)
    if found:
        draw(found)


def draw(found: dict[str, list[tuple[int, float]]]) -> None:
    """Seconds of CPU against candidates and recordings; dashed: proportional to the last size."""
    import matplotlib
    from matplotlib.figure import Figure

    from invdyn.plots import BLUE, GREY, STYLE

    titles = {"candidates": "candidates in a screen of 600 rows", "recordings": "recordings of 300 rows, diagnosed"}
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(8, 2.9), layout="constrained")
        for axes, (kind, points) in zip(figure.subplots(1, len(found), squeeze=False)[0], found.items(), strict=True):
            x, y = zip(*points, strict=True)
            axes.plot([0, x[-1]], [0, y[-1]], color=GREY, linewidth=0.9, dashes=(4, 2))
            axes.plot(x, y, ".-", color=BLUE)
            axes.set_title(titles[kind], loc="left")
            axes.set(xlabel=kind, ylabel="CPU s", xlim=(0, None), ylim=(0, None))
        figure.savefig(FIGURE, dpi=110)


def against_rows() -> None:
    """The table against rows, of the whole diagnosis and of the screen of all candidates."""
    print("| rows | diagnosis, CPU s | exponent | screen of all candidates, CPU s | exponent |\n|---|---|---|---|---|")
    before = None
    for rows in ROWS:
        recording = recorded("payload", rows / 100, CALM)
        start = time.process_time()
        diagnose(recording, ARM)
        now = np.array([rows, time.process_time() - start, screened(recording, 1.0)[1]])
        grown = np.full(3, np.nan) if before is None else np.log(now / before)
        whole, part = ("" if before is None else f"{each:.2f}" for each in grown[1:] / grown[0])
        print(f"| {rows} | {now[1]:.1f} | {whole} | {now[2]:.2f} | {part} |", flush=True)
        before = now


def screened(recording: Recording, share: float) -> tuple[int, float]:
    """Candidates, an even share of the catalogue's, and the least seconds of CPU of three screens of them."""
    bound = diagnosis_problem(recording, ARM)
    path, _ = data_path(bound)
    bound = finely_stepped(bound.shaped(path), path)
    among = [effect for effect in considered(bound) if not is_searched(effect)][:: round(1 / share)]
    common = unknowns(bound, ())
    taken = []
    for _ in range(3):
        start = time.process_time()
        screen(bound, bound.model, path, among, common, common.mean)
        taken.append(time.process_time() - start)
    return len(among), min(taken)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--workers", nargs="+", type=int, default=[1, 2])
    parser.add_argument("--repeat", type=int, default=3)
    kinds = ["rows", "candidates", "recordings"]
    parser.add_argument("--growth", nargs="*", choices=kinds, help="how it grows with these instead; by default all")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    seconds(recorded("no gap"), 1)
    if arguments.growth is not None:
        growth(arguments.growth or kinds)
        return
    heads = " | ".join(f"{workers} worker{'s' * (workers > 1)}, s" for workers in arguments.workers)
    print(
        f"| what the simulation lacks | {heads} | what the diagnosis says |\n{'|---' * (len(arguments.workers) + 2)}|"
    )
    for name in CASES:
        recording, row, said = recorded(name), [], ""
        for workers in arguments.workers:
            runs = [seconds(recording, workers) for _ in range(arguments.repeat)]
            row.append(f"{min(taken for taken, _ in runs):.1f}")
            said = runs[0][1]
        print(f"| {name} | {' | '.join(row)} | {said} |", flush=True)


if __name__ == "__main__":
    main()
