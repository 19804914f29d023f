# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # From the film to the torque
#
# So far somebody had tracked the joints for us. Here we begin one step earlier, with a film. A small network learns
# from a few labelled pictures where the joints are. Its tracks become torques, and the model of the arm then tells
# which pictures the network got wrong. At the end several cameras look at an arm in space.
#
# **You will learn**
#
# * how a network turns pictures into keypoints, and what its confidence is worth;
# * why a tracker's error is no white noise, and what that does to the bands of a torque;
# * how the equations of motion find the pictures that need a label;
# * why pixels of several cameras say more than points triangulated of them.
#
# You need [notebook 1](01_planar_arm.py) and `pip install 'invdyn[tracking,video]'`. Three exercises stand at the end.

# %% tags=["hide-input"]
# %matplotlib inline
import logging
import tempfile
import warnings
from pathlib import Path

warnings.filterwarnings("ignore", r"\s*ArviZ is undergoing", FutureWarning)
warnings.filterwarnings("ignore", "IProgress not found")
logging.getLogger("arviz").setLevel(logging.ERROR)

import matplotlib.pyplot as plt
import numpy as np
import torch

from invdyn.film import write_mp4
from invdyn.inference import infer, pooled
from invdyn.models import Body, Joint, Link, planar_body
from invdyn.plots import BLUE, GREY, PURPLE, STYLE, VERMILION
from invdyn.recordings import Recording
from invdyn.recordings.cameras import Calibration, Camera, Views, filmed, project
from invdyn.recordings.tracking.choose import different, surprising
from invdyn.recordings.tracking.film import Film, read_pictures
from invdyn.recordings.tracking.heatmap import normalised
from invdyn.recordings.tracking.labels import Labels
from invdyn.recordings.tracking.tracker import track_film
from invdyn.recordings.tracking.training import examples, train
from invdyn.simulate import random_arm, record
from invdyn.surprise import surprise

plt.rcParams.update(STYLE | {"figure.constrained_layout.use": True, "figure.dpi": 90})
torch.set_num_threads(1)

# %% [markdown]
# ## A film
#
# A simulated arm swings for three seconds under random torques, so that we know the answer. We draw it in pictures of
# 64 pixels with noise, and compress them as a telephone would. Half a second long a ball of the wrist's own colour
# rolls through the picture.

# %%
body = planar_body(
    "arm",
    [
        Link("upper_arm", joint="shoulder", tip="elbow", length=0.30, mass=1.5),
        Link("forearm", joint="elbow", tip="wrist", length=0.25, mass=1.0),
    ],
)
exact, truth = record(random_arm(body, duration=3, fps=30.0, noise=1e-5, seed=3), seed=3)
NAMES, SIZE, SCALE, SHOULDER = ("elbow", "wrist"), 64, 0.02, np.array([31.5, 20.0])  # px, metres a pixel, px
pixels = SHOULDER + exact.keypoints / SCALE * [1, -1]  # v points down
ROLLS = range(50, 65)
grid = np.stack(np.meshgrid(np.arange(SIZE), np.arange(SIZE)), -1)
rng = np.random.default_rng(0)
wall = 40 + 60 * rng.random((8, 8, 1)).repeat(8, 0).repeat(8, 1).repeat(3, 2)


def dot(picture, place, radius, colour):
    cover = np.clip(radius + 0.5 - np.linalg.norm(grid - place, axis=-1), 0, 1)[..., None]
    return (1 - cover) * picture + cover * np.array(colour)


def drawn(number):
    elbow, wrist = pixels[number]
    picture = wall
    for start, stop in ((SHOULDER, elbow), (elbow, wrist)):
        for share in np.linspace(0, 1, 20):
            picture = dot(picture, start + share * (stop - start), 1.6, (150, 150, 150))
    picture = dot(dot(picture, elbow, 2.5, (200, 60, 60)), wrist, 2.5, (60, 200, 60))
    if number in ROLLS:
        picture = dot(picture, (4 + 4 * (number - ROLLS.start), 56), 2.5, (60, 200, 60))
    return np.clip(picture + rng.normal(0, 6, picture.shape), 0, 255).astype(np.uint8)


path = Path(tempfile.mkdtemp()) / "arm.mp4"
write_mp4(map(drawn, range(exact.num_frames)), exact.time, path)
film = Film(path)
print(f"{film.expected} pictures of {film.width} × {film.height} px")

# %% [markdown]
# ## A network that learns from few labels
#
# The network gives each pixel $x$ a score $h_p(x)$ for each keypoint $p$. The softmax of the scores is a map, a
# distribution over the picture. Training pulls it towards a small bell $t_p$ around the label:
#
# $$\text{loss} = -\sum_p \sum_x t_p(x) \log \operatorname{softmax}(h_p)(x).$$
#
# The peak of the map is the keypoint. The mass near the peak, calibrated on labels that were held out, is its
# confidence. Which pictures should be labelled? Such as differ from one another: the next is always the one farthest
# from all that are chosen. Here nobody labels a picture with the ball. `invdyn label` shows a page to click on; we
# know the joints and take them.

# %%
chosen = different(film, 16, list(ROLLS))


def taught(numbers):
    """Network from labels of these pictures, and its tracks of the film: (T, 2, 3), px, px, confidence."""
    given = examples([film], [Labels(np.array(numbers), pixels[numbers], NAMES)], SIZE)
    network = train(given, steps=140, widths=(12, 16, 24)).tracker
    return network, track_film(film, network)[1]


network, tracks = taught(chosen)
error = np.linalg.norm(tracks[..., :2] - pixels, axis=-1)
strays = np.flatnonzero((error > 3).any(1))
elbow, wrist = np.median(error, 0)
print(f"labels: {len(chosen)} of {film.expected} pictures")
print(f"median error: elbow {elbow:.2f} px, wrist {wrist:.2f} px")
print(f"off by more than 3 px: pictures {strays.tolist()}, all while the ball rolls")

shown = [chosen[1], int(strays[-1])]
pictures = np.stack(list(read_pictures(film, shown)))
with torch.no_grad():
    scores = network.network(normalised(torch.from_numpy(pictures), network.mean, network.deviation))
maps = scores.flatten(2).softmax(-1).reshape(scores.shape).numpy()
figure, panels = plt.subplots(1, 4, figsize=(10, 2.7))
for k, number in enumerate(shown):
    panels[2 * k].imshow(pictures[k])
    panels[2 * k].plot(*tracks[number, :, :2].T, "+", color="white", markersize=12)
    panels[2 * k].set(title=f"picture {number}: tracks")
    panels[2 * k + 1].imshow(np.sqrt(maps[k, 1]), cmap="Purples")
    panels[2 * k + 1].set(title="root of the wrist's map")
for axes in panels:
    axes.set(xticks=[], yticks=[])
    axes.grid(False)
plt.show()

# %% [markdown]
# ## Tracks become torques
#
# From here on the film is a recording like any other: pixels times a scale, relative to the shoulder. Noise comes
# from Student's distribution, whose heavy tails forgive a stray, and confidence widens it. Forgiven is not forgotten,
# though. A band holds 90 % of the truth only if the model's noise is the tracker's.

# %%
metres = (tracks[..., :2] - SHOULDER) * SCALE * [1, -1]
recording = Recording(exact.time, metres, NAMES, tracks[..., 2])


def bands(posterior, sampled="torque"):
    """Draws (N, T, K), and their 90 % bands."""
    draws = pooled(posterior)[sampled].transpose("sample", "time", "joint").values
    return draws, *np.quantile(draws, [0.05, 0.95], axis=0)


def told(name, posterior, true):
    draws, low, high = bands(posterior)
    held = ((low <= true) & (true <= high)).mean()
    off, sd = np.sqrt(((draws.mean(0) - true) ** 2).mean()), np.sqrt(draws.var(0).mean())
    print(f"{name}: bands hold {held:.2f} of the torques; rms error {off:.3f} N·m, stated {sd:.3f} N·m")


LIKELIEST = {"method": "laplace", "family": "student_t", "seed": 0}
posterior = infer(recording, body, **LIKELIEST)
told("film", posterior, truth.torque)
white = exact.keypoints + np.median(error) * SCALE * np.random.default_rng(1).standard_normal(metres.shape)
told("white noise of that size", infer(Recording(exact.time, white, NAMES), body, **LIKELIEST), truth.torque)

clean = np.where((error > 3)[..., None], np.nan, tracks[..., :2] - pixels).reshape(film.expected, 4)
alike = [np.ma.corrcoef(*np.ma.masked_invalid([each[:-1], each[1:]]))[0, 1] for each in clean.T]
print(f"an error is like that of the picture before it: correlation {np.mean(alike):.2f}")

_, low, high = bands(posterior)
figure, panels = plt.subplots(1, 2, figsize=(10, 2.6))
for k, (axes, joint) in enumerate(zip(panels, truth.joint_names, strict=True)):
    axes.axvspan(exact.time[ROLLS.start], exact.time[ROLLS.stop], color=GREY, alpha=0.2, linewidth=0)
    axes.fill_between(exact.time, low[:, k], high[:, k], color=PURPLE, alpha=0.3, linewidth=0, label="90 % band")
    axes.plot(exact.time, truth.torque[:, k], color="black", linewidth=1, label="truth")
    axes.set(title=f"{joint}; grey: the ball rolls", xlabel="time (s)", ylabel="torque (N·m)")
panels[0].legend()
plt.show()

# %% [markdown]
# The tracker's bands hold less than they say; with white noise of that size they would be right. A network that sees
# the wrist half a pixel too low often sees it too low in the next picture, too. The model believes in fresh noise
# each time, and takes what lasts for motion.
#
# ## Which pictures surprise the model
#
# Keypoint $y_p$ at a row has a predictive mean $m_p$ and covariance $C_p$. Its surprise is
#
# $$d_p^2 = (y_p - m_p)^\top C_p^{-1} (y_p - m_p).$$
#
# An arm cannot jump to a ball and back within a thirtieth of a second, whatever the network thinks of its map.

# %%
surprises = surprise(posterior)
worst = surprising(surprises, np.arange(film.expected), 6, chosen)
off = np.isin(np.arange(film.expected), strays)
found, least = off[worst].sum(), tracks[..., 2].min(1)
print(f"six most surprising pictures: {worst}; {found} of them are off by more than 3 px")
print(f"surprise of a stray: {surprises[off].min():.1f} and more; of the others: {surprises[~off].max():.1f} at most")
print(f"as unsure as the surest stray: {(least[~off] <= least[off].max()).sum()} pictures that are right")

figure, panels = plt.subplots(1, 2, figsize=(10, 2.6))
for axes, values, name in ((panels[0], surprises, "surprise"), (panels[1], least, "least confidence")):
    axes.plot(exact.time[~off], values[~off], ".", color=BLUE, markersize=4, label="tracked")
    axes.plot(exact.time[off], values[off], "x", color=VERMILION, markersize=6, label="off by more than 3 px")
    axes.set(title=name, xlabel="time (s)")
panels[0].set_yscale("log")
panels[0].set_yticks([1, 10], ["1", "10"])
panels[0].legend()
plt.show()

# %% [markdown]
# These pictures are worth a label: `invdyn label arm.mp4 --out labels.csv --posterior arm.nc` offers them. Exercise 1
# does.
#
# ## Several cameras
#
# An arm in space needs two views. The usual way triangulates: of each row the point nearest to the rays of all
# cameras, and then an inverse dynamics of the points. We ask the pixels themselves,
#
# $$y_{cp} \sim \text{Student-t}(\pi_c(X_p(\theta)) + b_{cp},\, \sigma),\qquad
#   b_{cp}(t + \delta) \sim \mathcal N(a\, b_{cp}(t),\, \beta^2 (1 - a^2)),\quad a = e^{-\delta/\ell}.$$
#
# Camera $c$ projects point $X_p$ by $\pi_c$. The bias $b_{cp}$ says that its error lasts, about $\ell$ seconds. It is
# part of the state, and its size β is learned. We play two cameras whose detections are off by 1.5 px of noise and by
# 6 px that last 0.3 s; one in twenty is missing. The torques' size is given, and the noise is fitted.

# %%
NOISE, BIAS, LASTS, RATE = 1.5, 6.0, 0.3, 30.0
down = ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0))
thick, thin = (0.003, 0.015, 0.015, 0.0, 0.0, 0.0), (0.002, 0.008, 0.008, 0.0, 0.0, 0.0)
ball = Joint("shoulder", "universal")
arm = Body(
    "arm in space",
    [
        Link("upper", ball, rotation=down, length=0.3, tip="elbow", mass=2.0, inertia=thick),
        Link("fore", Joint("elbow", "universal"), parent="upper", length=0.25, tip="wrist", mass=1.2, inertia=thin),
    ],
)
points, known = record(random_arm(arm, duration=1.5, fps=RATE, noise=1e-5, torque_scale=0.25, seed=0), seed=0)


def camera(name, angle):
    """On a circle of 3 m, looking at its middle."""
    ahead = -np.array([np.cos(angle), np.sin(angle), 0.0])
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    rotation = np.stack([right, np.cross(ahead, right), ahead])
    matrix = [[1100.0, 0, 640], [0, 1100.0, 480], [0, 0, 1]]
    return Camera(name, matrix, [0.0] * 5, rotation, 3 * rotation @ ahead, (1280, 960))


cameras = Calibration((camera("front", 0.0), camera("side", np.pi / 2)), metric=True)
rng = np.random.default_rng(0)
seen = np.stack([project(each, points.keypoints) for each in cameras], 1)  # (T, C, P, 2) px
keep, lasting = np.exp(-1 / (RATE * LASTS)), BIAS * rng.standard_normal(seen.shape)
for t in range(1, len(seen)):
    lasting[t] = keep * lasting[t - 1] + np.sqrt(1 - keep**2) * lasting[t]
seen = seen + lasting + NOISE * rng.standard_t(4, seen.shape)
seen[rng.random(seen.shape[:3]) < 0.05] = np.nan
shot = filmed(Views(cameras, points.time, seen, np.ones(seen.shape[:3]), NAMES))
ways = {"pixels": shot, "triangulated points": Recording(shot.time, shot.keypoints, NAMES)}
size = {"torque.scale": 0.25 * 10**0.5, "torque.decay": 5.0}  # as played: 0.25 N·m, for a fifth of a second
answers = {name: infer(each, arm, settings=size, **LIKELIEST) for name, each in ways.items()}
for name, answer in answers.items():
    told(name, answer, known.torque)

figure, panels = plt.subplots(1, 2, figsize=(10, 2.6), sharey=True)
for axes, (name, answer) in zip(panels, answers.items(), strict=True):
    _, low, high = bands(answer)
    axes.fill_between(shot.time, low[:, 1], high[:, 1], color=PURPLE, alpha=0.3, linewidth=0)
    axes.plot(shot.time, known.torque[:, 1], color="black", linewidth=1)
    axes.set(title=f"{known.joint_names[1]}, from {name}", xlabel="time (s)")
panels[0].set_ylabel("torque (N·m)")
plt.show()

# %% [markdown]
# From the pixels the error is smaller, and the bands know of it. One film is an anecdote:
# `benchmarks/simulated_cameras.py` plays many. A row in which one camera lost the wrist is not lost either: the other
# camera's pixel still counts, while there is nothing to triangulate. From a terminal it is
# `invdyn infer front.csv side.csv --calibration cameras.toml --body arm.toml --out torque.nc`. [A film, and
# nothing else](../docs/how-to/film.md) goes through the commands; `benchmarks/README.md` has the same on real films.
#
# ## Exercises
#
# **1. A round of labels.** Label the six surprising pictures and train again. What becomes of the strays?

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
again = np.linalg.norm(taught(sorted(chosen + worst))[1][..., :2] - pixels, axis=-1)
print(f"pictures off by more than 3 px: {len(strays)} before, {(again > 3).any(1).sum()} after six labels more")

# %% [markdown]
# **2. How many pictures count?** An error that lasts $\ell$ has the correlation $a^{|k|}$ between pictures $k$ apart.
# The mean of $n$ such errors has a variance of about $\beta^2 / n_\text{eff}$ with $n_\text{eff} = n (1-a)/(1+a)$. How
# many independent pictures are the 45 of ours worth?

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
n = len(shot.time)
lag = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
print(f"n (1 − a)/(1 + a) = {n * (1 - keep) / (1 + keep):.1f} of {n}")
print(f"exactly, 1 / mean of all correlations: {1 / (keep**lag).mean():.1f}")
print("A model that takes them for white believes its mean to be about four times as sure as it is.")

# %% [markdown]
# **3. The same pixels, taken for white.** Give the errors their right size and no memory: `emission.bias_scale` of
# almost nothing, `emission.pixel_scale` of both together. What do the bands hold?

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
forgets = {"emission.pixel_scale": float(np.hypot(NOISE, BIAS)), "emission.bias_scale": 1e-3}
told("white", infer(shot, arm, settings=size | forgets, **LIKELIEST), known.torque)
print("The projection is the same, and so are the pixels: it is the memory of the error that makes bands honest.")
