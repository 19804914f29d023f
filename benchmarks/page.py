"""The page of benchmarks: runs their scripts, and puts the table that each one prints into benchmarks/README.md.

In the page a table stands between `<!-- NAME -->` and `<!-- end -->`, below a line that says which command made it, by
which commit, when, and on which machine. So whoever doubts a number runs one command, and the page has theirs.

    python benchmarks/page.py planar_paper walker     these two
    python benchmarks/page.py                         all of them: hours, on a machine that nothing else uses
"""

import datetime
import os
import platform
import re
import shlex
import subprocess
import sys
from pathlib import Path

import torch

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "benchmarks" / "README.md"
COMMANDS = {
    "planar_paper": "planar_paper.py",
    "spatial_paper": "spatial_paper.py --turned --results build/spatial_paper.jsonl",
    "spatial_paper_turned": "spatial_paper.py --noise --turned .1 .01 .003 --no-planar "
    "--results build/spatial_paper.jsonl",
    "mouse": "mouse.py --out build/mouse --shown 0:60",
    "panda": "panda.py --seconds 1 --seeds 1 --results build/panda.jsonl",
    "cost": "cost.py",
    "cost_long": "cost.py --long 1000 10000 100000 --torque ornstein_uhlenbeck",
    "users_clock": "users_clock.py",
    "live": "live.py",
    "live_seven": "live.py --minutes 10 --changes 0 --only seven",
    "calibration": "calibration.py",
    "parameter_calibration": "parameter_calibration.py",
    "gallery": "gallery.py",
    "gallery_growth": "gallery.py --growth 20",
    "gallery_peers": "gallery_peers.py",
    "against_sensors": "against_sensors.py --results build/sensors.jsonl",
    "what_is_off": "what_is_off.py",
    "what_is_off_scales": "what_is_off.py --scales",
    "reaches": "reaches.py --first 5000 --reaches 55 --smc 0 --results build/reaches.jsonl",
    "study_size": "study.py size",
    "study_coverage": "study.py coverage --studies 21 --results build/study.jsonl",
    "study_pooling": "study.py pooling",
    "study_kill": "study.py kill",
    "real_studies": "real_studies.py",
    "real_studies_mice": "real_studies.py beam --beam build/beam",
    "filters": "filters.py",
    "gpu": "gpu.py",
    "ladder": "ladder.py",
    "spatial_dynamics": "spatial_dynamics.py",
    "projection": "projection.py",
    "moving_base": "moving_base.py --seeds 2 --cases still/2 walking/2 running/2 jumping/2 bus/2 falling/2 "
    "walking/3 falling/3",
    "leg": "leg.py --seeds 4 --filters 4 --results build/leg.jsonl",
    "quadruped": "quadruped.py --method laplace --results build/quadruped.jsonl",
    "muscles": "muscles.py",
    "gait": "gait.py",
    "walker": "walker.py",
    "walker_arm": "walker_arm.py --every 3 --results build/walker_arm.jsonl",
    "simulated_cameras": 'simulated_cameras.py --cases two three four hidden clock "two, points" "four, points" '
    "--results build/simulated_cameras.jsonl",
    "tracking_dfki": "tracking.py dfki",
    "tracking_people": "tracking.py people",
    "vsmc_bound": "vsmc.py bound",
    "vsmc_learn": "vsmc.py learn",
    "diagnose_speed": "diagnose_speed.py",
    "diagnose_growth": "diagnose_speed.py --growth rows",
    "diagnose_candidates": "diagnose_speed.py --growth candidates recordings",
    "diagnose_in_space": "diagnose_in_space.py --results build/diagnose_in_space.jsonl",
    "diagnose_logs": "diagnose_logs.py",
    "ablation": "ablation.py",
    "expected_gain": "expected_gain.py --only commanded",
    "excite": "excite.py --seeds 3",
    "board": "board.py",
    "closing_calibration": "closing_calibration.py",
    "check": "check.py --seed 46000 --results build/check.jsonl",
    "robots": "robots.py --files build/robots --results build/robots.jsonl",
    "servo": "servo.py --results build/servo.jsonl",
    "write_back": "write_back.py --results build/write_back.jsonl",
    "sysid": "sysid.py --results build/sysid.jsonl --ours build/write_back.jsonl",
    "diagnose_arms": "diagnose_logs.py nothing heavy stated delay seven long",
}
"""Script and arguments of each table."""


def tables(printed: str) -> str:
    """The Markdown tables in what a script printed; where there are several, under the line before each."""
    found: list[tuple[str, list[str]]] = []
    title, within = "", False
    for line in printed.splitlines():
        if line.startswith("|"):
            if not within:
                found.append((title, []))
            found[-1][1].append(line.rstrip())
            title, within = "", True
        else:
            title, within = line.strip() or title, False
    texts = ["\n".join(rows) for _, rows in found]
    if len(found) > 1:
        texts = [f"**{title}**\n\n{text}" if title else text for (title, _), text in zip(found, texts, strict=True)]
    return "\n\n".join(texts)


def replaced(page: str, name: str, text: str) -> str:
    """The page with other text at a name's place; raises ValueError if it has no such place."""
    place = re.compile(rf"(<!-- {name} -->\n).*?(<!-- end -->)", re.DOTALL)
    if not place.search(page):
        raise ValueError(f"expected <!-- {name} --> … <!-- end --> in the page, found none")
    return place.sub(lambda found: f"{found[1]}{text}\n{found[2]}", page, count=1)


def stamp(command: str) -> str:
    """One line: command, commit, day and machine."""
    git = ("git", "-C", str(ROOT))
    commit = subprocess.run([*git, "rev-parse", "--short", "HEAD"], capture_output=True, text=True).stdout.strip()
    changed = subprocess.run([*git, "diff", "--quiet", "HEAD", "--", "*.py"], capture_output=True).returncode
    return (
        f"*`python benchmarks/{command}`, commit {commit or 'unknown'}{' with changes' if changed else ''}, "
        f"{datetime.date.today():%d %B %Y}, {machine()}, torch {torch.__version__.split('+')[0]}*"
    )


def machine() -> str:
    """The processor's name, the number of cores, and how busy they were."""
    information = Path("/proc/cpuinfo")
    reported = re.search(
        r"^model name\s*:\s*(.+)$", information.read_text() if information.exists() else "", re.MULTILINE
    )
    name = reported[1] if reported else platform.processor() or platform.machine()
    busy = f", load {os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else ""
    return f"{name}, {os.cpu_count()} cores{busy}"


def main() -> None:
    wanted = sys.argv[1:] or [name for name in COMMANDS if name != "gpu" or torch.cuda.is_available()]
    if unknown := set(wanted) - set(COMMANDS):
        sys.exit(f"no table {', '.join(sorted(unknown))}; expected any of {', '.join(COMMANDS)}")
    for name in wanted:
        said = stamp(COMMANDS[name])  # before, as the load is then that of others
        script, *options = shlex.split(COMMANDS[name])
        command = [sys.executable, str(ROOT / "benchmarks" / script), *options]
        done = subprocess.run(command, stdout=subprocess.PIPE, text=True, env={**os.environ, "OMP_NUM_THREADS": "1"})
        found = tables(done.stdout)
        if done.returncode or not found:
            sys.exit(f"{name}: no table; {COMMANDS[name]} ended with {done.returncode}")
        PAGE.write_text(replaced(PAGE.read_text("utf-8"), name, f"{said}\n\n{found}"), "utf-8")
        print(f"{name}: done", flush=True)


if __name__ == "__main__":
    main()
