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
# # A model of your own
#
# A hand trembles at some five beats a second. Which torques make it do so? The Ornstein–Uhlenbeck torque of
# [notebook 1](01_planar_arm.py) wanders and has no beat. So we write a torque that has one, and a body that invdyn
# does not have. Together they are under forty lines. Then every inference method runs on them unchanged.
#
# **You will learn**
#
# * what a torque process is, and which four methods define one;
# * how to fit its parameters, and how the evidence tells whether a recording needs it;
# * how to hand a model of your own to every inference method;
# * which mistakes to avoid.
#
# You need [notebook 1](01_planar_arm.py), and some Python with classes. Three exercises stand at the end.

# %% tags=["hide-input"]
# %matplotlib inline
import logging
import warnings

warnings.filterwarnings("ignore", r"\s*ArviZ is undergoing", FutureWarning)
warnings.filterwarnings("ignore", "IProgress not found")
logging.getLogger("arviz").setLevel(logging.ERROR)

import math

import matplotlib.pyplot as plt
import numpy as np
import torch
from IPython.display import display

from invdyn.inference import METHODS, Free, Problem, SMCOptions, arm_problem, fit
from invdyn.models import ArmModel, Keypoints, Link, Observation, OrnsteinUhlenbeck, TorqueProcess, planar_body
from invdyn.plots import BLUE, STYLE, VERMILION, plot_comparison
from invdyn.simulate import record

plt.rcParams.update(STYLE | {"figure.constrained_layout.use": True, "figure.dpi": 90})

# %% [markdown]
# ## The torque
#
# A torque process is a Gaussian Markov chain $z_t$ whose first entries are the joint torques. A noisy oscillation
# needs two numbers a joint: the torque $\tau$ and a companion $s$, a quarter of a beat behind. In a step $\delta$
# they turn by $\omega\delta$, shrink a little, and get noise:
#
# $$ \begin{pmatrix}\tau\\ s\end{pmatrix}_{t} = e^{-\gamma\delta}
#    \begin{pmatrix}\cos\omega\delta & -\sin\omega\delta\\ \sin\omega\delta & \cos\omega\delta\end{pmatrix}
#    \begin{pmatrix}\tau\\ s\end{pmatrix}_{t-1} + \sigma\sqrt{1 - e^{-2\gamma\delta}}\;\eta_t,
#    \qquad \eta_t \sim \mathcal N(0, I). $$
#
# A turn changes no lengths, so both keep the standard deviation $\sigma$ for ever, and
#
# $$ \mathrm{cov}(\tau_u, \tau_{u+h}) = \sigma^2 e^{-\gamma |h|} \cos \omega h: $$
#
# This is a beat of $f = \omega/2\pi$ Hz that keeps time for about $1/\gamma$ seconds. The step is exact for any
# $\delta$, so frames may be missing or irregular.
#
# Four methods say all of this. Shapes: `z` is (…, 2K) for K joints, all torques first; parameters are (…, K);
# `dt` is in seconds.


# %%
class Tremor(TorqueProcess):
    """Torque that beats: torque.scale σ (N·m), torque.decay γ (1/s), torque.frequency f (Hz)."""

    def size(self, num_joints):
        return 2 * num_joints

    def defaults(self, scale):
        start = {"scale": 0.1 * scale, "decay": 0 * scale + 2.0, "frequency": 0 * scale + 4.0}
        return {f"torque.{name}": value for name, value in start.items()}

    def mean(self, z, dt, parameters):
        torque, companion = z.chunk(2, -1)
        turn = 2 * math.pi * parameters["torque.frequency"] * dt
        keep = torch.exp(-parameters["torque.decay"] * dt)
        turned = (torque * turn.cos() - companion * turn.sin(), torque * turn.sin() + companion * turn.cos())
        return torch.cat([keep * part for part in turned], -1)

    def noise(self, dt, parameters):
        sd = parameters["torque.scale"] * torch.sqrt(-torch.expm1(-2 * parameters["torque.decay"] * dt))
        return torch.cat([sd, sd], -1)

    def stationary(self, dt, parameters):
        return torch.cat([parameters["torque.scale"], parameters["torque.scale"]], -1)


# %% [markdown]
# ## The body
#
# A forearm that rests at the elbow, and a hand. Lengths are in m, masses in kg. The hand's centre of mass is given.
# What is not given is that of a uniform rod.

# %%
forearm = Link("forearm", joint="elbow", tip="wrist", length=0.26, mass=1.2)
hand = Link("hand", joint="wrist", tip="knuckle", length=0.09, mass=0.45, com=0.05)
body = planar_body("forearm and hand", [forearm, hand], gravity=(0.0, 0.0))

# %% [markdown]
# That is the whole variant. (Written as TOML, the body would be a file for `--body`. A torque process that is to stay
# goes into `models/torques/`, and its name into `TORQUE_PROCESSES`.)
#
# ## A recording with known truth
#
# A second and a half at 60 frames a second, of a tremor of 5.5 Hz, filmed from above with 1 mm of noise.

# %%
TRUE = {"torque.frequency": 5.5, "torque.decay": 1.0, "torque.scale": [0.25, 0.05]}
NOISE = {"emission.keypoint_scale": 0.001, "noise.angle": 1e-4, "noise.velocity": 1e-3}
START = {"initial.angle": [0.3, 0.2], "initial.angle_scale": 0.1, "initial.velocity_scale": 0.1}
time = np.arange(90) / 60
world = ArmModel(body, time, Observation(Keypoints(range(2))), torque=Tremor(), parameters=TRUE | NOISE | START)
recording, truth = record(world, seed=1)

figure, (left, right) = plt.subplots(1, 2, figsize=(10, 2.6))
for name, color in (("wrist", BLUE), ("knuckle", VERMILION)):
    left.plot(time, 1000 * recording.keypoint(name)[:, 1], ".", markersize=3, color=color, label=name)
left.set(title="what the camera sees: y (mm)", xlabel="time (s)")
left.legend()
right.plot(time, truth.torque, linewidth=1.2, label=truth.joint_names)
right.set(title="what moved it (N·m, hidden from now on)", xlabel="time (s)")
right.legend()
plt.show()

# %% [markdown]
# ## At what frequency?
#
# `fit` maximises the marginal likelihood over the parameters that we call free, those of our new process included.
# It starts at 4 Hz. We fit the Ornstein–Uhlenbeck torque likewise. The difference of the two log evidences says
# whether this recording needs a beat at all.

# %%
scales = [Free("torque.scale"), Free("torque.decay", sd=1.0), Free("emission.keypoint_scale", tied=True)]
fits = {}
for name, process, free in (
    ("tremor", Tremor(), [*scales, Free("torque.frequency", tied=True, sd=0.5)]),
    ("Ornstein–Uhlenbeck", OrnsteinUhlenbeck(), scales),
):
    problem = arm_problem(recording, body, torque=process, substeps=1)
    fits[name] = fit(problem.model, problem.observations, free)
    print(f"{name:>18}: log evidence {fits[name].log_evidence:.1f}")
found = fits["tremor"]
frequency, sd = found.model.parameters["torque.frequency"][0].item(), found.log_sd["torque.frequency"][0]
print(f"frequency {frequency:.2f} ± {frequency * sd:.2f} Hz (truth 5.5)")

# %% [markdown]
# ## Every method
#
# `METHODS` holds all of them by name. To save time they get the first frames only, and small sizes. Nothing here is
# about tremors.

# %%
FRAMES = 12
short = recording.select(0, FRAMES)
small = arm_problem(short, body, torque=Tremor(), substeps=1)
fitted = {name: value for name, value in found.model.parameters.items() if not name.startswith("initial.")}
small = Problem(small.model.replace(**fitted), small.observations, short, truth.at(short.time))
SIZES = SMCOptions(num_filters=6, num_particles=50, num_draws=6)
SHORTER = {
    "nuts": {"chains": 1, "warmup": 15},
    "particle-gibbs": {"warmup": 3, "thin": 1},
    "svi": {"max_steps": 200},
    "svi-markov": {"max_steps": 200},
    "vsmc": {"steps": 5},
}
posteriors = {}
print("              error rms: elbow, wrist (N·m)      log evidence   seconds")
for name, method in METHODS.items():
    posteriors[name] = idata = method(small, options=SIZES, seed=0, **SHORTER.get(name, {}))
    error = idata.posterior["torque"].values.mean((0, 1)) - idata.constant_data["truth_torque"].values
    rms = np.sqrt((error**2).mean(0))
    evidence, seconds = idata.attrs["log_evidence"], idata.sample_stats.attrs["seconds"]
    print(f"{name:>14}: {rms[0]:10.4f} {rms[1]:10.4f} {evidence:22.2f} {seconds:12.2f}")

# %%
display(plot_comparison({name: posteriors[name] for name in ("smc", "nuts", "laplace", "svi")}))

# %% [markdown]
# So few frames cannot rank anybody's error; for that see [notebook 2](02_compare_inference.py). The evidence does
# tell something. `smc`, `vsmc` and `laplace` agree. `svi-markov` and `svi` are lower bounds, and mean field's is far
# below. The bootstrap filter is lost.
#
# What matters here: no method knows of tremors, and no line was written for any of them. Particle filters call
# `transition` for many particles at once. NUTS and SVI differentiate through it. The smoother linearises it by
# automatic differentiation.
#
# Three things to look at when you write your own:
#
# * **Shapes.** Parameters may come with leading dimensions, many sets at once. So write `z.chunk(2, -1)` and not
#   `z[0]`.
# * **Time.** `dt` is in seconds and need not be constant. Where there is an exact transition over `dt`, take it, and
#   not one step of Euler's method.
# * **A proper density.** Every entry of `z` needs noise. A torque that is exactly the integral of another entry has
#   no transition density. Give it a little noise, or return the triangular root of the exact joint covariance, as
#   `Matern32` does with `diagonal = False`.
#
# ## Exercises
#
# **1. No beat.** Set the frequency to 0. Which process of notebook 1 is the tremor's torque then?

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
one, dt = torch.ones(1, dtype=torch.float64), torch.tensor(1 / 60, dtype=torch.float64)
decay, sigma = 2.0 * one, 0.3 * one
still = {"torque.scale": sigma, "torque.decay": decay, "torque.frequency": 0 * one}
same = {"torque.scale": sigma * torch.sqrt(2 * decay), "torque.decay": decay}
for name, mine, other in (
    ("mean", Tremor().mean(torch.cat([one, 0 * one]), dt, still)[:1], OrnsteinUhlenbeck().mean(one, dt, same)),
    ("noise", Tremor().noise(dt, still)[:1], OrnsteinUhlenbeck().noise(dt, same)),
):
    print(f"{name} of one step: {mine.item():.6f} here, {other.item():.6f} of the Ornstein–Uhlenbeck torque")
print("It is the Ornstein–Uhlenbeck torque, whose scale is σ√(2γ) where the tremor's is σ.")

# %% [markdown]
# **2. A slow camera.** The hand trembles at 5.5 Hz, and a camera takes 8 frames a second. What does it see?

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
frames = np.arange(16) / 8
seen, slow = np.cos(2 * np.pi * 5.5 * frames), np.cos(2 * np.pi * (8 - 5.5) * frames)
print(f"In those frames a beat of 5.5 Hz and one of {8 - 5.5} Hz differ by {abs(seen - slow).max():.0e} at most.")
print("Above half the frame rate, beats fold back (aliasing). No method can tell the two; only the prior can.")

# %% [markdown]
# **3. Where the noise comes from.** Why is the noise's standard deviation $\sigma\sqrt{1 - e^{-2\gamma\delta}}$?

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
variance = 0 * one
for _ in range(600):
    variance = torch.exp(-2 * decay * dt) * variance + Tremor().noise(dt, still)[:1] ** 2
print("The variance must stay σ²: v = e^(−2γδ) v + noise² has the solution v = σ² only for this noise.")
print(f"From variance 0, 600 steps lead to a standard deviation of {variance.sqrt().item():.4f}; σ is {sigma.item()}.")
