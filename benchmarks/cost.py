"""What a run costs: time and memory of the controlled filter against rows T, particles N, filters M and joints K.

The paper's planar arm (see planar_paper.py, ε .1), every size in a process of its own. Other K: its
first links, or more like its second (1 m, .3 kg), in steps of .01 s. Seconds of the filter alone,
and next to it those of the Gauss–Newton smoother that its guide is made of (once for all filters; without the refits,
whose pilot runs are runs of the same filter). The sweeps count seconds of CPU on one thread, which do not depend on
what else the machine is doing; --one gives wall time too. Memory is the process's largest resident size (ru_maxrss)
above what it was before.

    python benchmarks/cost.py                          the sweeps; a table, and docs/cost.png
    python benchmarks/cost.py --one 200 1000 64        one size: T N M, and --joints K
    python benchmarks/cost.py --one 10000 1000 64 --keep 300     and smooth the last 300 rows alone
    python benchmarks/cost.py --long 1000 10000 100000 --torque ornstein_uhlenbeck    `infer --method laplace`
    --threads 2                                        torch's threads
"""

import argparse
import json
import math
import os
import resource
import shlex
import subprocess
import sys
import time
from pathlib import Path

SWEEPS = {  # the one that varies, and the others
    "T": [(rows, 200, 16, 2) for rows in (100, 200, 400, 800, 1600)],
    "N": [(100, particles, 16, 2) for particles in (250, 500, 1000, 2000, 4000, 8000)],
    "M": [(100, 200, filters, 2) for filters in (16, 32, 64, 128, 256, 512)],
    "K": [(100, 1000, 16, joints) for joints in (1, 2, 3, 4, 5, 6, 8, 12)],
}
NAMES = {"T": "rows T", "N": "particles N", "M": "filters M", "K": "joints K"}
FIGURE = Path(__file__).parents[1] / "docs" / "cost.png"


def peak_mb(used: resource.struct_rusage | None = None) -> float:
    """The largest resident memory of this process so far, or of what a process has ``used``, MB."""
    used = used or resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_maxrss / (1e6 if sys.platform == "darwin" else 1e3)  # bytes there, kB elsewhere


def now() -> tuple[float, float]:
    """Wall clock and this process's CPU clock, s."""
    return time.perf_counter(), time.process_time()


def seconds(what: str, start: tuple[float, float], end: tuple[float, float]) -> dict[str, float]:
    return {f"{what} s": end[0] - start[0], f"{what} CPU s": end[1] - start[1]}


def chain_problem(rows: int, joints: int):
    """The paper's arm, or the like with other than two links."""
    import numpy as np
    import torch
    from planar_paper import paper_problem

    from invdyn.inference import Problem
    from invdyn.models import ArmModel, Keypoints, Link, Observation, planar_body
    from invdyn.simulate import PAPER, record

    if joints == 2:
        return paper_problem(0.1, seed=0, num_frames=rows)
    names = [f"joint{k}" for k in range(joints + 1)]
    masses = [0.5, *[0.3] * (joints - 1)]
    links = [Link(f"link{k}", *names[k : k + 2], length=1.0, mass=masses[k]) for k in range(joints)]
    # A long chain's last links whip round, and explicit Euler with steps of .03 s would blow that up.
    model = ArmModel(
        planar_body("chain", links, gravity=(0.0, -1.0)),
        0.01 * np.arange(rows),
        Observation(Keypoints(range(joints))),
        torque=PAPER["torque"],
        integrator=PAPER["integrator"],
        parameters={**PAPER["settings"], "initial.angle_scale": 0.3, "initial.velocity_scale": 0.3},
    )
    recording, truth = record(model, seed=0)
    return Problem(model, torch.as_tensor(recording.keypoints.reshape(rows, -1)), recording, truth)


def measure(
    rows: int, particles: int, filters: int, joints: int, keep: int | None, refits: int, threads: int
) -> dict[str, float]:
    """Run one size in this process."""
    import torch

    from invdyn.inference import SMCOptions, adapted_smoother, backward_simulation, outer_weights, run_filters

    torch.set_num_threads(threads)
    torch.manual_seed(0)
    small = chain_problem(20, joints)
    # Once small, so that imports, derivation and the allocator's first pages are not counted.
    run_filters(small.model, small.observations, SMCOptions(2, 10, refits=0))
    before = peak_mb()
    problem = chain_problem(rows, joints)
    model, observations = problem.model, problem.observations
    options = SMCOptions(filters, particles, refits=refits)
    clock = [now()]
    smoother = adapted_smoother(model, observations, options)
    clock.append(now())
    result = run_filters(model, observations, options, smoother=smoother, keep=keep)
    clock.append(now())
    out = {"T": rows, "N": particles, "M": filters, "K": joints}
    out |= {**seconds("guide", *clock[:2]), **seconds("filter", *clock[1:])}
    if keep is not None:
        paths = backward_simulation(model, result, observations, options.num_draws, smoother=smoother)
        out |= {"smoothed rows": paths.shape[-2], **seconds("smoothing", clock[-1], now())}
    outer = outer_weights(result.log_evidence)
    return out | {
        "memory MB": peak_mb() - before,
        "peak of the process MB": peak_mb(),
        "outer ESS": outer.ess,
        "sd of log Ẑ": outer.filter_sd,
    }


def wandering_arm(rows: int, path: Path) -> None:
    """A file of keypoints of the paper's arm, 30 frames a second, that torques without damping would make whirl.

    Angles of joints are stationary: white noise through three low passes of .2 s, of a standard deviation of .5 rad.
    """
    import numpy as np
    from scipy.signal import lfilter

    from invdyn.recordings.tables import write_table

    rng, keep = np.random.default_rng(0), math.exp(-1 / 30 / 0.2)
    angles = rng.standard_normal((rows + 300, 2))
    for _ in range(3):
        angles = lfilter([1.0], [1.0, -keep], angles, axis=0)
    angles = 0.5 * (angles / angles.std(0))[300:] + np.array([-math.pi / 2, 0.0])
    steps = np.stack([np.cos(angles.cumsum(-1)), np.sin(angles.cumsum(-1))], -1)
    tips = steps.cumsum(1) + 0.005 * rng.standard_normal(steps.shape)
    columns = {"time": np.arange(rows) / 30}
    for k, name in enumerate(("elbow", "wrist")):
        columns |= {f"{name}_x": tips[:, k, 0], f"{name}_y": tips[:, k, 1]}
    write_table(columns, path)


def long_recordings(sizes: list[int], torque: str) -> None:
    """`invdyn infer --method laplace` in a fresh process, on recordings of so many rows: CPU seconds and memory."""
    folder = Path("build")
    folder.mkdir(exist_ok=True)
    print("| rows | CPU s | µs a row | memory MB | posterior MB | paths | log evidence a row |")
    print("|---|---|---|---|---|---|---|")
    for rows in sizes:
        rec, out = folder / f"t{rows}.csv", folder / f"t{rows}.nc"
        invdyn = [sys.executable, "-W", "ignore", "-m", "invdyn"]
        body = ["--body", "paper_planar_arm"]
        if not rec.exists():
            wandering_arm(rows, rec)
        command = [*invdyn, "infer", str(rec), *body, "--method", "laplace", "--torque", torque, "--out", str(out)]
        child = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        _, status, used = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
        if child.returncode:
            raise SystemExit(f"{shlex.join(command)} ended with {child.returncode}")
        import arviz as az

        found = az.from_netcdf(str(out), engine="h5netcdf")
        taken = used.ru_utime + used.ru_stime
        sizes_of = found["posterior"].sizes
        print(
            f"| {rows} | {taken:.1f} | {1e6 * taken / rows:.0f} | {peak_mb(used):.0f} "
            f"| {out.stat().st_size / 1e6:.0f} | {sizes_of['chain'] * sizes_of['draw']} "
            f"| {found.attrs['log_evidence'] / rows:.4f} |",
            flush=True,
        )


def measured(size: tuple[int, int, int, int], threads: int) -> dict[str, float]:
    """`measure` in a fresh process."""
    command = [sys.executable, "-W", "ignore", __file__, "--threads", str(threads), "--one", *map(str, size[:3])]
    command += ["--joints", str(size[3])]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def slope(x: list[float], y: list[float]) -> float:
    """Exponent b of y ∝ x^b between the last two sizes."""
    return math.log(y[-1] / y[-2]) / math.log(x[-1] / x[-2])


def draw(sweeps: dict[str, list[dict[str, float]]]) -> None:
    import matplotlib
    from matplotlib.figure import Figure

    from invdyn.plots import BLUE, GREEN, GREY, STYLE, VERMILION

    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(12, 5), layout="constrained")
        axes = figure.subplots(2, len(sweeps), sharex="col", sharey="row")
        for column, (letter, rows) in enumerate(sweeps.items()):
            x = [row[letter] for row in rows]
            fixed = ", ".join(f"{other} = {rows[0][other]:g}" for other in "TNMK" if other != letter)
            for place, (name, color, unit) in enumerate((("filter CPU s", BLUE, "CPU s"), ("memory MB", GREEN, "MB"))):
                panel, y = axes[place, column], [row[name] for row in rows]
                panel.loglog(x, [y[-1] * each / x[-1] for each in x], color=GREY, linewidth=0.9, dashes=(4, 2))
                panel.loglog(x, y, ".-", color=color, label=name.split()[0])
                if letter in "TK" and place == 0:
                    panel.loglog(
                        x, [row["guide CPU s"] for row in rows], ".-", color=VERMILION, label="its guide, once"
                    )
                if column == 0:
                    panel.set_ylabel(unit)
                    panel.legend(loc="upper left")
            axes[0, column].set_title(f"{NAMES[letter]}\n({fixed})", loc="left")
            axes[1, column].set_xlabel(NAMES[letter])
            axes[1, column].set_xticks(x, [f"{each:g}" for each in x])
            axes[1, column].minorticks_off()
    figure.suptitle("controlled filter: time and memory; dashed: proportional", x=0.01, ha="left", fontsize=9.5)
    FIGURE.parent.mkdir(exist_ok=True)
    figure.savefig(FIGURE, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--one", type=int, nargs=3, metavar=("T", "N", "M"))
    parser.add_argument("--joints", type=int, default=2, metavar="K")
    parser.add_argument("--keep", type=int, help="rows to keep, the last ones, which are smoothed")
    parser.add_argument("--refits", type=int, default=0, help="of the guide; `invdyn infer` makes 2")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--long", type=int, nargs="+", metavar="T", help="rows of recordings for `laplace`")
    parser.add_argument("--torque", default="auto", help="process of the torques of long recordings")
    arguments = parser.parse_args()
    if arguments.long:
        long_recordings(arguments.long, arguments.torque)
        return
    if arguments.one:
        row = measure(*arguments.one, arguments.joints, arguments.keep, arguments.refits, arguments.threads)
        print(json.dumps({name: round(value, 3) for name, value in row.items()}, ensure_ascii=False))
        return
    sweeps: dict[str, list[dict[str, float]]] = {}
    print("| what grows | from … to | filter CPU s | time grows as | memory MB | memory as | µs a particle-step |")
    print("|---" * 7 + "|")
    for letter, sizes in SWEEPS.items():
        sweeps[letter] = []
        for size in sizes:
            sweeps[letter].append(measured(size, arguments.threads))
        rows, ends = sweeps[letter], (sweeps[letter][0], sweeps[letter][-1])
        cells = [f"{ends[0][letter]} … {ends[1][letter]}"]
        for name, digits in (("filter CPU s", 2), ("memory MB", 0)):
            grows = slope([row[letter] for row in rows], [row[name] for row in rows])
            cells += [" … ".join(f"{row[name]:.{digits}f}" for row in ends), f"{letter}^{grows:.2f}"]
        each = (1e6 * row["filter CPU s"] / (row["T"] * row["N"] * row["M"]) for row in ends)
        print(f"| {NAMES[letter]} | {' | '.join(cells)} | {' … '.join(f'{one:.2f}' for one in each)} |", flush=True)
    draw(sweeps)
    print(f"\n{FIGURE.relative_to(Path.cwd()) if FIGURE.is_relative_to(Path.cwd()) else FIGURE}")


if __name__ == "__main__":
    main()
