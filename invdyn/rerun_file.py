"""A page's content as a recording of the viewer Rerun (rerun.io), .rrd: body, keypoints and curves on one time axis.

body/<arm>, body/draws, body/seen        lines and points, in the recording's unit of length; a plane has z = 0
<group>/<joint>/<side>/middle, low, high  scalars, as on the page, whose rows these are
"""

from pathlib import Path

import numpy as np

from invdyn.recordings import InputError, atomic_path

from .page import View


def write_rerun(view: View, out: Path) -> None:
    """Write it, whole or not at all. Raises InputError without the library, OSError where it cannot be written."""
    try:
        import rerun
    except ImportError:
        raise InputError(f"{out}: .rrd needs `pip install 'invdyn[rerun]'`; the page works without") from None
    flat = 3 - (view.observed.shape[-1] if view.arms else 3)
    body = [(["body", name], points) for (name, _), points in view.arms.items()]
    body += [(["body", "draws", str(number)], points) for number, points in enumerate(view.draws if view.arms else ())]
    with atomic_path(out) as temporary:
        recording = rerun.RecordingStream("invdyn")
        recording.save(str(temporary))
        for row, time in enumerate(view.time):
            recording.set_time("time", duration=float(time))
            for name, points in body:
                placed = np.pad(points[row], ((0, 0), (0, flat)))
                strips = [placed[line] for line in view.lines if np.isfinite(placed[line]).all()]
                recording.log(name, rerun.LineStrips3D(strips))
            if view.arms:
                seen = view.observed[row][np.isfinite(view.observed[row]).all(-1)]
                recording.log(["body", "seen"], rerun.Points3D(np.pad(seen, ((0, 0), (0, flat)))))
            for panel in view.panels:
                for side in panel["sides"]:
                    place = [panel["group"], panel["joint"], side["name"]]
                    for curve in ("middle", "low", "high"):
                        if (value := side[curve][row]) is not None:
                            recording.log([*place, curve], rerun.Scalars(value))
        recording.disconnect()
