"""How often "at least x % of the missing torque is explained" holds on rows that nobody has seen.

A regression of the first two thirds of a recording states what share of the missing torque it explains, with a 90 %
interval. The last third then says what share a fit to all rows before it explains there. A lower bound should hold in
95 of 100.

    python benchmarks/closing_calibration.py [--files FOLDER] [--real N] [--engine mujoco]

On the recordings of `board`, or on N cases of the kind as real, from seed 7000 on, which also count what the regression
names: the odd effects, and those at all places. Needs `INVDYN_DATA` without ``--real``.
"""

import argparse
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from board import ROBOTS, recordings

from invdyn.blindcheck.cases import make_case
from invdyn.blindcheck.judge import as_real
from invdyn.blindcheck.measures import median, rate
from invdyn.diagnosis.regression.regress import regress
from invdyn.models import Body
from invdyn.recordings import InputError, Recording

SHARE = 2 / 3


def stated_and_seen(recording: Recording, body: Body, passive: bool) -> tuple[float, float, float] | None:
    """Lower and upper end of the interval that the first rows give, and the share of the last rows."""
    rows = len(recording.time)
    first, last = recording.at(slice(0, int(SHARE * rows))), recording.at(slice(int(SHARE * rows), rows))
    try:
        said = regress(first, body, passive=passive, rules=ROBOTS)
        then = regress(first, body, passive=passive, rules=ROBOTS, held_out=last)
    except InputError:
        return None
    return None if said is None or then is None else (*said.torque.interval_90, then.torque.share)


def given(folder: Path | None) -> Iterator[tuple[str, tuple[Recording, Body, bool]]]:
    """The board's recordings; their names begin with that of their robot."""
    for name, made in recordings(folder).items():
        yield name.partition("-")[0], made()[0]


def real(count: int, engine: str) -> Iterator[tuple[str, tuple[Recording, Body, bool]]]:
    """Cases as real; prints what a regression of the whole recording says of each, and of all."""
    closed, named, usual = [], [], []
    for seed in range(7000, 7000 + count):
        case = make_case(seed, "as_real", engine=engine)
        found = regress(case.recording, case.body, rules=ROBOTS, held_out=case.other)
        if found is not None:
            said = {"closing": {"shown": "regression", "torque": {"regression": {"closed": found.torque.share}}}}
            stated = [{"effect": each.effect, "places": each.places} for each in found.stated]
            score = as_real(case.answer, said | {"regression": {"statements": stated}, "causes": []}, [])
            closed.append(found.torque.share)
            named += list(zip([each["effect"] for each in case.answer["effects"]], score["named"], strict=True))
            usual.append(score["usual"])
        yield engine, (case.recording, case.body, False)
    for each in (median("torque closed", closed), rate("odd effects named", [hit for _, hit in named])):
        print(f"{engine}: {each.name} {each.value:.2f} ({each.low:.2f}–{each.high:.2f}) of {each.n}")
    print(f"{engine}: effects at all places named {np.mean(usual):.2f}; odd ones: {named}")


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--files", type=Path, help="folder with state_4.json and data_measured.csv")
    arguments.add_argument("--real", type=int, default=0, help="cases as real, in place of recordings")
    arguments.add_argument("--engine", default="mujoco")
    asked = arguments.parse_args()
    torch.set_num_threads(1)
    warnings.simplefilter("ignore")
    found: dict[str, list[tuple[float, float, float]]] = {}
    for robot, (recording, body, passive) in real(asked.real, asked.engine) if asked.real else given(asked.files):
        if (each := stated_and_seen(recording, body, passive)) is not None:
            found.setdefault(robot, []).append(each)
    print("| recordings | stated, at least | closed then | bound holds | interval holds |\n|---|---|---|---|---|")
    for robot, rows in {**found, "all": [row for each in found.values() for row in each]}.items():
        low, high, then = np.transpose(rows)
        middle = [f"{np.median(column):.2f}" for column in (low, then)]
        holds = [int((then >= low).sum()), int(((low <= then) & (then <= high)).sum())]
        print(f"| {robot} | {' | '.join(middle)} | {holds[0]} of {len(rows)} | {holds[1]} of {len(rows)} |")


if __name__ == "__main__":
    main()
