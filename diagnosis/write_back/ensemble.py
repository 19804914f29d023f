"""What to do with a posterior: copies of the simulation's file drawn from it, and ranges to randomise a simulation in.

A member takes a cause by its probability, and all of that cause's numbers from one draw of their joint posterior:
damping and armature that only their sum is known of stay together. Its file is written as the corrected copy is.

    robot_000.xml, robot_001.xml, …    the members; one without a cause is the file as it was
    randomisation.json                 each number's mean, sd and central 90 % range, and the correlations; the same as
                                       fields of a `mujoco.mjx.Model` (MuJoCo Playground's `randomize`) and as terms of
                                       Isaac Lab's `EventManager`

A number of which the log says nothing keeps the width of its prior, and is listed as such.
"""

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from invdyn.diagnosis.assessment.result import Cause, Change, Diagnosis, Estimate, Finding, Learned
from invdyn.diagnosis.rules import FIXED
from invdyn.diagnosis.write_back.changes import Correction, FileChange, Refined, correction, in_files
from invdyn.diagnosis.write_back.write_back import rewritten
from invdyn.models import ArticulatedBody
from invdyn.models.bodies import body_xml
from invdyn.models.bodies.whole_file import read_whole
from invdyn.recordings import InputError, atomic_path, write_text

Copy = tuple[bytes, Sequence[FileChange], dict[str, str]]
"""A member's file, what it changes, and what it could not: words → why."""
MJX = {
    "damping": "dof_damping",
    "friction": "dof_frictionloss",
    "armature": "dof_armature",
    "stiffness": "jnt_stiffness",
    "mass": "body_mass",
    "payload": "body_mass",
    "servo gain": "actuator_gainprm",
    "torque": "dof_frictionloss",
    "tendon stiffness": "tendon_stiffness",
    "tendon damping": "tendon_damping",
    "tendon force": "tendon_frictionloss",
}
"""Fields of a compiled model that a number is in."""
ISAAC_LAB = {
    "friction": ("randomize_joint_parameters", "friction_distribution_params"),
    "armature": ("randomize_joint_parameters", "armature_distribution_params"),
    "mass": ("randomize_rigid_body_mass", "mass_distribution_params"),
    "payload": ("randomize_rigid_body_mass", "mass_distribution_params"),
    "servo gain": ("randomize_actuator_gains", "stiffness_distribution_params"),
}
"""Terms of `isaaclab.envs.mdp`, and the parameter of each that has the range; its joints have no damping of their own.

Friction is in N·m from Isaac Sim 5 on, and a coefficient before.
"""
RELATIVE = {"servo gain": "scale", "motor gain": "scale", "actuator factor": "scale", "payload": "add"}
"""How a number acts that is no value of its own."""


def check_ensemble(members: int) -> None:
    """Raise InputError for no usual number of members."""
    if not 1 <= members <= FIXED.max_members:
        raise InputError(f"expected from 1 to {FIXED.max_members} members of an ensemble, got {members}")


def drawn(diagnosis: Diagnosis, members: int, seed: int) -> list[Cause | None]:
    """Causes whose numbers are those of one draw each; None for the file as it was. The same for a seed."""
    rng = np.random.default_rng([seed, members])
    causes = [c for c in diagnosis.causes if c.probability + c.in_part > 0] if diagnosis.gap.detected else []
    weights = np.array([c.probability + c.in_part for c in causes])
    if diagnosis.regressed is not None:
        causes, weights = [diagnosis.regressed], np.ones(1)
    found: list[Cause | None] = []
    for _ in range(members):
        pick, place = rng.random(), int(rng.integers(2**31))
        if not len(weights):
            found.append(None)
            continue
        cause = causes[int(np.searchsorted(np.cumsum(weights / weights.sum()), pick).clip(0, len(causes) - 1))]
        found.append(_member(cause, place) if _says(cause) else None)
    return found


def copies(
    diagnosis: Diagnosis, source: str | Path, body: ArticulatedBody, members: int, refined: Refined | None = None
) -> Iterator[Copy]:
    """Members as draws of ``refined`` where an output-error fit was made, else of the diagnosis' causes."""
    content = read_whole(source, body_xml.MOST_BYTES)
    corrections: list[Correction | None]
    if refined is not None:
        corrections = [Correction(refined.member(n), {}) for n in range(members)]
    else:
        causes = drawn(diagnosis, members, diagnosis.seed)
        corrections = [None if cause is None else correction(cause, body) for cause in causes]
    for wanted in corrections:
        if wanted is None:
            yield content, (), {}
            continue
        new, left = rewritten(content, source, body, wanted.changes)
        yield new, [each for each in wanted.changes if each.words not in left], left | wanted.unsaid


def write_ensemble(
    diagnosis: Diagnosis,
    source: str | Path,
    body: ArticulatedBody,
    folder: Path,
    members: int,
    refined: Refined | None = None,
) -> dict[str, Any]:
    """:func:`write_members` of :func:`copies`."""
    return write_members(diagnosis, Path(source).suffix, copies(diagnosis, source, body, members, refined), folder)


def write_members(diagnosis: Diagnosis, suffix: str, members: Iterable[Copy], folder: Path) -> dict[str, Any]:
    """Write the members and the ranges into ``folder``, which exists; gives what randomisation.json has.

    Raises OSError where they cannot be written.
    """
    every, unsaid = list[Sequence[FileChange]](), dict[str, str]()
    for number, (new, changes, left) in enumerate(members):
        with atomic_path(folder / f"robot_{number:03d}{suffix}") as temporary:
            temporary.write_bytes(new)
        every.append(changes)
        unsaid |= left
    ranges = randomisation(diagnosis, every, unsaid)
    write_text(folder / "randomisation.json", json.dumps(ranges, indent=1, ensure_ascii=False) + "\n")
    return ranges


def randomisation(
    diagnosis: Diagnosis, members: Sequence[Sequence[FileChange]], unsaid: dict[str, str]
) -> dict[str, Any]:
    """Ranges of the numbers that any member changes; one that a member leaves is the file's own there."""
    named = {(each.place, each.quantity): each for changes in members for each in changes}
    columns = {
        key: np.array(
            [next((c.after for c in changes if (c.place, c.quantity) == key), each.before) for changes in members]
        )
        for key, each in named.items()
    }
    numbers = [_range(named[key], values) for key, values in columns.items()]
    whole = [values for values in columns.values() if np.isfinite(values).all()]
    moving = [values for values in whole if values.std() > 0]
    return {
        "recording": diagnosis.recording,
        "body": diagnosis.body,
        "members": len(members),
        "numbers": numbers,
        "correlation": np.corrcoef(moving).round(4).tolist() if len(moving) > 1 else [],
        "correlated": [
            f"{n['quantity']} of {n['place']}"
            for n, values in zip(numbers, columns.values(), strict=True)
            if len(moving) > 1 and np.isfinite(values).all() and values.std() > 0
        ],
        "not_told_by_the_log": _not_identified(diagnosis),
        "not_in_the_files": unsaid,
        "mjx": [_mjx(n) for n in numbers if n["quantity"] in MJX],
        "isaac_lab": [_isaac_lab(n) for n in numbers if n["quantity"] in ISAAC_LAB],
    }


def _says(cause: Cause) -> bool:
    return bool(cause.effects) or any(map(in_files, cause.learned))


def _member(cause: Cause, place: int) -> Cause:
    """A cause with each estimate at one of its draws."""

    def at(e: Estimate) -> Estimate:
        return replace(e, mean=float(e.draws[place % len(e.draws)])) if len(e.draws) else e

    def change(own: Change) -> Change:
        return replace(own, after=at(own.after))

    def finding(own: Finding) -> Finding:
        parameters = {name: at(e) for name, e in own.parameters.items()}
        return replace(own, parameters=parameters, changes={name: change(c) for name, c in own.changes.items()})

    def learned(own: Learned) -> Learned:
        return replace(own, change=change(own.change))

    return replace(cause, effects=tuple(map(finding, cause.effects)), learned=tuple(map(learned, cause.learned)))


def _range(change: FileChange, values: np.ndarray) -> dict[str, Any]:
    unlimited = int((~np.isfinite(values)).sum())  # members whose motor the file gives no limit
    values = values[np.isfinite(values)]
    low, high = np.quantile(values, [0.05, 0.95])
    return {
        "place": change.place,
        "quantity": change.quantity,
        "unit": change.unit,
        "file": change.before if np.isfinite(change.before) else None,
        "mean": float(values.mean()),
        "sd": float(values.std()),
        "range_90": [float(low), float(high)],
        "operation": RELATIVE.get(change.quantity, "abs"),
        **({"members_without_a_limit": unlimited} if unlimited else {}),
    }


def _not_identified(diagnosis: Diagnosis) -> list[str]:
    """Numbers of the causes that the log says nothing of: as wide as the prior."""
    found: dict[str, None] = {}
    for cause in diagnosis.causes:
        every = [(f"{f.key}.{name}", e) for f in cause.effects for name, e in f.parameters.items()]
        every += [(f"{own.quantity} of {own.place}", own.change.after) for own in cause.learned]
        found |= dict.fromkeys(name for name, e in every if e.narrowed > FIXED.min_unknown_share)
    return list(found)


def _mjx(number: dict[str, Any]) -> dict[str, Any]:
    return {
        "field": MJX[number["quantity"]],
        "name": number["place"],
        "operation": number["operation"],
        "distribution": "uniform",
        "range": number["range_90"],
    }


def _isaac_lab(number: dict[str, Any]) -> dict[str, Any]:
    func, key = ISAAC_LAB[number["quantity"]]
    asset = "body_names" if "mass" in func else "joint_names"
    return {
        "func": f"isaaclab.envs.mdp.{func}",
        "mode": "startup",
        "params": {
            "asset_cfg": {"name": "robot", asset: [number["place"]]},
            key: number["range_90"],
            "operation": number["operation"],
            "distribution": "uniform",
        },
    }
