"""A robot's logs diagnosed from Python, with the simulation as a file, a ``mujoco.MjSpec`` or ``MjModel``."""

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .diagnosis_options import Diagnosed

if TYPE_CHECKING:
    from invdyn.diagnosis import Diagnosis


def run_diagnosis(log: Any, robot: Any, mapping: str | Path | None, options: dict[str, Any]) -> "Diagnosis":
    """What :func:`invdyn.diagnose` does."""
    from invdyn.diagnosis.diagnose import diagnose

    return diagnose(**arguments_of(log, robot, mapping, options))


def corrected_robot(diagnosis: "Diagnosis", robot: Any, log: Any, mapping: str | Path | None) -> Any:
    """What :func:`invdyn.corrected` does."""
    import mujoco

    from invdyn.diagnosis.write_back.changes import Correction, correction
    from invdyn.diagnosis.write_back.in_memory import changed_model, changed_spec
    from invdyn.diagnosis.write_back.output_error import refine
    from invdyn.diagnosis.write_back.write_back import best
    from invdyn.models import load_body

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what the robot lacks was said before the diagnosis
        body = load_body(robot, filmed=False)
        found = [] if log is None else arguments_of(log, robot, mapping, {})["recording"]
    recordings = found if isinstance(found, list) else [found]
    own = mujoco.MjSpec.from_file(str(robot)) if isinstance(robot, str | Path) else robot
    cause = best(diagnosis)
    tries = [Correction((), {}) if cause is None else correction(cause, body)]
    if cause is not None and recordings and (fit := refine(diagnosis, robot, body, recordings)) is not None:
        tries.insert(0, Correction(fit.changes, {}))
    change = changed_model if isinstance(own, mujoco.MjModel) else changed_spec
    for wanted in tries:
        new, left = change(own, body, wanted.changes)
        if not left:  # else a number would be missing from those that were fitted with it
            break
    for words, why in {**wanted.unsaid, **left}.items():
        warnings.warn(f"not changed: {words}: {why}", stacklevel=3)
    return new


def arguments_of(log: Any, robot: Any, mapping: str | Path | None, options: dict[str, Any]) -> dict[str, Any]:
    """Arguments of `diagnosis.diagnose`; ``log`` may be a recording, a file's name, or several of one of them."""
    from invdyn.recordings import InputError, Recording

    logs = list(log) if isinstance(log, list | tuple) else [log]
    recorded = {isinstance(each, Recording) for each in logs}
    if len(recorded) != 1:
        raise InputError(
            f"expected a log's file, a recording, or several of one of them, got {'both' if logs else 'none'}"
        )
    if recorded == {True}:
        if mapping is not None:
            raise InputError("a mapping is for a log's file, got a recording with it: leave it out, or give the file")
        from .inputs import load_body

        filmed = any(each.keypoint_names for each in logs)
        own = {"robot": True} | options
        return {"recording": logs if len(logs) > 1 else logs[0], "body": load_body(robot, filmed=filmed), **own}
    given = Diagnosed([str(each) for each in logs], robot, mapping=None if mapping is None else str(mapping), **options)
    given.check()
    return given.load()[0]
