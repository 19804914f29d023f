"""Torques of joints, with their intervals, in NWB files (Neurodata Without Borders), next to the pose they come from.

    processing/<trial>/<joint>_torque, …_q05, …_q95    TimeSeries (T,), N·m or N: median, 5 and 95 % quantile
    processing/<trial>/<trial>_pose                    PoseEstimation (ndx-pose) of the keypoints

Times are the recording's, s. A file of NWB needs the date of its session, which no recording here tells: it is 1970.
Written by pynwb, which checks it; read back, the pose is a recording again (:mod:`.nwb_pose`).

https://nwb-schema.readthedocs.io, https://github.com/rly/ndx-pose
"""

from collections.abc import Collection, Mapping, Sequence
from datetime import UTC, datetime
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from ..atomic import atomic_path
from ..errors import InputError
from ..recording import Recording

Moments = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, Sequence[str], Collection[str]]
"""Time (T,), median, q05, q95 (T, K), K joints, and those of them that shift: as of :func:`.write_moments`."""


def check_nwb(path: str | Path) -> None:
    """Raise InputError where the libraries that write it are missing."""
    if not (find_spec("pynwb") and find_spec("ndx_pose")):
        raise InputError(f"{path}: .nwb needs `pip install 'invdyn[tracks]'`; .csv has the same torques")


def write_nwb(path: str | Path, torques: Mapping[str, Moments], recordings: Mapping[str, Recording]) -> None:
    """Write torques by trial, and the keypoints of the recordings that have some, of the same names.

    Raises InputError without the libraries, or for a name with / or : in it; OSError where it cannot be written.
    """
    check_nwb(path)
    if wrong := [name for name in torques if set("/:") & set(name)]:
        raise InputError(f"{path}: expected a name without / and :, got {wrong[0]!r}")
    import pynwb
    from ndx_pose import PoseEstimation, PoseEstimationSeries

    unknown = datetime.fromtimestamp(0, UTC)
    file = pynwb.NWBFile(
        session_description="Torques by invdyn; the date is not known",
        identifier=", ".join(torques),
        session_start_time=unknown,
    )
    for trial, (time, median, q05, q95, joints, shifting) in torques.items():
        module = file.create_processing_module(name=trial, description="Joint torques, and their pose")
        first = None  # the others link to its times
        for suffix, values in (("", median), ("_q05", q05), ("_q95", q95)):
            for k, joint in enumerate(joints):
                series = pynwb.TimeSeries(
                    name=f"{joint}_torque{suffix}",
                    data=values[:, k],
                    unit="N" if joint in shifting else "N·m",
                    timestamps=time if first is None else first,
                    description=f"{suffix.removeprefix('_') or 'median'} of the posterior",
                )
                module.add(series)
                first = first or series
        known = recordings.get(trial)
        if known is not None and known.keypoint_names:
            unit = {"m": "meters", "px": "pixels"}.get(known.length_unit, known.length_unit)
            points = [
                PoseEstimationSeries(
                    name=name,
                    data=known.keypoints[:, p],
                    reference_frame="the recording's own",
                    unit=unit,
                    timestamps=known.time,
                )
                for p, name in enumerate(known.keypoint_names)
            ]
            module.add(PoseEstimation(name=f"{trial}_pose", pose_estimation_series=points))
    with atomic_path(path) as temporary, pynwb.NWBHDF5IO(str(temporary), "w") as store:
        store.write(file)
