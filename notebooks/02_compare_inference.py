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
# # Which method to trust?
#
# [Notebook 1](01_planar_arm.py) infers an arm's torques by one method. There are others, some cheaper, some older.
# Here all of them get the same model $p(x, y)$ and the same keypoints $y$. All are asked for the same thing: the
# posterior $p(x \mid y)$ of the path $x$ of torques, angles and velocities. Where they differ, at most one is
# right.
#
# **You will learn**
#
# * how to compare methods by one table, and what each column tells;
# * why mean-field variational inference is far too sure of itself, by a formula of one line;
# * how to test whether bands are right on average, with a truth that you drew yourself;
# * which method to use for what.
#
# You need [notebook 1](01_planar_arm.py). Three exercises stand at the end.
#
# | | what it does | what it leaves out |
# |---|---|---|
# | `smc` | particle filters that look ahead, weighed by their evidence | nothing, with enough particles |
# | `bootstrap` | the same, proposing blindly | nothing, with *very* many particles |
# | `vsmc` | `smc` with a guide trained on the bound $\mathbb{E} \log \hat p(y) \le \log p(y)$ | nothing, as `smc` |
# | `particle-gibbs`, `nuts` | Markov chains of whole paths | nothing, given time |
# | `laplace` | a Gaussian smoother around the best path | what is not Gaussian |
# | `svi-markov` | the best Gaussian Markov chain, by maximising a bound | what is not Gaussian |
# | `svi` | the best *independent* Gaussians: mean field | that neighbours in time move together |
# | `differentiate` | low-pass filter, two derivatives, Newton | uncertainty |

# %% tags=["hide-input"]
# %matplotlib inline
import logging
import warnings
from importlib.resources import files

warnings.filterwarnings("ignore", r"\s*ArviZ is undergoing", FutureWarning)
warnings.filterwarnings("ignore", "IProgress not found")
logging.getLogger("arviz").setLevel(logging.ERROR)

import matplotlib.pyplot as plt
import numpy as np
import torch
from IPython.display import display
from scipy.stats import norm

from invdyn.inference import GaussianChain, compare, gaussian_smoother
from invdyn.inputs import load_recording
from invdyn.models import Body
from invdyn.plots import BLUE, GREY, STYLE, VERMILION, plot_comparison
from invdyn.recordings import InputError
from invdyn.simulate import PAPER, paper_arm, record
from invdyn.summary import comparison_text

plt.rcParams.update(STYLE | {"figure.constrained_layout.use": True, "figure.dpi": 90})
BODIES = files("invdyn.models") / "bodies"

# %% [markdown]
# ## One recording, one table
#
# We take the first rows of the paper's simulated arm, with every parameter known. `compare` runs the methods one
# after another on the same problem. On the command line it is `invdyn compare`. (`nuts` and `particle-gibbs` take
# minutes, so they are left out. Add them to the list if you can wait.)

# %%
ROWS = 20
body = Body.from_toml(BODIES / "paper_planar_arm.toml")
recording, truth = record(paper_arm(body), seed=4)
recording, truth = recording.select(0, ROWS), truth.at(recording.time[:ROWS])
methods = ["smc", "bootstrap", "vsmc", "laplace", "svi-markov", "svi", "differentiate"]
comparison = compare(recording, body, methods, truth=truth, seed=0, num_draws=8, held_out=0, **PAPER)
print(comparison_text(comparison))

# %% [markdown]
# How to read it:
#
# * **error rms** is the error of the posterior mean. Only `differentiate` is bad at it. It differentiates noise
#   twice, and a second difference divides by the squared time step, $\delta^{-2} \approx 1{,}100$ per s². If a
#   mean were all you wanted, nearly any other method would do.
# * **CRPS** scores the whole posterior, in N·m like an error. Bands that are too wide cost, and so do bands that are
#   too narrow.
# * **covers** is the share of true torques inside the 50 and 90 % bands. Few correlated rows make it a rough number.
# * **log evidence** is $\log p(y)$. `smc`, `bootstrap` and `vsmc` estimate the same number without bias, so they
#   should agree within their errors. `svi` and `svi-markov` give a *lower bound*. What they fall short by is
#   $\mathrm{KL}(q \,\|\, p(x \mid y))$: how far their answer $q$ is from the posterior.
# * **outer ESS** says how many of 64 filters agree. Near 64 is healthy. Near 1 means that one lucky filter speaks
#   for all. Then neither its evidence nor its error bar means much.
# * **elpd** says how well a method predicts each row from all others. It needs no truth, so you have it for real
#   recordings, too. But it does not see everything: compare mean field's with that of `smc`. Do not trust it
#   where Pareto k is above 0.7.

# %%
display(plot_comparison({name: comparison.posteriors[name] for name in ("smc", "laplace", "svi-markov", "svi")}))

# %% [markdown]
# Look at the width of the bands, not at the medians. `smc` and `laplace` agree. `svi-markov` is somewhat too
# narrow. Mean field (`svi`) draws nearly a line.
#
# ## Why mean field is so sure
#
# More training would not help. Let the posterior be Gaussian with precision $\Lambda$, the inverse covariance.
# Among independent Gaussians, those with the best bound have the variances
#
# $$ \sigma_i^2 = 1 / \Lambda_{ii} \;\le\; (\Lambda^{-1})_{ii}, $$
#
# The left side says how uncertain $x_i$ is *when all other entries are known*. The right side says how uncertain it
# is. The dynamics of an arm tie neighbours in time together. If you know the velocities at $t$ and $t + 1$ to within
# $\varepsilon$, then you know the torque in between. So the left side is next to nothing, while the right side is
# wide. A Markov chain or a particle's trajectory lets neighbours move together, and has no such trouble.
#
# The Gaussian smoother has $\Lambda$, so both sides can be computed:

# %%
model = paper_arm(body, ROWS)
model = model.replace(
    **{"initial.angle_scale": torch.full((2,), 0.5).double(), "initial.velocity_scale": torch.ones(2).double()}
)


def widths(observations):
    """Mean, and standard deviations by mean field and as they are, of the torques (T, K)."""
    smoother = gaussian_smoother(model, observations)
    chain = GaussianChain.of(smoother)
    mean_field = chain.precision_diagonal().rsqrt()
    marginal = smoother.covariance().diagonal(dim1=-2, dim2=-1).sqrt()
    return [values[:, :2].numpy() for values in (chain.loc, mean_field, marginal)]


observations = torch.as_tensor(recording.keypoints.reshape(ROWS, -1))
_, mean_field, marginal = widths(observations)
print(f"mean-field band over true band, median: shoulder, elbow {np.median(mean_field / marginal, 0).round(3)}")

# %% [markdown]
# ## Calibration: ask many times
#
# One recording cannot say whether 90 % bands hold 90 %. Many simulated ones can. Draw a path from the prior and a
# recording from that path. Infer, and note the rank of the true torque among the posterior's draws, from 0 (below
# all) to 1 (above all). If the method is right, truth and draws have the same distribution given the recording, so
# the rank is uniform. This is *simulation-based calibration*
# ([Talts et al. 2018](https://arxiv.org/abs/1804.06788)). If bands are too narrow, ranks pile up at 0 and 1.
#
# We do this on a hundred arms with the two Gaussians from above, whose ranks are $\Phi((\tau - \mu)/\sigma)$. If
# ranks are uniform, 99 of 100 bars end in the grey band.

# %%
torch.manual_seed(0)
ARMS, ROW, BINS = 100, 15, 10
ranks = {"smoother": [], "mean field": []}
states, films = model.simulate((ARMS,))
for path, film in zip(states, films, strict=True):
    mean, narrow, wide = widths(film)
    error = path[ROW, :2].numpy() - mean[ROW]
    ranks["smoother"].append(norm.cdf(error / wide[ROW]))
    ranks["mean field"].append(norm.cdf(error / narrow[ROW]))

figure, panels = plt.subplots(1, 2, figsize=(9, 2.8), sharey=True)
expected, spread = ARMS / BINS, 2.58 * np.sqrt(ARMS / BINS * (1 - 1 / BINS))
for axes, (name, values) in zip(panels, ranks.items(), strict=True):
    elbow = np.array(values)[:, 1]
    axes.axhspan(expected - spread, expected + spread, color=GREY, alpha=0.2, linewidth=0)
    axes.hist(elbow, bins=np.linspace(0, 1, BINS + 1), color=BLUE if name == "smoother" else VERMILION, rwidth=0.92)
    axes.set(title=f"{name}: 90 % bands hold {np.mean(abs(elbow - 0.5) < 0.45):.2f}", xlabel="rank of the true torque")
panels[0].set_ylabel("arms")
plt.show()
for name, values in ranks.items():
    print(f"{name}: 90 % bands hold {np.mean(abs(np.array(values) - 0.5) < 0.45):.2f} of the true torques")

# %% [markdown]
# `python benchmarks/calibration.py` does this with the draws of every method. It also ranks $\log p(x, y)$ of the
# true path among those of the draws. There the Gaussian smoother fails too (`laplace` below). Each of its bands is
# right, but its whole paths are not paths that this arm could have taken.
#
# ![ranks by method](../docs/calibration.png)

# %% [markdown]
# ## A real arm
#
# On the paper's human arm there is no truth. Three questions are left. Do methods that should agree, agree? Is the
# outer ESS healthy? Who predicts best?

# %%
arm = Body.from_toml(BODIES / "human_arm_on_table.toml")
try:
    film = load_recording("human-arm", arm, scale="body").select(50, 90)
except InputError as error:
    film = None
    print(f"The recording cannot be had here, so what follows is skipped: {error}")
if film is not None:
    human = compare(film, arm, ["smc", "laplace", "differentiate"], seed=0, held_out=0, learn_lengths=True)
    print(comparison_text(human))
    display(plot_comparison(human.posteriors))

# %% [markdown]
# ## What to trust
#
# * Begin with `laplace`. It is the fastest. Its bands are good as long as the posterior is nearly Gaussian; clear
#   keypoints and short steps make it so.
# * Report `smc`. It corrects what the Gaussian gets wrong, and its outer ESS tells you when it could not. If that
#   is low, take more particles or filters before you believe anything.
# * If two methods that leave nothing out disagree, one has not converged. Let `nuts` or `particle-gibbs` decide on a
#   short stretch, and look at their `r_hat`.
# * Never take bands from `svi`. Never believe a bootstrap filter whose outer ESS is near 1.
# * `differentiate` is good for a first look at clean data. It has no bands.
# * All of this is about finding the posterior *of this model*. None of these numbers says that the arm is rigid,
#   planar, or as heavy as you wrote.
#
# ## Exercises
#
# **1. Two numbers.** Let a posterior be Gaussian with variances 1 and correlation $\rho = 0.99$. How wide is the best
# mean-field answer?

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
covariance = np.array([[1, 0.99], [0.99, 1]])
width = 1 / np.sqrt(np.linalg.inv(covariance).diagonal())
print(f"Its standard deviation is 1/√Λᵢᵢ = √(1 − ρ²) = {width[0]:.3f}, where 1 is right.")
print(f"So its 90 % band holds {norm.cdf(1.645 * width[0]) * 2 - 1:.2f} of the probability.")

# %% [markdown]
# **2. Too wide.** A method states twice the right standard deviation. What do its ranks look like, and how often do
# its 90 % bands hold the truth?

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
wide = norm.cdf(norm.ppf(np.clip(np.array(ranks["smoother"])[:, 1], 1e-9, 1 - 1e-9)) / 2)
print("ranks between 0, .1, …, 1:", np.histogram(wide, bins=np.linspace(0, 1, BINS + 1))[0])
print(f"They form a hump in the middle, and 90 % bands hold {np.mean(abs(wide - 0.5) < 0.45):.2f}.")

# %% [markdown]
# **3. Right bands, wrong paths.** Each torque's band of a method is right. You draw each row's torque independently
# from its band. Are these paths draws from the posterior?

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
smoother = gaussian_smoother(model, observations)
chain = GaussianChain.of(smoother)
independent = chain.loc + smoother.covariance().diagonal(dim1=-2, dim2=-1).sqrt() * torch.randn_like(chain.loc)
for name, path in (("together", chain.rsample()), ("row by row", independent)):
    angle, velocity = path[:, 2:4], path[:, 4:]
    slip = angle[1:] - angle[:-1] - 0.03 * velocity[:-1]
    print(f"drawn {name}: angles miss θ + δ·velocity of the row before by {slip.square().mean().sqrt():.3f} rad rms")
print("No. The model allows ε = 0.01 rad. Rows of the posterior depend on one another; rows drawn apart do not.")
