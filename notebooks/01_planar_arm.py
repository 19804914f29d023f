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
# # Which torques moved this arm?
#
# A camera films an arm. A tracker marks its elbow and its wrist in every frame, a little wrong each time.
# Which torques did the joints exert, and how sure can one be?
#
# **You will learn**
#
# * how Newton's law and Bayes' rule together turn keypoints into torques;
# * what a particle filter does, and why the plain one fails here;
# * how looking ahead mends it, and how to see that it did;
# * how to read the bands, and when not to trust them.
#
# You need Bayes' rule and $F = ma$. You need not know particle filters. Ten minutes to read; three exercises
# stand at the end.
#
# The arm is that of [Biderman, Naesseth and colleagues (2020)](https://montrealrobotics.ca/diffcvgp/), *Inverse
# articulated-body dynamics from video via variational sequential Monte Carlo*. First it is simulated, so that the
# truth is known. Then it is real, and nobody knows.

# %% tags=["hide-input"]
# %matplotlib inline
import warnings
from importlib.resources import files
from itertools import pairwise

warnings.filterwarnings("ignore", r"\s*ArviZ is undergoing", FutureWarning)
warnings.filterwarnings("ignore", "IProgress not found")

import matplotlib.pyplot as plt
import numpy as np
import torch
from IPython.display import display

from invdyn.inference import (
    Problem,
    SMCOptions,
    backward_simulation,
    gaussian_smoother,
    genealogy,
    infer,
    outer_weights,
    pooled,
    run_filters,
    smc,
)
from invdyn.inputs import load_recording
from invdyn.models import Body, OrnsteinUhlenbeck
from invdyn.plots import BLUE, GREY, PURPLE, STYLE, VERMILION, plot_posterior
from invdyn.recordings import InputError, load, median_link_lengths
from invdyn.simulate import paper_arm, record
from invdyn.summary import torque_table

plt.rcParams.update(STYLE | {"figure.constrained_layout.use": True, "figure.dpi": 90})
plt.rcParams["axes.prop_cycle"] = plt.cycler(color=[BLUE, VERMILION, PURPLE])
BODIES = files("invdyn.models") / "bodies"
generator = torch.manual_seed(0)

# %% [markdown]
# ## The model
#
# The arm is two rigid links in a plane. Its state is $x = (\tau, \theta, \dot\theta)$: two torques, two
# angles and two angular velocities. The first angle counts from the horizontal, the second from the first link.
# Newton says
#
# $$ D(\theta)\,\ddot\theta + h(\theta, \dot\theta) + c(\theta) = \tau, $$
#
# with the inertia matrix $D$, Coriolis and centrifugal torques $h$ and the gravity load $c$. Nobody tells
# us what $\tau$ does. So it gets a modest prior, the Ornstein–Uhlenbeck process: it wanders, and is pulled back to
# zero,
#
# $$ \dot\tau = -\lambda \tau + \sigma_\tau \eta, \qquad \lambda = 6 /\mathrm{s},\ \sigma_\tau = 20. $$
#
# Time goes in steps of $\delta = 0.03$ s: $x_t = x_{t-1} + \delta\,\dot x_{t-1}$ plus noise. The noise is
# $\delta\sigma_\tau$ on each torque (the paper's scaling) and $\varepsilon = 0.01$ on angles and velocities.
# The camera sees elbow and wrist with variance 0.05 on links of one metre. That is 22 cm of noise on each
# coordinate: a bad camera.
#
# Together these are a prior $p(x)$ of whole motions and a likelihood $p(y \mid x)$ of the film $y$. Bayes' rule
# gives what we want,
#
# $$ p(x \mid y) = \frac{p(x)\, p(y \mid x)}{p(y)}. $$
#
# No formula solves it: the path $x$ has 1,200 unknowns, and they enter through sines and products. So we *sample*.

# %%
body = Body.from_toml(BODIES / "paper_planar_arm.toml")
model = paper_arm(body)
model = model.replace(**{"initial.velocity_scale": torch.ones(2, dtype=torch.float64)})  # a calm start
recording, truth = record(model, seed=4)
observations = torch.as_tensor(recording.keypoints.reshape(len(recording.time), -1))
problem = Problem(model, observations, recording, truth)

figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.2))
for name, color in (("elbow", BLUE), ("wrist", VERMILION)):
    left.plot(*recording.keypoint(name).T, ".", color=color, markersize=3, label=name)
left.plot(0, 0, "o", color="black", markersize=5, label="shoulder, fixed")
left.set(title="what the camera sees", xlabel="x (m)", ylabel="y (m)", aspect="equal")
left.legend(loc="upper left", bbox_to_anchor=(1, 1))
right.plot(truth.time, truth.torque, linewidth=1, label=truth.joint_names)
right.set(title="what moved it (hidden from now on)", xlabel="time (s)", ylabel="torque (N·m)")
right.legend()
plt.show()

# %% [markdown]
# $D$, $h$ and $c$ come from the Lagrangian by computer algebra. They are plain functions of tensors. Here is
# each along the true motion, and the check that they add up to the torque.

# %%
parameters = body.parameters()
q, qd, tau = (torch.as_tensor(values) for values in (truth.angle, truth.velocity, truth.torque))
dynamics = model.dynamics
qdd = dynamics.forward(q, qd, tau, parameters)
sum_of_parts = (dynamics.inertia_matrix(q, parameters) @ qdd[..., None])[..., 0]
sum_of_parts = sum_of_parts + dynamics.coriolis(q, qd, parameters) + dynamics.gravity_load(q, parameters)
print(f"D θ̈ + h + c differs from τ by at most {(sum_of_parts - tau).abs().max():.1e} N·m")
for name, value in {
    "inertia  D θ̈": tau - dynamics.coriolis(q, qd, parameters) - dynamics.gravity_load(q, parameters),
    "Coriolis h": dynamics.coriolis(q, qd, parameters),
    "gravity  c": dynamics.gravity_load(q, parameters),
}.items():
    print(f"{name}: rms {value.square().mean(0).sqrt().numpy().round(2)} N·m at shoulder and elbow")

# %% [markdown]
# ## The bootstrap filter, and how it fails
#
# A particle filter carries a cloud of guessed states, the *particles*, through the film. For every frame it
#
# 1. moves each particle as the model says, with fresh noise;
# 2. weighs it by how well it explains the frame, $w = p(y_t \mid x_t)$;
# 3. now and then drops particles of little weight and copies those of much weight.
#
# The product over frames of the mean weight, $\hat Z$, estimates the *evidence* $p(y)$, without bias.
#
# How would one know that it works? Run it 64 times and compare. Each run $m$ is weighed by its own estimate,
# $W_m = \hat Z_m / \sum_k \hat Z_k$. This is the *outer* importance sampler of the paper. Its effective
# sample size is
#
# $$ \mathrm{ESS} = \frac{1}{\sum_m W_m^2}. $$
#
# If all runs found the same answer, it is near 64. If one lucky run dwarfs the others, it is near 1.

# %%
blind = run_filters(model, observations, SMCOptions(64, 1000), guide="bootstrap", keep=0)
outer = outer_weights(blind.log_evidence)
print(
    f"bootstrap, 64 × 1,000 particles: outer sample size {outer.ess:.1f} of 64, "
    f"log Ẑ spreads by {outer.filter_sd:.0f} nats"
)

# %% [markdown]
# So the outer sampler rests on a few runs, and the runs disagree wildly. The reason is in the equations. A torque
# $\tau_t$ changes $\dot\theta_{t+1}$, and that changes $\theta_{t+2}$. The first frame that says anything about
# it comes two rows later. Under so much noise it takes many more to say something clear. A guess of $\tau_t$ from
# the past alone is a guess in the dark, in every row. The weights then kill nearly all guesses.

# %% [markdown]
# ## Looking ahead
#
# The cure is to use what is *still to be seen*. Suppose we knew $\psi_t(x) = p(y_{t}, \dots, y_T \mid x_t = x)$:
# how well a particle at $x$ can still explain the rest of the film. Then moving by
#
# $$ q(x_t \mid x_{t-1}) \;\propto\; p(x_t \mid x_{t-1})\, \psi_t(x_t) $$
#
# would draw from the posterior itself, and all weights would be equal. We do not know $\psi$. But a Gaussian
# smoother knows it roughly: it linearises the model along the best path, and one backward pass gives a Gaussian
# $\psi_t$. The particles still move by the exact, nonlinear model. The weights correct whatever $\psi$ got wrong,
# so the evidence stays unbiased. This is controlled SMC
# ([Heng et al. 2020](https://arxiv.org/abs/1708.08396)).

# %%
smoother = gaussian_smoother(model, observations)
guided = run_filters(model, observations, SMCOptions(64, 100), smoother=smoother)
outer_guided = outer_weights(guided.log_evidence)
print(
    f"controlled, 64 × 100 particles: outer sample size {outer_guided.ess:.1f} of 64, "
    f"log Ẑ spreads by {outer_guided.filter_sd:.2f} nats"
)

figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3))
for result, color, label in (
    (blind, VERMILION, "bootstrap, 1,000 particles"),
    (guided, BLUE, "controlled, 100"),
):
    evidence = result.log_evidence.sort(descending=True).values
    left.plot(range(1, 65), (evidence - outer_guided.log_evidence).numpy(), ".-", color=color, label=label)
    right.plot(range(1, 65), torch.softmax(evidence, 0).numpy(), ".-", color=color, label=label)
left.set(title="log Ẑ of each filter, less the best estimate", xlabel="filter, best first", ylabel="nat")
left.set_yscale("symlog", linthresh=1)
left.set_yticks([1, 0, -1, -10, -100, -1000], ["1", "0", "−1", "−10", "−100", "−1000"])
right.set(title="its outer weight (all alike: 1/64)", xlabel="filter, best first")
right.axhline(1 / 64, color=GREY, linewidth=0.8, dashes=(4, 2))
left.legend()
plt.show()

# %% [markdown]
# ## From filter to smoother
#
# A bootstrap filter at row $t$ has seen the frames up to $t$. But $\tau_t$ shows itself later. So the filter's
# answer for *now* is hardly better than guessing zero: see the numbers below the figure. What one wants is the
# *smoothed* torque, given the whole film. There are two ways to it.
#
# * **Genealogy** takes the final particles and follows their ancestors back. Every resampling loses some lines. A
#   bootstrap filter resamples often, so all its trajectories share a few pasts.
# * **Backward simulation** draws trajectories from the end to the start. In each row it chooses anew among all
#   particles, and it moves whole blocks of states on the way.
#
# The controlled filter resamples so seldom that even its genealogy stays alive here.

# %%
few = run_filters(model, observations, SMCOptions(8, 100), smoother=smoother)
cloud = run_filters(model, observations, SMCOptions(1, 20_000), guide="bootstrap")
lines = {
    "bootstrap, 20,000 particles: genealogy": genealogy(cloud, 100),
    "controlled, 100: genealogy": genealogy(few, 100),
    "controlled, 100: backward simulation": backward_simulation(model, few, observations, 100, smoother=smoother),
}
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3))
for (label, paths), color in zip(lines.items(), (VERMILION, GREY, BLUE), strict=True):
    distinct = [np.mean([len(torch.unique(one[:, t, 0])) for one in paths]) for t in range(len(recording.time))]
    left.plot(recording.time, distinct, color=color, label=label)
left.set(title="distinct values among 100 trajectories", xlabel="time (s)", ylim=(0, 105))
left.legend(loc="center", bbox_to_anchor=(0.5, 0.3))

filtered = (cloud.log_weights[:, 0].exp().unsqueeze(-1) * cloud.states[:, 0]).sum(1)[:, :2]
smoothed = paths.mean((0, 1))[:, :2]
right.plot(truth.time, truth.torque[:, 1], color="black", linewidth=1, dashes=(4, 2), label="truth")
right.plot(truth.time, filtered[:, 1], color=VERMILION, linewidth=1, label="filter's mean")
right.plot(truth.time, smoothed[:, 1], color=PURPLE, linewidth=1.3, label="smoothed mean")
right.set(title="elbow torque (N·m)", xlabel="time (s)")
right.legend()
plt.show()
for name, mean in (("filter", filtered), ("smoother", smoothed)):
    print(
        f"{name}: rms error {(mean - tau).square().mean(0).sqrt().numpy().round(2)} N·m; "
        f"the torques' own rms is {tau.square().mean(0).sqrt().numpy().round(2)}"
    )

# %% [markdown]
# ## The torques
#
# One call does all of it: filters, outer sampler, smoothing. The bands hold 50 and 90 % of the posterior.

# %%
idata = smc(problem, options=SMCOptions(64, 100, num_draws=8), seed=0)
display(plot_posterior(idata))
display(torque_table(idata).round(3))

# %% [markdown]
# The true torque (dashed) jumps faster than such a camera could show. The median does not pretend to see the
# jumps. The bands say how much is hidden. In the table, `90 % covers` is the share of frames whose true torque
# lies in the band. It should be near 0.9. One run scatters around that by some hundredths, because neighbouring
# frames are not independent; the benchmarks average over many runs.

# %% [markdown]
# ## What the evidence is good for
#
# The filters' average $\hat Z$ compares explanations. How strong do the data think the torques are? Try five
# values of $\sigma_\tau$; the truth is 20. A difference of 3 nats means odds of $e^3 \approx 20$ to 1.

# %%
scales = [5.0, 10.0, 20.0, 40.0, 80.0]
for scale in scales:
    other = model.replace(**{"torque.scale": torch.full((2,), scale, dtype=torch.float64)})
    outer = outer_weights(run_filters(other, observations, SMCOptions(16, 100, refits=0), keep=0).log_evidence)
    print(f"σ_τ = {scale:>4.0f}:  log evidence {outer.log_evidence:7.2f} ± {outer.log_evidence_sd:.2f}")

# %% [markdown]
# ## A real arm
#
# The paper's recording: a human arm moves on a table and is filmed from above, so gravity acts out of the
# plane. DeepLabCut tracked shoulder, elbow and wrist at 30 frames a second. The paper shows frames 50 to
# 250. Nobody measured the scale. So lengths are in *body lengths* (the arm's median length is 1), and
# torques in kg·(body length)²/s². If the arm is 0.5 m long and its links weigh what the body file assumes,
# multiply by $0.5^2$ to have N·m.

# %%
arm = Body.from_toml(BODIES / "human_arm_on_table.toml")
try:
    film = load_recording("human-arm", arm, scale="body").select(50, 250)
    pixels = load("human-arm").select(50, 250)
except InputError as error:
    film = None
    print(f"The recording cannot be had here, so what follows is skipped: {error}")

# %% [markdown]
# Noise scales, the torques' strength and speed, and the links' lengths are not known now. `infer` finds them by
# maximising the evidence. Then the filters run. The torque has the paper's prior, an Ornstein–Uhlenbeck process.

# %%
if film is not None:
    posterior = infer(film, arm, learn_lengths=True, torque=OrnsteinUhlenbeck(), num_draws=8, seed=0)
    display(plot_posterior(posterior))
    size, spread = posterior.attrs["outer_ess"], posterior.attrs["log_evidence_spread"]
    print(f"outer sample size {size:.1f} of 64 filters of 100 particles; log Ẑ spreads by {spread:.2f} nats")

# %% [markdown]
# ### How badly rigid links fit
#
# The sampler is healthy. Is the *model*? A healthy sampler only says that the posterior of this model was
# found. So look at the links. A rigid arm in a plane, seen straight from above, has the same distance from
# shoulder to elbow in every frame.

# %%
if film is not None:
    chain = [pixels.keypoint(name) for name in ("shoulder", "elbow", "wrist")]
    apparent = np.stack([np.linalg.norm(b - a, axis=-1) for a, b in pairwise(chain)], axis=1)
    body_length = median_link_lengths(load("human-arm"), ("shoulder", "elbow", "wrist")).sum()
    learned = posterior.constant_data["length"].values
    for k, link in enumerate(arm.links):
        low, high = apparent[:, k].min(), apparent[:, k].max()
        print(
            f"{link.name:>9}: {low:.0f} … {high:.0f} px, at its longest {high / low:.1f} times its shortest; "
            f"learned {learned[k] * body_length:.0f} px ({learned[k]:.3f} body lengths)"
        )

    tips = pooled(posterior)["position"].mean("sample").transpose("time", "keypoint", "space").values
    seen = posterior.observed_data["position"].values
    predictive = pooled(posterior, group="posterior_predictive")["position"]
    low, high = np.quantile(predictive.transpose("sample", "time", "keypoint", "space").values, [0.05, 0.95], axis=0)
    off = seen - tips
    print()
    for k, name in enumerate(("elbow", "wrist")):
        rms = np.sqrt(np.mean(off[:, k] ** 2))
        memory = np.mean([np.corrcoef(c[:-1], c[1:])[0, 1] for c in off[:, k].T])
        print(
            f"{name}: residual {rms * body_length:.1f} px = {rms:.3f} body lengths rms a coordinate; "
            f"90 % predictive interval covers {np.mean((low <= seen) & (seen <= high), axis=(0, 2))[k]:.3f}; "
            f"a residual resembles the one before it by {memory:.2f}"
        )
    total = np.sqrt(np.mean(off**2))
    print(f"both: {total * body_length:.1f} px = {total:.3f} body lengths rms a coordinate")
    jump = np.linalg.norm(np.diff(seen[:, 1], axis=0), axis=-1)
    print(f"the wrist's mark jumps farthest at {film.time[jump.argmax() + 1]:.1f} s, by {jump.max():.2f} body lengths")

    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3))
    left.plot(pixels.time, apparent / body_length, linewidth=1.2, label=[link.name for link in arm.links])
    for k, color in enumerate(("C0", "C1")):
        left.axhline(learned[k], color=color, linewidth=0.8, dashes=(4, 2))
    left.set(
        title="apparent link length (dashed: learned)",
        xlabel="time (s)",
        ylabel="body length",
        ylim=(0, None),
    )
    left.legend()
    for k, (name, color) in enumerate((("elbow", BLUE), ("wrist", VERMILION))):
        right.plot(film.time, off[:, k, 0], color=color, linewidth=1.2, label=f"{name} x")
        right.plot(film.time, off[:, k, 1], color=color, linewidth=1.2, dashes=(2, 1), label=f"{name} y")
    right.set(title="observed less predicted", xlabel="time (s)", ylabel="body length")
    right.legend(ncols=2)
    plt.show()

# %% [markdown]
# So the fit is bad, and the numbers above say how bad. Perhaps the arm leaves the plane. Perhaps the camera looks
# at a slant, or the shoulder's mark slides on the shirt. The model has one place to put that: the camera's noise.
# It makes the noise large enough, and then the predictive intervals cover the keypoints about as often as they
# should. Coverage alone would let it pass. The residuals give it away. Camera noise is fresh in each frame, but
# each of these residuals resembles the one before it.
#
# What does it mean for the torques? Their bands allow for noise of that size, as if it were independent from frame
# to frame. They know nothing of a systematic cause. Take the *shape* of the torques as the answer of a rigid planar
# arm to this film. Do not take the bands as the last word.

# %%
if film is not None:
    display(torque_table(posterior).round(3))

# %% [markdown]
# ## Exercises
#
# Think first; each answer is folded below its question.
#
# **1. A better camera.** Its noise is now 2 cm instead of 22. Does the bootstrap filter get better or worse?

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
sharp = model.replace(**{"emission.keypoint_scale": torch.full_like(model.parameters["emission.keypoint_scale"], 0.02)})
film_sharp = torch.as_tensor(record(sharp, seed=4)[0].keypoints.reshape(len(recording.time), -1))
for name, guide in (("bootstrap", "bootstrap"), ("controlled", "controlled")):
    options = SMCOptions(64, 1000 if guide == "bootstrap" else 100, refits=0)
    outer = outer_weights(run_filters(sharp, film_sharp, options, guide=guide, keep=0).log_evidence)
    print(f"{name}: outer sample size {outer.ess:.1f} of 64 filters, log Ẑ spreads by {outer.filter_sd:.1f} nats")
print("The bootstrap filter gets worse: the clearer the picture, the fewer blind guesses explain it.")
print("The controlled filter aims at the picture, so clarity does not harm it.")

# %% [markdown]
# **2. Unbiased, but too low.** The mean of $\hat Z$ is $p(y)$. Yet most bootstrap runs above lie below it.
# How can both be true?

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
below = (blind.log_evidence < outer_guided.log_evidence).double().mean()
mean_of_logs, log_of_mean = blind.log_evidence.mean(), outer_weights(blind.log_evidence).log_evidence
print(f"{below:.0%} of the bootstrap runs lie below the best estimate.")
print(f"Mean of log Ẑ: {mean_of_logs:.1f}; log of the mean of Ẑ: {log_of_mean:.1f}.")
print("The logarithm is concave, so E[log Ẑ] ≤ log E[Ẑ] = log p(y) (Jensen).")
print("Ẑ is like a lottery: a few large prizes keep its mean right, and most tickets win less.")

# %% [markdown]
# **3. Twice as heavy.** Double both masses, and double the torques' scale $\sigma_\tau$. What happens to the evidence?

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
doubled = {name: 2 * model.parameters[name] for name in ("body.mass", "torque.scale")}
heavy = gaussian_smoother(model.replace(**doubled), observations)
print(f"log evidence by the Gaussian smoother: {smoother.log_evidence:.4f} before, {heavy.log_evidence:.4f} after")
print("Nothing happens. D, h and c are proportional to the masses, so twice the torque moves twice the mass alike.")
print("Keypoints alone never tell masses from torques: one of the two must be known.")
