"""Plausibility of units: lengths against a body, angles against its keypoints, times against its speeds.

A wrong unit changes numbers by a factor of 10 or more. Refused are differences larger than those of all real recordings
at hand. A declared unit (`--units`) is accepted where only the size of numbers contradicts it.
"""

from collections.abc import Collection, Mapping, Sequence
from itertools import pairwise

import numpy as np

from .errors import InputError
from .exchanged_names import check_names
from .limits import PLAUSIBLE
from .pace import check_interval, froude
from .recording import Recording
from .si import median_distances
from .units import METRES, RADIANS, Units

BASE = "the base"
"""Name of the first joint's position, which is no keypoint."""


def check_magnitudes(recording: Recording) -> None:
    """Raise InputError when lengths are too large for metres, or undeclared angles for radians."""
    if recording.length_unit == "m" and (extent := _extent(recording)) > PLAUSIBLE.extent:
        raise InputError(
            f"keypoints extend over {extent:.3g} m, too much for one body; "
            + (_odd_columns(recording) or "these look like pixels: pass --units px (or mm, cm)")
        )
    if (units := recording.units).angle is None and recording.angles is not None:
        largest = np.nanmax(np.abs(recording.angles), initial=0.0)
        if largest > PLAUSIBLE.angle:
            raise InputError(
                f"angles reach {largest:.3g}, too much for radians; these look like degrees: "
                f"{units.put('deg')} ({units.accepts('rad')} if radians they are)"
            )


def check_shifts(recording: Recording, slides: Collection[str]) -> None:
    """Raise InputError where a joint that shifts does so by more than any body's is long: it is in mm, or cm."""
    if recording.angles is None:
        return
    for name, shift in zip(recording.joint_names, recording.angles.T, strict=True):
        known = shift[np.isfinite(shift)]
        if name in slides and known.size and (extent := float(np.ptp(known))) > PLAUSIBLE.extent:
            line = (
                f'write unit = "mm" (or "cm") in the line "angle = …" of [joints.{name}] in {recording.units.mapping}'
            )
            raise InputError(
                f"joint {name} shifts by {extent:.3g} m, too much for one body; these look like mm or cm: "
                f"{'write that column in m' if recording.units.mapping is None else line}"
            )


def check_plausible(
    recording: Recording,
    link_lengths: Sequence[float],
    base: Sequence[float] | None = (0.0, 0.0),
    guessed: bool = False,
) -> None:
    """Compare a recording with a body: distances, times and speeds, and angles with keypoints.

    Args:
        recording: keypoints along the chain: the K links' tips, or the base and then the K tips; angles of K joints.
        link_lengths: K lengths, in the recording's unit.
        base: position of the first joint in the recording's frame, when it is not itself a keypoint; None leaves the
            first link unchecked.
        guessed: lengths are to be learned, or uncertain.

    Raises:
        InputError: a distance that is off by more than a factor of 3, or too large by more than 1.5 for a length that
            is not guessed; names of two keypoints that are exchanged (:mod:`.exchanged_names`); times or speeds that
            are not this body's (:mod:`.pace`); angles that fit the keypoints in the other unit. With keypoints of
            another chain only the times are checked.
    """
    lengths, reach = list(link_lengths), float(sum(link_lengths))
    if recording.length_unit == "px":
        reach = 1.0  # of an arm whose size is not known, at most
    if recording.length_unit == "body length" and abs(reach - 1) > PLAUSIBLE.body_length_error:
        raise InputError(
            f"keypoints are in body lengths, but this body's links are {reach:.3g} long together: "
            "give lengths that add up to 1, or scale the keypoints by the body's own length"
        )
    count, angles = len(lengths), recording.angles
    known = len(recording.keypoint_names) in (count, count + 1)
    names = (BASE, *recording.keypoint_names)[-count - 1 :] if known else ()
    links = dict(zip(pairwise(names), lengths, strict=False))
    turned = angles is not None and angles.shape[1] == count
    levers = dict(zip(recording.joint_names, lengths, strict=True)) if turned else {}
    check_in_space(recording, reach, links, levers, guessed, base)
    tracks = _tracks(recording, base)
    nothing = np.full((recording.num_frames, recording.keypoints.shape[-1]), np.nan)
    along = {pair: tracks.get(pair[1], nothing) - tracks.get(pair[0], nothing) for pair in links}
    for (before, name), track in along.items() if recording.length_unit == "m" and recording.units.time is None else ():
        if (number := froude(track, recording.time, links[before, name])) > PLAUSIBLE.froude:
            raise InputError(
                f"{name} moves too fast: in a quarter of the rows it feels {number:.3g} times gravity about the joint "
                f"before it. Check --fps, and that times are seconds; {recording.units.accepts('s')} accepts them"
            )
    if along and angles is not None and turned:
        _check_agreement(np.stack(list(along.values()), axis=1), angles, recording.units)


def check_in_space(
    recording: Recording,
    reach: float,
    distances: Mapping[tuple[str, str], float],
    levers: Mapping[str, float],
    guessed: bool = False,
    base: Sequence[float] | None = None,
    farthest: float = np.inf,
) -> None:
    """Compare a recording with a body of any shape: constant distances, times and speeds.

    Args:
        recording: keypoints and angles, any of the body's.
        reach: of the body, m.
        distances: by two keypoints' names, m, of points at a constant distance; `BASE` is the first joint.
        levers: by joint, m, how far a rotation by one radian moves some point; without joints that shift.
        guessed: distances are to be learned, or uncertain.
        base: place of the first joint in the recording's frame, m, of a body that only rotates about it; else None.
        farthest: that a point of such a body may be from there, m.

    Raises:
        InputError: as `check_plausible`.
    """
    units = recording.units
    if units.time is None:
        check_interval(recording, reach)
    known = _tracks(recording, base)
    if base is not None:
        for name in recording.keypoint_names:
            (observed,) = median_distances(np.stack([known[BASE], known[name]], axis=1))
            if observed > (PLAUSIBLE.length_ratio if guessed else PLAUSIBLE.known_length_ratio) * farthest:
                raise InputError(
                    f"{name} lies {observed:.3g} m from the base (median), and the body reaches {farthest:.3g} m at "
                    "most: check --units, or pass --set base=NAME, the first joint's keypoint, if the recording has "
                    "another frame than the body"
                )
    known_distances = {pair: length for pair, length in distances.items() if set(pair) <= known.keys()}
    check_names(known, known_distances, recording.keypoint_names)
    _check_lengths(known, known_distances, guessed, recording)
    if (
        recording.angles is not None and units.angle is None and recording.length_unit == "m"
    ):  # elsewhere g is not known
        for name, angle in zip(recording.joint_names, recording.angles.T, strict=True):
            if name in levers:
                _check_turning(name, angle, recording.time, levers[name], units)


def _tracks(recording: Recording, base: Sequence[float] | np.ndarray | None) -> dict[str, np.ndarray]:
    """By name, tracks (T, S) of the keypoints, and of the first joint where its place, or its track, is known."""
    found = {name: recording.keypoints[:, place] for place, name in enumerate(recording.keypoint_names)}
    if base is not None:
        at = np.asarray(base)
        size = max(recording.keypoints.shape[-1], at.shape[-1])  # encoders alone have keypoints of no size
        found[BASE] = np.zeros((recording.num_frames, size))
        found[BASE][:, : at.shape[-1]] = at
    return found


def _odd_columns(recording: Recording) -> str:
    """Advice where some columns seem to be in a smaller unit than the others; "" where none are.

    Centimetres among metres are a hundred times as large, up to a link's own tolerance.
    """
    columns = {
        f"{name}_{'xyz'[axis]}": np.median(np.abs(values[np.isfinite(values)]))
        for name, own in zip(recording.keypoint_names, recording.keypoints.swapaxes(0, 1), strict=True)
        for axis, values in enumerate(own.T)
        if np.isfinite(values).any()
    }
    ranked = sorted(columns, key=lambda name: columns[name])
    for one, other in pairwise(ranked):
        small, large = columns[one], columns[other]
        if small > 0 and large * METRES["cm"] * PLAUSIBLE.length_ratio >= small * METRES["m"]:
            odd, rest = ranked[ranked.index(other) :], ranked[: ranked.index(other)]
            what = f"{', '.join(odd)} {'is' if len(odd) == 1 else 'are'} about {large:.3g}"
            return (
                f"{what}, {', '.join(rest)} at most about {small:.3g}: expected one unit in all columns; write those"
                " in mm or cm in m, or, if all are in one unit, pass --units px (or mm, cm)"
            )
    return ""


def _check_lengths(
    tracks: Mapping[str, np.ndarray], distances: Mapping[tuple[str, str], float], guessed: bool, recording: Recording
) -> None:
    unit = recording.length_unit
    longest = PLAUSIBLE.length_ratio if guessed else PLAUSIBLE.known_length_ratio
    for ends, length in distances.items():
        (observed,) = median_distances(np.stack([tracks[name] for name in ends], axis=1))
        if not np.isfinite(observed) or 1 / PLAUSIBLE.length_ratio <= observed / length <= longest:
            continue
        usual = (
            "check --units, --scale or the body's lengths; uncertain ones may be off by a factor of "
            f"{PLAUSIBLE.length_ratio:g}"
        )
        if unit == "px":
            usual = "scale the keypoints to the body's unit, by load(…, scale=metres a pixel) or in_body_lengths"
        raise InputError(
            f"{ends[0]} and {ends[1]} lie {observed:.3g} {unit} apart (median), but the body's link is {length:.3g} "
            f"{unit} long: {_odd_columns(recording) or usual}"
        )


def _check_turning(joint: str, angle: np.ndarray, time: np.ndarray, length: float, units: Units) -> None:
    if (number := froude(length * angle[:, None], time, length)) > PLAUSIBLE.froude:
        raise InputError(
            f"joint {joint} turns too fast: in a quarter of the rows the tip of its {length:.3g} m link feels "
            f"{number:.3g} times gravity. These look like degrees: {units.put('deg')}. If they are radians, "
            f"check that times are seconds; {units.accepts('rad')} accepts them"
        )


def _check_agreement(links: np.ndarray, angles: np.ndarray, units: Units) -> None:
    """Check angles (T, K) against the links (T, K, S), in the declared unit and in the other one."""
    if links.shape[-1] != 2:
        return
    seen = np.arctan2(links[..., 1], links[..., 0])

    def off(factor: float) -> float:
        difference = seen - factor * np.cumsum(angles, axis=1)
        wrapped = np.abs((difference + np.pi) % (2 * np.pi) - np.pi)
        return float(np.median(wrapped[np.isfinite(wrapped)])) if np.isfinite(wrapped).any() else np.nan

    declared = units.angle or "rad"
    other = "deg" if declared == "rad" else "rad"
    if off(1.0) > PLAUSIBLE.wrong_angle and off(RADIANS[other] / RADIANS[declared]) < PLAUSIBLE.right_angle:
        raise InputError(
            f"angles taken as {declared} are {off(1.0):.2g} rad (median) from the directions that the keypoints show, "
            f"taken as {other} they fit: {units.put(other)}"
        )


def _extent(recording: Recording) -> float:
    """Median over frames of the box diagonal of the keypoints; of a single keypoint's whole track."""
    points = recording.keypoints if recording.keypoints.shape[1] > 1 else recording.keypoints.swapaxes(0, 1)
    points = points[np.isfinite(points).all(axis=-1).any(axis=1)]  # rows may carry a command and no keypoints
    if len(points) == 0:
        return 0.0
    size = np.nanmax(points, axis=1) - np.nanmin(points, axis=1)
    return float(np.median(np.linalg.norm(size, axis=-1)))
