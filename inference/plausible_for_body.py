"""Whether a recording can be one of a body: lengths, times and angles against it, in the plane and in space.

:mod:`invdyn.recordings.plausible` compares numbers with numbers; here these are a body's.
"""

import warnings
from collections.abc import Sequence
from itertools import combinations

import numpy as np
import torch

from invdyn.models import ArticulatedBody, Body
from invdyn.models.dynamics.registry import dynamics_for
from invdyn.recordings import Recording, check_in_space, check_plausible
from invdyn.recordings.cameras import Filmed
from invdyn.recordings.errors import about
from invdyn.recordings.jitter import jitter
from invdyn.recordings.limits import PLAUSIBLE
from invdyn.recordings.plausible import BASE, check_shifts
from invdyn.recordings.repairs import repaired
from invdyn.recordings.zero_likelihood import without_zeros

POSES = (0.0, 0.7, -1.3)
"""Of all coordinates, each one's a little further on: what keeps its distance in all of them always does."""
ROUNDING = 1e-9
"""Of the reach: what a distance may change by for rounding."""


def check_fits(recording: Recording, body: ArticulatedBody, guessed: bool = False) -> None:
    """Raise InputError for distances, times or speeds that are not this body's, unless its units were declared.

    Keypoints are in the body's frame, or the base is tracked. Lengths are ``guessed`` where the body does not state
    them, or the caller says so. Of a body of another kind than a chain in the plane or a tree, nothing is checked.
    """
    if isinstance(body, Body):
        recording = at_rest(recording, body)[0]
    if isinstance(body, Body) and body.is_chain:
        guessed = guessed or any(not isinstance(link.length, int | float) for link in body.links)
        guessed = guessed or body.uncertainty.get("length", 0.0) > 0
        recording = in_chain_order(recording, body)
        check_plausible(recording, [link.nominal("length") for link in body.links], body.base, guessed)
    elif isinstance(body, Body):
        numbers, dynamics = body.parameters(), dynamics_for(body)
        turning = {motion.name for _, motion in body.motions() if motion.turns}
        levers = zip(body.joint_names, dynamics.levers(numbers).tolist(), strict=True)
        check_in_space(
            recording,
            dynamics.reach(numbers).item(),
            rigid_distances(body) | (distances_of_base(body) if rooted(body) else {}),
            {joint: lever for joint, lever in levers if joint in turning},
            guessed or body.has_priors or bool(body.learned),
            numbers.position[0].tolist() if rooted(body) else None,
            numbers.position.norm(dim=-1).sum().item() + max(numbers.sites.norm(dim=-1).tolist(), default=0.0),
        )


def put_right(recording: Recording, body: ArticulatedBody) -> Recording:
    """A recording that may have been made in Python, repaired as those of files are (:mod:`invdyn.recordings.repairs`).

    Raises InputError where it is in other units than the body's, or in a unit that makes its motion another body's.
    Lengths may be uncertain here: they may be off by a factor of three (:func:`check_fits`).
    """
    if isinstance(recording, Filmed) or not isinstance(body, Body):
        return recording
    with about(recording.name):
        found = without_zeros(recording, recording.length_unit == "px", in_file=False)
        recording = repaired(found, slides(body))
        check_shifts(recording, slides(body))
        _warn_of_constants(recording, body.keypoint_names)
        check_fits(recording, body, guessed=True)
    return recording


def _warn_of_constants(recording: Recording, names: Sequence[str]) -> None:
    """Say which coordinates of keypoints never change, to the last digit, where those of others have noise."""
    points = recording.keypoints
    extent = np.fmax.reduce(points) - np.fmin.reduce(points)
    noise = jitter(points.reshape(len(points), -1)).reshape(extent.shape)
    still = (extent == 0) & (noise > PLAUSIBLE.least_noise * np.nanmax(extent, initial=0.0)).any(0)
    for place, axis in np.argwhere(still):
        if (name := recording.keypoint_names[place]) in names:
            words = f"{name}_{'xyz'[axis]} never changes, to the last digit, and other keypoints have noise"
            warnings.warn(f"{words}: if {name} was not seen, leave these cells empty", stacklevel=4)


def at_rest(recording: Recording, body: Body, base: str | None = None) -> tuple[Recording, str | None]:
    """The body's keypoints as of a base that stands still, where it is tracked, and the name of that track.

    ``base`` is a name that it may have besides the body's own.
    """
    known = (body.base_keypoint, base, site_at_base(body))
    seen = [name for name in recording.keypoint_names if np.isfinite(recording.keypoint(name)).any()]
    own = next((each for each in known if each in seen), None)
    if own is None or recording.keypoints.shape[-1] != body.dimensions:
        return recording, None
    steady = recording.relative_to(own).moved(body.base)
    return steady.with_keypoints([each for each in steady.keypoint_names if each in body.keypoint_names]), own


def in_chain_order(recording: Recording, body: Body) -> Recording:
    """The recording with its columns in the order of the chain; keypoints or joints of other names stay as they are."""
    points = _order(recording.keypoint_names, (body.joint_names[0], *body.keypoint_names))
    return recording.with_keypoints(points).with_joints(_order(recording.joint_names, body.joint_names))


def _order(names: Sequence[str], known: Sequence[str]) -> Sequence[str]:
    """``names`` as they come among those that are known; in their own order where one is not."""
    return sorted(names, key=known.index) if set(names) <= set(known) else names


def slides(body: ArticulatedBody) -> set[str]:
    """Names of the joints that shift."""
    return {motion.name for _, motion in body.motions() if not motion.turns} if isinstance(body, Body) else set()


def rooted(body: Body) -> bool:
    """Whether all motions are turns, so that no site leaves the first joint's reach."""
    return all(motion.turns for _, motion in body.motions())


def rigid_distances(body: Body) -> dict[tuple[str, str], float]:
    """Distances, m, of two sites that keep it however the body moves."""
    points = _posed(body)
    apart = torch.cdist(points, points).numpy()
    found = {}
    for one, other in combinations(range(len(body.keypoint_names)), 2):
        lengths = apart[:, one, other]
        if np.ptp(lengths) <= ROUNDING * apart.max() < lengths[0]:
            found[body.keypoint_names[one], body.keypoint_names[other]] = float(lengths[0])
    return found


def distances_of_base(body: Body) -> dict[tuple[str, str], float]:
    """Distances, m, from the first joint's place to the sites that keep it."""
    if body.is_chain:
        return {(BASE, body.keypoint_names[0]): body.links[0].nominal("length")}
    apart = (_posed(body) - body.parameters().position[0]).norm(dim=-1).numpy()
    kept = np.ptp(apart, axis=0) <= ROUNDING * apart.max()
    places = zip(body.keypoint_names, kept & (apart[0] > ROUNDING * apart.max()), apart[0], strict=True)
    return {(BASE, name): float(length) for name, known, length in places if known}


def site_at_base(body: Body) -> str | None:
    """Name of a site of a tree that stays at the first joint's place, if there is one."""
    if body.is_chain or not body.keypoint_names or not rooted(body):
        return None
    apart = (_posed(body) - body.parameters().position[0]).norm(dim=-1)
    here = (apart <= ROUNDING * apart.max()).all(0).tolist()
    return next((name for name, at_base in zip(body.keypoint_names, here, strict=True) if at_base), None)


def _posed(body: Body) -> torch.Tensor:
    """Sites (poses, P, 3), m, of the body in each of some poses."""
    poses = [[pose + 0.37 * joint for joint in range(body.num_joints)] for pose in POSES]
    points: torch.Tensor = dynamics_for(body).keypoints(torch.tensor(poses, dtype=torch.float64), body.parameters())
    return points
