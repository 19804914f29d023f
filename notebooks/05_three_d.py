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
# # An arm in space, and a mouse
#
# Real arms leave the plane. Half of [Biderman, Naesseth and colleagues (2020)](https://montrealrobotics.ca/diffcvgp/)
# lives in three dimensions: first a simulated arm whose torques are known, then the paw of a mouse. This notebook
# follows them. It shows what sampling costs in space. It asks what a camera of that quality can tell of torques at all.
# And it walks into three traps that the plane does not have: poles, aliases, and turns that nobody sees.
#
# **You will learn**
#
# - how much a camera tells of torques in space,
# - why a start must choose among poses that show the same points,
# - what a posterior says of turns that no keypoint shows,
# - how lengths and motion are learned without forces.
#
# It needs notebook 1, and runs in about half a minute.

# %%
# %matplotlib inline
import os
import warnings
from pathlib import Path

warnings.filterwarnings("ignore", r"\s*ArviZ is undergoing", FutureWarning)
warnings.filterwarnings("ignore", "IProgress not found")

import matplotlib.pyplot as plt
import numpy as np
import torch

from invdyn.inference import Problem, SMCOptions, infer_kinematics, learned_lengths, pooled, smc
from invdyn.inference.posterior.visibility import visibility
from invdyn.inputs import load_body
from invdyn.models import ArmModel, Body, Joint, KinematicModel, Link
from invdyn.models.inverse_kinematics import pose_candidates
from invdyn.plots import BLUE, GREY, PURPLE, STYLE, VERMILION
from invdyn.recordings import Recording
from invdyn.simulate import paper_arm, record

plt.rcParams.update(STYLE | {"figure.constrained_layout.use": True, "figure.dpi": 90})
plt.rcParams["axes.prop_cycle"] = plt.cycler(color=[BLUE, VERMILION, PURPLE])

# %% [markdown]
# ## The paper's arm
#
# Two thin rods of one metre. Shoulder and elbow each turn by a *yaw* and then a *pitch*: four angles, four torques,
# twelve numbers in the state. Here is the body as its file says it, and the beginning of its motion.

# %%
body = load_body("paper_spatial_arm")
model = paper_arm(body, num_frames=60)
recording, truth = record(model, seed=4)
print(f"coordinates: {', '.join(body.joint_names)}")
print(f"operations for one acceleration: {model.dynamics.operations('forward')}")

figure = plt.figure(figsize=(9, 3.2))
axes = figure.add_subplot(121, projection="3d")
for name, color in (("elbow", BLUE), ("wrist", VERMILION)):
    axes.plot(*recording.keypoint(name).T, ".", color=color, markersize=3, label=name)
axes.set(title="what the cameras see", xlabel="x (m)", ylabel="y (m)", zlabel="z (m)")
axes.legend()
right = figure.add_subplot(122)
right.plot(truth.time, truth.torque, linewidth=1, label=truth.joint_names)
right.set(title="what moved it (hidden from now on)", xlabel="time (s)", ylabel="torque (N·m)")
right.legend(fontsize=7)
plt.show()

# %% [markdown]
# ## Sampling is the same; what it tells is not
#
# The filters know nothing of space. With the controlled guide of notebook 1 a hundred particles do; the paper's code
# ends with an outer sample size of 1 to 3 of 64 filters, with a thousand particles each. The paper's camera is off by
# 10 cm in each coordinate. Beside it the same motion, seen ten and thirty times as sharply.


# %%
def seen_to(noise):
    scale = model.parameters["emission.keypoint_scale"]
    sharp = model.replace(**{"emission.keypoint_scale": torch.full_like(scale, noise)})
    film, known = record(sharp, seed=4)
    return Problem(sharp, torch.as_tensor(film.keypoints.reshape(60, -1)), film, known)


prior = model.torque.stationary(model.dt[1:2], model.parameters).mean().item()
sizes = SMCOptions(num_filters=16, num_particles=100, num_draws=4)
figure, panels = plt.subplots(1, 3, figsize=(10, 2.8), sharey=True)
for axes, noise in zip(panels, (0.1, 0.01, 0.003), strict=True):
    problem = seen_to(noise)
    posterior = smc(problem, options=sizes, seed=0)
    draws = pooled(posterior)["torque"].transpose("sample", "time", "joint").values
    low, high = np.quantile(draws, [0.05, 0.95], axis=0)
    true = problem.truth.torque
    covered = ((low <= true) & (true <= high)).mean()
    removed = 1 - np.sqrt(draws.var(0).mean()) / prior
    print(
        f"keypoints off by {noise:5.3f} m: outer sample size {posterior.attrs['outer_ess']:.1f} of 16, "
        f"90 % bands hold {covered:.2f} of the true torques, {removed:.0%} of the prior's sd removed"
    )
    axes.fill_between(truth.time, low[:, 0], high[:, 0], color=PURPLE, alpha=0.25, linewidth=0)
    axes.plot(problem.truth.time, true[:, 0], color="black", linewidth=1)
    axes.set(title=f"shoulder yaw, off by {noise:g} m", xlabel="time (s)")
panels[0].set_ylabel("torque (N·m)")
plt.show()

# %% [markdown]
# The bands are honest at all three, and at the paper's own they say: the camera hardly tells. Most of what is known
# there is the prior. A healthy sampler is no proof of an informative recording; it only finds what is there.
#
# ## Aliases
#
# Turn the shoulder's yaw $\psi$ by half a turn and take $\pi$ minus its pitch $\varphi$. The upper arm points where it
# pointed, rolled over. With the elbow's angles negated the forearm does too:
#
# $$ X(\psi, \varphi, \psi_e, \varphi_e) = X(\psi + \pi,\; \pi - \varphi,\; -\psi_e,\; -\varphi_e). $$
#
# Both stories show the *same points*. No camera can tell them apart, their evidence is the same, and pitch torques have
# opposite signs.

# %%
alias = truth.angle * [1, -1, -1, -1] + [np.pi, np.pi, 0, 0]
parameters = body.parameters()
apart = model.dynamics.keypoints(torch.as_tensor(truth.angle), parameters)
apart = (apart - model.dynamics.keypoints(torch.as_tensor(alias), parameters)).abs().max().item()
print(f"the alias shows the same points to {apart:.0e} m")

sharp = seen_to(0.003)
paths = pose_candidates(
    body, truth.time, sharp.observations, model.observation, parameters, np.full(4, 0.003), agility=(4.0,)
)
first = np.degrees(paths[0, 0]).round(1)
print(f"inverse kinematics begins at {first} degrees: of all aliases the one with the smallest pitches")

# %% [markdown]
# So a start is chosen, and said: pitches within a quarter turn. From there the filters stay in it.
#
# ## Poles, and turns that nobody sees
#
# At a pitch of 90° the yaw turns nothing. A frame is therefore chosen from the recording where a motion comes near
# (`invdyn.inference.posterior.charts`). And some turns move no keypoint at all: a straight arm twists unseen.
# Keypoints move by the Jacobian,
#
# $$ \dot X = J(q)\, \dot q, \qquad J = U\, \mathrm{diag}(w)\, V^\top, $$
#
# so a turn along $v_i$ is seen as a motion of $w_i$ metres a radian. The smallest $w_i$ says how near a turn is to
# being unseen, and a posterior names what is not seen.

# %%
inertia = (0.002, 0.015, 0.015, 0.0, 0.0, 0.0)
human = Body(
    "ball and hinge",
    [
        Link("upper_arm", Joint("shoulder", "ball"), length=0.3, tip="elbow", mass=2.0, inertia=inertia),
        Link("forearm", Joint("elbow"), parent="upper_arm", length=0.25, tip="wrist", mass=1.5, inertia=inertia),
    ],
)
bent = ArmModel(human, [0.0, 0.1], parameters={"emission.keypoint_scale": 0.005})
for degrees in (60, 10, 0):
    pose = torch.tensor([[0.2, 0.3, 0.0, np.deg2rad(degrees)]], dtype=torch.float64)
    smallest, unseen = visibility(bent, torch.zeros(1, 6), pose)
    hidden = [name for name, is_hidden in zip(human.joint_names, unseen[0], strict=True) if is_hidden]
    print(
        f"elbow bent by {degrees:2d}°: smallest singular value {smallest[0]:.3f} m/rad; unseen: {hidden or 'nothing'}"
    )

# %% [markdown]
# ## The mouse
#
# A mouse reaches for a pellet; two cameras, one of them behind the scene, give its shoulder, elbow and wrist in space.
# Nobody weighed its paw, so no force is asked for. The *kinematic* model lets the velocities walk by chance,
# $\ddot q = \sigma_w \eta$ with white noise $\eta$, and learns the lengths.
# The cameras' calibration is not metric (its own parameters multiply one camera's picture by 19), so that lengths are
# in **reconstruction units**, and no centimetres. Every twentieth frame is hidden, and predicted.
#
# The recording is not ours to give. Without it (`INVDYN_DATA`) a walking arm of the same kind is simulated.

# %%
mouse = Body(
    "mouse",
    [
        Link("upper_arm", Joint("shoulder", "universal"), length=2.5, tip="elbow", mass=1.0),
        Link("forearm", Joint("elbow", "universal"), parent="upper_arm", length=1.5, tip="wrist", mass=1.0),
    ],
    gravity=(0.0, 0.0, 0.0),
)
FRAMES, FIRST = 120, 2000
place = Path(os.environ.get("INVDYN_DATA", "")) / "mouse_3d" / "costa_BA_3D_pts.npy"
if os.environ.get("INVDYN_DATA") and place.exists():
    every = np.load(place, allow_pickle=False).T.reshape(-1, 3, 3)[FIRST : FIRST + FRAMES]
    points = every[:, 1:] - every[:, :1]  # from the shoulder, which hardly moves
else:
    print("the mouse cannot be had here: set INVDYN_DATA; an arm that walks by chance stands for it")
    walk = KinematicModel(
        mouse,
        np.arange(FRAMES) / 30,
        parameters={
            "walk.scale": 1.0,
            "emission.keypoint_scale": 0.1,
            "initial.angle_scale": 0.2,
            "initial.velocity_scale": 0.3,
        },
    )
    torch.manual_seed(2)
    points = walk.simulate()[1].numpy().reshape(FRAMES, 2, 3)
hidden = np.arange(10, FRAMES - 5, 20)
seen = points.copy()
seen[hidden] = np.nan
film = Recording(
    time=np.arange(FRAMES) / 30, keypoints=seen, keypoint_names=("elbow", "wrist"), length_unit="reconstruction units"
)
motion = infer_kinematics(film, mouse, learn_lengths=True, method="laplace", num_filters=16, num_draws=16)
for link, (length, sd) in learned_lengths(motion).items():
    print(f"{link}: {length:.2f} ± {sd:.2f} reconstruction units")
predicted = pooled(motion, group="posterior_predictive")["position"].transpose("sample", "time", ...).values
low, high = np.quantile(predicted, [0.05, 0.95], axis=0)
held = ((low <= points) & (points <= high))[hidden].mean()
print(f"90 % bands hold {held:.2f} of {points[hidden].size} hidden coordinates")

figure, panels = plt.subplots(1, 2, figsize=(10, 2.8))
for axes, name, k in zip(panels, ("elbow", "wrist"), (0, 1), strict=True):
    for axis, color in enumerate((BLUE, VERMILION, PURPLE)):
        axes.fill_between(film.time, low[:, k, axis], high[:, k, axis], color=color, alpha=0.25, linewidth=0)
        axes.plot(film.time, seen[:, k, axis], ".", color=color, markersize=2)
        axes.plot(film.time[hidden], points[hidden, k, axis], "x", color=GREY, markersize=5)
    axes.set(title=f"{name}: x, y, z; crosses were hidden", xlabel="time (s)", ylabel="reconstruction units")
plt.show()

# %% [markdown]
# The learned noise is a good part of the motion. The apparent lengths of the two bones differ from frame to frame by
# much more than a rigid bone's can. That is the calibration's doing. What the bands hold, they hold because the model
# says so of its noise, as in notebook 1's human arm. The same from a terminal, with a body file and a recording in
# metres: `invdyn infer paw.csv --body mouse.toml --torque none --learn lengths --out motion.nc`.
#
# ## Exercises
#
# **1. Why the camera hardly tells.** A keypoint's place is off by $\sigma$ in each frame. Differences of three frames
# give its acceleration. By how much is that off, at the paper's 10 cm and this frame rate? Compare it with how fast the
# wrist really accelerates.

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
step = float(model.dt[1])
noise = np.sqrt(1 + 4 + 1) * 0.1 / step**2
path = model.dynamics.keypoints(torch.as_tensor(truth.angle), parameters)[..., -1, :].numpy()
real = np.sqrt((np.diff(path, 2, axis=0) ** 2).mean()) / step**2
print(f"(1, −2, 1)/δ² makes √6 σ/δ² of the noise: {noise:.0f} m/s². The wrist itself has {real:.1f} m/s² rms.")
print(f"So one frame tells nothing. About {(noise / real) ** 2:.0e} of them would have to agree, or the prior helps.")

# %% [markdown]
# **2. What an alias pushes.** The alias has angles $q' = S q + c$ with $S = \mathrm{diag}(1, -1, -1, -1)$. Both tell of
# one motion, and so of one power $\tau^\top \dot q$. Which torques does the alias have? Check your answer by inverse
# dynamics.

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
turned = torch.tensor([1.0, -1, -1, -1], dtype=torch.float64)
q, qd = torch.as_tensor(truth.angle), torch.as_tensor(truth.velocity)
qdd = torch.gradient(qd, spacing=step, dim=0)[0]
told = model.dynamics.inverse(q, qd, qdd, parameters)
mirrored = model.dynamics.inverse(torch.as_tensor(alias), turned * qd, turned * qdd, parameters)
off = (mirrored - turned * told).abs().max() / told.abs().max()
print(f"S S = 1 and τ'ᵀ S q̇ = τᵀ q̇ give τ' = S τ: all but the shoulder's yaw change their sign (off by {off:.0e}).")

# %% [markdown]
# **3. A twist that nearly nobody sees.** The upper arm twists about itself by a small angle. How far does the wrist go
# for each radian, at a bend $\beta$ of the elbow? Which bend keeps a twist of 10° above keypoints that are off by 5 mm?

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
for degrees in (60, 10, 0):
    print(
        f"bent by {degrees:2d}°: the wrist is {0.25 * np.sin(np.radians(degrees)):.3f} m off the axis, and goes so far"
    )
least = np.degrees(np.arcsin(0.005 / (0.25 * np.radians(10))))
print(f"0.25 sin β · 10° > 5 mm needs a bend of {least:.0f}° or more in one frame; many frames do with less.")
print("The smallest singular value is at most so large: a motion of several joints may show less than a pure twist.")
