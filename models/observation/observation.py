"""The observation of a body: one or several sensors, whose parts form a row.

Adjacent sensors of independent noise have one joint distribution: Gaussian; or with "emission.df" degrees of
freedom (1,) for outliers, Student-t of each entry or multivariate t of each keypoint (:mod:`.multivariate_t`);
or for a tracker with occasional errors a mixture (:mod:`.mixture`). Others keep their own, and :mod:`.side_by_side`
joins them.

Shapes: rows (..., O), O the sum of the sensors' sizes. NaN is missing.
"""

import copy
from collections.abc import Mapping, Sequence
from dataclasses import replace
from inspect import getattr_static
from itertools import groupby
from typing import Any, Self, TypeVar

import numpy as np
import torch
from pyro.distributions import Chi2, Distribution, Normal, StudentT
from torch import Tensor

from invdyn.models.bodies.protocol import ArticulatedBody
from invdyn.models.observation.encoders import Encoders
from invdyn.models.observation.keypoints import BasePoint, Keypoints
from invdyn.models.observation.multivariate_t import MultivariateT
from invdyn.models.observation.pixels import Pixels
from invdyn.models.observation.sensor import NoisySensor, Sensor, SensorWithStates, size
from invdyn.models.observation.side_by_side import SideBySide
from invdyn.models.observation.view import View
from invdyn.models.shapes import join

Rows = TypeVar("Rows", Tensor, np.ndarray)
FAMILIES = ("gaussian", "student_t", "multivariate_t")
REQUIRED = ("name", "unit", "bound", "to", "shape", "coords", "defaults", "started", "predict")
"""What a sensor has, see :class:`.sensor.Sensor`."""
DEFAULT_DEGREES = 4.0
"""Starting value of the degrees of freedom of Student-t noise."""


class Observation:
    """Sensors that are read in every row.

    Args:
        sensors: in the order of their parts; keypoints whose tracker may have occasional errors come first.
        family: one of ``FAMILIES``, of those with independent noise; "multivariate_t" of keypoints.

    Raises ValueError for an unknown family, no sensor, or two of one name; TypeError for what is no sensor.
    """

    def __init__(self, *sensors: Sensor, family: str = "gaussian"):
        if family not in FAMILIES:
            raise ValueError(f"expected a noise family among {', '.join(FAMILIES)}, got {family!r}")
        if not sensors or any(isinstance(each, Keypoints) and not each.sites for each in sensors):
            raise ValueError("expected at least one sensor, and keypoints of at least one site, got none")
        for each in sensors:
            if lacks := [name for name in REQUIRED if getattr_static(each, name, None) is None]:
                raise TypeError(f"expected a sensor, got {type(each).__name__}, which lacks {', '.join(lacks)}")
        names = [each.name for each in sensors]
        if len(set(names)) < len(names):
            raise ValueError(f"expected a name of its own for each sensor, got {', '.join(names)}")
        self.sensors = tuple(sensors)
        self.family = family
        # Runs of adjacent sensors of independent noise; any other is a run of its own.
        runs = groupby(sensors, lambda each: isinstance(each, NoisySensor) or each.name)
        self._runs: list[list[Any]] = [list(run) for _, run in runs]
        self.with_states: list[Any] = [each for each in sensors if isinstance(each, SensorWithStates) and each.states]
        """Those that have states (:class:`.sensor.SensorWithStates`)."""

    def _with(self, sensors: Sequence[Sensor]) -> Self:
        return type(self)(*sensors, family=self.family)

    def bound(self, body: ArticulatedBody) -> Self:
        """The observation of a body, whose size is then known."""
        return self._with([each.bound(body) for each in self.sensors])

    def to(self, device: torch.device | str) -> Self:
        """The same with all that a row needs on ``device``."""
        moved = [each.to(device) for each in self.sensors]
        return self if all(a is b for a, b in zip(moved, self.sensors, strict=True)) else self._with(moved)

    def with_family(self, family: str) -> Self:
        """The same under noise of another family."""
        other = copy.copy(self)
        other.family = family
        return other

    def data(self) -> list[Tensor]:
        """Its sensors' data of each row other than the observations, such as a tracker's confidence."""
        known = None if self.keypoints is None else self.keypoints.confidence
        own = [] if known is None else [known.doubt, known.drop, known.itself]
        return own if self.pixels is None else [*own, *self.pixels.data()]

    # -- rows ----------------------------------------------------------------------------------
    @property
    def size(self) -> int:
        """O, the length of a row."""
        return sum(map(size, self.sensors))

    @property
    def keypoints(self) -> Keypoints | None:
        """The sensor of keypoints, if there is one."""
        return next((each for each in self.sensors if isinstance(each, Keypoints)), None)

    @property
    def base_point(self) -> BasePoint | None:
        """The sensor of the base's own keypoint, if there is one."""
        return next((each for each in self.sensors if isinstance(each, BasePoint)), None)

    @property
    def encoders(self) -> Encoders | None:
        """The encoders, if there are any."""
        return next((each for each in self.sensors if isinstance(each, Encoders)), None)

    @property
    def pixels(self) -> Pixels | None:
        """The sensor of pixels, if there is one."""
        return next((each for each in self.sensors if isinstance(each, Pixels)), None)

    @property
    def states(self) -> int:
        """M, of all sensors that have any."""
        return sum(each.states for each in self.with_states)

    @property
    def tracked(self) -> tuple[int, ...]:
        """Sites that keypoints show, (P,)."""
        return () if self.keypoints is None else self.keypoints.sites

    @property
    def tracked_names(self) -> tuple[str, ...]:
        """Their names."""
        return () if self.keypoints is None else self.keypoints.names

    def part(self, sensor: Sensor) -> slice:
        """Where a sensor's part of a row is."""
        before = self.sensors[: self.sensors.index(sensor)]
        start = sum(map(size, before))
        return slice(start, start + size(sensor))

    def of(self, sensor: Sensor, rows: Rows) -> Rows:
        """A sensor's part of rows (..., O), tensor or array, in its own shape."""
        return rows[..., self.part(sensor)].reshape(*rows.shape[:-1], *sensor.shape)

    def points(self, rows: Rows) -> Rows:
        """Keypoints (..., P, d) of rows (..., O), tensor or array; none of no keypoints."""
        if self.keypoints is None:
            return rows[..., :0].reshape(*rows.shape[:-1], 0, 1)
        return self.of(self.keypoints, rows)

    def with_points(self, rows: Tensor, points: Tensor) -> Tensor:
        """Rows (..., O) with other keypoints (..., P, d)."""
        if self.keypoints is None:
            return rows
        part = self.part(self.keypoints)
        return torch.cat([rows[..., : part.start], points.flatten(-2), rows[..., part.stop :]], -1)

    # -- the distribution of a row -------------------------------------------------------------
    def defaults(self, reach: float) -> dict[str, Tensor]:
        """Starting parameters for a body that reaches so far.

        Raises ValueError for a sensor whose parameters or names are not as :class:`.sensor.Sensor` has them.
        """
        parameters: dict[str, Tensor] = {}
        for each in self.sensors:
            own = each.defaults(reach)
            if wrong := [k for k, v in own.items() if not ("." in k and isinstance(v, Tensor))]:
                raise ValueError(f"{each.name}: expected tensors named emission.<name>, got {', '.join(wrong)}")
            if (lengths := tuple(map(len, each.coords.values()))) != each.shape:
                raise ValueError(f"{each.name}: expected as many coords as its shape {each.shape} has, got {lengths}")
            parameters |= own
        if self.family != "gaussian":
            parameters["emission.df"] = torch.full((1,), DEFAULT_DEGREES).double()
        return parameters

    def predict(self, view: View, t: int | Tensor, parameters: Mapping[str, Tensor]) -> Distribution:
        """Distribution of row ``t``, event shape (O,).

        Raises ValueError for mistakes under Student-t noise, which models outliers itself, and for locations of
        another size than the sensor's.
        """
        parts = [self._side_by_side(run, view, t, parameters) for run in self._runs]
        return parts[0] if len(parts) == 1 else SideBySide(parts)

    def _side_by_side(
        self, run: Sequence[Any], view: View, t: int | Tensor, parameters: Mapping[str, Tensor]
    ) -> Distribution:
        """Of one sensor, or of several that have independent noise."""
        first = run[0]
        if not isinstance(first, NoisySensor):
            return first.predict(self._for(first, view), t, parameters)
        found = [each.location_scale(self._for(each, view), t, parameters) for each in run]
        for each, (middle, _) in zip(run, found, strict=True):
            if middle.shape[-1:] != (size(each),):
                raise ValueError(f"{each.name}: expected locations (..., {size(each)}), got {tuple(middle.shape)}")
        loc, scale = found[0] if len(found) == 1 else (join(*each) for each in zip(*found, strict=True))
        if view.mistakes and isinstance(first, Keypoints):
            if self.family != "gaussian":
                raise ValueError(
                    f"expected gaussian noise under outliers and swaps, got {self.family!r}; drop one of them"
                )
            return first.mistaken(loc, scale, view.mistakes)
        if self.family == "multivariate_t" and isinstance(first, Keypoints):
            return MultivariateT(loc, scale, first.shape, parameters["emission.df"][..., 0])
        if self.family == "student_t":
            return _UncheckedStudentT(parameters["emission.df"], loc, scale).to_event(1)
        return Normal(loc, scale, validate_args=False).to_event(1)

    # -- states of the sensors themselves --------------------------------------------------------
    def _for(self, sensor: Sensor, view: View) -> View:
        """The view with the sensor's own states."""
        if view.memory is None:
            return view
        if sensor not in (own := self.with_states):
            return replace(view, memory=None)
        return replace(view, memory=view.memory.split([each.states for each in own], -1)[own.index(sensor)])

    def initial_sd(self, parameters: Mapping[str, Tensor]) -> list[Tensor]:
        """Deviations of their states in the first row."""
        return [each.initial_sd(parameters) for each in self.with_states]

    def next_mean(self, memory: Tensor, dt: Tensor, parameters: Mapping[str, Tensor]) -> list[Tensor]:
        """Means of their states ``dt`` (..., 1) s after they were ``memory`` (..., M)."""
        own = self.with_states
        shares = memory.split([each.states for each in own], -1) if own else ()
        return [each.next_mean(share, dt, parameters) for each, share in zip(own, shares, strict=True)]

    def transition_sd(self, dt: Tensor, parameters: Mapping[str, Tensor]) -> list[Tensor]:
        """Deviations about these means."""
        return [each.transition_sd(dt, parameters) for each in self.with_states]

    @property
    def independent_states(self) -> tuple[list[int], list[int]]:
        """Of the M states those that show in one entry of a row each, by number, and these entries."""
        own: list[int] = []
        shown: list[int] = []
        start = 0
        for each in self.with_states:
            own += range(start, start + each.independent_states)
            shown += range(self.part(each).start, self.part(each).start + each.independent_states)
            start += each.states
        return own, shown


class _UncheckedStudentT(StudentT):
    """Student-t noise whose parameters (..., O) are not checked.

    torch's own class checks the χ² inside it for all ``validate_args``: the host would wait in each row.
    """

    def __init__(self, df: Tensor, loc: Tensor, scale: Tensor):
        self.df, self.loc, self.scale = torch.broadcast_tensors(df, loc, scale)
        self._chi2 = Chi2(self.df, validate_args=False)
        torch.distributions.Distribution.__init__(self, self.df.shape, validate_args=False)

    def expand(self, batch_shape: Sequence[int], _instance: Any = None) -> Any:
        """See :class:`torch.distributions.Distribution`."""
        return super().expand(batch_shape, self._get_checked_instance(_UncheckedStudentT, _instance))
