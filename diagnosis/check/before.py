"""What is asked before a diagnosis begins, in a second: whether the recording is what it says it is.

A unit or a sign that is wrong, and columns that are exchanged, look like no effect: they are refused where they are
sure. A gear, a zero or an offset may be a true one, such as a motor's gain: a line says so, and the diagnosis goes on.
"""

import warnings

from invdyn.diagnosis.check.check import Wrong, check
from invdyn.diagnosis.check.units import check_units
from invdyn.diagnosis.problem.conventions import MISSED, NEAR, SIGNS
from invdyn.models import ArticulatedBody
from invdyn.recordings import InputError
from invdyn.recordings.reading import Reading

MAY_BE = {"scale": "a motor's gain", "zero": "another zero of the robot", "offset": "a constant torque"}
"""Kinds that an effect looks like, and what it would be."""


def check_before(reading: Reading, body: ArticulatedBody, passive: bool = False) -> None:
    """Raise InputError for what is surely a mistake; warn of one that is not sure, or may be an effect.

    Surely: the torques miss a fifth of their size or more, and less than a third of that once it is put right.
    """
    check_units(reading, body)
    found = check(reading, body, passive=passive, effects=False).mistakes
    if not found or found[0].kind == "refused":
        return
    wrong, unless = found[0], ""
    said = f"{reading.recording.name}: {wrong.sentence}"
    if wrong.kind in MAY_BE:
        unless = f", unless it is {MAY_BE[wrong.kind]}"
    elif _sure(wrong, body):
        raise InputError(f"{said}; `invdyn check` says more")
    warnings.warn(f"{said}{unless}; `invdyn check` says more", stacklevel=2)


def _sure(wrong: Wrong, body: ArticulatedBody) -> bool:
    """As :mod:`..problem.conventions` is: of signs only under gravity."""
    told = wrong.kind not in SIGNS or bool(body.parameters().gravity.any())
    return told and wrong.before >= MISSED and wrong.after <= min(NEAR * wrong.before, MISSED)
