"""Pose estimates in NWB files (the extension ndx-pose, of any version), read as plain HDF5: no class is built from it.

    <PoseEstimation>/                                any group, known by its attribute neurodata_type
        nodes                 (P,) names, in ndx-pose 0.1; later ones keep them in a group that is linked, skeleton/
        <keypoint>/           PoseEstimationSeries, whose name may be the node's behind "PoseEstimationSeries"
            data              (T, 2 or 3), in attribute `unit` once times `conversion` plus `offset`
            confidence        (T,), optional
            timestamps        (T,) s; or starting_time, s, with attribute `rate`, 1/s

https://github.com/rly/ndx-pose
"""

from pathlib import Path

import h5py
import numpy as np

from ..budget import bytes_of
from ..errors import InputError, readable
from ..limits import LIMITS
from ..naming import choose_individual
from ..paths import check_readable
from ..recording import Recording

SERIES = "PoseEstimationSeries"


def read_nwb_pose(path: str | Path, individual: str | None = None) -> Recording:
    """Read one; `individual` is the name of a PoseEstimation, needed where there are several.

    Raises:
        InputError: a file that is not whole or has no pose estimates, several that were not chosen among, keypoints
            that have not the same times, or data that lie in other files.
        OSError: a file that cannot be opened.
    """
    check_readable(path)
    with open(path, "rb") as file, readable(path, "an NWB file"), h5py.File(file, "r") as store:
        return _recording(store, individual, Path(path).stem)


def _recording(store: h5py.File, individual: str | None, name: str) -> Recording:
    estimates: dict[str, list[h5py.Group]] = {}

    def visit(_: str, node: object) -> None:
        if isinstance(node, h5py.Group) and _kind(node) == SERIES:
            estimates.setdefault(str(node.parent.name).rpartition("/")[2], []).append(node)

    store.visititems(visit)
    if not estimates:
        raise InputError("no pose estimates are in this NWB file: expected PoseEstimation, as ndx-pose writes it")
    series = estimates[choose_individual(list(estimates), individual)]
    tracks = _named(series)
    times = [_times(each) for each in tracks.values()]
    if any(len(time) != len(times[0]) or not np.array_equal(time, times[0]) for time in times):
        raise InputError("its keypoints were seen at different times: expected the same timestamps for all of them")
    points = np.stack([_scaled(_child(each, "data"), len(times[0])) for each in tracks.values()], axis=1)
    confidence = [
        _numbers(_child(each, "confidence")) if "confidence" in each else np.full(len(times[0]), np.nan)
        for each in tracks.values()
    ]
    return Recording(
        time=times[0],
        keypoints=points,
        keypoint_names=tuple(tracks),
        confidence=np.stack(confidence, axis=1) if np.isfinite(confidence).any() else None,
        name=name,
        length_unit="px" if points.shape[-1] == 2 else "m",
    )


def _kind(node: h5py.Group) -> str:
    kind = node.attrs.get("neurodata_type", "")
    return kind.decode() if isinstance(kind, bytes) else str(kind)


def _named(series: list[h5py.Group]) -> dict[str, h5py.Group]:
    """Series by keypoint: in the nodes' order and by their names, where they name all series."""
    own = {str(each.name).rpartition("/")[2]: each for each in series}
    plain = {name.removeprefix(SERIES).casefold(): each for name, each in own.items()}
    nodes = _nodes(series[0].parent)
    if len(plain) == len(own) and {node.casefold() for node in nodes} == set(plain):
        return {node: plain[node.casefold()] for node in nodes}
    return own


def _nodes(estimate: h5py.Group) -> list[str]:
    for place in ("nodes", "skeleton/nodes"):
        if place in estimate:
            return [node.decode() if isinstance(node, bytes) else str(node) for node in _child(estimate, place)[()]]
    return []


def _times(series: h5py.Group) -> np.ndarray:
    if "timestamps" in series:
        return _numbers(_child(series, "timestamps"))
    start = _child(series, "starting_time")
    rate = float(start.attrs["rate"])
    if not rate > 0:
        raise InputError(f"{series.name} has a rate of {rate:g}: expected rows a second")
    return float(start[()]) + np.arange(len(_child(series, "data"))) / rate


def _scaled(data: h5py.Dataset, rows: int) -> np.ndarray:
    values = _numbers(data)
    if values.ndim != 2 or values.shape[0] != rows or values.shape[1] not in (2, 3):
        raise InputError(f"{data.name} has shape {values.shape}: expected ({rows}, 2) or ({rows}, 3)")
    return values * float(data.attrs.get("conversion", 1.0)) + float(data.attrs.get("offset", 0.0))


def _numbers(stored: h5py.Dataset) -> np.ndarray:
    if not np.issubdtype(stored.dtype, np.number):
        raise InputError(f"{stored.name} holds no numbers")
    return np.asarray(stored[()], dtype=np.float64)


def _child(group: h5py.Group, name: str) -> h5py.Dataset:
    """A data set of a group, which lies in the same file and is not too large. Raises InputError for another."""
    stored = None if isinstance(group.get(name, getlink=True), h5py.ExternalLink) else group[name]
    if stored is None or stored.file != group.file:
        raise InputError(f"{group.name}/{name} lies in another file, which is not read")
    if (size := bytes_of(stored)) > LIMITS.memory:
        raise InputError(f"{stored.name} declares {size:.3g} bytes, expected at most {LIMITS.memory / 2**30:g} GiB")
    return stored
