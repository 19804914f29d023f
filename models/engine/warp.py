"""The same steps on a GPU, by MuJoCo Warp: states are worlds of one simulation.

Warp (Google DeepMind and NVIDIA, https://github.com/google-deepmind/mujoco_warp, extra ``warp``) computes in float32:
ends of rows are MuJoCo's to about a millionth of the motion. Contacts, constraints and sums are in a fixed order, and
warm starts zero, so that on one device a seed gives the same bits. A first call compiles, up to a minute; kernels are
kept on disk. On a GPU a step is one graph of kernels. Shapes are those of :mod:`.simulator`.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from invdyn.models.bodies.scalars import BodyError
from invdyn.models.engine.simulator import Simulator

ROOM, MOST_ROOM = 32, 2**12
"""Contacts that a world has memory for at first, and at most."""
UNSETTLED = 1 << 9 | 1 << 10
"""Bits of Warp's ``OverflowType`` that tell of a solver's iterations, not of memory."""
INPUTS = ("ctrl", "qfrc_applied", "xfrc_applied")
"""Warp's names of what a drive fills, in the order of ``mujoco.mjtState``."""


class WarpSimulator(Simulator):
    """Steps of a compiled model on a ``device`` by Warp's name, such as "cuda", "cuda:1" or "cpu".

    Raises BodyError where MuJoCo Warp is not installed, has no such device, or lacks a part of the model.
    """

    def __init__(self, model: Any, control_spec: int, device: str):
        import mujoco

        super().__init__(model, control_spec, threads=1)
        off, reset = mujoco.mjtDisableBit.mjDSBL_ACTUATION, mujoco.mjtDisableBit.mjDSBL_AUTORESET
        if model.opt.disableflags & off:  # Warp 4.0 leaves joints' implicit damping out then, too
            for part in ("gaintype", "gainprm", "biastype", "biasprm", "dyntype", "damping"):
                getattr(model, f"actuator_{part}")[:] = 0
        model.opt.disableflags &= ~int(off | reset)  # it never resets, nor knows the word
        self.device, self.room = device, ROOM
        try:
            import mujoco_warp
            import warp

            with warp.ScopedDevice(device):
                mujoco_warp.put_model(model)
        except (ImportError, NotImplementedError, RuntimeError, ValueError) as error:
            raise BodyError(
                f"MuJoCo Warp cannot simulate this on {device}: {error}; pip install 'invdyn[warp]', or leave warp= out"
            ) from error

    def _worlds(self, model: Any, size: int) -> tuple[Any, Callable[[], None]]:
        """Data of ``size`` worlds on the current device, and what steps them."""
        import mujoco_warp
        import warp

        key = (model.opt.timestep, size, self.room)
        if key not in self._kept:
            own = mujoco_warp.put_model(model)
            own.opt.deterministic, own.opt.warn_overflow = True, False
            rows = 6 * self.room + 2 * (model.nv + model.ntendon) + 6 * model.neq
            data = mujoco_warp.make_data(model, size, self.room, njmax=rows)
            step = partial(mujoco_warp.step, own, data)
            if warp.get_device().is_cuda:
                step()  # compiles
                with warp.ScopedCapture() as capture:
                    step()
                step = partial(warp.capture_launch, capture.graph)
            self._kept[key] = data, step
        return self._kept[key]

    def _rollout(
        self, model: Any, begin: np.ndarray, controls: np.ndarray, steps: int
    ) -> tuple[np.ndarray, np.ndarray]:
        import mujoco
        import warp

        bits = [int(getattr(mujoco.mjtState, f"mjSTATE_{name.upper()}")) & self.control_spec for name in INPUTS]
        ends = np.cumsum([mujoco.mj_stateSize(model, bit) for bit in bits[:-1]])
        count = len(begin)
        worlds = np.arange(1 << (count - 1).bit_length()) % count  # few sizes, as each has memory of its own
        inputs = np.nan_to_num(controls)[worlds]
        states, sensors = np.zeros((count, steps, begin.shape[-1])), np.empty((count, steps, model.nsensordata))
        with warp.ScopedDevice(self.device):
            data, step = self._worlds(model, len(worlds))
            moved = (data.qpos, data.qvel, data.act)
            _fill(moved, np.split(begin[worlds, 1:], [model.nq, model.nq + model.nv], -1))
            for field in (data.qacc_warmstart, data.overflow):
                field.zero_()
            for k in range(steps):
                _fill([getattr(data, name) for name in INPUTS], np.split(inputs[:, k], ends, -1))
                step()
                states[:, k, 1:] = np.concatenate([each.numpy()[:count] for each in moved], -1)
                sensors[:, k] = data.sensordata.numpy()[:count]
            lacks_room = (data.overflow.numpy() & ~UNSETTLED).any()
        if not lacks_room:
            return states, sensors
        if self.room >= MOST_ROOM:
            raise BodyError(f"expected at most {MOST_ROOM} contacts at once by MuJoCo Warp, got more: leave warp= out")
        self.room *= 2
        return self._rollout(model, begin, controls, steps)


def _fill(fields: Sequence[Any], values: Sequence[np.ndarray]) -> None:
    """Set Warp's arrays to ``values`` (B, …), where there are any."""
    for field, value in zip(fields, values, strict=True):
        if value.size:
            shape = field.shape if value.size == field.size else (*field.shape, -1)  # numbers, or vectors of them
            field.assign(value.astype(np.float32).reshape(shape))
