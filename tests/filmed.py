"""A film of a swinging stick, made here: red at its elbow, green at its wrist, about a shoulder that stands still."""

from fractions import Fraction

import av
import numpy as np

NAMES = ("elbow", "wrist")
SHOULDER = np.array([20.0, 12.0])
LENGTHS = 10.0, 9.0  # px


BODY = """name = "stick"
gravity = [0.0, -9.81]
base = [{base[0]}, {base[1]}]
[[links]]
name = "upper"
joint = "shoulder"
tip = "elbow"
length = {length[0]}
mass = 0.1
[[links]]
name = "lower"
joint = "elbow"
tip = "wrist"
length = {length[1]}
mass = 0.1
"""


def stick(scale):
    """The stick's body file, of so many metres a pixel."""
    return BODY.format(base=scale * SHOULDER * [1, -1], length=scale * np.array(LENGTHS))


def joints(time):
    """Angles (T, 2) rad from hanging at times (T,) s, as slow sines, and the joints (T, 2, 2) px, v down."""
    time = np.asarray(time)
    angle = np.stack([1.1 * np.sin(4.0 * time), 0.7 * np.sin(6.5 * time + 1.0)], -1)
    direction = np.cumsum(angle, -1)
    steps = np.stack([np.sin(direction), np.cos(direction)], -1) * np.array(LENGTHS)[:, None]
    return angle, SHOULDER + np.cumsum(steps, 1)


def picture(points, size=(40, 40)):
    """RGB (H, W, 3) uint8 of a stick through the shoulder and points (2, 2) px."""
    v, u = np.mgrid[: size[0], : size[1]]
    grid = np.stack([u, v], -1)
    rgb = np.full((*size, 3), 40.0) + 0.8 * v[..., None]
    for start, stop in ((SHOULDER, points[0]), (points[0], points[1])):
        along = stop - start
        share = np.clip((grid - start) @ along / (along @ along), 0, 1)
        distance = np.linalg.norm(grid - (start + share[..., None] * along), axis=-1)
        rgb += np.clip(1.6 - distance, 0, 1)[..., None] * 90
    for point, colour in zip(points, ((220, 20, 20), (20, 220, 20)), strict=True):
        cover = np.clip(3.0 - np.linalg.norm(grid - point, axis=-1), 0, 1)[..., None]
        rgb = (1 - cover) * rgb + cover * np.array(colour)
    return np.clip(rgb, 0, 255).astype(np.uint8)


def write_film(path, pictures, times):
    """Write pictures (H, W, 3) shown at times (T,) s, to the millisecond, without loss."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("png", rate=1000)
        stream.height, stream.width = pictures[0].shape[:2]
        stream.pix_fmt, stream.time_base = "rgb24", Fraction(1, 1000)
        stream.codec_context.time_base = Fraction(1, 1000)
        for rgb, time in zip(pictures, times, strict=True):
            frame = av.VideoFrame.from_ndarray(rgb, format="rgb24")
            frame.pts, frame.time_base = round(1000 * time), Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def swinging(path, frames=60, rate=30.0):
    """Write the film; its times (T,) s to the millisecond, and the joints (T, 2, 2) px."""
    times = np.round(np.arange(frames) / rate, 3)
    points = joints(times)[1]
    write_film(path, [picture(each) for each in points], times)
    return times, points
