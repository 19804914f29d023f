"""MuJoCo's own sensors as a part of an observation row: accelerometers, forces, touch, tendon lengths and all others.

    y_k ~ F(s_k(x), σ_k),     σ_k = "emission.sensor_scale" (n,), in the sensor's own unit

s is what ``sensordata`` holds in a state, with the drive of that row. A sensor of several numbers has a column each,
"imu_0", "imu_1", "imu_2".
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import ClassVar, Self

import torch
from torch import Tensor

from invdyn.models.bodies.protocol import ArticulatedBody
from invdyn.models.engine.scene import Scene
from invdyn.models.observation.sensor import NamedSensor
from invdyn.models.observation.view import View


@dataclass
class EngineView(View):
    """A row's view with MuJoCo's ``sensordata`` (…, N)."""

    readings: Tensor | None = None


@dataclass(frozen=True)
class Readings(NamedSensor):
    """Sensors of the file, by name; all of them by default. The columns are known once :meth:`bound`."""

    sensors: tuple[str, ...] | None = None
    columns: tuple[int, ...] = field(default=())

    name: ClassVar[str] = "sensor"
    unit: ClassVar[str] = "1"
    dim: ClassVar[str] = "reading"

    def bound(self, body: ArticulatedBody) -> Self:
        """The sensors of a scene; raises ValueError for a body of another kind, or a sensor that it does not have."""
        if not isinstance(body, Scene):
            raise ValueError(f"expected a MuJoCo model, got {type(body).__name__}: its sensors are not simulated")
        wanted = body.sensor_names if self.sensors is None else self.sensors
        if unknown := [name for name in wanted if name not in body.sensor_names]:
            raise ValueError(f"expected sensors among {', '.join(body.sensor_names) or 'none'}, got {unknown[0]!r}")
        columns: list[int] = []
        names: list[str] = []
        for name in wanted:
            first, size = int(body.model.sensor(name).adr[0]), int(body.model.sensor(name).dim[0])
            columns += range(first, first + size)
            names += [name] if size == 1 else [f"{name}_{k}" for k in range(size)]
        return replace(self, sensors=tuple(wanted), columns=tuple(columns), names=tuple(names))

    def defaults(self, reach: float) -> dict[str, Tensor]:
        """A hundredth of the sensor's own unit."""
        return {"emission.sensor_scale": torch.full(self.shape, 0.01).double()}

    def location_scale(self, view: View, t: int | Tensor, parameters: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
        """What they show, and their noise."""
        assert isinstance(view, EngineView)
        assert view.readings is not None
        return view.readings[..., list(self.columns)], parameters["emission.sensor_scale"]
