"""The base of a recording: whether it moves by more than its tracker's noise, and how; or whether it is elsewhere.

What its own track says needs no body.

Two laws of a track y (T, d) are compared by their evidence,

    at rest    y_t = c + N(0, r²)
    it moves   y_t = b_t + N(0, r²),   b as in :mod:`invdyn.models.articulated.moving_base`

each at the best of a grid of its parameters, axis by axis; ℓ has a wide prior. A base moves where the second is ahead
by ``AHEAD`` nats, and where that matters: its acceleration has an rms above ``FELT`` of gravity, or its displacement
one above ``SHIFTED`` times the noise. What is smaller changes torques by less than their bands. A displacement under
``WANDERS`` of the reach is taken for errors of a tracker that last.

Of a base that is not tracked its place is the body file's. It is refused where it contradicts the keypoints: a site
that keeps its distance L from the first joint lies on a circle, or sphere, about it. Another middle than the file's,

    min over c of Σ_t (|y_t − c| − L)²,

must leave less than ``EXPLAINED`` of the rms that the file's leaves, which must exceed ``MISFIT`` of L, and no other
length about the file's place may do nearly as well. And the rms must be ``SHOWN`` of how far the middle is off: a site
that hardly turns is as far from many places.

Shapes: T rows, d axes.
"""

import math
import warnings
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import torch
from scipy.optimize import least_squares

from invdyn.inference.plausible_for_body import distances_of_base, rooted, site_at_base
from invdyn.models import ArticulatedBody, Body
from invdyn.models.articulated.base_track import filtered, without_outliers
from invdyn.models.articulated.moving_base import MovingBase
from invdyn.models.dynamics.registry import dynamics_for
from invdyn.recordings import InputError, Recording
from invdyn.recordings.cameras import Filmed
from invdyn.recordings.jitter import point_jitter

AHEAD, FELT, SHIFTED = 10.0, 0.01, 3.0
"""Nats; share of gravity; times the noise."""
SCALES, LENGTHS = np.geomspace(0.003, 3.0, 7), np.geomspace(0.03, 1.0, 6)
"""Grids of σ, in units of gravity, and of ℓ, s."""
NOISES = np.array([0.5, 0.7, 1.0, 1.4])
"""Grid of the noise, times the jitter."""
FINER = np.geomspace(0.75, 1 / 0.75, 5)
"""Of a second, finer grid, times the first one's best."""
USUAL, LOG_LENGTH_SD, MIN_ROWS_APART = 0.15, 0.7, 2.0
"""Prior of ℓ, s and sd of its logarithm: steps of people, vehicles. And the least ℓ, in rows: what changes faster than
rows are seen moves a base that the arm would not feel."""
STANDARD_GRAVITY = 9.81
MIN_ROWS, MOST_ROWS = 10, 1200
"""In which a base must be seen, and that its process is looked for in."""
WANDERS = 0.01
"""Of the reach: a smaller displacement is not distinguished from errors of a tracker or filter that last."""
MISFIT, EXPLAINED, SHOWN = 0.05, 0.3, 0.25
"""Of a length, of a misfit, and of a distance."""


@dataclass(frozen=True)
class BaseMotion:
    """What a track says of its base.

    Attributes:
        moves: whether it moves.
        place: (d,) median of the track.
        noise: sd, in the unit of length.
        gain: by how many nats "it moves" is ahead.
        acceleration: rms of b̈ over the rows, m/s².
        displacement: rms of b − its mean.
        values: of the process, by the model's names.
        path: (T, 4 d) states of the moving base about ``place``.
    """

    moves: bool
    place: np.ndarray
    noise: float
    gain: float
    acceleration: float
    displacement: float
    values: dict[str, np.ndarray]
    path: np.ndarray

    @property
    def displacements(self) -> torch.Tensor:
        """Of b, about ``place``, (T, d)."""
        return torch.as_tensor(self.path[:, : len(self.place)])


@dataclass(frozen=True)
class Base:
    """A recording whose base is where the body's is, but for its motion.

    Attributes:
        recording: shifted by one constant.
        motion: of the base, about the body's own place; None where it is taken to be at rest.
        apart: name of the keypoint that is the moving base's own track.
        line: what was decided, for a reader.
    """

    recording: Recording
    motion: BaseMotion | None = None
    apart: str | None = None
    line: str = ""

    @property
    def at_rest(self) -> Recording:
        """The recording as of a base at rest, where it was estimated."""
        if self.motion is None:
            return self.recording
        return replace(self.recording, keypoints=self.recording.keypoints - self.motion.displacements.numpy()[:, None])

    @property
    def values(self) -> dict[str, np.ndarray]:
        """Where a model's parameters of the base begin."""
        if self.motion is None:
            return {}
        return {**self.motion.values, "emission.base_scale": np.array([self.motion.noise])}


def hold_base(recording: Recording, body: ArticulatedBody) -> Base:
    """What is made of a recording's base.

    Raises InputError for a base that is not tracked and stands elsewhere than the body's file says.
    """
    if not isinstance(body, Body) or not recording.keypoint_names:
        return Base(recording)
    unit, own = recording.length_unit, np.array(body.base)
    name = next((n for n in (body.base_keypoint, site_at_base(body)) if n in recording.keypoint_names), None)
    if name is None:
        check_place(recording, body)
        where = ", ".join(f"{x:.3g}" for x in own)
        return Base(
            recording, line=f"base: not tracked, taken to be at rest at ({where}) {unit}, as the body's file says"
        )
    if (rows := int(np.isfinite(recording.keypoint(name)).all(-1).sum())) < MIN_ROWS:
        if not rows:
            check_place(recording, body)
        elif not isinstance(recording, Filmed):
            recording = recording.moved(own - np.nanmedian(recording.keypoint(name), axis=0))
        return Base(
            recording, line=f"base: {name!r} is seen in {rows} rows, too few for a motion, and taken to be at rest"
        )
    found = base_motion(recording.time, recording.keypoint(name), float(np.linalg.norm(body.gravity)))
    size = f"noise {found.noise:.2g} {unit}"
    if isinstance(recording, Filmed):
        if found.moves:
            warnings.warn(
                f"{recording.name}: the base {name!r} moves ({found.acceleration:.2g} {unit}/s² rms), which pixels of "
                "several cameras are taken not to show: triangulate them first (invdyn triangulate)",
                stacklevel=3,
            )
        return Base(recording, line=f"base: {name!r} is taken to be at rest")
    moved = recording.moved(own - found.place)
    if not found.moves:
        return Base(moved, line=f"base: {name!r} is at rest ({size})")
    if found.displacement < WANDERS * dynamics_for(body).reach(body.parameters()).item():
        by = f"its track wanders by {found.displacement:.2g} {unit} rms, as a tracker's own error may"
        return Base(moved, line=f"base: {name!r} is taken to be at rest: {by}")
    return Base(
        moved,
        found,
        name,
        f"base: {name!r} moves, so its motion is part of the model: acceleration {found.acceleration:.2g} {unit}/s² "
        f"rms, displacement {found.displacement:.2g} {unit} rms, {size}",
    )


def check_place(recording: Recording, body: Body) -> None:
    """Raise InputError where keypoints contradict the place of a base that is not tracked; see the top of the file."""
    if not rooted(body):
        return
    for (_, name), length in distances_of_base(body).items():
        if name not in recording.keypoint_names:
            continue
        points = recording.keypoint(name)
        points = points[np.isfinite(points).all(-1)]
        if len(points) < 10:
            continue
        place = np.array(body.base)
        before = np.linalg.norm(points - place, axis=-1)
        found = least_squares(lambda c, y=points, r=length: np.linalg.norm(y - c, axis=-1) - r, place, loss="soft_l1")
        after = np.linalg.norm(points - found.x, axis=-1)
        misfit, left, other = (
            float(np.sqrt(np.mean(off**2))) for off in (before - length, after - length, before - before.mean())
        )
        shown = misfit > SHOWN * float(np.linalg.norm(found.x - place))
        if shown and misfit > MISFIT * length and left < EXPLAINED * min(misfit, other):
            at = ", ".join(f"{x:.3g}" for x in found.x)
            unit = recording.length_unit
            raise InputError(
                f"{recording.name}: {name} turns about ({at}) {unit}, not about the base of body '{body.name}', from "
                f"which its distance is {misfit:.2g} {unit} (rms) off {length:.3g}: expected keypoints in the body's "
                "frame: set the base's place in the body's file, or pass --set base=NAME, the first joint's keypoint"
            )


def base_motion(time: np.ndarray, track: np.ndarray, gravity: float = STANDARD_GRAVITY) -> BaseMotion:
    """Of a ``track`` (T, d) at times (T,), NaN where missing; ``gravity`` in the track's unit of length a s²."""
    axes, gravity = track.shape[-1], gravity or STANDARD_GRAVITY
    jitter = float(point_jitter(track[:, None])[0])
    extent = float(np.nanmax(np.abs(track - np.nanmedian(track, 0))))
    jitter = max(jitter, 1e-4 * extent, 1e-9)
    seen = without_outliers(track, jitter)
    place = np.nanmedian(seen, axis=0)
    about = seen - place
    speed = _speed(time, about)
    wide = {"base.place_scale": np.maximum(2 * np.sqrt(np.nanmean(about**2, 0)), 3 * jitter)}
    wide["base.speed_scale"] = np.maximum(2 * speed, jitter / np.median(np.diff(time)))
    base = MovingBase(axes)
    fixed = {name: torch.as_tensor(value) for name, value in wide.items()}
    chosen = np.tile([1.0, 1.0, 1.0], (axes, 1))  # σ, ℓ and noise of each axis
    shortest = MIN_ROWS_APART * float(np.median(np.diff(time)))
    grids = [
        (SCALES * gravity, LENGTHS, NOISES * jitter),
        (FINER**2, FINER, FINER),
    ]
    part = _busiest(about)
    for grid in grids:
        tried = np.array(list(product(*grid)))[:, None] * chosen  # (G, d, 3)
        tried[..., 1] = np.maximum(tried[..., 1], shortest)
        scale, length, noise = (torch.as_tensor(each.copy()) for each in np.moveaxis(tried, -1, 0))
        values = {"base.scale": scale, "base.lengthscale": length}
        values |= {name: value.expand_as(scale) for name, value in fixed.items()}
        evidence, _ = filtered(base, values, time[part], about[part], noise, smooth=False)
        prior = -0.5 * (np.log(length.numpy() / USUAL) / LOG_LENGTH_SD) ** 2
        best = np.nanargmax(evidence + prior, axis=0)
        chosen, own = tried[best, range(axes)], evidence[best, range(axes)]
    found = {"base.scale": chosen[:, 0], "base.lengthscale": chosen[:, 1], **wide}
    tensors = {name: torch.as_tensor(value.copy()) for name, value in found.items()}
    _, path = filtered(base, tensors, time, about, torch.as_tensor(chosen[:, 2].copy()))
    still = _at_rest(about[part], wide["base.place_scale"], jitter)
    gain = float(own.sum() - still)
    states = base.parted(torch.as_tensor(path))
    shift, acceleration = states[0].numpy(), states[2].numpy()
    felt = float(np.sqrt((acceleration**2).sum(-1).mean()))
    moved = float(np.sqrt(((shift - shift.mean(0)) ** 2).sum(-1).mean()))
    size = float(chosen[:, 2].max())
    moves = gain > AHEAD and (felt > FELT * gravity or moved > SHIFTED * size)
    return BaseMotion(moves, place, size, gain, felt, moved, found, path)


def _busiest(track: np.ndarray) -> slice:
    """Of a long track (T, d) the ``MOST_ROWS`` rows among which it moves most; they tell its process well enough."""
    starts = range(0, max(len(track) - MOST_ROWS, 0) + 1, MOST_ROWS // 2)
    size = [np.nansum(np.nanvar(track[start : start + MOST_ROWS], axis=0)) for start in starts]
    first = starts[int(np.argmax(size))]
    return slice(first, first + MOST_ROWS)


def _speed(time: np.ndarray, track: np.ndarray) -> np.ndarray:
    """Rms velocity (d,) over tenths of a second, m/s."""
    seen = np.isfinite(track).all(-1)
    when, where = time[seen], track[seen]
    apart = max(1, round(0.1 / float(np.median(np.diff(time)))))
    if len(when) <= apart:
        return np.zeros(track.shape[-1])
    rate = (where[apart:] - where[:-apart]) / (when[apart:] - when[:-apart])[:, None]
    return np.sqrt((rate**2).mean(0))


def _at_rest(track: np.ndarray, wide: np.ndarray, jitter: float) -> float:
    """Log-evidence of a constant c ~ N(0, wide²) and white noise, at the best noise of each axis, nats."""
    total = 0.0
    for column, sd in zip(track.T, wide, strict=True):
        y = column[np.isfinite(column)]
        size = len(y)
        r2 = (jitter * np.geomspace(0.5, 4.0, 13)) ** 2
        # y ~ N(0, r² I + sd² 1 1ᵀ)
        inner = 1 + size * sd**2 / r2
        square = (y**2).sum() / r2 - (sd * y.sum() / r2) ** 2 / inner
        log = -0.5 * (square + size * np.log(2 * math.pi * r2) + np.log(inner))
        total += float(log.max())
    return total
