"""The arm, true to length, with the share of the gap at each joint, link and keypoint."""

import math

import numpy as np
from markupsafe import Markup

from invdyn.diagnosis.assessment.posture import Posture
from invdyn.diagnosis.assessment.result import Diagnosis
from invdyn.diagnosis.report.numbers import known, percent
from invdyn.diagnosis.report.sentences import best
from invdyn.diagnosis.rules import FIXED


class View:
    """Metres to the units of a picture: y up becomes y down, one scale for both."""

    def __init__(self, points: np.ndarray, size: tuple[int, int], room: tuple[int, int]):
        points = points[np.isfinite(points).all(-1)]
        low, high = (points.min(0), points.max(0)) if len(points) else (np.zeros(2), np.ones(2))
        span = np.maximum(high - low, 1e-9)
        free = np.array(size) - 2 * np.array(room)
        self.scale = float(min(free / span)) if (high > low).any() else 1.0
        self._middle, self._centre = (low + high) / 2, np.array(size) / 2

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """(…, 2) m to picture units."""
        return self._centre + (np.asarray(points, float) - self._middle) * self.scale * np.array([1.0, -1.0])


def arm(diagnosis: Diagnosis) -> Markup:
    """The drawing; of a body in space one from the side and one from the front."""
    if (body := diagnosis.posture) is None:
        return Markup("")
    return Markup("").join(_seen(diagnosis, body, body.points @ view.T) for view in body.views)


def _seen(diagnosis: Diagnosis, body: Posture, points: np.ndarray) -> Markup:
    """One picture of points (N, 2)."""
    names = (*diagnosis.joint_names, *diagnosis.where.keypoints)
    side = 26 + 8 * min(max(map(len, names), default=0), FIXED.max_name_letters)
    span = np.ptp(points, 0)
    height = int(
        np.clip(
            (FIXED.arm_width - 2 * side) * span[1] / max(span[0], 1e-9) + 2 * FIXED.arm_margin,
            FIXED.min_arm_height,
            FIXED.max_arm_height,
        )
    )
    view = View(points, (FIXED.arm_width, height), (side, FIXED.arm_margin))
    spots = view(points)
    where = diagnosis.where
    cause = best(diagnosis)
    links = {f.where["link"]: cause.probability for f in cause.effects if "link" in f.where} if cause else {}
    root = body.lines[0][1]
    below = 1 if spots[body.lines[0][2]][1] < spots[root][1] else -1
    drawn, named = [_ground(spots[root], below)], set()
    for k, start, end in body.lines:
        share = links.get(diagnosis.link_names[k]) if diagnosis.gap.detected and k >= 0 else None
        (x0, y0), (x1, y1) = spots[start], spots[end]
        drawn.append(
            Markup('<path class="link s{}" d="M{:.1f} {:.1f}L{:.1f} {:.1f}"/>').format(level(share), x0, y0, x1, y1)
        )
        if share is not None and k not in named:
            middle = (spots[start] + spots[end]) / 2
            text = f"{_short(diagnosis.link_names[k])} {percent(share)}"
            drawn.append(_words(middle, [text], [spot - middle for spot in (spots[start], spots[end])], 0.0))
            named.add(k)
    for n, spot in enumerate(spots):
        joints = [diagnosis.joint_names[k] for k, node in enumerate(body.joints) if node == n]
        words = [[_short(name), *map(percent, filter(known, [where.joints.get(name)]))] for name in joints]
        lines = [" ".join(each) for each in words] if len(joints) > 1 else [line for each in words for line in each]
        if joints:
            share = max((where.joints.get(name) for name in joints), key=lambda s: s if known(s) else -1.0)
            mark = '<circle class="joint s{}" cx="{:.1f}" cy="{:.1f}" r="{:.1f}"/>'
            drawn.append(Markup(mark).format(level(share), *spot, 7 + 6 * (share if known(share) else 0)))
        for name in [name for name, node in body.keypoints.items() if node == n and name in where.keypoints]:
            share = where.keypoints.get(name)
            r = f"{4 + 5 * (share if known(share) else 0):.1f}"
            mark = '<path class="keypoint s{}" d="M{:.1f} {:.1f}l{r} {r}l-{r} {r}l-{r} -{r}Z"/>'
            drawn.append(Markup(mark).format(level(share), spot[0], spot[1] - float(r), r=r))
            if name in joints and known(share):
                lines.append(f"seen {percent(share)}")
            elif not joints or (known(share) and share >= 0.005):
                lines += [_short(name)] + ([percent(share)] if known(share) else [])
        ends = [{start: end, end: start}[n] for _, start, end in body.lines if n in (start, end)]
        neighbours = [spots[end] - spot for end in ends]
        if n == root:
            neighbours.append(np.array([0.0, float(below)]))
        drawn.append(_words(spot, lines, neighbours))
    shares = [f"{name} {percent(share)}" for name, share in (*where.joints.items(), *where.keypoints.items())]
    return Markup('<svg class="arm" viewBox="0 0 {} {}" role="img" aria-label="{}">{}</svg>').format(
        FIXED.arm_width,
        height,
        f"The arm with the share of the gap at each place: {', '.join(shares)}",
        Markup("").join(drawn),
    )


def level(share: float | None) -> int:
    """Class of a share, 0 (none) to 4 (nearly all)."""
    return 0 if not known(share) else int(np.searchsorted([0.05, 0.25, 0.5, 0.8], share, side="right"))


def _short(name: str) -> str:
    return name if len(name) <= FIXED.max_name_letters else f"{name[: FIXED.max_name_letters - 1]}…"


def _words(spot: np.ndarray, lines: list[str], neighbours: list[np.ndarray], level_first: float = 0.5) -> Markup:
    """Lines of text next to `spot`, in the direction furthest from its neighbours, level ones preferred, then up."""
    if not lines:
        return Markup("")
    away = [math.atan2(n[1], n[0]) for n in neighbours]

    def clear(turn: float) -> float:
        nearest = min((abs(math.remainder(turn - a, math.tau)) for a in away), default=math.pi)
        return min(nearest, 1.4) + level_first * abs(math.cos(turn)) - 0.05 * math.sin(turn)

    turn = max((i * math.pi / 4 for i in range(8)), key=clear)
    x, y = spot + 19 * np.array([math.cos(turn), math.sin(turn)])
    anchor = "start" if math.cos(turn) > 0.3 else "end" if math.cos(turn) < -0.3 else "middle"
    top = y + 4 - 16 * (len(lines) - 1) * (1 - math.sin(turn)) / 2
    texts = [
        Markup('<text x="{:.1f}" y="{:.1f}" text-anchor="{}">{}</text>').format(x, top + 16 * i, anchor, line)
        for i, line in enumerate(lines)
    ]
    return Markup("").join(texts)


def _ground(spot: np.ndarray, side: int) -> Markup:
    """What the base is fixed to, on the `side` (+1 below, −1 above) that the first link does not go to."""
    x, y = spot[0], spot[1] + 20 * side
    hatch = "".join(f"M{x - 16 + 8 * i:.1f} {y:.1f}l-5 {7 * side}" for i in range(5))
    plate = f"M{x:.1f} {spot[1]:.1f}V{y:.1f}M{x - 20:.1f} {y:.1f}h40"
    return Markup('<path class="ground" d="{}"/>').format(plate + hatch)
