"""Keypoints of a person's arm without labels: BlazePose.

Bazarevsky et al., "BlazePose: On-device real-time body pose tracking" (CVPR workshop, 2020); details are those of
MediaPipe's graphs (`pose_detection_cpu`, `pose_landmark_cpu`). A detector finds people in the whole picture, which is
padded to a square. For each of its anchors it gives a score, the middle of the hips, and a point on a circle around
the body. The square about that circle, rotated such that the body is upright, is the input of the second network. That
one gives 39 landmarks, two of which define the square of the next picture. So the detector is needed only for pictures
that follow one in which no person was found.

A square is (u, v, side, angle): centre and side in px, angle in rad. A point p in it, from −½ to ½ on each axis, is at
centre + side R(angle) p.
"""

from collections.abc import Callable

import numpy as np
import torch
import torch.nn.functional as F
from scipy.special import expit

from ..errors import InputError
from .blazepose_weights import Network, load_networks

ARM = {"left": (11, 13, 15), "right": (12, 14, 16)}
"""Landmarks of shoulder, elbow and wrist; left and right are the person's own."""
DETECTOR_SIDE, LANDMARKS_SIDE, MAP_SIDE = 224, 256, 64  # px of the networks' pictures and heat maps
LANDMARKS, CENTRE, CIRCLE = 39, 33, 34  # of MediaPipe's model: their number, two auxiliary ones
SQUARE_TO_CIRCLE = 1.25  # side of a square over the circle's diameter
MIN_SCORE = 0.5  # of a person or of a heat map's peak
BOX_MARGIN = 1.5  # side of the square that is searched for a person over the longer side of the user's box
MIN_SEPARATION = 0.5  # of two people's centres, in radii of their circle: nearer ones are one person
REFINE_CELLS = 3  # of a heat map, on each side of a landmark


class PersonTracker:
    """See `tracker.Tracker`; keypoints are shoulder, elbow and wrist of one arm.

    Args:
        detector, landmarks: the two networks.
        arm: left or right, the person's own.
        person: which one to follow: left, right or largest in the picture where a person is seen first, or a box about
            them there: u and v of its upper left corner, width, height, px. None if only one person is in view.
    """

    keypoint_names: tuple[str, ...] = ("shoulder", "elbow", "wrist")
    picture_size: tuple[int, int] | None = None

    def __init__(
        self,
        detector: Network,
        landmarks: Network,
        arm: str,
        person: str | tuple[float, float, float, float] | None = None,
    ):
        self.detector, self.landmarks = detector, landmarks
        self.arm, self.person = list(ARM[arm]), person
        self.memory = np.empty(0)
        """The last square, and 1 if a person was found in the last picture, else 0."""

    def track(self, picture: np.ndarray) -> np.ndarray:
        """RGB (H, W, 3) uint8 to (3, 3), NaN where no person is found.

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
        return np.column_stack([places[self.arm], confidence[self.arm]])

    def _detect(self, picture: np.ndarray) -> np.ndarray | None:
        """The square about the chosen person; once seen, about the one nearest to where they were."""
        height, width = picture.shape[:2]
        whole = np.array([(width - 1) / 2, (height - 1) / 2, max(height, width), 0.0])
        if len(self.memory):
            return _nearest(self._people(picture, whole), self.memory[:2])
        if isinstance(self.person, tuple):
            u, v, box_width, box_height = self.person
            centre = np.array([u + box_width / 2, v + box_height / 2])
            region = np.array([*centre, BOX_MARGIN * max(box_width, box_height), 0.0])
            return _nearest(self._people(picture, region), centre)
        squares = self._people(picture, whole)
        if len(squares) < 2:
            return squares[0] if len(squares) else None
        if self.person is None:
            where = " and ".join(f"({u:.0f}, {v:.0f})" for u, v, *_ in squares)
            raise InputError(
                f"{len(squares)} people are in view, about {where} px: choose one, --set person=left, right, "
                "largest or a box u,v,width,height"
            )
        column = {"left": squares[:, 0], "right": -squares[:, 0], "largest": -squares[:, 2]}[self.person]
        return squares[column.argmin()]

    def _people(self, picture: np.ndarray, region: np.ndarray) -> np.ndarray:
        """Squares (N, 4) about all people that the detector finds in a square region."""
        boxes, scores = self.detector(crop(picture, region, DETECTOR_SIDE) * 2 - 1)
        score = expit(scores[0, :, 0])
        good = np.flatnonzero(score >= MIN_SCORE)
        good = good[np.argsort(-score[good], kind="stable")]
        points = boxes[0, good, 4:8].reshape(-1, 2, 2) / DETECTOR_SIDE + ANCHORS[good, None] - 0.5
        squares: list[np.ndarray] = []
        for centre, circle in region[:2] + region[2] * points:
            square = square_about(centre, circle)
            radii = [other[2] / (2 * SQUARE_TO_CIRCLE) for other in squares]
            distances = [np.hypot(*(square[:2] - other[:2])) for other in squares]
            if all(d > MIN_SEPARATION * r for d, r in zip(distances, radii, strict=True)):
                squares.append(square)
        return np.array(squares).reshape(-1, 4)

    def _look(self, picture: np.ndarray, square: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """Landmarks (39, 2) px of the person in a square, their visibility, and the next square.

        None if no person is there.
        """
        outputs = self.landmarks(crop(picture, square, LANDMARKS_SIDE))
        rows, presence, maps = outputs[0].reshape(LANDMARKS, 5), outputs[1].item(), outputs[3][0]
        if presence < MIN_SCORE:
            return None
        places = refined(rows[:, :2] / LANDMARKS_SIDE, expit(maps)) - 0.5
        pixels = square[:2] + square[2] * places @ rotation(square[3]).T
        return pixels, expit(rows[:, 3]), square_about(pixels[CENTRE], pixels[CIRCLE])


def person_tracker(
    arm: str, person: str | None, progress: Callable[[int, int, str], None] | None = None
) -> PersonTracker:
    """The tracker of a person's arm; its weights are fetched at need.

    Raises InputError for words that choose neither an arm nor a person, and as `load_networks`.
    """
    if arm not in ARM:
        raise InputError(f"an arm is left or right, the person's own, got {arm!r}")
    chosen: str | tuple[float, float, float, float] | None = person
    if person is not None and person not in ("left", "right", "largest"):
        try:
            u, v, width, height = (float(each) for each in person.split(","))
        except ValueError:
            u = v = width = height = np.nan
        if not (np.isfinite([u, v]).all() and 0 < width < np.inf and 0 < height < np.inf):
            raise InputError(f"person is left, right, largest, or a box u,v,width,height in px, got {person!r}")
        chosen = (u, v, width, height)
    networks = load_networks(progress)
    return PersonTracker(networks["detector"], networks["landmarks"], arm, chosen)


def _nearest(squares: np.ndarray, place: np.ndarray) -> np.ndarray | None:
    return squares[np.hypot(*(squares[:, :2] - place).T).argmin()] if len(squares) else None


def square_about(centre: np.ndarray, circle: np.ndarray) -> np.ndarray:
    """The square about a circle with that centre and a point on it, which is above the head of an upright person."""
    right, down = circle - centre
    return np.array([*centre, 2 * SQUARE_TO_CIRCLE * np.hypot(right, down), np.arctan2(right, -down)])


def rotation(angle: float) -> np.ndarray:
    """Rotation (2, 2) of pixels, clockwise as one sees them."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, -sin], [sin, cos]])


def crop(picture: np.ndarray, square: np.ndarray, side: int) -> np.ndarray:
    """A square's content, (1, side, side, 3) float32 from 0 to 1, black outside the picture; bilinear."""
    axes = rotation(square[3]) * square[2]
    reach = np.abs(axes).sum(1) / 2
    low = np.clip(np.floor(square[:2] - reach) - 1, 0, None).astype(int)
    high = np.ceil(square[:2] + reach).astype(int) + 2
    part = picture[low[1] : max(high[1], 0), low[0] : max(high[0], 0)]  # only this becomes floats
    if 0 in part.shape:
        return np.zeros((1, side, side, 3), np.float32)
    size = np.array([part.shape[1], part.shape[0]])
    # affine_grid counts from −1 to 1 across both pictures
    theta = np.column_stack([axes / size[:, None], (square[:2] - low + 0.5) / size * 2 - 1])
    pixels = torch.from_numpy(np.ascontiguousarray(part)).permute(2, 0, 1)[None].float()
    grid = F.affine_grid(torch.tensor(theta[None], dtype=torch.float32), [1, 3, side, side], align_corners=False)
    return (F.grid_sample(pixels, grid, align_corners=False).permute(0, 2, 3, 1) / 255).contiguous().numpy()


def refined(places: np.ndarray, maps: np.ndarray) -> np.ndarray:
    """Places (39, 2) from 0 to 1, moved to the mean of their heat map (64, 64, 39) around them.

    A place stays where no cell around it reaches `MIN_SCORE`.
    """
    moved = places.copy()
    for k, (u, v) in enumerate((places * MAP_SIDE).astype(int)):
        if not (0 <= u < MAP_SIDE and 0 <= v < MAP_SIDE):
            continue
        top, left = max(v - REFINE_CELLS, 0), max(u - REFINE_CELLS, 0)
        near = maps[top : v + REFINE_CELLS + 1, left : u + REFINE_CELLS + 1, k]
        if near.max() >= MIN_SCORE:
            rows, columns = np.indices(near.shape)
            moved[k] = np.array([(near * (left + columns)).sum(), (near * (top + rows)).sum()]) / near.sum() / MAP_SIDE
    return moved


def _anchors() -> np.ndarray:
    """Centres (N, 2), from 0 to 1, of the detector's anchors.

    Each cell has two for each layer of its stride; layers of the same stride share a grid.
    """
    centres = []
    for stride, layers in ((8, 1), (16, 1), (32, 3)):
        cells = DETECTOR_SIDE // stride
        v, u = np.mgrid[:cells, :cells]
        grid = (np.stack([u, v], -1).reshape(-1, 2) + 0.5) / cells
        centres.append(np.repeat(grid, 2 * layers, 0))
    return np.concatenate(centres)


ANCHORS = _anchors()
