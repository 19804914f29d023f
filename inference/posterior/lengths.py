"""Lengths of links from what was recorded: the median distance between neighbouring joints, where learning begins."""

from dataclasses import replace

import numpy as np

from invdyn.models import ArticulatedBody, Body, Learned
from invdyn.models.bodies.scalars import nominal
from invdyn.recordings import InputError, Recording


def with_observed_lengths(recording: Recording, body: ArticulatedBody) -> ArticulatedBody:
    """The body whose links are as long as the median distance between neighbouring joints, in the recording's unit.

    Of a tree in space its sticks are, which begin where another one ends or at a given place of the world, and their
    lengths are learned from there. A link keeps its own length where an end of it is unseen. Raises InputError for a
    body that has no lengths.
    """
    if not isinstance(body, Body) or all(link.length is None for link in body.links):
        raise InputError(f"body '{body.name}' has no links of a length that could be learned: leave out learn_lengths")
    tips = {link.name: link.tip for link in body.links}
    links = []
    for link, parent in zip(body.links, body.parents, strict=True):
        if link.length is None:
            links.append(link)
            continue
        start = np.full((1, body.dimensions), np.nan)
        if parent < 0:
            start = np.array([[nominal(x) for x in link.origin or (0.0, 0.0, 0.0)][: body.dimensions]])
        elif link.origin is None and (tip := tips[link.parent]) in recording.keypoint_names:
            start = recording.keypoint(tip)
        end = recording.keypoint(link.tip) if link.tip in recording.keypoint_names else start * np.nan
        length = _median_distance(start, end) or nominal(link.length)
        links.append(replace(link, length=length if body.is_chain else Learned(length)))
    return replace(body, links=links)


def _median_distance(start: np.ndarray, end: np.ndarray) -> float | None:
    """Between points (T, d), where both are seen; None where they never are."""
    distance = np.linalg.norm(end - start, axis=-1)
    seen = np.isfinite(distance)
    return float(np.median(distance[seen])) if seen.any() else None
