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
# # Any state-space model
#
# No arm this time. A detector counts events, and their rate drifts. A model gives three distributions, and every
# inference method then takes it. ArviZ reads what comes back.
#
# **You will learn**
#
# * how to write a state-space model;
# * how to infer its states, and how to compare methods on it;
# * how ArviZ compares two models by leaving rows out.
#
# You need some Python with classes, and no other notebook.

# %% tags=["hide-input"]
# %matplotlib inline
import logging
import warnings

warnings.filterwarnings("ignore", r"\s*ArviZ is undergoing", FutureWarning)
warnings.filterwarnings("ignore", "IProgress not found")
warnings.filterwarnings("ignore", "The inplace keyword", DeprecationWarning)
warnings.filterwarnings("ignore", "Estimated shape parameter", UserWarning)
logging.getLogger("arviz").setLevel(logging.ERROR)

# %% [markdown]
# ## The model
#
# The logarithm of the rate is an autoregression, and each row is a Poisson count:
#
# $$x_0 \sim N(\mu, s), \quad x_t \sim N(\mu + a (x_{t-1} - \mu),\, s), \quad y_t \sim \mathrm{Poisson}(e^{x_t}).$$

# %%
import arviz as az
import matplotlib.pyplot as plt
import numpy as np
import torch
from pyro.distributions import Normal, Poisson

from invdyn.inference import compare_methods, infer_states
from invdyn.models import StateSpaceModel


class Counts(StateSpaceModel):
    state_dim, observation_dim, num_steps = 1, 1, 80
    state_names = ("log rate",)

    def __init__(self, mean=1.0, decay=0.95, step=0.3):
        values = {"mean": mean, "decay": decay, "step": step}
        super().__init__({name: torch.tensor([value], dtype=torch.float64) for name, value in values.items()})

    def initial(self):
        return Normal(self.parameters["mean"], self.parameters["step"]).to_event(1)

    def transition(self, state, t):
        p = self.parameters
        return Normal(p["mean"] + p["decay"] * (state - p["mean"]), p["step"]).to_event(1)

    def emission(self, state, t):
        return Poisson(state.exp()).to_event(1)


# %% [markdown]
# ## Rows, and the states behind them
#
# Ten rows are lost. They stay missing: they have no term in the likelihood.

# %%
model = Counts()
states, rows = model.simulate(seed=1)
rows[40:50] = torch.nan

posterior = infer_states(model, rows, seed=0)
rate = np.exp(posterior.posterior["state"].sel(state_name="log rate"))
low, middle, high = rate.quantile([0.05, 0.5, 0.95], ("chain", "draw"))

plt.fill_between(np.arange(80), low, high, alpha=0.3, label="90 %")
plt.plot(middle, label="median")
plt.plot(states[:, 0].exp(), "k--", label="truth")
plt.plot(rows[:, 0], ".", label="counts")
plt.xlabel("row")
plt.legend()
plt.show()
print(f"log evidence {posterior.attrs['log_evidence']:.2f} ± {posterior.attrs['log_evidence_sd']:.2f}")

# %% [markdown]
# ArviZ's own summary, of every tenth state:

# %%
print(az.summary(posterior, var_names=["state"], coords={"time": range(0, 80, 10)}).to_string())

# %% [markdown]
# ## Methods side by side
#
# All see the same model. The particle filters estimate the evidence without bias; `laplace` approximates it.

# %%
comparison = compare_methods(model, rows, ["smc", "bootstrap", "laplace"], truth=states, seed=0, replicates=3)
columns = ["log_evidence", "log_evidence_sd", "replicates_sd", "log rate_crps", "log rate_coverage_90", "outer_ess"]
print(comparison.table[columns].round(2).to_string())

# %% [markdown]
# ## Two models, compared by ArviZ
#
# Does the rate come back to its mean? A random walk (`decay=1`) says no. Leaving out one row at a time, ArviZ finds how
# well each model predicts it.

# %%
walk = infer_states(Counts(decay=1.0), rows, seed=0)
print(az.compare({"autoregression": posterior, "random walk": walk}, ic="loo", var_name="y").round(2).to_string())

# %% [markdown]
# ## Exercises
#
# Answers are folded below each.
#
# **1. More variance than Poisson's.** A negative binomial count has the same mean and a larger variance. Which of the
# two emissions predicts these rows better?

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
from pyro.distributions import NegativeBinomial


class Overdispersed(Counts):
    def emission(self, state, t):
        return NegativeBinomial(4.0, logits=state - np.log(4.0)).to_event(1)


wider = infer_states(Overdispersed(), rows, seed=0)
table = az.compare({"Poisson": posterior, "negative binomial": wider}, ic="loo", var_name="y")
print(table.round(2).to_string())
print(f"{table.index[0]} predicts better: the rows are Poisson counts.")

# %% [markdown]
# **2. A jump.** Add 3 to the log rate from row 30 on. The model knows no jumps: does its evidence tell?

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
torch.manual_seed(2)
jumped = states.clone()
jumped[30:] += 3
counts = torch.poisson(jumped.exp())
found = infer_states(model, counts, seed=0)
low, high = found.posterior["state"].quantile([0.05, 0.95], ("chain", "draw")).values
covered = np.mean((low <= jumped.numpy()) & (jumped.numpy() <= high))
print(f"90 % bands hold {covered:.2f} of the states; log evidence {found.attrs['log_evidence']:.1f}.")
steps = np.diff(found.posterior["state"].mean(("chain", "draw")).values[:, 0])
print(f"The largest step of the mean is {np.abs(steps).max() / 0.3:.0f} standard deviations of the model's own steps.")

# %% [markdown]
# On the command line, with your own counts in a table:
#
# ```text
# invdyn compare model.py:Counts rows.csv --methods smc,laplace --out comparison
# ```
