"""A motion to record next as files, a figure and words."""

import json
from collections import defaultdict
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from invdyn.diagnosis import Excitation
from invdyn.recordings import InputError, atomic_path, write_table, write_text

from .plots import BLUE, STYLE, save_figure

MAX_LISTED = 8
"""Numbers of a kind that are listed."""


def write_excitation(motion: Excitation, path: Path) -> None:
    """Write the motion, or what it tells, as the file's ending says.

    Raises InputError where parquet is wanted and pyarrow is not there, OSError for a file that cannot be written.
    """
    ending = path.suffix.lower()
    if ending == ".csv":
        write_table(_columns(motion), path)
    elif ending == ".yaml":
        write_text(path, _joint_trajectory(motion))
    elif ending == ".json":
        write_text(path, json.dumps(motion.to_json(), indent=1, ensure_ascii=False) + "\n")
    elif ending == ".parquet":
        _write_actions(motion, path)
    else:
        save_figure(plot_excitation(motion), path)


def _columns(motion: Excitation) -> dict[str, np.ndarray]:
    """Time, and of each joint its angle, velocity and acceleration, and the torque that the file's robot needs."""
    columns = {"time": motion.time}
    for k, joint in enumerate(motion.joints):
        for what in ("angle", "velocity", "acceleration", "torque"):
            columns[f"{joint}_{what}"] = getattr(motion, what)[:, k]
    return columns


def _joint_trajectory(motion: Excitation) -> str:
    """ROS: a message trajectory_msgs/msg/JointTrajectory, in JSON, which is YAML too."""
    points = []
    for row, time in enumerate(motion.time):
        seconds = int(time)
        nanoseconds = round(1e9 * (time - seconds))
        points.append(
            {
                "positions": motion.angle[row].tolist(),
                "velocities": motion.velocity[row].tolist(),
                "accelerations": motion.acceleration[row].tolist(),
                "time_from_start": {"sec": seconds, "nanosec": nanoseconds},
            }
        )
    return json.dumps({"joint_names": list(motion.joints), "points": points}) + "\n"


def _write_actions(motion: Excitation, path: Path) -> None:
    """LeRobot: rows of an episode with "action", angles in rad."""
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        raise InputError(f"{path}: to write parquet install the extra logs: pip install 'invdyn[logs]'") from None
    rows = len(motion.time)
    columns = {
        "action": pa.array(motion.angle.astype(np.float32).tolist(), pa.list_(pa.float32(), len(motion.joints))),
        "timestamp": pa.array(motion.time.astype(np.float32)),
        "frame_index": pa.array(np.arange(rows)),
        "episode_index": pa.array(np.zeros(rows, dtype=np.int64)),
    }
    with atomic_path(path) as temporary:
        pq.write_table(pa.table(columns), temporary)


def excitation_text(motion: Excitation) -> str:
    """What the command prints: how much the motion tells, of what, and what stays hidden."""
    seconds, joints = motion.time[-1], ", ".join(motion.joints)
    lines = [
        f"motion     {seconds:g} s of {joints}, from rest to rest",
        f"tells      {motion.nats:.0f} nats of what may be wrong; a random motion in these limits {motion.usual:.0f}",
    ]
    known = defaultdict(list)
    for column, sd in zip(motion.columns, motion.sds, strict=True):
        if column not in motion.hidden:
            known[column.effect, column.name, column.unit].append(f"{column.place} {sd:.2g}")
    for (effect, name, unit), places in known.items():
        more = f" and {len(places) - MAX_LISTED} more" if len(places) > MAX_LISTED else ""
        sure = f"{effect}, {name}" if name else effect
        lines.append(f"to         {sure}, ± {unit}: {', '.join(places[:MAX_LISTED])}{more}")
    if motion.hidden:
        count: defaultdict[str, int] = defaultdict(int)
        for column in motion.hidden:
            count[column.effect] += 1
        parts = ", ".join(f"{number} of {effect}" for effect, number in count.items())
        lines.append(f"hidden     numbers that stay nearly as uncertain as they are: {parts}")
    if motion.assumed:
        lines.append(f"assumed    limits that nothing gives: {', '.join(motion.assumed)}; say them with --limits")
    return "\n".join(lines)


def plot_excitation(motion: Excitation) -> Figure:
    """Angles and torques of all joints over time."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(9, 1.2 + 1.1 * len(motion.joints)), layout="constrained")
        axes = figure.subplots(len(motion.joints), 2, sharex=True, squeeze=False)
        for k, joint in enumerate(motion.joints):
            for place, (values, what) in enumerate(((motion.angle, "angle, rad"), (motion.torque, "torque, N·m"))):
                own = axes[k, place]
                own.plot(motion.time, values[:, k], color=BLUE, linewidth=1)
                own.set_title(f"{joint}: {what}", loc="left")
        for own in axes[-1]:
            own.set_xlabel("time, s")
    return figure
