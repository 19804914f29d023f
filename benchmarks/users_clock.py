"""What a user waits for: commands in fresh processes, with nothing cached and then with all of it.

    python benchmarks/users_clock.py [--only infer,check] [--no-cold]

Cold: an empty folder for Python's bytecode and one for compiled code (`PYTHONPYCACHEPREFIX`, `NUMBA_CACHE_DIR`), as in
the first call after an installation without bytecode. Warm: the same command once more. Units: CPU s of the process
and its children (user and system, `os.wait4`); memory is the largest resident set, MB.
"""

import argparse
import os
import sys
import tempfile
from pathlib import Path

ARM = ("--body", "paper_planar_arm")
SWING = ("infer", "swing.csv", *ARM)
COMMANDS = {
    "help": ("--help",),
    "a file that is not there": ("infer", "nothing.csv", *ARM),
    "a wrong unit": (*SWING, "--units", "furlong"),
    "simulate, 84 frames": ("simulate", *ARM, "--duration", "2.52", "--out", "swing.csv", "--truth", "truth.csv"),
    "infer, 84 frames": (*SWING, "--out", "swing.nc"),
    "infer by laplace": (*SWING, "--method", "laplace", "--out", "laplace.nc"),
    "plot": ("plot", "swing.nc", "--out", "swing.png"),
    "view": ("view", "swing.nc", "--out", "swing.html"),
    "compare, 60 frames": (
        *("compare", "swing.csv", *ARM, "--set", "truth=truth.csv", "--methods", "laplace,svi"),
        *("--frames", "0:60", "--out", "compared"),
    ),
    "simulate a log of 3 s": (
        *("simulate", *ARM, "--commanded", "--fps", "100", "--duration", "3"),
        *("--out", "log.csv"),
    ),
    "check": ("check", "paper_planar_arm", "log.csv"),
    "diagnose": ("diagnose", "log.csv", *ARM, "--out", "found"),
}
"""Words of each command, in the order in which they need each other's files."""
FAIL = {"a file that is not there", "a wrong unit"}


def seconds(words: tuple[str, ...], folder: Path, environment: dict[str, str]) -> tuple[float, float, int]:
    """CPU s, largest resident set (MB) and exit status of one command in a process of its own."""
    child = os.fork()
    if not child:
        os.chdir(folder)
        silent = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silent, 1)
        os.dup2(silent, 2)
        os.execve(sys.executable, [sys.executable, "-m", "invdyn", *words], environment)
    _, status, used = os.wait4(child, 0)
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1024, os.waitstatus_to_exitcode(status)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", help="names of the table's rows, with commas; those before them must have run")
    parser.add_argument("--no-cold", action="store_true")
    options = parser.parse_args()
    wanted = options.only.split(",") if options.only else list(COMMANDS)
    usual = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
    usual |= {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}

    print("| command | cold, CPU s | warm, CPU s | warm, MB |\n|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for name in wanted:
            rows = {}
            for state in ("warm",) if options.no_cold else ("cold", "warm"):
                with tempfile.TemporaryDirectory() as empty:
                    caches = {"PYTHONPYCACHEPREFIX": empty, "NUMBA_CACHE_DIR": empty} if state == "cold" else {}
                    rows[state] = seconds(COMMANDS[name], Path(folder), usual | caches)
                if (rows[state][2] != 0) != (name in FAIL):
                    sys.exit(f"{name}: ended with {rows[state][2]}: run `invdyn {' '.join(COMMANDS[name])}` to see why")
            cold = f"{rows['cold'][0]:.2f}" if "cold" in rows else ""
            print(f"| {name} | {cold} | {rows['warm'][0]:.2f} | {rows['warm'][1]:.0f} |", flush=True)


if __name__ == "__main__":
    main()
