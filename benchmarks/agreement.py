"""Do two versions of invdyn give the same answers on eighteen recordings and models?

    INVDYN_DATA=… python benchmarks/agreement.py before.json                          with the older version
    INVDYN_DATA=… python benchmarks/agreement.py after.json --against before.json     with the newer one

A case is a chain of commands in an empty folder. Its answer is every number that the commands write: means and standard
deviations over the draws of a posterior, log evidence, the JSON of a diagnosis, tables. A difference is divided by the
largest number of its variable. Equal arithmetic gives 1e-9 or less, other arithmetic gives Monte Carlo error.

INVDYN_DATA names the folder of real recordings; small public cases are in the folder ``cases`` next to it.
"""

import argparse
import csv
import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

DATA = Path(os.environ.get("INVDYN_DATA", ".")).resolve()
CASES = DATA.parent / "cases"

SMALL = "--filters 4 --particles 50 --seed 1"
LAPLACE = "--method laplace --out p.nc"
TRC = f"{CASES}/11-trc-of-a-planar-tracker"
MOT = f"{CASES}/112-mot-degrees-with-a-slide"
REF = f"{CASES}/101-mjcf-joint-ref"
GEAR = f"{CASES}/102-mjcf-servo-gear"
BAG = f"{CASES}/107-bag-first-stamp-zero"


def simulated(body: str, seconds: float, seed: int, more: str = "") -> str:
    """The command that simulates a recording."""
    return f"simulate --body {body} --out r.csv --duration {seconds} --seed {seed} {more}"


CHAINS: dict[str, list[str]] = {
    "plane-smc": [
        simulated("paper_planar_arm", 2, 3),
        f"infer r.csv --body paper_planar_arm --out p.nc {SMALL}",
    ],
    "plane-laplace": [
        simulated("paper_planar_arm", 2, 3),
        f"infer r.csv --body paper_planar_arm {LAPLACE}",
    ],
    "plane-compare": [
        simulated("paper_planar_arm", 1, 4),
        f"compare r.csv --body paper_planar_arm --methods smc,bootstrap --out c {SMALL}",
    ],
    "plane-diagnose": [
        simulated("dfki_design_a0", 3, 5, "--commanded"),
        "diagnose r.csv --body dfki_design_a0 --out d --max-effects 1 --workers 1",
    ],
    "human-arm": [f"infer human-arm --body human_arm_on_table --scale body --frames 50:150 --out p.nc {SMALL}"],
    "ibm": [f"infer ibm-0 --body ibm.toml --zero-torque --frames 0:200 {LAPLACE}"],
    "dfki-check": ["check dfki_design_a0 dfki-trajectory-02 --out c.json --no-effects"],
    "trc": [f"infer {TRC}/arm.trc --body {TRC}/arm.toml {LAPLACE}"],
    "mot": [f"infer {MOT}/degrees.mot --body {MOT}/cart.toml {LAPLACE}"],
    "space-smc": [
        simulated("paper_spatial_arm", 1.5, 6),
        f"infer r.csv --body paper_spatial_arm --out p.nc {SMALL}",
    ],
    "space-diagnose": [
        simulated("paper_spatial_arm", 2, 7, "--commanded"),
        "diagnose r.csv --body paper_spatial_arm --out d --max-effects 1 --workers 1",
    ],
    "log-diagnose": [
        f"diagnose {REF}/log.csv --map {REF}/map.toml --body {REF}/arm.xml --frames :300 --out d"
        " --max-effects 1 --workers 1"
    ],
    "log-check": [f"check {GEAR}/arm.xml {GEAR}/log.csv --map {GEAR}/map.toml --no-effects --out c.json"],
    "bag-check": [f"check {BAG}/arm.xml {BAG}/from_zero --no-effects --out c.json"],
    "cameras": [
        "triangulate cam01=cam01.csv cam02=cam02.csv --out r.csv --fps 60"
        f" --calibration {DATA}/multiview_walker/Calib.qca.txt"
    ],
    "film": [f"track {DATA}/sports2d/demo.mp4 --tracker left --out t.csv"],
    "generic-normal": [f"compare-model normal.py:Level rows.csv --methods smc,bootstrap,laplace --out c {SMALL}"],
    "generic-poisson": [f"compare-model poisson.py:Level rows.csv --methods smc,bootstrap --out c {SMALL}"],
}

MODEL = """
import torch, pyro.distributions as dist
from invdyn.models.state_space import StateSpaceModel

class Level(StateSpaceModel):
    state_dim = 1
    observation_dim = 1
    num_steps = 20

    def initial(self):
        return dist.Normal(torch.zeros(1), torch.ones(1)).to_event(1)

    def transition(self, state, t):
        return dist.Normal(0.9 * state, 0.5).to_event(1)

    def emission(self, state, t):
        return dist.EMISSION.to_event(1)
"""

LINK = '[[links]]\nname = "{}"\njoint = "{}"\ntip = "{}"\nlength = {}\nmass = {}\n'

GIVEN = {
    "normal.py": MODEL.replace("EMISSION", "Normal(state, 0.7)"),
    "poisson.py": MODEL.replace("EMISSION", "Poisson(state.exp())"),
    "rows.csv": "y\n" + "\n".join("01021321001243101120") + "\n",
    "ibm.toml": 'name = "ibm"\n'
    + LINK.format("first", "shoulder", "elbow", 0.091, 0.02)
    + LINK.format("second", "elbow", "wrist", 0.07, 0.015),
}


def given() -> dict[str, str]:
    """Files that the chains read, by name; tracks of the walker have confidences under another name."""
    walker = DATA / "multiview_walker"
    cameras = {name: (walker / f"{name}_mediapipe2d.csv").read_text("utf-8") for name in ("cam01", "cam02")}
    return GIVEN | {f"{name}.csv": text.replace("_vis", "_likelihood") for name, text in cameras.items()}


def answer(chain: list[str]) -> dict[str, Any]:
    """Run a chain; return its numbers by name and its seconds of CPU, or what it says where it fails."""
    with tempfile.TemporaryDirectory() as name:
        folder, files = Path(name), given()
        for file, text in files.items():
            (folder / file).write_text(text, "utf-8")
        before = os.times()
        for line in chain:
            command = [sys.executable, "-m", "invdyn", *line.split()]
            done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
            if done.returncode not in ((0, 2) if line.startswith("check") else (0,)):
                return {"failed": done.returncode, "says": done.stderr[-400:]}
        after = os.times()
        written = [path for path in sorted(folder.rglob("*")) if path.is_file() and path.name not in files]
        found = {
            f"{path.relative_to(folder)}/{key}": value
            for path in written
            if path.suffix in READERS
            for key, value in READERS[path.suffix](path)
        }
        seconds = after.children_user + after.children_system - before.children_user - before.children_system
        return {"numbers": found, "cpu_s": seconds}


def in_json(path: Path) -> Iterator[tuple[str, float]]:
    """Every number of a JSON file but times and versions."""

    def walk(value: Any, name: str) -> Iterator[tuple[str, float]]:
        if any(word in name for word in ("seconds", "second/", "version", "elapsed", "created", "cost")):
            return
        if isinstance(value, dict | list):
            for key, each in value.items() if isinstance(value, dict) else enumerate(value):
                yield from walk(each, f"{name}/{key}")
        elif isinstance(value, int | float) and not isinstance(value, bool):
            yield name, value

    return walk(json.loads(path.read_text("utf-8")), "")


def in_posterior(path: Path) -> Iterator[tuple[str, float]]:
    """Mean and standard deviation of each variable over its draws; some forty entries of each."""
    import arviz

    data = arviz.from_netcdf(path)
    for group in data.groups():
        for key, variable in data[group].data_vars.items():
            if variable.dtype.kind not in "fi" or "second" in key:
                continue
            dims = [dim for dim in ("chain", "draw", "filter") if dim in variable.dims]
            for what, values in (("mean", variable.mean(dims)), ("sd", variable.std(dims))):
                flat = np.asarray(values, float).reshape(-1)
                for place in range(0, flat.size, max(1, flat.size // 40)):
                    yield f"{group}/{key}/{what}/{place}", float(flat[place])


def in_table(path: Path) -> Iterator[tuple[str, float]]:
    """Numbers of every fifth row of a CSV file."""
    with path.open(encoding="utf-8") as file:
        for place, row in enumerate(csv.DictReader(line for line in file if not line.startswith("#"))):
            for key, text in row.items() if place % 5 == 0 else ():
                if "second" not in str(key) and "memory" not in str(key):
                    with suppress(TypeError, ValueError):
                        yield f"{place}/{key}", float(text)


READERS = {".json": in_json, ".nc": in_posterior, ".csv": in_table}


def difference(new: dict[str, Any], old: dict[str, Any]) -> str:
    """The largest difference of two answers, where it is, and which numbers only one of them has."""
    if "failed" in new or "failed" in old:
        both = "failed" in new and "failed" in old
        return f"{'both fail' if both else 'ONE FAILS'}: {new.get('says', old.get('says'))!r}"
    a, b = new["numbers"], old["numbers"]
    scale: dict[str, float] = {}
    for key, value in b.items():
        variable = key.rpartition("/")[0]
        scale[variable] = max(scale.get(variable, 1e-12), abs(value) if math.isfinite(value) else 0.0)

    def off(key: str) -> float:
        if (math.isnan(a[key]) and math.isnan(b[key])) or abs(a[key] - b[key]) < 1e-10:
            return 0.0
        return abs(a[key] - b[key]) / scale[key.rpartition("/")[0]]

    shared = sorted(a.keys() & b.keys())
    worst = max(shared, key=off, default="")
    text = f"{len(shared)} numbers"
    if worst:
        text += f", largest difference {off(worst):.2g} in {worst}: {b[worst]!r}, now {a[worst]!r}"
    for what, keys in (("gone", b.keys() - a.keys()), ("new", a.keys() - b.keys())):
        if keys:
            text += f"; {len(keys)} {what}, such as {min(keys)}"
    return f"{text}; CPU s {old['cpu_s']:.1f}, now {new['cpu_s']:.1f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("answers", type=Path, help="file of answers; cases in it are not run again")
    parser.add_argument("--against", type=Path, help="answers of the other version")
    parser.add_argument("--only", nargs="+", choices=list(CHAINS), help="cases, even those that are in the file")
    options = parser.parse_args()
    answers = json.loads(options.answers.read_text("utf-8")) if options.answers.exists() else {}
    for name in options.only or CHAINS:
        if options.only or "numbers" not in answers.get(name, {}):
            answers[name] = answer(CHAINS[name])
            options.answers.write_text(json.dumps(answers, indent=1), "utf-8")
            found = answers[name]
            print(name, found.get("says") or f"{len(found['numbers'])} numbers, {found['cpu_s']:.1f} CPU s", flush=True)
    if options.against:
        before = json.loads(options.against.read_text("utf-8"))
        for name in options.only or CHAINS:
            print(f"{name}: {difference(answers[name], before[name])}")


if __name__ == "__main__":
    main()
