"""Whether a saved posterior has the layout that :mod:`.posterior` documents: what is read is checked once, here.

Every variable below has these dimensions, finite numbers within ±10¹⁵ (a detection may be missing), and names and
units that can be printed. What else a file holds is its own affair. A kinematic model, which
the attribute "model" tells, has no torque.
"""

from collections.abc import Iterator
from typing import Any

import arviz as az
import numpy as np
import xarray as xr

from invdyn.inference.posterior.problem import STATES
from invdyn.recordings import InputError

JOINTS, TIPS, PLACE = ("time", "joint"), ("time", "keypoint", "space"), ("time", "space")
NEEDED: dict[str, dict[str, tuple[str, ...]]] = {
    "posterior": dict.fromkeys(("torque", "angle", "velocity"), ("chain", "draw", *JOINTS))
    | {"position": ("chain", "draw", *TIPS)},
    "sample_stats": {"log_weight": ("filter",)},
    "observed_data": {},
    "constant_data": {},
}
OPTIONAL: dict[str, dict[str, tuple[str, ...]]] = {
    "posterior": {f"base_{name}": ("chain", "draw", *PLACE) for name in ("position", "velocity", "acceleration")},
    "posterior_predictive": {"position": ("chain", "draw", *TIPS), "angle": ("chain", "draw", *JOINTS)}
    | {"base_position": ("chain", "draw", *PLACE)},
    "log_likelihood": {"y": ("chain", "draw", "time")},
    "sample_stats": {"log_evidence": ("filter",), "ess": ("filter", "time"), "resampled": ("filter", "time")},
    "observed_data": {"position": TIPS, "angle": JOINTS, "base_position": PLACE},
    "constant_data": dict.fromkeys(("truth_torque", "truth_angle", "truth_velocity", "command"), JOINTS)
    | {"base": ("space",), "skeleton": ("edge", "end"), "turns": ("joint",)},
}
MISSING = {"observed_data", "constant_data"}
"""Groups in which a number may be missing."""
MAY_HAVE_NONE = {"log_evidence"}
"""Variables that are NaN where a method has none."""
STATE_VARIABLES = {"posterior": {"state": ("chain", "draw", "time", "state_name")}}
"""Of a posterior of any state-space model, whose attribute "layout" is "states"."""
NUMBERS, TEXTS = ("log_evidence", "outer_ess"), ("method",)
"""Attributes of the whole."""
MAX_NUMBER, MAX_NAME = 1e15, 100
"""Of any number, and of any name in characters."""


def check_layout(idata: az.InferenceData) -> None:
    """Raise InputError unless a posterior, in memory, has this layout."""
    if missing := [group for group in NEEDED if group not in idata.groups()]:
        raise InputError(f"no posterior of invdyn: it lacks {', '.join(missing)}")
    if idata.attrs.get("layout") == STATES:
        _check_states(idata)
        return
    without = {"torque"} if idata.attrs.get("model") == "kinematic" else set()
    for group, needed in NEEDED.items():
        if lacking := [name for name in needed if name not in idata[group] and name not in without]:
            raise InputError(f"no posterior of invdyn: it lacks {group}/{lacking[0]}")
    for name in (*NUMBERS, *TEXTS):
        _check_attribute(name, idata.attrs.get(name))
    sizes = dict(idata["posterior"].sizes)
    for group, name, dims in _there(idata):
        _check_variable(f"{group}/{name}", idata[group][name], dims, group in MISSING or name in MAY_HAVE_NONE)
        # Of the keypoints that were tracked, or the rows that hold an observation.
        if group in ("posterior_predictive", "log_likelihood") or name == "position":
            continue
        if wrong := [d for d in dims if d in sizes and idata[group].sizes[d] != sizes[d]]:
            raise InputError(f"{group}/{name}: expected {sizes[wrong[0]]} of {wrong[0]}, as angle has")
    if "skeleton" in idata["constant_data"]:
        _check_skeleton(idata["constant_data"]["skeleton"].to_numpy(), sizes["keypoint"])
    _check_time(idata["posterior"])
    tracked = idata["observed_data"].get("position")
    if tracked is not None and tracked.sizes["time"] != sizes["time"]:
        raise InputError(f"observed_data/position: expected {sizes['time']} times, as angle has")
    for group, dim in (("posterior", "joint"), ("posterior", "keypoint"), ("observed_data", "keypoint")):
        if dim in idata[group].dims:
            _check_names(f"{group}/{dim}", idata[group])
    if tracked is not None and not {*tracked["keypoint"].values} <= {*idata["posterior"]["keypoint"].values}:
        raise InputError("observed_data/keypoint: expected names that posterior/keypoint has")


def _check_states(idata: az.InferenceData) -> None:
    for group, variables in STATE_VARIABLES.items():
        for name, dims in variables.items():
            if name not in idata[group]:
                raise InputError(f"no posterior of invdyn: it lacks {group}/{name}")
            _check_variable(f"{group}/{name}", idata[group][name], dims, may_miss=False)
    _check_names("posterior/state_name", idata["posterior"])
    for name in (*NUMBERS, *TEXTS):
        _check_attribute(name, idata.attrs.get(name))


def _there(idata: az.InferenceData) -> Iterator[tuple[str, str, tuple[str, ...]]]:
    """Group, name and dimensions of each variable of the layout that the file has."""
    for layout in (NEEDED, OPTIONAL):
        for group, variables in layout.items():
            if group in idata.groups():
                yield from ((group, name, dims) for name, dims in variables.items() if name in idata[group])


def _check_variable(what: str, values: xr.DataArray, dims: tuple[str, ...], may_miss: bool) -> None:
    if set(values.dims) != set(dims) or values.dtype.kind not in "fiub" or not values.size:
        raise InputError(f"{what}: expected numbers over {', '.join(dims)}, got {values.dtype} over {values.dims}")
    numbers = np.abs(values.to_numpy().astype(np.float64))
    if np.nanmax(numbers, initial=0.0) > MAX_NUMBER or (not may_miss and np.isnan(numbers).any()):
        raise InputError(f"{what}: expected finite numbers up to {MAX_NUMBER:.0e}, it has others")
    if not _printable(values.attrs.get("units", None if what.startswith("posterior/") else "1")):
        raise InputError(f"{what}: expected its unit as text, in the attribute units")


def _check_skeleton(skeleton: np.ndarray, keypoints: int) -> None:
    whole = skeleton.dtype.kind in "iu" and skeleton.shape[1] == 2
    if not whole or not ((skeleton >= -1) & (skeleton < keypoints)).all():
        raise InputError(f"constant_data/skeleton: expected pairs of numbers of the {keypoints} keypoints, −1 the base")


def _check_time(posterior: xr.Dataset) -> None:
    time = posterior["time"].to_numpy() if "time" in posterior.coords else np.empty(0)
    rises = len(time) > 1 and time.dtype.kind == "f" and np.isfinite(time).all() and (np.diff(time) > 0).all()
    if not rises or np.abs(time).max() > MAX_NUMBER:
        raise InputError("posterior/time: expected times in s that increase")


def _check_names(what: str, data: xr.Dataset) -> None:
    dim = what.rpartition("/")[2]
    names = data[dim].to_numpy().tolist() if dim in data.coords else []
    if not names or len(set(map(str, names))) < len(names) or not all(map(_printable, names)):
        raise InputError(f"{what}: expected names, each once, of up to {MAX_NAME} characters that can be printed")


def _check_attribute(name: str, value: Any) -> None:
    if name in TEXTS and not _printable(value):
        raise InputError(f"attribute {name}: expected a text, got {value!r:.60}")
    if name in NUMBERS and (
        not isinstance(value, float | int | np.integer | np.floating) or np.abs(value) > MAX_NUMBER
    ):
        raise InputError(f"attribute {name}: expected a number, got {value!r:.60}")


def _printable(text: object) -> bool:
    return isinstance(text, str) and bool(text.strip()) and text.isprintable() and len(text) <= MAX_NAME
