"""What is tested before a diagnosis begins, in a second: whether the recording is what it says it is.

One rule decides: a mistake that is sure is refused, any other is said in a line. It is not sure where an effect of the
catalogue, of a size that its prior expects, looks like it (:func:`_looks_like`): to tell those two apart is what a
diagnosis is for.
"""

import warnings
from collections.abc import Collection, Sequence

import numpy as np

from invdyn.diagnosis.check.check import Wrong, check, rows_of
from invdyn.diagnosis.check.units import wrong_size
from invdyn.diagnosis.problem.conventions import refuse
from invdyn.diagnosis.rules import DEFAULT, Rules
from invdyn.models import ArticulatedBody
from invdyn.recordings import Recording
from invdyn.recordings.pace import check_interval
from invdyn.recordings.reading import Reading

SIGNS = ("torque sign", "direction", "angle sign")
NOT_SURE = ("held",)
"""Mistakes of rows that cost precision, and mislead nobody."""
OF_FILE = ("gain",)
"""Mistakes of the robot's file, which a diagnosis corrects."""


def check_before(
    recording: Recording | Reading,
    body: ArticulatedBody,
    passive: bool = False,
    force: bool = False,
    rules: Rules = DEFAULT,
) -> tuple[str, ...]:
    """Raise InputError for what is certainly a mistake; warn of one that is not sure, or may be an effect.

    By ``force`` nothing is raised: what would be is warned of, and returned.

    Certain are numbers that are the body's in another unit, or torques that miss a fifth of their size or more, and
    less than a third of that once the mistake is put right. Numbers that no other unit makes plausible are refused
    where a `Reading` says what was declared. A `Recording` is in SI units by its own account, so a warning says it.

    A servo's gain in the robot's file is none of the recording's mistakes, and is warned of.

    Each mistake is found with those before it put right. So the first alone can be sure: if it is none, but an effect,
    the others may be none either, and are said. So are torques far from the motion of encoders that nothing explains.
    """
    checked = check(recording, body, passive=passive, effects=False, rules=rules)
    found, refused = checked.mistakes, list[str]()
    given = recording if isinstance(recording, Recording) else recording.recording
    implausible = [wrong for wrong in found if wrong.kind == "refused"]
    for wrong in implausible:
        if isinstance(recording, Reading):
            refused.append(refuse(f"{given.name}: {wrong.words}", force))
            continue
        warnings.warn(f"{given.name}: {wrong.words}", stacklevel=2)
    refused += _by_size(given.name, [wrong for wrong in found if wrong.by_size and wrong not in implausible], force)
    for n, wrong in enumerate([wrong for wrong in found if not wrong.by_size]):
        said, effect = f"{given.name}: {'then ' * (n > 0)}{wrong.sentence}", _looks_like(wrong, body, rules)
        if wrong.kind not in OF_FILE and _sure(wrong, body, rules) and effect is None and n == 0:
            refused.append(refuse(f"{said}; `invdyn check` says more", force))
            continue
        warnings.warn(f"{said}{f', unless it is {effect}' if effect else ''}; `invdyn check` says more", stacklevel=2)
    if checked.unclear and given.angles is not None:  # a film's accelerations are too noisy to tell
        warnings.warn(
            f"{given.name}: the torques miss {100 * (checked.unexplained or 0.0):.0f} % of their size, and no sign, "
            "zero, unit, column or gear explains it: an effect may, or the log is not this body's; "
            "`invdyn check` says more",
            stacklevel=2,
        )
    if checked.doubt is not None:
        warnings.warn(f"{given.name}: {checked.doubt}", stacklevel=2)
    return tuple(refused)


def check_numbers(
    recording: Recording, reach: float, shifting: Collection[str], force: bool = False, rules: Rules = DEFAULT
) -> tuple[str, ...]:
    """The same of a simulation without equations of motion here, ``reach`` m large: rows, units and the clock alone.

    Joints of ``shifting`` are in m. Numbers that are too large for their unit are warned of, as a wheel's angle may be.
    """
    found = wrong_size(recording, shifting, lambda: check_interval(recording, reach))
    if found is not None:
        warnings.warn(f"{recording.name}: {found}", stacklevel=2)
    return _by_size(recording.name, rows_of(Reading(recording), rules)[0], force)


def _by_size(name: str, found: Sequence[Wrong], force: bool) -> tuple[str, ...]:
    """Refuse what the numbers alone say for certain, and warn of the rest."""
    for wrong in (each for each in found if each.kind in NOT_SURE):
        warnings.warn(f"{name}: {wrong.sentence}; `invdyn check` says more", stacklevel=3)
    if not (sure := [wrong for wrong in found if wrong.kind not in NOT_SURE]):
        return ()
    what = ", and ".join(f"{wrong.words}, it seems: {wrong.remedy}" for wrong in sure)
    return (refuse(f"{name}: {what}; `invdyn check` says more", force),)


def _looks_like(wrong: Wrong, body: ArticulatedBody, rules: Rules) -> str | None:
    """The effect that a mistake may be. None is like a gear: no motor gives twice its command, or more."""
    if wrong.kind == "scale" and rules.check.min_motor_limit < wrong.value < 1:
        return "a motor at its limit"
    if wrong.kind == "offset":
        return "a spring's torque, a stop's, or a shifted marker"
    if wrong.kind == "zero" and wrong.joints == body.joint_names[:1] and abs(wrong.value) < rules.check.max_tilt:
        return "gravity that is tilted"
    return None


def _sure(wrong: Wrong, body: ArticulatedBody, rules: Rules) -> bool:
    """Whether a mistake is far larger than what it leaves. Of signs only under gravity; a gear has a gear's size."""
    sure = rules.check.sure_misfit
    certain = wrong.kind not in SIGNS or bool(body.parameters().gravity.any())
    certain &= wrong.kind != "scale" or wrong.value < rules.check.max_gear
    # no effect and no numbers of a body make up for a sign
    size = np.fmax(wrong.before, wrong.misfit) if wrong.kind in SIGNS else wrong.before
    return certain and size >= sure and wrong.after <= min(rules.check.sure_remaining * size, sure)
