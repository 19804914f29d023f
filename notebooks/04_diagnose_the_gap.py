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
# # Diagnose the gap
#
# A simulated arm and the real one get the same commands, and part. What does the simulation lack? Friction, a
# delay, a crooked camera? This notebook plays reality with an effect that the simulation does not have, and asks
# `diagnose` for four things: is there a gap, where, which effect causes it, and how far does it close once the
# effect is added. It ends with an effect that no catalogue has.

# %%
# %matplotlib inline
import logging
import warnings

warnings.filterwarnings("ignore", r"\s*ArviZ is undergoing", FutureWarning)
warnings.filterwarnings("ignore", "IProgress not found")
logging.getLogger("arviz").setLevel(logging.ERROR)

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import torch
from pyro.distributions import Normal

from invdyn.diagnosis import diagnose
from invdyn.models import Body, Link
from invdyn.models.effects import EFFECTS, Effect, GravityTilt, Parameter, ViscousFriction
from invdyn.plots import BLUE, GREY, STYLE, VERMILION
from invdyn.simulate import random_arm, record

plt.rcParams.update(STYLE | {"figure.constrained_layout.use": True, "figure.dpi": 90})

# %% [markdown]
# ## Simulation and reality
#
# The simulation is a rigid body: two links, ideal motors, a level camera.

# %%
upper = Link("upper_arm", joint="shoulder", tip="elbow", length=0.30, mass=1.5)
fore = Link("forearm", joint="elbow", tip="wrist", length=0.25, mass=1.0)
body = Body("bench arm", [upper, fore], gravity=(0.0, -9.81))


def reality(effect, duration=2.0, **values):
    """Two seconds or so of the arm with one effect, under known commands; 50 frames/s, 2 mm of noise."""
    arm = random_arm(body, duration=duration, fps=50, noise=0.002, commanded=True).with_effects(effect)
    named = {f"effect.{effect.key}.{name}": torch.tensor([v], dtype=torch.float64) for name, v in values.items()}
    return record(arm.replace(**named))[0]


# %% [markdown]
# An **effect** is a small class. Viscous friction adds the torque $-b\,\dot\theta$ at its joint; every effect of the
# catalogue says where it can act, which parameters it has, and what sizes are plausible (a prior that follows the
# size of the body).

# %%
print(len(EFFECTS), "effects:", ", ".join(EFFECTS))
DAMPING = 0.05  # N·m·s/rad
friction = reality(ViscousFriction("elbow"), damping=DAMPING)

# %% [markdown]
# ## The diagnosis
#
# It is told the recording and the simulation, and not a word about friction. Between the two it puts a **residual
# torque** $r$, an Ornstein–Uhlenbeck process at every joint that stands for whatever is missing,
#
# $$ D(\theta)\ddot\theta + h(\theta, \dot\theta) + c(\theta) = u + r(t), \qquad r \sim \mathcal{OU}(\text{size}), $$
#
# and gives every cause $c$, an effect at a place or several effects, its evidence: how probable are the keypoints
# $y$, parameters integrated out, weighed by the prior. The size of $r$ is unknown too. That it is next to zero once
# the cause is in has a share $s_c$ of the cause's probability $p_c$, and only that share counts for the cause:
#
# $$ P(\text{cause } c) = p_c\, s_c, \qquad P(\text{outside the catalogue}) = \sum_c p_c\,(1 - s_c). $$
#
# So a cause is probable only when it explains the gap *and nothing is left*; what it has of the second sum stands in
# its `in_part`: it is at work, and so is something else. "No gap" is one of the causes.


# %%
def tell(diagnosis):
    """What a diagnosis says, in five lines or so."""
    gap, outside = diagnosis.gap, diagnosis.outside
    print(f"gap: {'yes' if gap.detected else 'no'} (probability {gap.probability:.2f})")
    for cause in diagnosis.causes[:3]:
        print(f"  {cause.probability:.2f}  {' + '.join(f.key for f in cause.effects) or 'no gap'}")
        for finding in cause.effects:
            for name, e in finding.parameters.items():
                print(f"          {name} {e.mean:.4f} {e.unit}, 90 %: {e.interval_90[0]:.4f} to {e.interval_90[1]:.4f}")
    print(f"  {outside.probability:.2f}  outside the catalogue")


diagnosis = diagnose(friction, body)
tell(diagnosis)

# %% [markdown]
# The first line is the verdict, then the causes by probability, with the posterior of their parameters. The truth,
# $b = 0.05$ N·m·s/rad, can be compared with the interval:

# %%
estimate = diagnosis.causes[0].effects[0].parameters["damping"]
print(f"truth {DAMPING}: {(estimate.mean - DAMPING) / estimate.sd:+.1f} standard deviations from the mean")

# %% [markdown]
# Do not be surprised by a near relative among the causes. Drifting friction has constant friction as a special case
# (its slope is then zero), so it explains the recording as well; it has a parameter more to waste, and Occam's
# razor, which the evidence has built in, makes it less probable. Something stays outside the catalogue, too: next to
# friction, a torque so small that two seconds do not show it is not ruled out.
#
# *Where* comes as shares of probability, *how far* from data that the fit has not seen: parameters are fitted on the
# first two thirds, and on the last third each frame is predicted from the ones before. With the log scores of the
# frames, in nats, under the simulation as it is, with the cause, and of a simulation without a gap,
#
# $$ \text{closed} = \frac{\sum (\text{with cause} - \text{as it is})}{\sum (\text{no gap} - \text{as it is})}. $$

# %%
where, shrinkage, replay = diagnosis.where, diagnosis.shrinkage, diagnosis.gap.replay_rms_m
print("side:", ", ".join(f"{name} {share:.2f}" for name, share in where.side.items()))
print("joint:", ", ".join(f"{name} {share:.2f}" for name, share in where.joints.items()))
low, high = shrinkage.interval_90
print(f"share of the gap closed: {shrinkage.gap_closed:.2f} (90 %: {low:.2f} to {high:.2f})")
print(f"replay error: {1000 * replay['nominal']:.1f} mm before, {1000 * replay['corrected']:.1f} mm after")
for joint, before in diagnosis.gap.residual_torque_rms.items():
    after = shrinkage.residual_torque_rms_after[joint]
    print(f"residual torque at the {joint}: {before:.4f} N·m before, {after:.4f} after")

# %% [markdown]
# The replay starts from the smoothed state and runs open loop, set back to it now and then, with the parameters
# fitted to all frames.
#
# `diagnosis.tracks` holds what the report draws. On the left the residual torque at the elbow, before and after; on
# the right the same against the elbow's velocity. Nearly a straight line through the origin: that is viscous friction,
# seen by eye. It is flatter than the truth, in grey, for the prior of the residual pulls it towards zero; the
# friction's own parameter has no such bias.

# %%
tracks = diagnosis.tracks
elbow = body.joint_names.index("elbow")
velocity = tracks.velocity[:, elbow]
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 2.8), sharey=True)
for name, color in (("before", VERMILION), ("after", BLUE)):
    mean, sd = (getattr(tracks, f"residual_{name}{end}")[:, elbow] for end in ("", "_sd"))
    left.fill_between(tracks.time, mean - 1.64 * sd, mean + 1.64 * sd, color=color, alpha=0.25, linewidth=0)
    left.plot(tracks.time, mean, color=color, linewidth=1.2, label=name)
    right.plot(velocity, mean, ".", color=color, markersize=4, label=name)
line = np.array([velocity.min(), velocity.max()])
right.plot(line, -DAMPING * line, color=GREY, linewidth=1, zorder=0, label="−b × velocity")
left.set(title="residual torque at the elbow (N·m), with 90 % bands", xlabel="time (s)")
right.set(title="the same against the elbow's velocity", xlabel="velocity (rad/s)")
for axes in (left, right):
    axes.legend()
plt.show()

# %% [markdown]
# ## Two effects that cannot be told apart
#
# Now gravity is tilted by 0.05 rad: the arm stands on a floor that is not level. A camera that is *rolled* by the same
# angle films the same thing: turn the whole picture, and gravity points elsewhere in it.

# %%
tilted = diagnose(reality(GravityTilt(), angle=0.05), body)
tell(tilted)
print("cannot be told apart:", *(" / ".join(keys) for keys in tilted.ambiguity_set))
print(tilted.separating_experiment)

# %% [markdown]
# Both angles agree with the truth, and the probability is split between the two. One lies in the dynamics, the
# other in the observation, so *where* is split too. No longer recording of this kind will help: the two predict the
# same keypoints, whatever the arm does. What would help is something that is not in the recording. The diagnosis
# gives such rivals as one **ambiguity set**: the fewest causes that hold 95 % of the probability of all that name an
# effect.

# %%
print("side:", ", ".join(f"{name} {share:.2f}" for name, share in tilted.where.side.items()))

# %% [markdown]
# ## Unknown torque
#
# Take the recording with friction and forget the commands, as for a limb, whose muscles tell nobody their torque. The
# residual is now the limb's own torque, of any size.

# %%
hidden = replace(friction, torques=None, joint_names=())
unknown = diagnose(hidden, body)
print("regime:", unknown.regime)
tell(unknown)
print("could not have been seen:", ", ".join(unknown.not_identifiable))

# %% [markdown]
# Muscles whose torque is $-b\,\dot\theta$ more, or less, move the arm as friction does, and the keypoints do not tell
# them apart. So without commands no effect of the dynamics is named, and all of them are in the list of what *could
# not have been seen*; viscous friction at the elbow, the truth, is one. "No gap" is no proof that there is none.
#
# A torque cannot stretch a link or shift a marker. Most of what only the camera sees stays visible:

# %%
seen = {each.key: each.dprime for each in unknown.visibility if each.side == "observation"}
for key, dprime in sorted(seen.items(), key=lambda item: -item[1]):
    print(f"  d' {dprime:6.1f}  {key}")

# %% [markdown]
# ## Outside the catalogue
#
# The elbow's motor sits at the base, and a belt leads over the shoulder to the elbow. It drags the elbow along
# when the shoulder turns: at the elbow acts
#
# $$ \tau_\text{elbow} = -b\,\dot\theta_\text{shoulder}. $$
#
# The catalogue has no such thing. As an effect, to play reality with, it is a dozen lines: a pair of joints, one
# parameter with unit and prior, and one hook, the force. Shapes: `now.qd` is (…, K), a parameter (…, 1).


# %%
class BeltDrag(Effect):
    """Torque −b dθ/dt of the first joint of a pair, on the second."""

    site = "pair"

    def parameters(self, scale):
        inner, outer = self.place
        return (Parameter("damping", "N·m·s/rad", Normal(0.0, 0.5 * scale.torque[outer] / scale.speed[inner])),)

    def force(self, p, now):
        inner, outer = self.place
        return now.at(outer, -p["damping"] * now.qd[..., inner : inner + 1])


BELT = 0.1  # N·m·s/rad
belt = reality(BeltDrag("shoulder", "elbow"), duration=1.2, damping=BELT)  # later it whirls the elbow around
strange = diagnose(belt, body, most=1)  # to try sets of several, too, takes minutes
tell(strange)
print("formula:", strange.outside.description)
print(f"which predicts each held-out frame better by {strange.outside.gain_per_frame:.2f} nats")

# %% [markdown]
# Whatever effect is tried, a torque is left, so the probability lies outside the catalogue. The residual torque is
# then regressed on a library of functions of $(\theta, \dot\theta, u, t)$, and a formula of at most three
# terms comes out, as a hint. It is a hint and no proof: which terms stand in it is a choice among many that are
# alike, and the standard deviations know nothing of that choice. Here its first term is the truth's; compare its
# coefficient with $-b = -0.1$.
#
# ## Turn it into an effect
#
# A person who knows the machine reads "the shoulder's velocity, on the elbow", thinks of the belt, and writes the class
# above. In the catalogue, it is a candidate like all others:

# %%
EFFECTS["belt_drag"] = BeltDrag
explained = diagnose(belt, body)
tell(explained)
print(f"truth: {BELT}; share of the gap closed: {explained.shrinkage.gap_closed:.2f}")

# %% [markdown]
# An effect that is to stay becomes a file in `models/effects/`; CONTRIBUTING.md says what else it needs, and one set
# of tests checks every effect of the catalogue.
#
# Three things to keep in mind with recordings of your own:
#
# * **The body comes first.** Uncertain masses and lengths are integrated out where the body file states their
#   uncertainty. A number that is wrong and stated as exact is a gap like any other, and gets blamed on some effect.
# * **Held-out data of another kind** is worth more than the last third of the same motion: `diagnose(one, body,
#   held_out=another)`. An effect that imitates the true one on this motion often fails on another.
# * **Here reality was played by our own effect classes**, which is the easiest of cases. `invdyn blind` plays it in
#   another engine and withholds the answers.
