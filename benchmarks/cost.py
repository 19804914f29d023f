"""What a run costs: time and memory of the controlled filter against rows T, particles N and filters M.

The paper's planar arm (see planar_paper.py, ε .1), every size in a process of its own. Seconds of the filter alone,
and beside it those of the Gauss–Newton smoother that its guide is made of (once for all filters; without the refits,
whose pilot runs are runs of the same filter). The sweeps count seconds of CPU on one thread, which do not depend on
what else the machine is doing; --one gives wall time too. Memory is the process's largest resident size (ru_maxrss)
above what it was before.

    python benchmarks/cost.py                          the sweeps; a table, and docs/cost.png
    python benchmarks/cost.py --one 200 1000 64        one size: T N M
    python benchmarks/cost.py --one 10000 1000 64 --keep 300     and smooth the last 300 rows alone
    --threads 2                                        torch's threads
"""

import argparse
import json
import resource
import subprocess
import sys
import time
from pathlib import Path

SWEEPS = {  # the one that varies, and the other two
    "T": [(rows, 200, 16) for rows in (100, 200, 400, 800, 1600)],
    "N": [(100, particles, 16) for particles in (250, 500, 1000, 2000, 4000, 8000)],
    "M": [(100, 200, filters) for filters in (16, 32, 64, 128, 256, 512)],
}
NAMES = {"T": "rows T", "N": "particles N", "M": "filters M"}
FIGURE = Path(__file__).parents[1] / "docs" / "cost.png"


def peak_mb() -> float:
    """The largest resident memory of this process so far, MB."""
    unit = 1e6 if sys.platform == "darwin" else 1e3  # bytes there, kB elsewhere
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit


def now() -> tuple[float, float]:
    """Wall clock and this process's CPU clock, s."""
    return time.perf_counter(), time.process_time()


def seconds(what: str, start: tuple[float, float], end: tuple[float, float]) -> dict[str, float]:
    return {f"{what} s": end[0] - start[0], f"{what} CPU s": end[1] - start[1]}


def measure(rows: int, particles: int, filters: int, keep: int | None, refits: int, threads: int) -> dict[str, float]:
    """Run one size in this process."""
    import torch
    from planar_paper import paper_problem

    from invdyn.inference import SMCOptions, backward_simulation, outer_weights, run_filters
    from invdyn.inference.smc import adapted_smoother

    torch.set_num_threads(threads)
    torch.manual_seed(0)
    small = paper_problem(0.1, seed=0, num_frames=20)
    # Once small, so that imports, derivation and the allocator's first pages are not counted.
    run_filters(small.model, small.observations, SMCOptions(2, 10, refits=0))
    before = peak_mb()
    problem = paper_problem(0.1, seed=0, num_frames=rows)
    model, observations = problem.model, problem.observations
    options = SMCOptions(filters, particles, refits=refits)
    clock = [now()]
    smoother = adapted_smoother(model, observations, options)
    clock.append(now())
    result = run_filters(model, observations, options, smoother=smoother, keep=keep)
    clock.append(now())
    out = {"T": rows, "N": particles, "M": filters, **seconds("guide", *clock[:2]), **seconds("filter", *clock[1:])}
    if keep is not None:
        paths = backward_simulation(model, result, observations, options.num_draws, smoother=smoother)
        out |= {"smoothed rows": paths.shape[-2], **seconds("smoothing", clock[-1], now())}
    outer = outer_weights(result.log_evidence)
    return out | {
        "memory MB": peak_mb() - before,
        "peak of the process MB": peak_mb(),
        "outer ESS": outer.ess,
        "sd of log Ẑ": outer.spread,
    }


def measured(size: tuple[int, int, int], threads: int) -> dict[str, float]:
    """`measure` in a fresh process."""
    command = [sys.executable, "-W", "ignore", __file__, "--threads", str(threads), "--one", *map(str, size)]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def slope(x: list[float], y: list[float]) -> float:
    """Exponent b of y ∝ x^b between the last two sizes."""
    from math import log

    return log(y[-1] / y[-2]) / log(x[-1] / x[-2])


def draw(sweeps: dict[str, list[dict[str, float]]]) -> None:
    import matplotlib
    from matplotlib.figure import Figure

    from invdyn.plots import BLUE, GREEN, GREY, STYLE, VERMILION

    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(10, 5), layout="constrained")
        axes = figure.subplots(2, 3, sharex="col", sharey="row")
        for column, (letter, rows) in enumerate(sweeps.items()):
            x = [row[letter] for row in rows]
            fixed = ", ".join(f"{other} = {rows[0][other]:g}" for other in "TNM" if other != letter)
            for place, (name, color, unit) in enumerate((("filter CPU s", BLUE, "CPU s"), ("memory MB", GREEN, "MB"))):
                panel, y = axes[place, column], [row[name] for row in rows]
                panel.loglog(x, [y[-1] * each / x[-1] for each in x], color=GREY, linewidth=0.9, dashes=(4, 2))
                panel.loglog(x, y, ".-", color=color, label=name.split()[0])
                if letter == "T" and place == 0:
                    panel.loglog(
                        x, [row["guide CPU s"] for row in rows], ".-", color=VERMILION, label="its guide, once"
                    )
                if column == 0:
                    panel.set_ylabel(unit)
                    panel.legend(loc="upper left")
            axes[0, column].set_title(f"{NAMES[letter]}   ({fixed})", loc="left")
            axes[1, column].set_xlabel(NAMES[letter])
            axes[1, column].set_xticks(x, [f"{each:g}" for each in x])
            axes[1, column].minorticks_off()
    figure.suptitle("controlled filter: time and memory; dashed: proportional", x=0.01, ha="left", fontsize=9.5)
    FIGURE.parent.mkdir(exist_ok=True)
    figure.savefig(FIGURE, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--one", type=int, nargs=3, metavar=("T", "N", "M"))
    parser.add_argument("--keep", type=int, help="rows to keep, the last ones, which are smoothed")
    parser.add_argument("--refits", type=int, default=0, help="of the guide; `invdyn infer` makes 2")
    parser.add_argument("--threads", type=int, default=1)
    arguments = parser.parse_args()
    if arguments.one:
        row = measure(*arguments.one, arguments.keep, arguments.refits, arguments.threads)
        print(json.dumps({name: round(value, 3) for name, value in row.items()}, ensure_ascii=False))
        return
    sweeps: dict[str, list[dict[str, float]]] = {}
    print("| T | N | M | filter CPU s | µs a particle-step | guide CPU s | memory MB |\n|---|---|---|---|---|---|---|")
    for letter, sizes in SWEEPS.items():
        sweeps[letter] = []
        for size in sizes:
            row = measured(size, arguments.threads)
            sweeps[letter].append(row)
            each = 1e6 * row["filter CPU s"] / (row["T"] * row["N"] * row["M"])
            cells = f"{row['filter CPU s']:.2f} | {each:.2f} | {row['guide CPU s']:.2f} | {row['memory MB']:.0f}"
            print(f"| {row['T']} | {row['N']} | {row['M']} | {cells} |", flush=True)
    for letter, rows in sweeps.items():
        x = [row[letter] for row in rows]
        time_, memory = (slope(x, [row[name] for row in rows]) for name in ("filter CPU s", "memory MB"))
        print(
            f"\n{NAMES[letter]}: from {x[-2]} to {x[-1]}, time grows as {letter}^{time_:.2f}, "
            f"memory as {letter}^{memory:.2f}"
        )
    draw(sweeps)
    print(f"\n{FIGURE.relative_to(Path.cwd()) if FIGURE.is_relative_to(Path.cwd()) else FIGURE}")


if __name__ == "__main__":
    main()
