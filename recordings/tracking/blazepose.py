"""A person's arm without labels: BlazePose, run by plain torch.

Bazarevsky et al., "BlazePose: On-device real-time body pose tracking" (CVPR workshop, 2020); details are those of
MediaPipe's graphs (`pose_detection_cpu`, `pose_landmark_cpu`). A detector finds people in the whole picture, made
square: for each of its anchors a score, the middle of the hips, and a point on a circle round the body. A square about
that circle, turned so that the body stands upright, is what the second network sees: 39 landmarks, two of which say
where the square of the next picture is. So the detector is needed only where nobody is followed.

A square is (u, v, side, turn): centre and side in px, turn in rad. A place p in it, from −½ to ½, is at
centre + side R(turn) p.
"""

from collections.abc import Callable

import numpy as np
import torch
import torch.nn.functional as F

from ..errors import InputError
from .blazepose_weights import load_graphs
from .graph import Graph

ARM = {"left": (11, 13, 15), "right": (12, 14, 16)}
"""Landmarks of shoulder, elbow and wrist; left and right are the person's own."""
DETECTOR_SIDE, LANDMARKS_SIDE, MAP_SIDE = 224, 256, 64  # px
LANDMARKS, CENTRE, CIRCLE = 39, 33, 34
LARGER = 1.25  # a square's side against the circle's diameter
SURE = 0.5  # scores from here on count
ROOM = 1.5  # side of the square in which a person is looked for, against the box's longer one
APART = 0.5  # people whose centres are closer than so many radii are one
REACH = 3  # cells of a heat map to either side, over which a landmark is refined


class PersonTracker:
    """See `tracker.Tracker`; keypoints are shoulder, elbow and wrist of one arm.

    Args:
        detector, landmarks: the two networks.
        arm: left or right, the person's own.
        person: left, right or largest in the picture, or a box about them where they are seen first: u and v of its
            upper left corner, width, height, px; None where one alone is in view.
    """

    keypoint_names: tuple[str, ...] = ("shoulder", "elbow", "wrist")
    picture_size: tuple[int, int] | None = None

    def __init__(
        self, detector: Graph, landmarks: Graph, arm: str, person: str | tuple[float, float, float, float] | None = None
    ):
        self.detector, self.landmarks = detector, landmarks
        self.arm, self.person = ARM[arm], person
        self.memory = np.empty(0)

    def track(self, picture: np.ndarray) -> np.ndarray:
        """RGB (H, W, 3) uint8 to (3, 3), NaN where nobody is found.

        Raises InputError where several people are in view and none was chosen.
        """
        found = None
        if len(self.memory) and self.memory[4]:
            found = self._look(picture, self.memory[:4])
        if found is None and (square := self._detect(picture)) is not None:
            found = self._look(picture, square)
        if found is None:
            self.memory = self.memory * [1, 1, 1, 1, 0] if len(self.memory) else self.memory
            return np.full((3, 3), np.nan)
        places, confidence, square = found
        self.memory = np.append(square, 1.0)
        return np.column_stack([places[list(self.arm)], confidence[list(self.arm)]])

    def _detect(self, picture: np.ndarray) -> np.ndarray | None:
        """The square about the person who is asked for; once seen, whoever is nearest to where they were."""
        height, width = picture.shape[:2]
        whole = np.array([(width - 1) / 2, (height - 1) / 2, max(height, width), 0.0])
        if len(self.memory):
            squares = self._people(picture, whole)
            return _nearest(squares, self.memory[:2]) if len(squares) else None
        if isinstance(self.person, tuple):
            u, v, across, down = self.person
            centre = np.array([u + across / 2, v + down / 2])
            squares = self._people(picture, np.array([*centre, ROOM * max(across, down), 0.0]))
            return _nearest(squares, centre) if len(squares) else None
        squares = self._people(picture, whole)
        if len(squares) < 2:
            return squares[0] if len(squares) else None
        if self.person is None:
            where = " and ".join(f"({u:.0f}, {v:.0f})" for u, v, *_ in squares)
            raise InputError(
                f"{len(squares)} people are in view, about {where} px: choose one, --person left, right, largest or "
                "a box u,v,width,height"
            )
        column = {"left": squares[:, 0], "right": -squares[:, 0], "largest": -squares[:, 2]}[self.person]
        return squares[column.argmin()]

    def _people(self, picture: np.ndarray, within: np.ndarray) -> np.ndarray:
        """Squares (N, 4) about all people that the detector sees in a square."""
        found, scores = self.detector(cut(picture, within, DETECTOR_SIDE) * 2 - 1)
        boxes, score = found[0].numpy(), scores[0, :, 0].sigmoid().numpy()
        good = np.flatnonzero(score >= SURE)
        good = good[np.argsort(-score[good], kind="stable")]
        points = boxes[good, 4:8].reshape(-1, 2, 2) / DETECTOR_SIDE + ANCHORS[good, None] - 0.5
        squares: list[np.ndarray] = []
        for centre, circle in within[:2] + within[2] * points:
            square = about(centre, circle)
            if all(np.hypot(*(square[:2] - other[:2])) > APART * other[2] / (2 * LARGER) for other in squares):
                squares.append(square)
        return np.array(squares).reshape(-1, 4)

    def _look(self, picture: np.ndarray, square: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """Landmarks (39, 2) px of the person in the square, their visibility, and the next square; None if nobody."""
        outputs = self.landmarks(cut(picture, square, LANDMARKS_SIDE))
        rows, presence, maps = outputs[0].reshape(LANDMARKS, 5), float(outputs[1]), outputs[3][0]
        if presence < SURE:
            return None
        places = refined(rows[:, :2].numpy() / LANDMARKS_SIDE, maps.sigmoid().numpy()) - 0.5
        pixels = square[:2] + square[2] * places @ turned(square[3]).T
        return pixels, rows[:, 3].sigmoid().numpy(), about(pixels[CENTRE], pixels[CIRCLE])


def person_tracker(
    arm: str, person: str | None, progress: Callable[[int, int, str], None] | None = None
) -> PersonTracker:
    """The tracker of a person's arm, its weights fetched at need.

    Raises InputError for words that choose neither an arm nor a person, and as `load_graphs`.
    """
    if arm not in ARM:
        raise InputError(f"--arm is left or right, the person's own, got {arm!r}")
    chosen: str | tuple[float, float, float, float] | None = person
    if person is not None and person not in ("left", "right", "largest"):
        try:
            u, v, across, down = (float(each) for each in person.split(","))
        except ValueError:
            u = v = across = down = np.nan
        if not (np.isfinite([u, v]).all() and 0 < across < np.inf and 0 < down < np.inf):
            raise InputError(f"--person is left, right, largest, or a box u,v,width,height in px, got {person!r}")
        chosen = (u, v, across, down)
    graphs = load_graphs(progress)
    return PersonTracker(graphs["detector"], graphs["landmarks"], arm, chosen)


def _nearest(squares: np.ndarray, place: np.ndarray) -> np.ndarray:
    return squares[np.hypot(*(squares[:, :2] - place).T).argmin()]


def about(centre: np.ndarray, circle: np.ndarray) -> np.ndarray:
    """The square about a circle with that centre and a point on it, above the head of who stands in the square."""
    right, down = circle - centre
    return np.array([*centre, 2 * LARGER * np.hypot(right, down), np.arctan2(right, -down)])


def turned(angle: float) -> np.ndarray:
    """Rotation (2, 2) of pixels, clockwise as one sees them."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, -sin], [sin, cos]])


def cut(picture: np.ndarray, square: np.ndarray, side: int) -> torch.Tensor:
    """What is in a square, (1, side, side, 3) from 0 to 1, black beyond the picture; bilinear."""
    axes = turned(square[3]) * square[2]
    reach = np.abs(axes).sum(1) / 2
    low = np.clip(np.floor(square[:2] - reach) - 1, 0, None).astype(int)
    high = np.ceil(square[:2] + reach).astype(int) + 2
    part = picture[low[1] : max(high[1], 0), low[0] : max(high[0], 0)]  # only this is turned into floats
    if 0 in part.shape:
        return torch.zeros(1, side, side, 3)
    size = np.array([part.shape[1], part.shape[0]])
    # affine_grid counts from −1 to 1 across both pictures
    theta = np.column_stack([axes / size[:, None], (square[:2] - low + 0.5) / size * 2 - 1])
    pixels = torch.from_numpy(np.ascontiguousarray(part)).permute(2, 0, 1)[None].float()
    grid = F.affine_grid(torch.tensor(theta[None], dtype=torch.float32), [1, 3, side, side], align_corners=False)
    return F.grid_sample(pixels, grid, align_corners=False).permute(0, 2, 3, 1) / 255


def refined(places: np.ndarray, maps: np.ndarray) -> np.ndarray:
    """Places (39, 2) from 0 to 1, moved to the mean of their heat map (64, 64, 39) nearby, where it is sure."""
    moved = places.copy()
    for k, (u, v) in enumerate((places * MAP_SIDE).astype(int)):
        if not (0 <= u < MAP_SIDE and 0 <= v < MAP_SIDE):
            continue
        top, left = max(v - REACH, 0), max(u - REACH, 0)
        near = maps[top : v + REACH + 1, left : u + REACH + 1, k]
        if near.max() >= SURE:
            rows, columns = np.indices(near.shape)
            moved[k] = np.array([(near * (left + columns)).sum(), (near * (top + rows)).sum()]) / near.sum() / MAP_SIDE
    return moved


def _anchors() -> np.ndarray:
    """(N, 2) centres, from 0 to 1, of the detector's anchors: two for each cell of its layers, which share a grid
    where their strides are the same.
    """
    centres = []
    for stride, layers in ((8, 1), (16, 1), (32, 3)):
        cells = DETECTOR_SIDE // stride
        v, u = np.mgrid[:cells, :cells]
        grid = (np.stack([u, v], -1).reshape(-1, 2) + 0.5) / cells
        centres.append(np.repeat(grid, 2 * layers, 0))
    return np.concatenate(centres)


ANCHORS = _anchors()
