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
# # A study: many trials, two conditions
#
# An arm is lifted twelve times: six times free, and six times with half as much torque again at the shoulder. The
# elbow's torque is the same. From keypoints alone we ask what the condition changed.
#
# **You will learn**
#
# * how a table of trials becomes one study;
# * what its averages and differences say, and what their intervals hold;
# * which figure to look at first.

# %% tags=["hide-input"]
# %matplotlib inline
import logging
import warnings

warnings.filterwarnings("ignore", r"\s*ArviZ is undergoing", FutureWarning)
warnings.filterwarnings("ignore", "IProgress not found")
logging.getLogger("arviz").setLevel(logging.ERROR)

# %% [markdown]
# ## Trials
#
# Three subjects do two trials in each condition. A trial is a file of keypoints, and the lift begins at a time of its
# own. A further torque, another in each trial, is an Ornstein–Uhlenbeck process.

# %%
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd

import invdyn
from invdyn.inputs import load_body
from invdyn.models import ArmModel, Keypoints, Observation, OrnsteinUhlenbeck
from invdyn.recordings import write_keypoint_csv
from invdyn.simulate import record, resting

arm = load_body("paper_planar_arm")
folder = Path(tempfile.mkdtemp())
rng = np.random.default_rng(0)
time = np.arange(24) / 25
SIZE = np.array([1.0, 0.15])  # N·m, of shoulder and elbow
EFFECT = np.array([0.5, 0.0])  # share by which the load raises it

rows = []
for subject in "abc":
    strength = np.exp(rng.normal(0, 0.1))
    for number in range(4):
        condition = ("free", "load")[number % 2]
        begin = 0.1 + 0.1 * rng.random()
        lift = np.sin(np.pi * np.clip((time - begin) / 0.6, 0, 1)) ** 2
        size = strength * SIZE * (1 + EFFECT * (condition == "load"))
        model = ArmModel(
            arm,
            time,
            Observation(Keypoints(arm.keypoint_names)),
            torque=OrnsteinUhlenbeck(),
            command=lift[:, None] * size,
            substeps=10,
            parameters={
                "emission.keypoint_scale": 0.004,
                "initial.angle": resting(arm),
                "initial.angle_scale": 0.2,
                "initial.velocity_scale": 0.1,
                "torque.scale": [0.5, 0.08],
                "torque.decay": 5.0,
            },
        )
        recording, _ = record(model, int(rng.integers(2**31)))
        name = f"{subject}{number}.csv"
        write_keypoint_csv(recording, folder / name)
        rows.append({"recording": name, "subject": subject, "condition": condition, "event_lift": begin})

table = pd.DataFrame(rows)
table["recording"] = [str(folder / name) for name in table["recording"]]
table.assign(recording=[Path(name).name for name in table["recording"]]).head(4)

# %% [markdown]
# ## One study
#
# Trials of a session share the keypoints' noise and the prior of the torques. Each keeps its initial state.

# %%
study = invdyn.trials(table, arm)
print(f"{len(study.posteriors)} trials inferred, {len(study.left_out)} left out")

# %% [markdown]
# Look first at the trials that were left out, and at those in doubt.

# %%
print(study.reasons.to_string(index=False) if len(study.reasons) else "none left out")
print(study.doubts.to_string(index=False) if len(study.doubts) else "none in doubt")

# %% [markdown]
# The summary has an average of each condition, over subjects.

# %%
peaks = study.summary().query("quantity == 'peak'")
print(peaks.round(2).to_string(index=False))

# %% [markdown]
# ## The difference
#
# Three things to look at: the interval, whether zero is in it, and how many trials it has. `direction` is the
# probability of the difference's sign.

# %%
found = study.difference("condition").query("quantity == 'peak'").set_index("joint")
print(found[["first", "second", "mean", "q05", "q95", "direction", "found", "trials"]].round(3).to_string())
for joint in arm.joint_names:
    row = found.loc[joint]
    print(f"{joint}: load − free {row['mean']:.2f} N·m, 90 % between {row.q05:.2f} and {row.q95:.2f}")

# %% [markdown]
# Three subjects say little of a population, so the interval is wide. With one subject it is that subject's own.

# %% [markdown]
# ## The averages
#
# Trials are aligned at the lift. The dark band is of the average: doubt within trials and spread between them. The
# pale band is of a further trial. Look where the dark bands part: at the shoulder, a third of a second after the lift
# began. At the elbow they should not.

# %%
study.plot(align="lift")

# %% [markdown]
# ## Exercises
#
# 1. Keep only the free trials of `a` and the loaded ones of `b`. What does `confounded` say of the difference, and why?
# 2. Why may the average's dark bands overlap where the difference is found?

# %% [markdown] tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
# 1. It says `subject`. A strong subject and a load look the same, and the interval does not hold that doubt.

# %% [markdown] tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
# 2. A band holds the spread between subjects too. The difference is taken within subjects, so this spread cancels.
