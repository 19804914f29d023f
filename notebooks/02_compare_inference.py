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
# [Notebook 1](01_planar_arm.py) infers an arm's torques by one method. There are others, cheaper ones and older
# ones. All of them get the same model $p(x, y)$ and the same keypoints $y$, and are asked for the same thing, the
# posterior $p(x \mid y)$ of the path $x$ of torques, angles and velocities. Where they differ, at most one is
# right.
#
# | | what it does | what it leaves out |
# |---|---|---|
# | `smc` (`nested`) | particle filters that look ahead, weighed by their evidence | nothing, with enough particles |
# | `bootstrap` | the same, proposing blindly | nothing, with *very* many particles |
# | `vsmc` | `smc` with a guide trained on the bound $\mathbb{E} \log \hat p(y) \le \log p(y)$ | nothing, as `smc` |
# | `particle-gibbs`, `nuts` | Markov chains of whole paths | nothing, given time |
# | `laplace` | a Gaussian smoother around the best path | what is not Gaussian |
# | `svi-markov` | the best Gaussian Markov chain, by maximising a bound | what is not Gaussian |
# | `svi` | the best *independent* Gaussians: mean field | that neighbours in time move together |
# | `differentiate` | low-pass filter, two derivatives, Newton | uncertainty |
#
# The notebook takes about a minute.

# %%
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
# The paper's simulated arm, its first 30 rows, with every parameter known. `compare` runs the methods one after
# another on the same problem; on the command line it is `invdyn compare`. (`nuts` and `particle-gibbs` are left
# out for their time: add them to the list if you can wait some minutes.)

# %%
ROWS = 30
body = Body.from_toml(BODIES / "paper_planar_arm.toml")
recording, truth = record(paper_arm(body), seed=4)
recording, truth = recording.select(0, ROWS), truth.at(recording.time[:ROWS])
methods = ["smc", "bootstrap", "vsmc", "laplace", "svi-markov", "svi", "differentiate"]
comparison = compare(recording, body, methods, truth=truth, seed=0, num_draws=8, **PAPER)
print(comparison_text(comparison))

# %% [markdown]
# How to read it:
#
# * **error rms** is of the posterior mean alone. Hardly any method is bad at it, but for the one that
#   differentiates noise twice: second differences at 33 frames a second multiply 22 cm of noise by a thousand. If
#   a mean were all you wanted, nearly any of them would do.
# * **CRPS** scores the whole posterior, in N·m like an error: too wide costs, too narrow costs.
# * **covers** is the share of true torques inside the 50 and 90 % bands. With 30 correlated rows it is a rough
#   number.
# * **log evidence** $\log p(y)$: `smc`, `bootstrap` and `vsmc` estimate the same number without bias, so they
#   should agree within their errors. `svi` and `svi-markov` give a *lower bound*; what they fall short by is
#   exactly $\mathrm{KL}(q \,\|\, p(x \mid y))$, the distance of their answer from the posterior.
# * **outer ESS**: of 64 filters, how many agree. Near 64 is healthy. Near 1 means that one lucky filter speaks
#   for all, and then neither its evidence nor its error bar means much.
# * **log score** says how well each predicts the last fifth of the rows, one step at a time, having seen the
#   others. It needs no truth, so you also have it for real recordings. It does not see everything: mean field's is
#   level with that of `smc` here, whatever its bands.

# %%
display(plot_comparison({name: comparison.posteriors[name] for name in ("smc", "laplace", "svi-markov", "svi")}))

# %% [markdown]
# Look at the width of the bands, not at the medians. `smc` and `laplace` lie over one another, `svi-markov` is
# somewhat too narrow, and mean field (`svi`) draws nearly a line.
#
# ## Why mean field is so sure
#
# It is not a lack of training. Let the posterior be Gaussian with precision $\Lambda$ (the inverse covariance). The
# independent Gaussians with the best bound have the variances
#
# $$ \sigma_i^2 = 1 / \Lambda_{ii} \;\le\; (\Lambda^{-1})_{ii}, $$
#
# on the left: how uncertain $x_i$ is *when all other entries are known*; on the right, how uncertain it is. An
# arm's dynamics tie neighbours in time together. If you know the velocity at $t$ and at $t + 1$ to within
# $\varepsilon$, then you know the torque in between. So the left side is next to nothing while the right side is
# wide. A guide that lets neighbours move together, as a Markov chain or a particle's trajectory does, has no such
# trouble.
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
# One recording cannot say whether 90 % bands hold 90 %. Simulation can: draw a path from the prior and a
# recording from it, infer, and note the true torque's rank among the posterior's draws, from 0 (below all) to 1
# (above all). Draws and truth come from the same distribution, given the recording, if the method is right. Then
# the rank is uniform, whatever the model (*simulation-based calibration*, [Talts et al.
# 2018](https://arxiv.org/abs/1804.06788)). If bands are too narrow, ranks pile up at 0 and 1.
#
# Here with the two Gaussians from above, whose ranks are $\Phi((\tau - \mu)/\sigma)$, on a hundred simulated
# arms. The grey band is where 99 of 100 bars lie if the ranks are uniform.

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
# `python benchmarks/calibration.py` does this with every method, draws and all, and with more than single
# torques: it also ranks $\log p(x, y)$ of the true path among those of the draws. That is where the Gaussian
# smoother fails too. Each of its bands is right, but its paths as a whole are not ones that this arm could have
# taken.
#
# ![ranks by method](../docs/calibration.png)

# %% [markdown]
# ## A real arm
#
# On the paper's human arm there is no truth. What is left: do methods that should agree, agree; is the outer ESS
# healthy; and who predicts best?

# %%
arm = Body.from_toml(BODIES / "human_arm_on_table.toml")
try:
    film = load_recording("human-arm", arm, base=None, body_lengths=True).select(50, 150)
except InputError as error:
    film = None
    print(f"The recording cannot be had here, so what follows is skipped: {error}")
if film is not None:
    human = compare(film, arm, ["smc", "laplace", "differentiate"], seed=0, learn_lengths=True)
    print(comparison_text(human))
    display(plot_comparison(human.posteriors))

# %% [markdown]
# ## What to trust
#
# * Begin with `laplace`: a tenth of a second, and its torques' bands are good as long as the posterior is nearly
#   Gaussian. Clear keypoints and short steps make it so.
# * Report `smc`. It corrects what the Gaussian gets wrong, and its outer ESS tells you when it could not. If that
#   is low, take more particles or filters before you believe anything.
# * If two methods that leave nothing out disagree, one has not converged. `nuts` and `particle-gibbs` are the
#   referees, on a short stretch; look at their `r_hat`.
# * Never take bands from `svi`, nor believe a bootstrap filter whose outer ESS is near 1.
# * `differentiate` is good for a first look at clean data. It has no bands to be wrong.
# * All of this is about finding the posterior *of this model*. None of these numbers says that the arm is rigid,
#   planar, or as heavy as you wrote.
