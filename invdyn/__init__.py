"""invdyn: joint torques, with their uncertainty, from the keypoints that a camera tracks."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd

    from invdyn.diagnosis import Diagnosis
    from invdyn.inference.study.study import Study
    from invdyn.models import Body

# Threads that wait must sleep: spinning, they halve the speed of all other work on a shared machine, and of ours.
# OpenMP reads this when torch is loaded, so it has no effect where torch came first.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

ROOMS = ("recordings", "models", "inference", "diagnosis", "blindcheck")

if _missing := [room for room in ROOMS if not (Path(__file__).parent / room).is_dir()]:
    # A checkout without symbolic links has short text files in their place, and what is installed from it has nothing.
    raise ImportError(
        f"invdyn/{_missing[0]} should be a link to ../{_missing[0]}, but this checkout has no symbolic links: "
        "set 'git config core.symlinks true' and check out again, or install the wheel"
    )


def trials(
    table: "str | Path | pd.DataFrame",
    body: "str | Path | Body | None" = None,
    *,
    method: str = "laplace",
    workers: int | str | None = None,
    **options: Any,
) -> "Study":
    """Infer many trials, sharing within sessions: torques, tables, averages, differences between conditions.

    Args:
        table: a .csv or a data frame, one row a trial, with columns recording, subject, session, condition, event_…;
            or a folder of recordings (:mod:`.study_table` lists all columns).
        body: a body, or its file; None where the table has bodies, or ``height``, ``mass`` and ``sex`` are given.
        method: a key of ``METHODS``.
        workers: processes, or a Dask scheduler's address; the result is the same to the bit.
        options: those of the command by name, such as ``units``, ``fps``, ``seed``, ``checkpoint``.

    Returns the study: its ``table``, ``summary()``, ``difference("condition")``, ``plot(align="touch")`` and ``save``.
    Raises InputError for a table that cannot be used; a trial that cannot is named in ``reasons`` and left out.
    """
    from .study_commands import run_trials

    return run_trials(table, body, method=method, workers=workers, **options)


def diagnose(log: Any, robot: Any, *, mapping: str | Path | None = None, **options: Any) -> "Diagnosis":
    """Find where a robot's log and its simulation differ, and why.

    Args:
        log: a log's file, a :class:`~invdyn.recordings.Recording`, or a list of either.
        robot: its simulation: a file, a body, a ``mujoco.MjSpec`` or a ``mujoco.MjModel``, which stays as it is.
        mapping: which column of the log is which joint's (``--map``); of files alone.
        options: of files, those of the command by name, such as ``held_out``, ``exclude`` and ``workers``; of
            recordings, those of :func:`invdyn.diagnosis.diagnose`.

    Raises InputError for a log that cannot be used, BodyError for a robot that cannot.
    """
    from .robot_diagnosis import run_diagnosis

    return run_diagnosis(log, robot, mapping, options)


def corrected(diagnosis: "Diagnosis", robot: Any, log: Any = None, *, mapping: str | Path | None = None) -> Any:
    """A copy of a robot's simulation with the numbers that a diagnosis of it found.

    Args:
        diagnosis: of a robot's log, by :func:`diagnose`.
        robot: the ``mujoco.MjSpec`` or ``MjModel``, of which the copy is another, or an MJCF file, which gives a spec.
        log, mapping: as in :func:`diagnose`; replays of the log then refine what the regression found.

    A number that the copy cannot say is a warning (UserWarning). Without a cause the copy is the original.
    Raises InputError and BodyError as :func:`diagnose` does.
    """
    from .robot_diagnosis import corrected_robot

    return corrected_robot(diagnosis, robot, log, mapping)
