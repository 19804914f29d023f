"""Networks in place of BlazePose's: they see coloured discs, so that what is around them can be checked to a pixel."""

import numpy as np

from invdyn.recordings.tracking.blazepose import ANCHORS, DETECTOR_SIDE, LANDMARKS_SIDE

COLOURS = {
    "hips": (255, 0, 0),
    "circle": (0, 255, 0),
    "shoulder": (0, 0, 255),
    "elbow": (255, 255, 0),
    "wrist": (0, 255, 255),
}
LANDMARK = {33: "hips", 34: "circle", 12: "shoulder", 14: "elbow", 16: "wrist"}


def person(middle, turn=0.0, tall=60.0):
    """Places of a person's discs, px, who stands with the head up, or is rotated clockwise."""
    cos, sin = np.cos(turn), np.sin(turn)
    upright = {"hips": (0, 0), "circle": (0, -1), "shoulder": (0.2, -0.6), "elbow": (0.45, -0.5), "wrist": (0.5, -0.2)}
    rotation = tall * np.array([[cos, -sin], [sin, cos]])
    return {name: np.array(middle) + rotation @ np.array(place) for name, place in upright.items()}


def painted(people, size=(300, 400)):
    """RGB (H, W, 3) of discs of 4 px on black."""
    v, u = np.mgrid[: size[0], : size[1]]
    rgb = np.zeros((*size, 3))
    for each in people:
        for name, (x, y) in each.items():
            cover = np.clip(4.5 - np.hypot(u - x, v - y), 0, 1)[..., None]
            rgb = (1 - cover) * rgb + cover * COLOURS[name]
    return rgb.astype(np.uint8)


def centres(picture, name):
    """Centroids (N, 2) of all discs of a colour, in px of a picture (H, W, 3) from 0 to 1."""
    from scipy.ndimage import center_of_mass, label

    like = (np.abs(picture - np.array(COLOURS[name]) / 255) < 0.3).all(-1)
    numbered, count = label(like)
    return np.array([center_of_mass(like, numbered, k + 1)[::-1] for k in range(count)]).reshape(-1, 2)


def detector(pictures):
    """People by the two discs that say where they are: (1, anchors, 12) and scores (1, anchors, 1)."""
    picture = (pictures[0] + 1) / 2
    boxes, scores = np.zeros((len(ANCHORS), 12)), np.full((len(ANCHORS), 1), -10.0)
    circles = centres(picture, "circle")
    for hips in centres(picture, "hips"):
        circle = circles[np.hypot(*(circles - hips).T).argmin()]
        nearest = np.hypot(*(ANCHORS - (hips + 0.5) / DETECTOR_SIDE).T).argmin()
        for anchor, score in ((nearest, 3.0), (nearest + 1, 2.0)):  # its neighbours see the same person
            both = (np.stack([hips, circle]) + 0.5) / DETECTOR_SIDE
            boxes[anchor, 4:8] = ((both - ANCHORS[anchor]) * DETECTOR_SIDE).ravel()
            scores[anchor] = score
    return [boxes[None], scores[None]]


def landmarks(pictures):
    """The discs nearest to the middle: (1, 195), presence, and maps whose peaks are low."""
    picture = pictures[0]
    rows = np.zeros((39, 5))
    found = [centres(picture, name) for name in LANDMARK.values()]
    present = all(len(each) for each in found)
    if present:
        for k, each in zip(LANDMARK, found, strict=True):
            middle = each[np.hypot(*(each - LANDMARKS_SIDE / 2).T).argmin()]
            rows[k] = [*(middle + 0.5), 0, 4.0, 4.0]
    maps = np.full((1, 64, 64, 39), -20.0)
    return [rows.reshape(1, -1), np.array([[1.0 if present else 0.0]]), None, maps, None]
