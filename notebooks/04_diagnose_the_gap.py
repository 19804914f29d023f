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
# delay, a crooked camera? Here we play reality ourselves, with an effect that the simulation does not have. Then we
# ask `diagnose` four things. Is there a gap? Where? Which effect causes it? How far does it close once the effect is
# in?
#
# **You will learn**
#
# * what the probability of a cause means, and what "outside the catalogue" means;
# * why some effects cannot be told apart, and what would help;
# * what can be said when nobody knows the torque;
# * how to turn a formula found in the residual torque into an effect of your own.
#
# You need Bayes' rule and the model of [notebook 1](01_planar_arm.py). Three exercises stand at the end.

# %% tags=["hide-input"]
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

from invdyn.diagnosis import CATALOGUE, diagnose
from invdyn.models import Link, planar_body
from invdyn.models.effects import Effect, GravityTilt, Parameter, ViscousFriction
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
body = planar_body("bench arm", [upper, fore], gravity=(0.0, -9.81))


def reality(effect, duration=2.0, **values):
    """Two seconds or so of the arm with one effect, under known commands; 50 frames/s, 2 mm of noise."""
    arm = random_arm(body, duration=duration, fps=50, noise=0.002, commanded=True).with_effects(effect)
    named = {f"effect.{effect.key}.{name}": torch.tensor([v], dtype=torch.float64) for name, v in values.items()}
    return record(arm.replace(**named))[0]


# %% [markdown]
# An **effect** is a small class. Viscous friction adds the torque $-b\,\dot\theta$ at its joint. Every effect of the
# catalogue says where it can act, which parameters it has, and which sizes are plausible: a prior that follows the
# size of the body.

# %%
print(len(CATALOGUE), "effects:", ", ".join(CATALOGUE))
DAMPING = 0.05  # N·m·s/rad
friction = reality(ViscousFriction("elbow"), damping=DAMPING)

# %% [markdown]
# ## The diagnosis
#
# `diagnose` gets the recording and the simulation, and not a word about friction. Between the two it puts a
# **residual torque** $r$ at every joint, which stands for whatever is missing:
#
# $$ D(\theta)\ddot\theta + h(\theta, \dot\theta) + c(\theta) = u + r(t), \qquad r \sim \mathcal{OU}(\text{size}), $$
#
# A cause $c$ is an effect at a place, or several of them, or no gap. Bayes' rule gives its probability $p_c$ from
# its evidence $p(y \mid c)$, with all parameters integrated out, and from its prior. The size of $r$ is unknown,
# too. Let $s_c$ be the probability that next to nothing of $r$ remains once the cause is in. Only that share counts
# for the cause:
#
# $$ P(\text{cause } c) = p_c\, s_c, \qquad P(\text{outside the catalogue}) = \sum_c p_c\,(1 - s_c). $$
#
# So a cause is probable only when it explains the gap *and nothing is left*. Its term of the second sum stands in its
# `in_part`: it is at work, and so is something else.


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
# A near relative may stand among the causes. Drifting friction, for example, has constant friction as a special case,
# so it explains the recording as well. But it has one parameter more, and the evidence punishes that (Occam's
# razor). Something stays outside the catalogue, too. A torque so small that two seconds do not show it is never
# ruled out.
#
# *Where* comes as shares of probability. *How far* comes from data that the fit has not seen. Parameters are fitted on
# the first two thirds. On the last third each frame is predicted from the ones before. Each frame's log score, in nats,
# is taken under the simulation as it is, with the cause, and for a simulation without a gap:
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
# The replay error is that of the simulation run on its own from the smoothed state, set back to it now and then.
#
# `diagnosis.tracks` holds what the report draws. The left panel shows the residual torque at the elbow, before and
# after. The right panel shows the same against the elbow's velocity. It is nearly a straight line through the origin:
# viscous friction, seen by eye. It is flatter than the truth in grey, because the prior of the residual pulls it
# towards zero. The parameter of the friction has no such bias.

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
# angle films the same thing. Turn the whole picture, and gravity points elsewhere in it.

# %%
tilted = diagnose(reality(GravityTilt(), angle=0.05), body)
tell(tilted)
print("cannot be told apart:", *(" / ".join(keys) for keys in tilted.ambiguity_set))
print(tilted.separating_experiment)

# %% [markdown]
# Both angles agree with the truth, and the two causes share the probability. One lies in the dynamics, the other in
# the observation, so *where* is split, too. A longer recording of this kind does not help: the two predict the same
# keypoints, whatever the arm does. Only something that is not in the recording can help. The diagnosis gives such
# rivals as one **ambiguity set**: the fewest causes that hold 95 % of the probability of all that name an effect.

# %%
print("side:", ", ".join(f"{name} {share:.2f}" for name, share in tilted.where.side.items()))

# %% [markdown]
# ## Unknown torque
#
# Take the recording with friction and forget the commands. This is the case of a limb: its muscles tell nobody their
# torque. The residual is now the limb's own torque, and may have any size.

# %%
hidden = replace(friction, torques=None, joint_names=())
unknown = diagnose(hidden, body)
print("regime:", unknown.regime)
tell(unknown)
print("could not have been seen:", ", ".join(unknown.not_identifiable))

# %% [markdown]
# Muscles that add the torque $-b\,\dot\theta$ move the arm as friction does. The keypoints cannot tell the two apart.
# So without commands no effect of the dynamics is named. All of them are in the list of what *could not have been
# seen*, and viscous friction at the elbow, the truth, is one. Here "no gap" does not prove that there is none.
#
# But a torque cannot stretch a link or shift a marker. So most of what only the camera sees stays visible. The
# detectability $d'$ says by how many standard deviations an effect of its usual size stands out:

# %%
seen = {each.key: each.dprime for each in unknown.visibility if each.side == "observation"}
for key, dprime in sorted(seen.items(), key=lambda item: -item[1]):
    print(f"  d' {dprime:6.1f}  {key}")

# %% [markdown]
# ## Outside the catalogue
#
# The elbow's motor sits at the base, and a belt leads over the shoulder to the elbow. When the shoulder turns, the
# belt drags the elbow along with the torque
#
# $$ \tau_\text{elbow} = -b\,\dot\theta_\text{shoulder}. $$
#
# The catalogue has no such effect. We write it, to simulate reality with: a pair of joints, one parameter with its unit
# and prior, and the one stage of the simulation that it changes, the force. Shapes: `now.qd` is (…, K), a parameter
# (…, 1).


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
# Five effects, one at a time, to be quick. Unchecked, an arm that whirls so fast would be asked for its units.
few = {
    name: CATALOGUE[name] for name in ("viscous_friction", "quadratic_drag", "joint_stiffness", "armature", "payload")
}
strange = diagnose(belt, body, effects=few, most=1, checked=True)
tell(strange)
print("formula:", strange.outside.description)
print(f"which predicts each held-out frame better by {strange.outside.gain_per_frame:.2f} nats")

# %% [markdown]
# Whatever effect is tried, a torque is left, so the probability lies outside the catalogue. All 37 take a minute
# and say the same. Then the residual torque is regressed on a library of functions of $(\theta, \dot\theta, u, t)$.
# The result is a formula of at most three terms. It is a hint and no proof. Many sets of terms fit about as well, and
# the standard deviations do not count that choice. Here the first term is that of the truth. Compare its coefficient
# with $-b$.
#
# ## Turn it into an effect
#
# Someone who knows the machine reads "the shoulder's velocity, on the elbow", thinks of the belt, and writes the class
# above. In a catalogue it is a candidate like all others:

# %%
explained = diagnose(belt, body, effects=few | {"belt": BeltDrag}, checked=True)
tell(explained)
print(f"truth: {BELT}; share of the gap closed: {explained.shrinkage.gap_closed:.2f}")

# %% [markdown]
# `CATALOGUE` itself does not change. In place of the class, a `CatalogueEntry` may say more than a diagnosis needs to
# find it: its phrase in the report, its twins and special cases, which values are credible. An effect that is to stay
# becomes a class in `models/effects/` and an entry in `diagnosis/catalogue/`. CONTRIBUTING.md says what else it needs.
#
# Three things to keep in mind with recordings of your own:
#
# * **The body comes first.** State how uncertain masses and lengths are, and they are integrated out. A wrong number
#   that is stated as exact is a gap like any other, and some effect gets the blame.
# * **Test on another motion.** That is worth more than the last third of the same one: `diagnose(one, body,
#   held_out=another)`. An effect that imitates the true one on this motion often fails on another.
# * **Here our own effect classes played reality**, which is the easiest case. `invdyn blind` plays it in another
#   engine and withholds the answers.
#
# ## Exercises
#
# **1. Two causes.** Viscous friction has $p = 0.7$, $s = 0.9$; a payload has $p = 0.3$, $s = 0.2$. What does the
# diagnosis state?

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
p, s = np.array([0.7, 0.3]), np.array([0.9, 0.2])
print("P(cause) = p s:", dict(zip(("viscous friction", "payload"), (p * s).round(2).tolist(), strict=True)))
print("in part, p (1 − s):", (p * (1 - s)).round(2).tolist())
print(f"outside the catalogue, the sum of these: {p @ (1 - s):.2f}")

# %% [markdown]
# **2. A plumb line.** A plumb line hangs in the picture. Does it tell tilted gravity from a rolled camera? Do encoders?

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
angle, down = 0.05, np.array([0.0, -1.0])
turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
print("tilted gravity: the line hangs along gravity, turn @ down =", (turn @ down).round(3).tolist())
print("rolled camera:  it hangs along down, and the picture turns it: the same", (turn @ down).round(3).tolist())
print("A plumb line shows where gravity points in the picture, and the arm's motion shows that already.")
print("Encoders count from the base. Under tilted gravity they agree with the picture.")
print(f"Under a rolled camera the first joint's encoder and the picture differ by {angle} rad. So encoders tell.")

# %% [markdown]
# **3. The least that shows.** How small may the damping be for two seconds to show it? Use the standard deviation
# of the first diagnosis.

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
print(f"The damping is known to ± {estimate.sd:.4f} N·m·s/rad: {DAMPING} is {DAMPING / estimate.sd:.0f} times that.")
print(f"About three of them must stand out, which is {3 * estimate.sd:.4f} N·m·s/rad.")
print(f"Four times as long a recording of the same kind halves that: {3 * estimate.sd / 2:.4f} N·m·s/rad.")
