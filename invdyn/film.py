"""A film of the arm: observed and predicted joints above, the torques with a moving time line below.

In space it is seen from two sides, x and z from the front, y and z from the side. Lines join the points as the body
has them; others are forces of contacts, and on bodies at joints. In the plane it may lie over the tracked film.

The still parts (axes, torque bands) are drawn once; each frame restores them and draws a few artists on top,
so that it costs milliseconds. The film has the recording's own speed. GIF by Pillow, MP4 by
imageio-ffmpeg (extra `video`).
"""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import arviz as az
import matplotlib
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from PIL import Image

from invdyn.inference import pooled
from invdyn.recordings import InputError, atomic_path

from .console import check_ending
from .plots import (
    AXIS_COLORS,
    BLUE,
    GREEN,
    INK,
    OF_CONTACT,
    ORANGE,
    PURPLE,
    STYLE,
    VERMILION,
    actuator_curves,
    draw_bands,
    draw_truth,
    draw_unseen,
    quantiles,
    unit_of,
    unseen_entry,
)

if TYPE_CHECKING:
    from .overlay import Overlay

FILM_SUFFIXES = (".gif", ".mp4")
FRAMES_PER_SECOND = 35  # at most; faster recordings show every second, third … frame
MAX_SHOWN_FRAMES = 750  # longer recordings show fewer frames a second, at the same speed
ARMS = 30  # posterior draws shown as pale arms
VIEWS = {2: [(0, 1)], 3: [(0, 2), (1, 2)]}
"""Of each number of coordinates: which two each picture shows."""
WIDTH = 6.4  # inches
LONGEST = 0.3  # of the arm's size, the line of the largest force
OF_JOINT = ("reaction_force", "joint_centre")
TRAIL = 0.3  # s of its past that the last observed keypoint draws behind it


def save_film(
    idata: az.InferenceData,
    path: str | Path,
    progress: Callable[[int, int, str], None] | None = None,
    overlay: "Overlay | None" = None,
) -> None:
    """Write the film as `path` says (.gif or .mp4), whole or not at all; `progress(done, total, what)`.

    With an `overlay`, the arm is drawn over the pictures of another film.

    Raises:
        InputError: another suffix, or .mp4 without imageio-ffmpeg.
        OSError: the place cannot be written.
    """
    check_film(path)
    time = idata["posterior"]["time"].values
    shown = shown_frames(time)
    frames = film_frames(idata, shown, progress, overlay)
    with atomic_path(path) as temporary:
        write = write_gif if temporary.suffix.lower() == ".gif" else write_mp4
        write(frames, time[shown], temporary)


def check_film(path: str | Path) -> None:
    """Raise InputError when a film of this suffix cannot be made here; call it before a long run."""
    check_ending("a film", Path(path), *FILM_SUFFIXES)
    if Path(path).suffix.lower() == ".mp4":
        try:
            import imageio_ffmpeg  # noqa: F401
        except ImportError:
            raise InputError(f"{path}: mp4 needs `pip install 'invdyn[video]'`; .gif works without") from None


def shown_frames(time: np.ndarray) -> np.ndarray:
    """Indices of the frames that the film shows, evenly spaced; time (T,) s."""
    rate = 1 / np.median(np.diff(time))
    # a rate of 35.0001 is not worth dropping every second frame
    stride = max(1, round(rate / FRAMES_PER_SECOND + 0.49), -(-len(time) // MAX_SHOWN_FRAMES))
    return np.arange(0, len(time), stride)


def film_frames(
    idata: az.InferenceData,
    shown: np.ndarray,
    progress: Callable[[int, int, str], None] | None = None,
    overlay: "Overlay | None" = None,
) -> Iterator[np.ndarray]:
    """Yield an image (height, width, 3) uint8 for each frame in `shown`; height and width are even."""
    arms, lines = arm_points(idata), skeleton(idata)
    mean = arms.mean(axis=0)
    arms = arms[np.linspace(0, len(arms) - 1, min(ARMS, len(arms)), dtype=int)]
    time, views = idata["posterior"]["time"].values, VIEWS[arms.shape[-1]]
    if "position" in idata["observed_data"]:
        observed = idata["observed_data"]["position"].transpose("time", "keypoint", "space").values
    else:
        observed = np.full((len(time), 1, arms.shape[-1]), np.nan)
    forces, inks = force_lines(idata, float(np.ptp(mean, axis=(0, 1)).max()))
    if overlay is not None:
        arms, mean, observed, forces = map(overlay.pixels, (arms, mean, observed, forces))
    dotted = ":" if len(views) == 1 else "none"  # a chain's keypoints follow each other; a tree's need not
    with matplotlib.rc_context(STYLE):
        figure, arm_axes, torque_axes = still_parts(idata, arms, observed, None if overlay is None else overlay.size)
        canvas = FigureCanvasAgg(figure)
        pictures = [Picture(axes, list(view), dotted, inks) for axes, view in zip(arm_axes, views, strict=True)]
        clock = arm_axes[-1].set_title(f"{time[-1]:.2f} s", loc="right")  # above the picture, not over it
        cursors = [axes.axvline(time[0], color=INK, linewidth=1) for axes in torque_axes]
        moving: list[Any] = [*(artist for picture in pictures for artist in picture.artists), clock, *cursors]
        if overlay is not None:
            axes, (height, width) = arm_axes[0], overlay.size
            (left, right), (bottom, top) = across, down = axes.get_xlim(), axes.get_ylim()
            box = max(0, int(left)), max(0, int(top)), min(width, int(right) + 2), min(height, int(bottom) + 2)
            film, edges = overlay.pictures(shown, box), np.array(box) - 0.5  # a pixel's centre is a whole number
            beneath = axes.imshow(np.zeros((1, 1, 3)), extent=tuple(edges[[0, 2, 3, 1]]), zorder=0)
            axes.set(xlim=across, ylim=down, xlabel="u (px)", ylabel="v (px)")
            moving.insert(0, beneath)
        for artist in moving:
            artist.set_animated(True)
        canvas.draw()
        still = canvas.copy_from_bbox(figure.bbox)
        for number, frame in enumerate(shown):
            canvas.restore_region(still)
            if overlay is not None:
                beneath.set_data(next(film))
            recent = (time > time[frame] - TRAIL) & (time <= time[frame])
            for picture in pictures:
                picture.show(
                    arms[:, frame], mean[frame], lines, observed[frame], observed[recent, -1], forces[:, frame]
                )
            clock.set_text(f"{time[frame]:.2f} s")
            for cursor in cursors:
                cursor.set_xdata([time[frame], time[frame]])
            for artist in moving:
                artist.axes.draw_artist(artist)
            yield np.asarray(canvas.buffer_rgba())[:, :, :3].copy()
            if progress is not None:
                progress(number + 1, len(shown), "film")


def arm_points(idata: az.InferenceData) -> np.ndarray:
    """Base and sites (sample, time, 1 + S, d) of posterior draws, the filters weighted by their evidence.

    Raises InputError for a motion neither in the plane nor in space.
    """
    sites = pooled(idata)["position"].transpose("sample", "time", "keypoint", "space").values
    if sites.shape[-1] not in VIEWS:
        raise InputError(f"a film shows a motion in the plane or in space, not in {sites.shape[-1]} dimensions")
    base = np.asarray(idata["constant_data"].get("base", np.zeros(sites.shape[-1])))
    if "base_position" in idata["posterior"]:
        base = pooled(idata)["base_position"].transpose("sample", "time", "space").values[:, :, None]
    return np.concatenate([np.broadcast_to(base, (*sites.shape[:2], 1, sites.shape[-1])), sites], axis=2)


def skeleton(idata: az.InferenceData) -> list[list[int]]:
    """Lines, as numbers of the `arm_points` along each: as the body says, or one through all of them."""
    if "skeleton" not in idata["constant_data"]:
        return [list(range(idata["posterior"].sizes["keypoint"] + 1))]
    lines: list[list[int]] = []
    for start, end in (idata["constant_data"]["skeleton"].values + 1).tolist():
        line = next((line for line in lines if line[-1] == start), None)
        if line is None:
            lines.append(line := [start])
        line.append(end)
    return lines


def force_lines(idata: az.InferenceData, size: float) -> tuple[np.ndarray, list[str]]:
    """Lines (force, time, 2, d) from where mean forces act along them, of contacts, then of joints; and their colours.

    NaN where a pair does not touch.
    """
    space = [list(AXIS_COLORS).index(str(name)) for name in idata["posterior"]["space"].values]
    draws, lines, inks = pooled(idata), [np.empty((idata["posterior"].sizes["time"], 0, 2, 3))], []
    for dim, names, ink in (("contact", OF_CONTACT, GREEN), ("link", OF_JOINT, ORANGE)):
        if set(names) <= set(draws):
            force, place = (draws[name].transpose("sample", "time", dim, "axis").values for name in names)
            known = np.isfinite(place).sum(0)
            middle = np.where(known > 0, np.nansum(place, 0), np.nan) / np.maximum(known, 1)
            lines.append(np.stack([middle, force.mean(0)], 2))
            inks += [ink] * force.shape[2]
    ends = np.concatenate(lines, 1)
    ends[:, :, 1] *= LONGEST * size / max(np.linalg.norm(ends[:, :, 1], axis=-1).max(initial=0), 1e-9)
    return ends.cumsum(2)[..., space].swapaxes(0, 1), inks


class Picture:
    """One view of the arm, with what moves in it: pale arms of posterior draws, their mean, what was observed.

    And forces of contacts and joints.
    """

    def __init__(self, axes: Axes, view: list[int], dotted: str, inks: Sequence[str] = (GREEN,)):
        self.view = view
        self.draws = LineCollection([], colors=BLUE, alpha=0.12, linewidths=2.5)
        (self.trail,) = axes.plot([], [], color=VERMILION, alpha=0.5, linewidth=1)
        self.arm = LineCollection([], colors=BLUE, linewidths=2)
        (self.joints,) = axes.plot([], [], "o", color=BLUE, markersize=5)
        (self.dots,) = axes.plot(
            [], [], "o", linestyle=dotted, color=VERMILION, linewidth=1, markersize=6, mfc="none", mew=1.6
        )
        self.forces = LineCollection([], colors=inks, linewidths=2)
        for collection in (self.draws, self.arm, self.forces):
            axes.add_collection(collection)
        self.artists: list[Any] = [self.draws, self.trail, self.arm, self.joints, self.dots, self.forces]

    def show(
        self,
        draws: np.ndarray,
        mean: np.ndarray,
        lines: list[list[int]],
        observed: np.ndarray,
        recent: np.ndarray,
        forces: np.ndarray,
    ) -> None:
        """One frame: `draws` (sample, 1 + S, d), `mean` (1 + S, d), `observed` (P, d), the last one's past (t, d).

        And lines of `forces` (force, 2, d).
        """
        self.forces.set_segments(list(forces[..., self.view]))
        self.draws.set_segments([arm for line in lines for arm in draws[:, line][..., self.view]])
        self.arm.set_segments([mean[line][:, self.view] for line in lines])
        self.joints.set_data(*mean[sorted({place for line in lines for place in line})][:, self.view].T)
        self.dots.set_data(*observed[:, self.view].T)
        self.trail.set_data(*recent[:, self.view].T)


def still_parts(
    idata: az.InferenceData, arms: np.ndarray, observed: np.ndarray, film: tuple[int, int] | None
) -> tuple[Figure, list[Axes], list[Axes]]:
    """Figure with the arm's axes, one a view, and each joint's torque over time; everything but what moves.

    Axes are cropped to where the arm moves; over a ``film``, (height, width) px, they stay within its pictures.
    """
    joints = idata["posterior"]["joint"].values
    time = idata["posterior"]["time"].values
    unit, views = idata["posterior"]["position"].attrs["units"], VIEWS[arms.shape[-1]]
    shown = "torque" if "torque" in idata["posterior"] else "angle"  # a kinematic model knows no forces
    bands, known = quantiles(idata, shown), idata["constant_data"]
    curves = [(f"{joint} {shown}", unit_of(idata, shown, k), bands[..., k]) for k, joint in enumerate(joints)]
    curves += next(iter(actuator_curves(idata).values()), [])  # activations, else actuators' forces
    columns = max(1 if len(curves) <= 3 else 2, len(views))
    rows = -(-len(curves) // columns)
    # a tracker's outlier must not shrink the arm to a dot
    none, drawn = np.empty((0, arms.shape[-1])), sorted({place for line in skeleton(idata) for place in line})
    far = np.nanpercentile(observed, (1, 99), axis=(0, 1)) if np.isfinite(observed).any() else none
    points = np.concatenate([arms[:, :, drawn].reshape(-1, arms.shape[-1]), far])
    low, high = points.min(0), points.max(0)
    margin = 0.08 * max((high - low).max(), 1e-9)
    low, high = low - margin, high + margin
    if film is not None:
        low, high = np.maximum(low, -0.5), np.minimum(high, np.array(film[::-1]) - 0.5)
    spans = [(high - low)[list(view)] for view in views]
    tall = float(np.clip(max(up / across for across, up in spans) * WIDTH / len(views), 0.35 * WIDTH, WIDTH))
    figure = Figure(figsize=(WIDTH, tall + 0.6 + 1.2 * rows), dpi=100, layout="constrained")
    grid = figure.add_gridspec(rows + 1, columns, height_ratios=[tall] + [1.2] * rows)
    arm_axes = []
    for number, view in enumerate(views):
        axes = figure.add_subplot(grid[0, :] if len(views) == 1 else grid[0, number])
        (left, bottom), (right, top) = low[list(view)], high[list(view)]
        axes.set(xlim=(left, right), ylim=(bottom, top) if film is None else (top, bottom), aspect="equal")
        across, up = (idata["posterior"]["space"].values[place] for place in view)
        axes.set(xlabel=f"{across} ({unit})", ylabel=f"{up} ({unit})")
        arm_axes.append(axes)
    torque_axes = []
    for number, (title, own_unit, own) in enumerate(curves):
        axes = figure.add_subplot(grid[1 + number // columns, number % columns])
        draw_bands(axes, time, own, PURPLE if number < len(joints) else ORANGE)
        if number < len(joints):
            draw_unseen(axes, idata, number)
            if f"truth_{shown}" in known:
                draw_truth(axes, time, known[f"truth_{shown}"].values[:, number])
        axes.set_title(f"{title} ({own_unit})" if own_unit else title, loc="left")
        axes.set_xlim(time[0], time[-1])
        if number >= len(curves) - columns:
            axes.set_xlabel("time (s)")
        else:
            axes.tick_params(labelbottom=False)
        torque_axes.append(axes)
    entries: list[Artist] = [
        Line2D([], [], color=VERMILION, ls="none", marker="o", mfc="none", mew=1.6, label="observed"),
        Line2D([], [], color=BLUE, marker="o", label="predicted"),
        Line2D([], [], color=BLUE, alpha=0.3, linewidth=2.5, label="posterior draws"),
    ]
    if f"truth_{shown}" in known:
        entries.append(Line2D([], [], color=INK, linewidth=1, dashes=(4, 2), label="truth"))
    for (name, _), color, label in ((OF_CONTACT, GREEN, "force"), (OF_JOINT, ORANGE, "joint's reaction")):
        if name in idata["posterior"]:
            entries.append(Line2D([], [], color=color, linewidth=2, label=label))
    entries += unseen_entry(idata)
    figure.legend(handles=entries, loc="outside upper left", ncols=4)
    figure.align_ylabels()
    return figure, arm_axes, torque_axes


def write_gif(frames: Iterator[np.ndarray], time: np.ndarray, path: Path) -> None:
    """Write frames shown at `time` s, all in one palette, so that unchanged pixels cost nothing."""
    hundredths = np.round(100 * (time - time[0])).astype(int)  # a GIF's clock: rounding must not add up
    durations = 10 * np.maximum(np.diff(hundredths), 2)
    durations = [*durations.tolist(), 1000]  # rest a second before the film starts again
    # the film's own colours fading into white: a palette taken from one frame would tint the others
    inks = np.array([to_rgb(color) for color in (INK, BLUE, VERMILION, PURPLE, GREEN, ORANGE)])
    shades = 1 - np.linspace(0, 1, 16)[:, None, None] * (1 - inks)
    palette = Image.new("P", (1, 1))
    palette.putpalette(np.round(255 * shades).astype(np.uint8).tobytes())
    images = (Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames)
    with path.open("wb") as file:  # opened here, so that an interrupt closes it
        next(images).save(file, "GIF", save_all=True, append_images=images, duration=durations, loop=0)


def write_mp4(frames: Iterator[np.ndarray], time: np.ndarray, path: Path) -> None:
    """Write frames at the mean rate of `time` s (H.264)."""
    import imageio_ffmpeg

    first = next(frames)
    height, width = first.shape[:2]
    rate = (len(time) - 1) / (time[-1] - time[0])
    writer = imageio_ffmpeg.write_frames(path, (width, height), fps=rate, macro_block_size=2)
    writer.send(None)
    try:
        writer.send(first)
        for frame in frames:
            writer.send(np.ascontiguousarray(frame))
    finally:
        writer.close()
