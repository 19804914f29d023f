"""Torques of joints, with their intervals, in NWB files (Neurodata Without Borders), next to the pose they come from.

    processing/<trial>/<joint>_torque, …_q05, …_q95    TimeSeries (T,): median, 5 and 95 % quantile, in the unit given
    processing/<trial>/<trial>_pose                    PoseEstimation (ndx-pose) of the keypoints

A / or : in a name stands as _, as NWB allows neither. Times are the recording's, s. A file of NWB needs the date of its
session, which no recording here tells: it is 1970. Written by pynwb, which checks it; read back, the pose is a
recording again (:mod:`.nwb_pose`).

https://nwb-schema.readthedocs.io, https://github.com/rly/ndx-pose
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from datetime import UTC, datetime
from importlib.util import find_spec
from itertools import count
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


def nwb_names(names: Iterable[str]) -> list[str]:
    """Names with _ for each / and :, and a number behind one that would be the same as one before."""
    found: list[str] = []
    for name in names:
        plain = name.replace("/", "_").replace(":", "_")
        others = (f"{plain}_{number}" for number in count(2))
        found.append(plain if plain not in found else next(other for other in others if other not in found))
    return found


def write_nwb(
    path: str | Path, torques: Mapping[str, Moments], recordings: Mapping[str, Recording], unit: str = "N·m"
) -> None:
    """Write torques by trial, and the keypoints of the recordings that have some, of the same names.

    ``unit`` is that of torques; a joint that shifts has N for its N·m. Raises InputError without the libraries, OSError
    where it cannot be written.
    """
    check_nwb(path)
    import pynwb
    from ndx_pose import PoseEstimation, PoseEstimationSeries

    unknown = datetime.fromtimestamp(0, UTC)
    file = pynwb.NWBFile(
        session_description="Torques by invdyn; the date is not known",
        identifier=", ".join(torques),
        session_start_time=unknown,
    )
    for trial, (name, (time, median, q05, q95, joints, shifting)) in zip(
        nwb_names(torques), torques.items(), strict=True
    ):
        module = file.create_processing_module(name=trial, description="Joint torques, and their pose")
        first = None  # the others link to its times
        for suffix, values in (("", median), ("_q05", q05), ("_q95", q95)):
            for k, (joint, plain) in enumerate(zip(joints, nwb_names(joints), strict=True)):
                series = pynwb.TimeSeries(
                    name=f"{plain}_torque{suffix}",
                    data=values[:, k],
                    unit=unit.replace("N·m", "N") if joint in shifting else unit,
                    timestamps=time if first is None else first,
                    description=f"{suffix.removeprefix('_') or 'median'} of the posterior",
                )
                module.add(series)
                first = first or series
        known = recordings.get(name)
        if known is not None and known.keypoint_names:
            length = {"m": "meters", "px": "pixels"}.get(known.length_unit, known.length_unit)
            points = [
                PoseEstimationSeries(
                    name=point,
                    data=known.keypoints[:, p],
                    reference_frame="the recording's own",
                    unit=length,
                    timestamps=known.time,
                )
                for p, point in enumerate(nwb_names(known.keypoint_names))
            ]
            module.add(PoseEstimation(name=f"{trial}_pose", pose_estimation_series=points))
    with atomic_path(path) as temporary, pynwb.NWBHDF5IO(str(temporary), "w") as store:
        store.write(file)
