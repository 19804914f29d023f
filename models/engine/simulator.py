"""Batches of MuJoCo's own steps, on all cores, with the same bits for any number of them.

``mujoco.rollout`` steps each state in one of several threads with a ``MjData`` of its own. MuJoCo's constraint solver
begins at the last step's accelerations (its warm start), so that a state's step could depend on which state the thread
had before. Rollouts begin with a warm start of zero, each: a state's result depends on the state alone.

Shapes: B states, n steps; physics (B, nq + nv + na); controls (B, n, C), C numbers of the inputs named by
``control_spec``; sensors (B, n, S), each of the state *before* a step.
"""

import copy
import os
from collections.abc import Sequence
from typing import Any

import numpy as np

from invdyn.models.bodies.joint_parts_mjcf import kept_warnings
from invdyn.models.bodies.scalars import BodyError

AT_ONCE = 2**22
"""Numbers of states and sensors that one batch may fill."""
MAX_STEPS = 2000
"""Between two rows."""
RAN_AWAY = 1e8
"""m, rad or their rates, beyond which a simulation has no meaning."""


class Simulator:
    """Steps of a compiled model.

    Args:
        model: a ``mujoco.MjModel``, which is changed: no automatic reset after a simulation ran away, no sleeping.
        control_spec: bits of ``mujoco.mjtState`` that controls hold, in MuJoCo's order.
        threads: number of threads; all cores by default.
    """

    def __init__(self, model: Any, control_spec: int, threads: int | None = None):
        import mujoco

        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        model.opt.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)
        self.model, self.control_spec = model, int(control_spec)
        self.num_controls = mujoco.mj_stateSize(model, self.control_spec)
        self.threads = threads or len(os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else range(1))
        self._kept: dict[Any, Any] = {}

    def __getstate__(self) -> dict[str, Any]:
        return vars(self) | {"_kept": {}}  # threads stay where they are

    def __deepcopy__(self, memo: dict) -> "Simulator":
        return self  # nothing of it changes

    def _at(self, timestep: float) -> Any:
        """The model with that time step, s."""
        if timestep not in self._kept:
            model = copy.copy(self.model)
            model.opt.timestep = timestep
            self._kept[timestep] = model
        return self._kept[timestep]

    def run(
        self, physics: np.ndarray, controls: np.ndarray, timestep: float, all_states: bool = False
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the states (B, nq + nv + na) after all steps, or after each, (B, n, …), and sensors (B, n, S).

        States that ran away are NaN from there on.
        """
        model, (count, steps, _) = self._at(timestep), controls.shape
        width = steps * (physics.shape[-1] + 1 + model.nsensordata)
        ends, sensed = [], []
        for some in np.array_split(np.arange(count), max(1, -(-count * width // AT_ONCE))):
            begin = np.concatenate([np.zeros((len(some), 1)), physics[some]], -1)
            finite = np.isfinite(begin).all(-1)
            state, sensors = self._rollout(model, np.where(finite[:, None], begin, 0.0), controls[some], steps)
            state = state[..., 1:]
            with np.errstate(invalid="ignore"):
                gone = ~(np.abs(state) < RAN_AWAY).all(-1).cumprod(-1).astype(bool) | ~finite[:, None]
            state = np.where(gone[..., None], np.nan, state)
            ends.append(state if all_states else state[:, -1])
            sensed.append(sensors)
        return np.concatenate(ends), np.concatenate(sensed)

    def _rollout(
        self, model: Any, begin: np.ndarray, controls: np.ndarray, steps: int
    ) -> tuple[np.ndarray, np.ndarray]:
        import mujoco
        from mujoco import rollout

        if "threads" not in self._kept:
            pool = rollout.Rollout(nthread=self.threads if self.threads > 1 else 0)
            self._kept["threads"] = pool, [mujoco.MjData(self.model) for _ in range(self.threads)]
        pool, data = self._kept["threads"]
        controls = np.ascontiguousarray(np.nan_to_num(controls))
        state = np.empty((len(begin), steps, begin.shape[-1]))
        sensors = np.empty((len(begin), steps, model.nsensordata))
        with kept_warnings(mujoco):
            pool.rollout(
                [model] * len(begin),
                data,
                begin,
                controls,
                control_spec=self.control_spec,
                nstep=steps,
                initial_warmstart=np.zeros((len(begin), model.nv)),
                state=state,
                sensordata=sensors,
                skip_checks=True,
            )
        return state, sensors


def unique_steps(seconds: np.ndarray, longest: float) -> tuple[np.ndarray, list[tuple[float, int]]]:
    """Which step each row (T,) takes, and of each step its length in s and how often: at most ``longest`` s each.

    Times that differ by less than a millionth of themselves are one. Raises BodyError for more than ``MAX_STEPS``.
    """
    rounded = np.array([float(f"{value:.6e}") for value in seconds])
    values, which = np.unique(rounded, return_inverse=True)
    counts: Sequence[int] = [max(1, int(np.ceil(value / longest - 1e-6))) for value in values]
    if max(counts) > MAX_STEPS:
        raise BodyError(
            f"expected at most {MAX_STEPS} of MuJoCo's steps from a row to the next, got {max(counts)} in "
            f"{values.max():g} s: give times in s, leave gaps out, or raise the file's timestep"
        )
    return which, [(float(value) / count, count) for value, count in zip(values, counts, strict=True)]
