"""The arrays that a report draws, kept with the result, so that no figure is drawn from anything else than the run.

T rows, K joints, S sites (in the plane the K tips), P tracked keypoints, d dimensions; SI units and radians.
"""

from dataclasses import dataclass

import numpy as np
import xarray as xr


@dataclass(frozen=True)
class Tracks:
    """What the figures show.

    Attributes:
        time: (T,) s.
        observed: (T, P, d) m, NaN where missing; `keypoint_names` P names.
        base: (d,) m.
        command: (T, K) N·m, or None.
        angle, velocity: (T, K) smoothed under the corrected simulation.
        nominal_replay, corrected_replay: (T, S, d) m, sites in open-loop replays, set back to the smoothed state every
            `replay_window` s.
        smoothed: (T, S, d) m, sites under the corrected simulation.
        residual_before, residual_after: (T, K) N·m mean of the residual torque's posterior; `…_sd` its sd.
        frame_gap: (T,) nats, what the corrected simulation predicts each frame better by; NaN where nothing was seen.
    """

    time: np.ndarray
    observed: np.ndarray
    keypoint_names: tuple[str, ...]
    base: np.ndarray
    command: np.ndarray | None
    angle: np.ndarray
    velocity: np.ndarray
    nominal_replay: np.ndarray
    corrected_replay: np.ndarray
    replay_window: float
    smoothed: np.ndarray
    residual_before: np.ndarray
    residual_before_sd: np.ndarray
    residual_after: np.ndarray
    residual_after_sd: np.ndarray
    frame_gap: np.ndarray

    def dataset(self, joint_names: tuple[str, ...], sites: tuple[str, ...]) -> xr.Dataset:
        """The arrays with their dimensions and units, as the group "tracks" of a saved diagnosis' posterior."""
        of_joint, of_site = ("time", "joint"), ("time", "site", "space")
        arrays = {
            "observed": (("time", "keypoint", "space"), self.observed, "m"),
            "base": (("space",), self.base, "m"),
            "angle": (of_joint, self.angle, "rad"),
            **{
                name: (of_site, getattr(self, name), "m") for name in ("nominal_replay", "corrected_replay", "smoothed")
            },
            **{
                f"residual_{name}": (of_joint, getattr(self, f"residual_{name}"), "N·m")
                for name in ("before", "before_sd", "after", "after_sd")
            },
        }
        if self.command is not None:
            arrays["command"] = (of_joint, self.command, "N·m")
        names = {"joint": list(joint_names), "site": list(sites), "keypoint": list(self.keypoint_names)}
        return xr.Dataset(
            {name: (dims, values, {"units": unit}) for name, (dims, values, unit) in arrays.items()},
            {"time": self.time, **names},
            {"replay_window": self.replay_window},
        )
